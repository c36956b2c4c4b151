"""`teleop demo`: three processes started, watched, followed, merged into one folder, and never left behind."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import load_result, load_scene, run
from teleop.live.demo import EndOptions, demo
from teleop.scene.library import ROOT
from tests.live.conftest import Demo, running
from tests.waiting import until

pytestmark = pytest.mark.live


Start = Callable[..., Any]
ONE = ("hard_wall", "--set", "duration=1")
LONG = ("hard_wall", "--set", "duration=600")


def children(pid: int) -> dict[str, int]:
    """The live processes that this one started, by their module's name."""
    return {words.split(" -m ")[1].split()[0]: child for child, words in running(pid).items() if " -m " in words}


def gone(pid: int) -> bool:
    return pid not in running()


def until_all_run(one: Any, tmp_path: Path) -> dict[str, int]:
    """Wait until slave, channel and master are up and the master has written rows; their process ids."""
    record = tmp_path / "out" / "master" / "record.bin"
    until(lambda: record.exists() and record.stat().st_size > 5000)
    found = children(one.process.pid)
    assert set(found) == {"slave", "channel", "master"}
    return found


def test_a_demo_ends_with_a_table_and_a_folder(demo_run: Demo) -> None:
    out, err = demo_run.out, demo_run.err
    assert "\x1b" not in out + err
    assert "\r" not in out + err
    for row in ("tracking error", "force error", "force at the end", "delay seen", "packets", "late ticks", "real time",
                "link energy", "time per tick"):
        assert f"\n{row} " in out
    assert out.splitlines()[-1] == f"written to {demo_run.folder}"
    got = load_result(demo_run.folder)
    assert (got.mode, got.status, got.scene) == ("live", "ok", "hard_wall")
    assert 0 < got.ticks <= 2000
    assert 0.045 < got.metrics["T_fwd_mean"] < 0.5
    assert got.metrics["E_link_min"] >= -1e-12
    for way in ("fwd", "bwd"):
        counts = got.packets[way]
        assert counts.rejected == {}
        assert 0.01 < counts.lost / counts.sent < 0.12  # counted where it happens, in the channel
        assert counts.received + counts.lost + counts.in_flight == counts.sent
    for end in ("master", "slave"):
        assert (demo_run.folder / end / "record.bin").is_file()
        assert {"late_us", "delay", "rtt", "clock"} <= set(got.extra[end])


@pytest.mark.parametrize("knobs", [
    {"scene": "canonical", "duration": "0.3", "law": f"{ROOT}/scenarios/examples/law.py", "law.K": "300",
     "link": "uniform(0.01) | duplicate(0.1) ; delay(0.03)"},
    pytest.param({"scene": "jittery_wan", "duration": "0.4"}, marks=pytest.mark.full),
    pytest.param({"scene": "local", "duration": "0.3", "law": "direct"}, marks=pytest.mark.full),
])
def test_a_stepped_demo_is_the_virtual_run_to_the_bit(knobs: dict[str, str], tmp_path: Path) -> None:
    name, given = knobs["scene"], {key: value for key, value in knobs.items() if key != "scene"}
    live = demo(name, given, EndOptions(lockstep=True), seed=5, out=str(tmp_path / "out"), stem="demo", json=True,
                command=["demo"])
    virtual = run(load_scene(name, **given), seed=5)
    assert (live.mode, live.status, live.sentence) == ("lockstep", virtual.status, virtual.sentence)
    assert list(live.trace) == list(virtual.trace)
    for column, numbers in virtual.trace.items():
        assert live.trace[column].tobytes() == numbers.tobytes(), column
    assert live.metrics == virtual.metrics
    assert live.packets == virtual.packets
    with np.load(tmp_path / "out" / "trace.npz") as written:
        assert written["x_s"].tobytes() == virtual.trace["x_s"].tobytes()


@pytest.mark.full
def test_a_demo_refused_the_rate_and_the_spin_that_its_ends_take(command: Start, tmp_path: Path) -> None:
    """And a scene may print what it likes: lines longer than any event are passed over, of stderr the end is kept."""
    (tmp_path / "loud.py").write_text(
        "import sys\nfrom scenarios import hard_wall\n\ndef scene(*, delay: float = 0.01):\n"
        "    print('hello')\n    print('[1]')\n"
        "    for _ in range(3):\n        print('x' * 3_000_000, flush=True)\n"
        "        print('y' * 300_000, file=sys.stderr)\n"
        "    return hard_wall.scene(delay=delay, duration=0.5)\n")
    code, out, err = command("scenarios", "demo", "loud.py", "--rate", "500", "--spin", "--out", "out").end()
    assert code == 0, err[-500:]
    assert "ran to its end, 250 ticks of 0.002 s" in out
    assert "written to out" in out
    for name in ("master", "slave"):
        typed = json.loads((tmp_path / "out" / name / "summary.json").read_text())["command"]
        assert typed[typed.index("--rate") + 1] == "500.0"
        assert "--spin" in typed


def test_an_interrupted_demo_saves_what_there_is_and_leaves_nobody_behind(command: Start, tmp_path: Path) -> None:
    one = command("scenarios", "demo", *LONG, "--out", "out", "--json")
    started = until_all_run(one, tmp_path)
    one.signal(signal.SIGINT)
    one.signal(signal.SIGINT)  # an impatient finger
    code, out, err = one.end()
    assert (code, err) == (130, "")  # what follows behind && does not take it for a whole run
    told = json.loads(out)  # one object and nothing else
    assert (told["status"], told["path"]) == ("stopped", "out")
    assert set(told["channel"]["counts"]) == {"fwd", "bwd"}
    assert "it was asked to stop" in told["sentence"]
    assert load_result(tmp_path / "out").ticks > 0
    assert all(gone(pid) for pid in started.values())


def test_a_demo_that_is_interrupted_before_it_runs_leaves_nothing(command: Start, tmp_path: Path) -> None:
    one = command("scenarios", "demo", *LONG, "--out", "out")
    until((tmp_path / "out").exists)
    one.signal(signal.SIGINT)
    code, out, err = one.end()
    assert (code, out) == (130, "")
    assert len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
    assert children(one.process.pid) == {}


def test_a_demo_that_is_killed_takes_its_processes_with_it(command: Start, tmp_path: Path) -> None:
    one = command("scenarios", "demo", *LONG, "--out", "out")
    started = until_all_run(one, tmp_path)
    one.signal(signal.SIGKILL)
    try:
        until(lambda: all(gone(pid) for pid in started.values()))
    finally:
        for pid in started.values():
            if not gone(pid):
                os.kill(pid, signal.SIGKILL)
    for end in ("master", "slave"):
        assert json.loads((tmp_path / "out" / end / "summary.json").read_text())["status"] == "stopped"


@pytest.mark.parametrize("name", [
    "channel", *(pytest.param(name, marks=pytest.mark.full) for name in ("slave", "master"))])
def test_who_is_killed_is_said_and_the_others_stop_and_keep_their_records(
    name: str, command: Start, tmp_path: Path
) -> None:
    one = command("scenarios", "demo", *LONG, "--out", "out")
    started = until_all_run(one, tmp_path)
    os.kill(started[name], signal.SIGKILL)
    err = one.refused(f"the {name} was ended by the signal SIGKILL", "what was recorded is in out")
    assert "Traceback" not in err
    for left in {"master", "slave"} - {name}:
        assert json.loads((tmp_path / "out" / left / "summary.json").read_text())["status"] == "stopped"
    assert all(gone(pid) for pid in started.values())


@pytest.mark.full
def test_on_a_terminal_one_line_is_written_over_itself(command: Start) -> None:
    """What a terminal is sent is carriage returns, text and colours: no other order, one line at the end."""
    ours, its = pty.openpty()
    one = command("scenarios", "demo", *ONE, "--out", "out", stderr=its)
    os.close(its)
    shown = b""
    with suppress(OSError):  # how the terminal says that its other side is closed
        while part := os.read(ours, 65536):
            shown += part
    os.close(ours)
    code, out, _ = one.end()
    assert code == 0
    assert out.endswith("written to out\n")
    text = re.sub(r"\x1b\[\d*m", "", shown.decode())  # an end that is safe is said in a colour
    assert {c for c in text if not c.isprintable()} <= {"\r", "\n"}
    assert text.count("\n") == 1
    frames = [frame for frame in text.strip().split("\r") if frame]
    assert len(frames) > 2
    assert max(map(len, frames)) <= 80
    assert all(re.search(r"  f [-\d./]+ N  queue [-\d./]+ ms  x [-\d./]+ mm", frame) for frame in frames)
    assert all("delay " in frame or "nothing heard" in frame for frame in frames)
    assert re.search(r"\d%  (\d+ s left  )?(\w+ )?(SAFE|f )", frames[-1]), "how much is done, and the numbers behind it"
