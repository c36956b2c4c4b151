"""`teleop export` and `teleop stream` as they are typed: what they answer, and what they refuse in a sentence."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import pytest

import teleop.export.command
import teleop.export.files
from teleop.scene.library import ROOT
from tests.waiting import PATIENCE

Typed = Callable[..., Any]
Stored = Callable[[str], Path]
NEEDS_MCAP = pytest.mark.skipif(find_spec("mcap") is None, reason="needs the extra `log`")


@pytest.fixture
def here(tmp_path: Path, stored: Stored) -> Path:
    shutil.copytree(stored("canonical"), tmp_path / "here")
    return tmp_path


def left(folder: Path) -> list[str]:
    """All that is in the folder beside the run itself, hidden files too."""
    return sorted(os.listdir(folder))


@NEEDS_MCAP
def test_both_files_are_written_and_named(typed: Typed, here: Path) -> None:
    answer = typed("export", "here", "--mcap", "run.mcap", "--csv", "run.csv")
    assert (answer.code, answer.err) == (0, "")
    for text in ("here (canonical, virtual)", "run.csv, 300 rows", "run.csv-metadata.json", "run.mcap",
                 "/master: 300 messages", "/log: 2 messages"):
        assert text in answer.out
    assert left(here) == ["here", "run.csv", "run.csv-metadata.json", "run.mcap"]


@pytest.mark.usefixtures("here")
def test_the_document_of_an_export_begins_as_that_of_every_command(typed: Typed) -> None:
    document = json.loads(typed("export", "here", "--csv", "run.csv", "--json").out)
    assert [*document][:9] == ["status", "sentence", "scene", "mode", "parameters", "seed", "versions", "command", "dt"]
    assert document["csv"] == {"file": "run.csv", "metadata": "run.csv-metadata.json", "rows": 300}


WRONG = {
    "no file": (["here"], ["--mcap FILE or --csv FILE"]),
    "a file that is there": (["here", "--csv", "there"], ["there is there already"]),
    "a link that is there": (["here", "--csv", "link"], ["link is there already"]),
    "the file beside it is there": (["here", "--csv", "x"], ["x-metadata.json is there already"]),
    "no folder to write into": (["here", "--csv", "no/x.csv"], ["there is no folder no"]),
    "no run": (["none", "--csv", "y.csv"], ["there is no folder none"]),
    "a file for a run": (["there", "--csv", "y.csv"], ["there is no folder there"]),
    "one file for both": (["here", "--csv", "y", "--mcap", "y"], ["would both write y"]),
    "a name too long": (["here", "--csv", "y" * 300], ["too long"]),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_export_is_refused_and_leaves_nothing(typed: Typed, here: Path, what: str) -> None:
    (here / "there").write_text("mine")
    (here / "link").symlink_to("nowhere")
    (here / "x-metadata.json").write_text("mine")
    before = left(here)
    arguments, words = WRONG[what]
    typed("export", *arguments).assert_refused(*words)
    assert left(here) == before
    assert (here / "there").read_text() == "mine"


@pytest.mark.usefixtures("here")
def test_without_the_extra_it_says_what_to_install(typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("teleop.export.files.find_spec", lambda _: None)
    typed("export", "here", "--mcap", "run.mcap").assert_refused("pip install 'bilateral-teleop[log]'")
    assert typed("export", "here", "--csv", "run.csv").code == 0


SMALL = """
import resource, signal, sys
from teleop.__main__ import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), -1))
sys.exit(main(sys.argv[2:]))
"""


@NEEDS_MCAP
@pytest.mark.parametrize("kind", ["csv", "mcap"])
@pytest.mark.parametrize("size", [100, 30_000])
def test_a_disk_that_takes_no_more_leaves_nothing_half_written(
    process: Callable[..., subprocess.Popen[str]], ended: Callable[..., Any], here: Path, kind: str, size: int
) -> None:
    words = [str(size), "export", "here", f"--{kind}", f"run.{kind}"]
    answer = ended(process("-B", "-c", SMALL, *words))  # -B: without bytecode, which would be cut off too
    answer.assert_refused(f"could not write run.{kind}", os.strerror(errno.EFBIG), "nothing was left there")
    assert left(here) == ["here"]


@NEEDS_MCAP
def test_if_one_of_two_files_finds_no_room_neither_is_there(
    typed: Typed, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: BinaryIO, *_: object) -> dict[str, int]:
        file.write(b"some")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("teleop.export.files.write_mcap", full)
    typed("export", "here", "--csv", "run.csv", "--mcap", "run.mcap").assert_refused("No space left", "run.mcap")
    assert left(here) == ["here"]


def test_ctrl_c_leaves_nothing_half_written(typed: Typed, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(file: BinaryIO, *_: object) -> int:
        file.write(b"some")
        os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError("it went on")

    monkeypatch.setattr(teleop.export.files, "write_csv", interrupted)
    answer = typed("export", "here", "--csv", "run.csv")
    assert answer.code == 130
    assert "nothing half-written is left" in answer.err
    assert left(here) == ["here"]


def test_a_file_that_comes_meanwhile_is_not_overwritten(
    typed: Typed, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def meanwhile(*_: object) -> int:
        (here / "run.csv").write_text("mine")
        return 0

    monkeypatch.setattr(teleop.export.files, "write_csv", meanwhile)
    typed("export", "here", "--csv", "run.csv").assert_refused("run.csv is there already")
    assert (here / "run.csv").read_text() == "mine"


STREAMS = {
    "a host that nobody knows": (["--plotjuggler", "no.such.host.invalid:9870"], ["no.such.host.invalid", "not known"]),
    "a port that is none": (["--plotjuggler", "127.0.0.1:port"], ["HOST:PORT"]),
    "a port beyond all": (["--plotjuggler", "127.0.0.1:70000"], ["HOST:PORT"]),
    "port 0": (["--plotjuggler", "127.0.0.1:0"], ["port of PlotJuggler's UDP Server, not 0"]),
    "no address": ([], ["--plotjuggler"]),
    "no rows": (["--plotjuggler", "127.0.0.1:9", "--rows", "0"], ["--rows", "at least 1"]),
    "a run in virtual time": (["--plotjuggler", "127.0.0.1:9"], ["in virtual time", "teleop export here"]),
}


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("what", STREAMS)
def test_a_wrong_stream_is_refused(typed: Typed, what: str) -> None:
    arguments, words = STREAMS[what]
    typed("stream", "here", *arguments).assert_refused(*words)


@NEEDS_MCAP
@pytest.mark.skipif(sys.platform != "linux", reason="the peak is in kB on Linux alone")
def test_memory_does_not_go_with_the_length_of_the_run(tmp_path: Path) -> None:
    """A run of 15 times the length takes at most a few MB more: chunk indices, and the times of a block."""
    from tests.teleop.export.conftest import LiveEnd

    peaks = []
    for name, ticks in (("short", 8_000), ("long", 120_000)):
        LiveEnd(tmp_path / name, "m", range(ticks), knobs={"duration": "200"}).close()
        script = ("import resource, sys; from teleop.__main__ import main; main(sys.argv[1:]);"
                  "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)")
        words = ["export", name, "--csv", f"{name}.csv", "--mcap", f"{name}.mcap"]
        # what a killed process left is made whole by a process of its own, which needs memory for a column
        subprocess.run([sys.executable, "-m", "teleop", "report", name], cwd=tmp_path, check=True, capture_output=True,
                       env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=PATIENCE)
        done = subprocess.run([sys.executable, "-c", script, *words], cwd=tmp_path, check=True, capture_output=True,
                              text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=PATIENCE)
        peaks.append(int(done.stdout.split()[-1]) / 1024)  # MB
    size = (tmp_path / "long" / "trace.npz").stat().st_size / 2**20
    assert size > 10.0
    assert peaks[1] - peaks[0] < 0.5 * size
