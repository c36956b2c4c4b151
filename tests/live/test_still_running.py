"""A live folder that is opened while its process runs: what there is so far is shown, and nothing is written."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused, load_result, load_scene
from teleop.__main__ import main
from teleop.live.records.end_result import NAMES
from teleop.live.records.inputs import ARRIVALS, INPUTS
from teleop.live.records.merge import merge, needs_recovery
from teleop.live.records.reader import FILE
from teleop.protocol.guard import Event
from teleop.simulation.result import RUNNING
from teleop.storage.folder import is_being_written
from tests.live.recording import add_rows, record_of

SCENE = load_scene("hard_wall", duration=60.0)
MET = [Event(0, "met", "session 1")]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="folders are not locked there")

CHILD = """
import sys
from pathlib import Path
from teleop.protocol.guard import Event
from teleop.storage.folder import claim
from tests.live.recording import add_rows, record_of

e, out = sys.argv[1:]
claimed, done = claim(out), 0
if e == "demo":
    print("there", flush=True)
    sys.stdin.readline()
recorder = record_of(Path(claimed.path), e, events=[Event(0, "met", "session 1")], duration="60.0")
print("there", flush=True)
for line in sys.stdin:  # a number of ticks more
    add_rows(recorder, range(done, done + int(line)))
    done += int(line)
    recorder.flush()
    print(done, flush=True)
"""


class End:
    """An end in a process of its own that records as many ticks as it is told to."""

    def __init__(self, e: str, folder: Path) -> None:
        self.folder = folder
        self.process = subprocess.Popen([sys.executable, "-c", CHILD, e, str(folder)], stdin=subprocess.PIPE,
                                        stdout=subprocess.PIPE, text=True)
        self._heard()

    def tick(self, count: int) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{count}\n")
        self.process.stdin.flush()
        self._heard()

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()

    def _heard(self) -> None:
        assert self.process.stdout is not None
        assert self.process.stdout.readline() != ""


Start = Callable[[str, Path], End]


@pytest.fixture
def start() -> Iterator[Start]:
    ends: list[End] = []

    def begin(e: str, folder: Path) -> End:
        ends.append(End(e, folder))
        return ends[-1]

    yield begin
    for end in ends:
        end.kill()


def left_in(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def shown(capsys: pytest.CaptureFixture[str], *typed: object) -> str:
    assert main(["report", *map(str, typed)]) == 0
    return capsys.readouterr().out


def test_a_run_that_was_reported_while_it_ran_and_then_killed_stayed_at_that_tick_for_good(
    start: Start, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And a running process was said to have "ended without a word"."""
    end = start("m", tmp_path / "m")
    end.tick(1000)
    assert not is_being_written(tmp_path)
    assert not is_being_written(tmp_path / "not there")
    os.kill(end.process.pid, signal.SIGSTOP)  # a process that stands still lives
    assert is_being_written(tmp_path / "m")
    os.kill(end.process.pid, signal.SIGCONT)
    before = left_in(tmp_path)
    said = shown(capsys, tmp_path / "m")
    assert "still running: this is its record up to tick 999" in said
    assert "nothing is written while it runs" in said
    assert "without a word" not in said
    assert json.loads(shown(capsys, tmp_path / "m", "--json"))["status"] == RUNNING
    assert left_in(tmp_path) == before
    end.tick(2000)
    assert load_result(tmp_path / "m").ticks == 3000
    end.tick(500)
    end.kill()
    assert not is_being_written(tmp_path / "m")
    for _ in range(2):
        result = load_result(tmp_path / "m")
        assert (result.status, result.ticks, len(result.trace["t"])) == ("stopped", 3500, 3500)
        assert result.sentence.startswith("the process ended without a word after tick 3499")


def test_a_run_that_has_not_ticked_yet_is_said_to_have_just_begun(start: Start, tmp_path: Path) -> None:
    start("m", tmp_path / "m")
    with pytest.raises(Refused, match="has not come to its first tick yet; ask again in a moment"):
        load_result(tmp_path / "m")
    start("demo", tmp_path / "demo")
    with pytest.raises(Refused, match="is being written, and there is nothing to show of it yet; ask again"):
        load_result(tmp_path / "demo")
    start("m", tmp_path / "demo" / "master").tick(1)
    with pytest.raises(Refused, match="is being written, and there is nothing to show of it yet"):
        load_result(tmp_path / "demo")


def test_two_ends_of_which_one_was_killed_and_one_runs_are_shown_and_not_written(
    start: Start, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    master, slave = start("m", tmp_path / "m"), start("s", tmp_path / "s")
    master.tick(1000)
    slave.tick(1200)
    said = shown(capsys, tmp_path / "m", tmp_path / "s", "--out", tmp_path / "both")
    assert "still running: master and slave; these are the ticks that both have run" in said
    slave.kill()
    said = shown(capsys, tmp_path / "m", tmp_path / "s", "--out", tmp_path / "both")
    assert "still running: master;" in said
    assert "slave: the process ended without a word after tick 1199" in said
    assert not (tmp_path / "both").exists()
    assert [sorted(left_in(tmp_path / each)) for each in "ms"] == [[ARRIVALS, "events.jsonl", INPUTS, FILE]] * 2
    master.tick(150)
    master.kill()
    assert "written to" in shown(capsys, tmp_path / "m", tmp_path / "s", "--out", tmp_path / "both")
    assert load_result(tmp_path / "both").ticks == 1150


def test_the_folder_of_a_demo_is_whole_when_neither_end_nor_demo_runs(start: Start, tmp_path: Path) -> None:
    top = tmp_path / "top"
    demo = start("demo", top)
    ends = [start(e, top / name) for e, name in NAMES.items()]
    for end in ends:
        end.tick(1000)
    assert load_result(top).status == RUNNING
    ends[0].kill()
    assert load_result(top).status == RUNNING
    ends[1].tick(500)
    ends[1].kill()
    result = load_result(top)
    assert result.status == RUNNING
    assert result.sentence.startswith("still running: both ends are over")
    assert not (top / "summary.json").exists()
    demo.kill()
    result = load_result(top)
    assert (result.status, result.ticks) == ("stopped", 1000)
    assert (top / "summary.json").exists()


def test_a_summary_that_was_made_too_early_is_made_again_when_the_record_has_grown(tmp_path: Path) -> None:
    """Where a folder cannot be locked, or was copied while it was written, a process cannot be seen to run."""
    recorder = record_of(tmp_path, "m", range(500), events=MET, duration="60.0")
    recorder.flush()
    assert load_result(tmp_path).ticks == 500
    assert not needs_recovery(tmp_path)
    add_rows(recorder, range(500, 800))
    recorder.flush()
    assert needs_recovery(tmp_path)
    assert load_result(tmp_path).ticks == 800
    recorder.close()
    summary: Any = json.loads((tmp_path / "summary.json").read_text())
    del summary["recovered"]  # what an end writes that came to its own end
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    with (tmp_path / FILE).open("ab") as file:
        file.write(bytes(8))
    assert not needs_recovery(tmp_path)


def test_two_ends_put_together_too_early_are_put_together_again(tmp_path: Path) -> None:
    top = tmp_path / "top"
    later = [record_of(top / name, e, range(750), duration="60.0") for e, name in NAMES.items()]
    assert load_result(top).ticks == 750
    for recorder in later:
        add_rows(recorder, range(750, 1000))
        recorder.close()
    assert load_result(top).ticks == 1000
    shutil.rmtree(top / "slave")  # what was put together once is still there to be read
    assert load_result(top).ticks == 1000


def test_an_end_that_comes_to_its_end_while_it_is_read_is_not_cut_off_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ran when the record was read, and had written its own summary when that was looked for."""
    folders = [tmp_path / name for name in NAMES.values()]
    for e, folder in zip(NAMES, folders, strict=True):
        record_of(folder, e, range(500), duration="60.0").close()
        load_result(folder)
    monkeypatch.setattr("teleop.live.records.merge.is_being_written", lambda folder: folder == folders[0])
    assert merge(SCENE, *folders).status == RUNNING
