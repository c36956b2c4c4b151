"""Processes that are killed, started again, stopped and continued: who is left lets go, and all resume again."""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple

import numpy as np
import pytest

from teleop.errors import Refused
from teleop.live.records.reader import TruncatedRecord, read_record
from teleop.live.records.record import read_events
from tests.live.conftest import Command, pair_of_keys, running
from tests.waiting import PATIENCE, free_port

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are looked for in /proc"),
]


RAMP, SLEW, F_MAX, DT, DELAY = 0.05, 1000.0, 20.0, 1e-3, 0.01  # of the scene, SI
SCENE = f"""
from channel.delay import Delay
from master.hand import Grip, Sine
from teleop.law import Law
from teleop.laws.wave import Wave
from teleop.physics.plant import MassDamper
from teleop.stages.force_cap import Cap
from teleop.stages.watchdog import Watchdog
from teleop.scene import Scene


def scene(*, duration: float, timeout: float, law: Law = Wave(), friction: float = 0.0) -> Scene:
    return Scene(
        law=law, hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.05, frequency=0.9)),
        master=MassDamper(mass=0.1, damping=0.5), link=Delay({DELAY}),
        slave=MassDamper(mass=0.5, damping=30.0, friction=friction), watchdog=Watchdog(timeout=timeout, ramp={RAMP}),
        cap=Cap(f_max={F_MAX}, slew={SLEW}), dt={DT}, duration=duration,
    )
"""  # a hand that is never still, on a slave in oil: there is force wherever the law may hold any
NAMES = ("master", "slave", "channel")
SLACK = 0.1  # s, between what these processes do and what this one saw of it


@dataclass
class One:
    """One process, from its start to its end. Times are of the monotonic clock, s."""

    name: str
    folder: Path
    command: Command
    began: float
    ended: float = float("inf")
    stops: list[tuple[float, float]] = field(default_factory=list)
    said: list[tuple[float, dict[str, Any]]] = field(default_factory=list)  # its live lines, and when they came
    files: int | None = None  # descriptors, when it first ran well

    @property
    def pid(self) -> int:
        return self.command.process.pid

    def listen(self) -> None:
        """Keep what it says as it says it."""
        for line in self.command.process.stdout or ():
            event = json.loads(line)
            if event["event"] == "live":
                self.said.append((time.monotonic(), event))


class Upset(NamedTuple):
    """Something that was done to the run, and when: s, from the first blow to the last process that is back."""

    what: str
    began: float
    over: float
    struck: tuple[str, ...]  # those that were gone or stopped


class Site:
    """Master, channel and slave, each started as often as it takes; the ports stay."""

    def __init__(self, command: Callable[..., Command], folder: Path, keys: dict[str, list[str]], seconds: int,
                 timeout: float, knobs: Sequence[str] = ()) -> None:
        self.timeout = timeout
        self._command, self._folder, self._keys = command, folder, keys
        scene = folder / "oil.py"
        scene.write_text(SCENE)
        self._scene = [str(scene), "--set", f"duration={seconds}", "--set", f"timeout={timeout}", "--json"]
        self._scene += [part for knob in knobs for part in ("--set", knob)]
        self.every: list[One] = []
        self.now: dict[str, One] = {}
        self.ports = {name: free_port() for name in ("slave", "channel")}
        self.upsets: list[Upset] = []
        for name in ("slave", "channel", "master"):
            self.start(name)

    def start(self, name: str) -> None:
        """Start it (anew); the answer is not waited for."""
        folder = self._folder / f"{name}{sum(one.name == name for one in self.every)}"
        own = ["--listen", f"127.0.0.1:{self.ports[name]}"] if name in self.ports else []
        to = {"master": "channel", "channel": "slave"}.get(name)
        own += ["--peer", f"127.0.0.1:{self.ports[to]}"] if to else []
        own += ["--out", str(folder), *self._keys.get(name, [])] if name != "channel" else []
        one = One(name, folder, self._command(name, *self._scene, *own), time.monotonic())
        Thread(target=one.listen, daemon=True).start()
        self.every.append(one)
        self.now[name] = one

    def kill(self, name: str) -> None:
        """As the system's out-of-memory killer does it."""
        one = self.now[name]
        one.command.signal(signal.SIGKILL)
        one.command.process.wait()
        one.ended = time.monotonic()

    def stop(self, name: str) -> float:
        self.now[name].command.signal(signal.SIGSTOP)
        return time.monotonic()

    def go_on(self, name: str, since: float) -> None:
        self.now[name].stops.append((since, time.monotonic()))
        self.now[name].command.signal(signal.SIGCONT)

    def resumed(self, since: float) -> None:
        """Wait until both ends say that they hold all of the law's force, and did so well after `since`."""
        until = time.monotonic() + PATIENCE
        while not all(self._well(self.now[name], since + 2 * self.timeout) for name in ("master", "slave")):
            told = {name: one.said[-1:] for name, one in self.now.items()}
            dead = [one for one in self.now.values() if one.command.process.poll() is not None]
            errors = [(one.name, one.command.process.communicate()[1]) for one in dead]
            assert not dead, f"ended by itself: {errors} after {self.upsets[-1:]}"
            assert time.monotonic() < until, f"not resumed {PATIENCE} s after {self.upsets[-1:]}: {told}"
            time.sleep(0.02)
        for one in self.now.values():
            files = len(os.listdir(f"/proc/{one.pid}/fd"))
            one.files = one.files or files
            assert abs(files - one.files) <= 1, f"the {one.name} has {files} files open, and had {one.files}"

    @staticmethod
    def _well(one: One, after: float) -> bool:
        when, event = one.said[-1] if one.said else (0.0, {})
        return when > after and event["gain"] == 1.0 and event["delay"] is not None

    def upset(self, dice: random.Random) -> None:
        """One blow of some kind, until all three run."""
        began = time.monotonic()
        kind = dice.choice(("kill", "kill", "stop", "stop", "two", "again", "crossed"))
        first, second, _ = dice.sample(NAMES, 3)
        pause = dice.uniform(0.0, 0.5)
        struck, what = (first, second), f"{kind} {first}"
        if kind == "kill":
            self.kill(first)
            time.sleep(pause)
            self.start(first)
            struck = (first,)
        elif kind == "stop":
            length = dice.uniform(0.05, 1.5)
            since = self.stop(first)
            time.sleep(length)
            self.go_on(first, since)
            struck, what = (first,), f"{what} for {length:.2f} s"
        elif kind == "two":
            self.kill(first)
            time.sleep(pause / 2)
            self.kill(second)
            for name in dice.sample(struck, 2):
                time.sleep(pause / 2)
                self.start(name)
            what += f" and {second}"
        elif kind == "again":
            self.kill(first)
            self.start(first)
            time.sleep(dice.uniform(0.0, 2.0))
            self.kill(first)
            self.start(first)
            struck = (first,)
        else:
            since = self.stop(first)
            self.kill(second)
            time.sleep(pause)
            self.start(second)
            time.sleep(length := dice.uniform(0.0, 1.5))
            self.go_on(first, since)
            what = f"stop {first} for {pause + length:.2f} s, kill {second} meanwhile"
        self.upsets.append(Upset(what, began, time.monotonic(), struck))
        self.resumed(time.monotonic())

    def end(self) -> None:
        """Ask all three to stop; they do, and nothing of this run is left."""
        for one in self.now.values():  # at once: one that ends because the other left heeds no signal any more
            one.command.signal(signal.SIGTERM)
        for name, one in self.now.items():
            code = one.command.process.wait(PATIENCE)
            said = one.command.process.stderr.read() if one.command.process.stderr else ""
            assert (code, said) == (0, ""), (name, code, said)
        assert not [one.name for one in self.every if Path(f"/proc/{one.pid}").exists()]
        assert not [words for pid, words in running().items() if str(self._folder) in words and pid != os.getpid()]


class Rows(NamedTuple):
    """What one end recorded. `t`: when the tick was due, s, of this process's clock."""

    one: One
    k: Any
    t: Any
    seq: Any
    f: Any
    g: Any
    events: list[dict[str, Any]]


def rows_of(one: One) -> Rows | None:
    """None if it was killed before it had said or written anything; what it did last may not be on the disk."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TruncatedRecord)
        try:
            header, record, _ = read_record(one.folder)
        except Refused:
            return None
    if not len(record.ticks) and not one.said:
        return None
    names = header["columns"][3:]
    rows: Any = record.rows
    table = rows.table(0, len(record.ticks))
    k, e = np.array(record.ticks, dtype=np.int64), header["end"]
    # a line comes a little after its tick; of one that said nothing no instant is known, and nothing compares
    zero = min((when - event["k"] * DT for when, event in one.said), default=float("nan"))
    return Rows(one, k, zero + k * DT, np.array(record.played, dtype=np.int64), table[:, names.index(f"f_{e}")],
                table[:, names.index(f"g_{e}")], read_events(one.folder))


@dataclass
class Figures:
    """What the judge has measured."""

    upsets: int = 0
    processes: int = 0
    most_step: float = 0.0  # of the slew limit
    force: list[float] = field(default_factory=list)  # N, the median of its amount where the gain was 1, by process
    safe: list[float] = field(default_factory=list)  # s, from a blow to the first tick on the way down
    back: list[float] = field(default_factory=list)  # s, from the end of a blow to the whole force
    slowest: str = ""  # the blow of the longest of these

    def __str__(self) -> str:
        spread = "; ".join(
            f"{name} {np.median(those):.3f} s, at most {max(those):.3f} s ({len(those)})"
            for name, those in (("on the way down after", self.safe), ("whole again after", self.back)) if those)
        spread += f", by {self.slowest!r}"
        return (f"{self.upsets} upsets, {self.processes} processes; {spread}; "
                f"force {np.median(self.force):.2f} N, largest force step {self.most_step:.3f} of the limit")


def judge(site: Site) -> Figures:
    """Every claim, for every process that recorded anything."""
    figures = Figures(len(site.upsets), len(site.every))
    all_rows = [rows for one in site.every if one.name != "channel" and (rows := rows_of(one)) is not None]
    for rows in all_rows:
        if not rows.k.size:
            continue
        where = rows.one.folder.name
        figures.most_step = max(figures.most_step, steps_are_slewed(rows, where))
        silence_is_heeded(rows, site.timeout, where)
        nothing_old_moves_it(rows, site.timeout, where)
        if np.any(rows.g == 1.0):
            figures.force.append(float(np.median(np.abs(rows.f[rows.g == 1.0]))))
        for stop in rows.one.stops:
            a_stop_ends_at_no_force(rows, stop, site.timeout, where)
    for i, upset in enumerate(site.upsets):
        until = site.upsets[i + 1].began if i + 1 < len(site.upsets) else float("inf")
        for rows in all_rows:
            figures.safe += survivor_is_safe(rows, upset, site.timeout)
        back = [whole_again(rows, upset, until) for rows in all_rows if alive(rows.one, upset.over, until)]
        assert len(back) == 2, (upset, "an end has no record")
        if max(back) > max(figures.back, default=0.0):
            figures.slowest = upset.what
        figures.back.append(max(back))
    return figures


def alive(one: One, since: float, until: float) -> bool:
    return one.began < since + 0.001 and one.ended > min(until, 1e12) - 0.001


def steps_are_slewed(rows: Rows, where: str) -> float:
    """No force step above the slew limit, from zero on; the largest, of the limit."""
    f, k = np.concatenate(([0.0], rows.f)), np.concatenate(([rows.k[0] - 1], rows.k))
    assert np.all(np.isfinite(f)), where
    assert np.max(np.abs(f)) <= F_MAX + 1e-9, where
    limit = SLEW * DT * np.diff(k)
    step = np.abs(np.diff(f))
    worst = int(np.argmax(step / limit))
    assert np.all(step <= limit + 1e-9), (where, int(k[worst + 1]), f[worst : worst + 2], limit[worst])
    return float(np.max(step / limit))


def silence_is_heeded(rows: Rows, timeout: float, where: str) -> None:
    """At the first tick past the timeout, and at each until something is played, the gain is on its way down."""
    joined = any(event["what"] == "joined" for event in rows.events)
    start = rows.k[0] - 1 if joined else -1
    heard = np.maximum.accumulate(np.where(rows.seq >= 0, rows.k, start))
    silent = (rows.k - heard) * DT > timeout + DT / 2
    before = np.concatenate(([1.0], rows.g[:-1]))
    down = (rows.g == 0.0) | (rows.g <= before - DT / RAMP + 1e-9)
    wrong = silent & ~down
    assert not wrong.any(), (where, rows.k[wrong][:3], rows.g[wrong][:3])


def nothing_old_moves_it(rows: Rows, timeout: float, where: str) -> None:
    """What waited at the socket of a stopped process, or in a stopped channel, is played at no force."""
    old = (rows.seq >= 0) & (rows.g > 0.0) & ((rows.k - rows.seq) * DT > timeout + DELAY + SLACK)
    assert not old.any(), (where, rows.k[old][:3], rows.seq[old][:3], rows.g[old][:3])


def a_stop_ends_at_no_force(rows: Rows, stop: tuple[float, float], timeout: float, where: str) -> None:
    """Stopped for longer than the timeout, an end holds nothing at its first tick afterwards."""
    since, until = stop
    after = np.flatnonzero(rows.t > since + SLACK)
    if until - since < timeout + SLACK or not after.size:
        return
    first = int(after[0])
    assert rows.t[first] > until - SLACK, (where, "it ticked while it was stopped")
    assert (rows.g[first], rows.f[first]) == (0.0, 0.0), (where, stop, rows.g[first], rows.f[first])


def survivor_is_safe(rows: Rows, upset: Upset, timeout: float) -> list[float]:
    """An end that was not struck, and heard nothing, lets go `timeout` after the last that was under way.

    How long (s) after the blow that was, if it was.
    """
    one = rows.one
    if one.name in upset.struck or not (one.began < upset.began and one.ended > upset.over):
        return []
    due = upset.began + DELAY + timeout + SLACK
    after = np.flatnonzero(rows.t > due)
    heard = (rows.seq >= 0) & (rows.t > upset.began + DELAY + SLACK) & (rows.t <= due)
    if not after.size or heard.any():  # what was struck was back in time, which no process that was killed is so soon
        assert not after.size or timeout > 1.0 or upset.what.startswith("stop"), (one.folder.name, upset)
        return []
    assert rows.g[after[0]] < 1.0, (one.folder.name, upset, rows.t[after[0]] - upset.began)
    down = np.flatnonzero((rows.t > upset.began) & (rows.g < 1.0))
    return [float(rows.t[down[0]] - upset.began)]


def whole_again(rows: Rows, upset: Upset, until: float) -> float:
    """How long after a blow was over the gain is 1 again, for good until the next one."""
    last = rows.t[-1] + DT if rows.t.size else 0.0  # what came behind that is known from its live lines alone
    later = [(at, event["gain"]) for at, event in rows.one.said if at > last]
    when, gain = np.append(rows.t, [at for at, _ in later]), np.append(rows.g, [g for _, g in later])
    here = np.flatnonzero((when > upset.over) & (when < until))
    assert here.size, (rows.one.folder.name, upset)
    assert gain[here[-1]] == 1.0, (rows.one.folder.name, upset)
    less = here[gain[here] < 1.0]
    return float(when[less[-1] + 1] - upset.over) if less.size else 0.0


class Form(NamedTuple):
    """How many blows to one run; each joining process first has to simulate the run so far."""

    blows: int
    sealed: bool
    seed: int
    timeout: float = 0.2  # s, of the watchdogs
    knobs: tuple[str, ...] = ()


SHORT = [pytest.param(Form(3, False, 56), id="in the open"), pytest.param(Form(2, True, 1), id="sealed")]
LONG = [
    pytest.param(Form(25, sealed, seed), id=f"{'sealed' if sealed else 'in the open'} {seed}",
                 marks=[pytest.mark.soak, pytest.mark.timeout(600)])
    for seed in range(10, 14) for sealed in (False, True)
]
LONG += [  # a session ends before such a watchdog lets go: its force is there still when the next one begins
    pytest.param(Form(10, False, 20, timeout=1.5, knobs=("law=direct", "friction=6")), id="with patient watchdogs",
                 marks=[pytest.mark.soak, pytest.mark.timeout(600)])
]


@pytest.mark.parametrize("form", SHORT + LONG)
def test_whoever_is_left_lets_go_and_all_resume(form: Form, command: Callable[..., Any], tmp_path: Path) -> None:
    keys = pair_of_keys(tmp_path) if form.sealed else {}
    dice = random.Random(form.seed)
    site = Site(command, tmp_path, keys, 60 + 15 * form.blows, form.timeout, form.knobs)
    site.resumed(site.every[-1].began)
    for _ in range(form.blows):
        site.upset(dice)
    site.end()
    print(judge(site))
