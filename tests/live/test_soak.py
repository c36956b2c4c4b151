"""A long live run over a bad link: nothing grows, nothing leaks, and the schedule stays where it was.

The long form is asked for by `-m soak`; the ordinary suite runs the same for some seconds.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.live.conftest import Command, summary
from tests.waiting import PATIENCE

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory and files are read from /proc"),
]

SECONDS = 1800  # of the long form
LINK = "delay(0.1) | uniform(0.02) | bernoulli(0.02)"
DT = 1e-3
MB = 1 << 20


class Form(NamedTuple):
    """How long, and what is asked of it."""

    seconds: int
    warm: float  # s: from when on nothing may grow
    grown: int  # bytes of resident memory that it may


SHORT = Form(5, warm=2.0, grown=2 * MB)
LONG = Form(SECONDS, warm=60.0, grown=MB)


class Sample(NamedTuple):
    """What a process holds."""

    at: float  # s, monotonic
    resident: int  # bytes
    anonymous: int  # bytes of that which are no file's
    files: int  # descriptors


def sample(pid: int) -> Sample:
    told = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    resident, anonymous = (int(told[name].split()[0]) * 1024 for name in ("VmRSS", "RssAnon"))
    return Sample(time.monotonic(), resident, anonymous, len(os.listdir(f"/proc/{pid}/fd")))


def kept(pid: int) -> float:
    """For how long (s) it was ready to run and others ran. It may have ended, and not been waited for."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9


def read_on(process: Command) -> list[tuple[float, str]]:
    """Have what it says read as it comes, so that it never waits for its reader; each line with the time it came."""
    stdout, said = process.process.stdout, list[tuple[float, str]]()
    assert stdout is not None

    def read() -> None:
        for line in stdout:
            said.append((time.monotonic(), line))

    Thread(target=read, daemon=True).start()
    return said


def drift(said: list[tuple[float, str]]) -> float:
    """By how much (s) tick k came later, at the end, than k*dt after the first: live lines are said as ticks run.

    The earliest of several stand for each, since a line may be read late, never early.
    """
    lives = [(at, json.loads(line)) for at, line in said if '"live"' in line]
    behind = [at - one["k"] * DT for at, one in lives if one["event"] == "live"]
    few = max(1, len(behind) // 4)
    return min(behind[-few:]) - min(behind[:few])


@pytest.mark.full
@pytest.mark.parametrize("form", [
    pytest.param(SHORT, id="short"),
    pytest.param(LONG, id="long", marks=[pytest.mark.soak, pytest.mark.timeout(2 * LONG.seconds + 300)]),
])
def test_nothing_grows_and_nothing_drifts(form: Form, command: Callable[..., Any], tmp_path: Path) -> None:
    scene = ["jittery_wan", "--link", LINK, "--set", "playout=fixed:0.13", "--set", f"duration={form.seconds}"]
    scene += ["--json"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", "--out", str(tmp_path / "slave"))
    water = command("channel", *scene, "--listen", "127.0.0.1:0", "--peer", f"127.0.0.1:{slave.port()}")
    master = command("master", *scene, "--peer", f"127.0.0.1:{water.port()}", "--out", str(tmp_path / "master"))
    processes = {"master": master, "slave": slave, "channel": water}
    slave.event("live")
    began = time.monotonic()
    samples: dict[str, list[Sample]] = {name: [] for name in processes}
    said = {name: read_on(process) for name, process in processes.items()}
    while time.monotonic() < began + form.seconds - 1.5:  # behind the last tick the summary is made, which takes room
        time.sleep(0.5)
        for name, process in processes.items():
            samples[name].append(sample(process.process.pid))
    time.sleep(2.0)
    waited = {name: kept(process.process.pid) for name, process in processes.items()}
    for end in (master, slave):
        assert end.process.wait(PATIENCE + form.seconds) == 0
    water.process.terminate()
    assert water.process.wait(PATIENCE) == 0

    for name, those in samples.items():
        warm = [one for one in those if one.at > began + form.warm]
        print(f"{name}: resident {warm[0].resident / MB:.2f} MB, grown by "
              f"{(warm[-1].resident - warm[0].resident) / MB:.2f} MB, of that "
              f"{(warm[-1].anonymous - warm[0].anonymous) / MB:.2f} MB its own; {warm[-1].files} files open")
        assert warm[-1].resident - warm[0].resident < form.grown, name
        assert {one.files for one in warm} == {warm[0].files}, name
    for name in ("master", "slave"):
        late = drift(said[name])
        print(f"{name}: the schedule has moved by {late * 1e3:.2f} ms")
        assert abs(late) < 0.02
        keeps_time(name, tmp_path / name, form.seconds, waited[name])


def keeps_time(name: str, folder: Path, seconds: int, waited: float) -> None:
    """Tick k is at start + k*dt, in the last minute as in the first; left out are those that the machine kept it from.

    A tick is left out when the end came to run more than a tick too late. Its own doing cannot be more of them than
    the time that it waited for a processor does not account for; of that the hypervisor's part is not known.
    """
    told: dict[str, Any] = summary(folder)
    assert told["status"] == "ok", told["sentence"]
    count, own = round(seconds / DT), told[name]
    with np.load(folder / "trace.npz") as trace:
        tick, late = np.rint(trace["t"] / DT).astype(int), trace[f"late_{name[0]}"]
    assert len(tick) == own["ticks"] == count - own["skipped"]
    assert own["skipped"] * DT <= waited + 0.05 * seconds
    assert abs(own["run_time"] - seconds) < 0.5, "from the first tick to the last by the clock itself"
    assert np.all(np.diff(tick) > 0)
    assert 0 <= tick[0] <= tick[-1] < count
    assert np.all((late >= 0.0) & (late < seconds)), "no tick is early"
    part = min(60.0, seconds / 4) / DT
    first, last = (float(np.median(late[some])) for some in (tick < part, tick >= count - part))
    print(f"{name}: late by a median of {first * 1e6:.0f} us first and {last * 1e6:.0f} us last; "
          f"{own['skipped']} of {count} ticks skipped, kept from running for {waited:.2f} s")
    assert abs(last - first) < 0.5 * DT + waited / count, "of 0 to DT that it can be"
