"""`teleop export`, `stream` and `manifest` as they are typed: what they answer, and what they refuse in a sentence."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import tracemalloc
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import msgpack
import pytest

import teleop.export.files
from teleop.__main__ import main
from teleop.export.files import write_csv, write_mcap
from teleop.export.stored import read_parts
from teleop.protocol.manifest import live_manifest
from teleop.protocol.packet import Kind, Packet, decode
from teleop.scene.loading import live_knobs, load_scene
from tests.teleop.export.conftest import LiveEnd

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
    document = json.loads(typed("export", "here", "--csv", "b.csv", "--json").out)
    assert [*document][:9] == ["status", "sentence", "scene", "mode", "parameters", "seed", "versions", "command", "dt"]
    assert document["csv"] == {"file": "b.csv", "metadata": "b.csv-metadata.json", "rows": 300}


def test_what_is_there_is_not_overwritten_and_a_run_in_virtual_time_is_not_followed(typed: Typed, here: Path) -> None:
    (here / "there").write_text("mine")
    (here / "link").symlink_to("nowhere")
    (here / "x-metadata.json").write_text("mine")
    before = left(here)
    for words, sentence in (
            (["there"], "there is there already"), (["link"], "link is there already"),
            (["x"], "x-metadata.json is there already"), (["no/x.csv"], "there is no folder no"),
            (["y" * 300], "too long")):
        typed("export", "here", "--csv", *words).assert_refused(sentence)
    typed("stream", "here", "--plotjuggler", "127.0.0.1:9").assert_refused("in virtual time", "teleop export here")
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
@pytest.mark.parametrize(("kind", "size"), [("csv", 100), ("mcap", 30_000)])
def test_a_disk_that_takes_no_more_leaves_nothing_half_written(process: Callable[..., subprocess.Popen[str]],
        ended: Callable[..., Any], here: Path, kind: str, size: int) -> None:
    words = [str(size), "export", "here", f"--{kind}", f"run.{kind}"]
    answer = ended(process("-B", "-c", SMALL, *words))  # -B: without bytecode, which would be cut off too
    answer.assert_refused(f"could not write run.{kind}", os.strerror(errno.EFBIG), "nothing was left there")
    assert left(here) == ["here"]


@NEEDS_MCAP
def test_if_one_of_two_files_finds_no_room_or_is_interrupted_neither_is_there(typed: Typed, here: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    def full(file: BinaryIO, *_: object) -> dict[str, int]:
        file.write(b"some")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def interrupted(file: BinaryIO, *_: object) -> int:
        file.write(b"some")
        os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError("it went on")

    words = ("export", "here", "--csv", "run.csv", "--mcap", "run.mcap")
    monkeypatch.setattr("teleop.export.files.write_mcap", full)
    typed(*words).assert_refused("No space left", "run.mcap")
    assert left(here) == ["here"]
    monkeypatch.setattr("teleop.export.files.write_mcap", interrupted)
    answer = typed(*words)
    assert answer.code == 130
    assert "nothing half-written is left" in answer.err
    assert left(here) == ["here"]


def test_a_file_that_came_meanwhile_is_kept(typed: Typed, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def meanwhile(*_: object) -> int:
        (here / "run.csv").write_text("mine")
        return 0

    monkeypatch.setattr(teleop.export.files, "write_csv", meanwhile)
    typed("export", "here", "--csv", "run.csv").assert_refused("run.csv is there already")
    assert (here / "run.csv").read_text() == "mine"


@pytest.mark.full
@NEEDS_MCAP
def test_memory_does_not_go_with_the_length_of_the_run(tmp_path: Path) -> None:
    """A run of half as much again takes hardly more: chunk indices, and the times of a block."""
    peaks = []
    for name, ticks in (("first", 1_000), ("short", 9_000), ("long", 14_000)):  # the first fills caches
        LiveEnd(tmp_path / name, "m", range(ticks), knobs={"duration": "200"}).close()
        parts = read_parts(tmp_path / name, trust=False)  # which makes it whole, in memory for a column
        tracemalloc.start()
        with (tmp_path / f"{name}.csv").open("wb") as rows, (tmp_path / f"{name}.mcap").open("wb") as messages:
            write_csv(rows, parts)
            write_mcap(messages, parts, "a test")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[2] - peaks[1] < 0.4 * (tmp_path / "long" / "trace.npz").stat().st_size


def said(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main(["manifest", *words, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def places(found: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    assert [one["place"] for one in found] == list(range(len(found)))
    return [(one["axis"], one["name"], one["kind"]) for one in found]


def test_its_manifest_is_that_of_the_ends_also_as_bytes(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "manifest"
    found = said(capsys, "hard_wall", "--set", "k_e=2000", "--write", str(file))
    own = live_manifest(load_scene("hard_wall", **live_knobs("hard_wall", {"k_e": "2000"})))
    assert found["manifest"] == own == msgpack.unpackb(file.read_bytes())
    assert found["manifest_hex"] == file.read_bytes().hex()
    assert own["k_e"] == "2000.0"


def test_its_examples_are_packets_of_the_scene(capsys: pytest.CaptureFixture[str]) -> None:
    found = said(capsys, "hard_wall")
    for name in ("forth", "back"):
        data = bytes.fromhex(found["examples"][name])
        packet = decode(data, len(found[name]))
        assert isinstance(packet, Packet)
        assert (packet.kind, packet.payload, len(data)) == (Kind[name.upper()], (0.0, 0.125, 0.25, 0.375), 100)
    hello = decode(bytes.fromhex(found["examples"]["hello"]), 0)
    assert isinstance(hello, Packet)
    assert (hello.kind, hello.payload) == (Kind.HELLO, found["manifest"])


def test_waves_have_integrals_behind_all_axes_and_coupled_axes_one_total(capsys: pytest.CaptureFixture[str]) -> None:
    found = said(capsys, "recorded_reach", "--set", "law=wave")
    waves = [(axis, "u", "wave") for axis in "xyz"]
    along = [(axis, name, "integral") for axis in "xyz" for name in "UE"]
    assert places(found["forth"]) == [*waves, *along, ("", "T", "integral")]
    assert found["E_in"] is False
    found = said(capsys, "recorded_reach", "--set", "law=tdpa")
    moves = [(axis, name, kind) for axis in "xyz" for name, kind in (("x", "position"), ("v", "sample"))]
    assert places(found["forth"]) == [*moves[:2], ("", "E", "total"), *moves[2:]]
    assert found["forth"][1]["says"] == "the master's velocity, m/s"
    assert found["E_in"] is True
    told = {(one["axis"], one["name"]): one["says"].rpartition(", ")[2] for one in said(capsys, "pose")["forth"]}
    assert (told["z", "x"], told["z", "v"], told["rx", "x"], told["rx", "v"]) == ("m", "m/s", "rad", "rad/s")


def test_a_person_reads_sizes_places_and_the_bytes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["manifest", "hard_wall", "--set", "law=pp"]) == 0
    out = capsys.readouterr().out
    for words in ("100 bytes, exactly", "1000000 ns", "1  x  v  sample    the master's velocity, m/s",
                  "law           pp PositionPosition(K=400.0, B=4.0, rejoin=2.0)", "  4254040000"):
        assert words in out
