"""A session of `teleop study run` as it is typed, for a scripted person in a browser or behind a socket."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path
from tempfile import mkdtemp
from threading import Thread
from types import TracebackType

from teleop.law import known_laws
from tests.live.conftest import OWN, running
from tests.waiting import PATIENCE, until

PLAN = '''
name = "try"
scene = "hard_wall"
set = {{delay = 0.02}}
turn = 1.0
[participants]
least = 2
most = 4
multiple_of = 2
[[condition]]
name = "first condition"
set = {{law = "wave"}}
[[condition]]
name = "other condition"
set = {{law = "tdpa"}}
[task]
{task}
[analysis]
primary = "{primary}"
contrasts = [["first condition", "other condition"]]
'''
NAMES = re.compile(r"\b(" + "|".join(sorted({*known_laws()} - {"direct"})) + r")\b|(first|other) condition|law\.|E_in_")
"""What names a condition; `direct` is a word of style sheets too."""


class StudySession:
    """The process of a session; `url` is its address. `lines`: what it has printed on its standard error."""

    def __init__(self, folder: Path, *words: str, participant: int = 1) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "teleop", "study", "run", "plan.toml", "--participant", str(participant), "--out",
             "study", *words], cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            env={**OWN, "XDG_RUNTIME_DIR": mkdtemp()})
        self.lines: list[str] = []
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()
        until(lambda: self.url or self.process.poll() is not None)
        assert self.url, self.lines

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)

    @property
    def url(self) -> str:
        found = re.search(r"http://\S+", "".join(self.lines))
        return found[0] if found else ""

    def command_lines(self) -> list[str]:
        """The command lines of the processes that it has started."""
        return list(running(self.process.pid).values())

    def interrupt(self) -> str:
        """End it as by Ctrl-C; what it prints in the end."""
        self.process.send_signal(signal.SIGINT)
        return self.wait()

    def wait(self) -> str:
        """What it prints in the end."""
        assert self.process.stdout is not None
        out = self.process.stdout.read()
        assert self.process.wait(PATIENCE) == 0, (out, self.lines)
        self._reader.join(PATIENCE)
        return out

    def __enter__(self) -> StudySession:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


def readable(folder: Path) -> str:
    """The names of all files of a study, and what stands in those that any user may read, but for the plan."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    texts = [path.read_bytes().decode(errors="replace") for path in paths
             if path.stat().st_mode & 0o004 and path.name != "plan.toml"]
    return "\n".join([*(str(path.relative_to(folder)) for path in paths), *texts])
