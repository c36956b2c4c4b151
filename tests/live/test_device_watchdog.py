"""The watchdog process of a device: it lets go for an end that is killed, stopped or hangs, and for no other."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from mmap import mmap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import DeviceError, load_result
from teleop.bench.watchdog import BLOWS, FORCE, HANG, SCENE, Motor, trial
from teleop.live.devices.device_watchdog import (
    ACKED,
    BEAT,
    DONE,
    FIRED,
    GONE_NS,
    SEEN,
    SIZE,
    K,
    WatchedDevice,
    Watching,
)
from teleop.live.devices.guarded_device import GuardedDevice
from teleop.live.records.record import read_events
from teleop.protocol.guard import DEADLINE
from tests.fakes import Body, raising
from tests.live.conftest import Command, running, summary
from tests.waiting import PATIENCE, until

pytestmark = pytest.mark.live
MS = 1_000_000
ONE, ZERO = (1.0,), (0.0,)


def meanwhile(act: Callable[[], object]) -> Callable[[Any], Any]:
    """`holds` of a device: what happens while it is given a force."""
    return lambda force: (act(), force)[1]


class Bench:
    """Both sides on one page of memory and one clock, `ms`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch | None = None) -> None:
        self.arm, self.ms = Body(mass=None), 1000.0
        self.words: Any = [0] * 8
        self.told: list[str] = []
        self.zeroed: list[float] = []
        self.broken: BaseException | None = None
        self.watched = WatchedDevice(self.arm, DEADLINE, mmap(-1, SIZE))
        self.watched._words = self.words
        self.watching = Watching(self.words, self.zero, DEADLINE, self.told.append)
        if monkeypatch is not None:
            monkeypatch.setattr("teleop.live.devices.device_watchdog.time.monotonic_ns", self.now)
        self.words[SEEN] = self.now()

    def now(self) -> int:
        return round(self.ms * MS)

    def zero(self) -> None:
        if self.broken is not None:
            raise self.broken
        self.arm.force = ZERO
        self.zeroed.append(self.ms)

    def look(self, ms: float, step: float = 10.0) -> None:
        """Let `ms` pass in which the watchdog alone runs."""
        until = self.ms + ms
        while self.ms + step <= until:
            self.ms += step
            self.watching.look(self.now)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def test_a_force_that_is_renewed_is_left_alone_and_one_that_is_not_is_set_to_zero_and_told_once(bench: Bench) -> None:
    for _ in range(100):
        bench.watched.hold(ONE)
        bench.look(140.0)
    bench.watched.hold(ZERO)
    bench.look(10_000.0)
    assert bench.zeroed == [], "nor is an end that holds none"
    bench.ms = 1000.0
    bench.watched.hold(ONE)
    bench.look(150.0)
    assert (bench.arm.force, bench.zeroed) == (ONE, [])
    bench.look(10.0)
    assert (bench.arm.force, bench.zeroed) == (ZERO, [1160.0])
    assert bench.told == ["no heartbeat of the end that drives the device for 0.160 s; its force was set to zero"]
    bench.look(400.0)
    assert len(bench.told) == 1
    assert len(bench.zeroed) > 1, "again and again: a call that hung may have come through"


def test_the_first_force_is_watched_before_the_device_has_it_and_one_that_it_does_not_take_is_not_renewed(
    bench: Bench
) -> None:
    bench.arm.holds = meanwhile(lambda: seen.append(bench.words[BEAT]))
    seen: list[int] = []
    bench.watched.hold(ONE)
    assert seen == [bench.now()]
    bench.arm.holds = raising(DeviceError("the amplifier is off"))
    for _ in range(20):
        with pytest.raises(DeviceError):
            bench.watched.hold(ONE)
        bench.look(10.0)
    assert bench.zeroed


def test_an_end_that_comes_back_reads_nothing_and_holds_zero_until_the_watchdog_has_seen_it(bench: Bench) -> None:
    guarded = GuardedDevice(bench.watched, 1)
    guarded.read(0, 0)
    guarded.hold(ONE)
    bench.look(200.0)
    for _ in range(3):
        assert guarded.read(1, MS) is None
        assert "watchdog has set its force to zero" in str(guarded.trouble)
        assert guarded.let_go()
    bench.look(10.0)
    assert guarded.let_go()
    assert guarded.read(2, 2 * MS) is not None
    guarded.hold(ONE)
    assert (guarded.trouble, bench.arm.force) == (None, ONE)
    bench.look(200.0)
    assert bench.words[FIRED] == 2, "it is armed again"
    assert bench.arm.force == ZERO


@pytest.mark.parametrize("seen", [True, False])
def test_a_force_that_comes_through_after_the_watchdog_acted_is_taken_back_at_once(bench: Bench, seen: bool) -> None:
    """The process stood still inside `hold`: what it had asked for came to the motor behind the watchdog's zero."""
    bench.watched.hold(ONE)
    stood = [0]

    def stand_still() -> None:
        if not stood[0]:
            stood[0] = 1
            bench.look(300.0)

    bench.arm.holds = meanwhile(stand_still)
    if not seen:
        bench.watching._zero = lambda: None  # and its zero was overwritten
    with pytest.raises(DeviceError, match="taken over"):
        bench.watched.hold(ONE)
    assert bench.arm.force == ZERO


def test_an_end_that_renews_while_the_watchdog_makes_up_its_mind_keeps_its_force(bench: Bench) -> None:
    class Late(list[int]):
        def __setitem__(self, at: Any, value: Any) -> None:
            super().__setitem__(at, value)
            if at == FIRED:
                super().__setitem__(BEAT, bench.now())

    bench.watched.hold(ONE)
    bench.watching._words = Late(bench.words)
    bench.look(160.0)
    assert bench.zeroed == []


def test_a_device_whose_watchdog_does_not_answer_is_not_driven(bench: Bench) -> None:
    bench.watched.read(0)
    bench.ms += GONE_NS / MS + 1
    with pytest.raises(DeviceError, match="does not answer"):
        bench.watched.read(1)
    bench.watching.look(bench.now)
    assert bench.watched.read(2) is not None
    assert bench.words[K] == 2


def test_a_device_that_cannot_be_set_to_zero_is_tried_at_every_look_and_told_once(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    for error in (OSError("busy"), ZeroDivisionError(), KeyboardInterrupt(), SystemExit(1)):
        bench = Bench(monkeypatch)
        bench.watched.hold(ONE)
        bench.broken = error
        bench.look(250.0)
        assert len(bench.told) == 1
        assert f"could not be set to zero: {type(error).__name__}" in bench.told[0]
        assert not bench.watching.take_over()
        bench.broken = None
        bench.look(10.0)
        assert "was set to zero" in bench.told[-1]
        assert bench.watching.take_over()
        assert bench.arm.force == ZERO


def test_a_device_that_is_held_after_the_run_is_held_without_a_watchdog() -> None:
    one = Bench()
    watched = WatchedDevice(one.arm, DEADLINE, mmap(-1, SIZE))
    assert watched.lets_go
    watched.release()
    assert watched.read(5) == one.arm.read(5)
    watched.hold(ONE)
    assert one.arm.force == ONE


def test_what_carries_a_weight_is_watched_while_the_laws_force_is_zero() -> None:
    """A watchdog process goes by the heartbeat: without one an end that is killed would leave the weight on."""
    class Carrying(Body):
        """A device that holds 2 N beside the law's."""

        carries = True

        def hold(self, force: tuple[float, ...]) -> None:
            self.force, self.carries = (force[0] + 2.0,), True

        def let_go(self, zero: tuple[float, ...]) -> None:
            self.force, self.carries = zero, False

    device = Carrying()
    watched = WatchedDevice(device, 0.15, mmap(-1, SIZE))
    words: Any = [0] * 8
    watched._words, words[SEEN] = words, 1 << 62
    guarded = GuardedDevice(watched, 1)
    guarded.read(0, 0)
    assert guarded.hold(ZERO)
    assert words[BEAT] > 0
    assert device.force == (2.0,)
    words[FIRED] = 1  # it takes over
    assert not guarded.hold(ZERO)
    assert device.force == ZERO
    words[DONE] = 1
    assert not guarded.hold(ZERO)  # and nothing is carried before the end has seen that
    assert guarded.hold(ZERO)
    assert device.force == (2.0,)
    assert guarded.let_go()
    assert (device.force, words[BEAT]) == (ZERO, 0)


HAPPENS = st.tuples(st.sampled_from(["tick", "still", "both", "hang", "zero"]), st.integers(1, 400))


@given(st.lists(HAPPENS, max_size=40))
def test_whatever_stands_still_for_however_long_no_force_outlives_its_deadline_and_no_live_one_is_taken(
    happens: list[tuple[str, int]]
) -> None:
    """In every order of ticks of the end, its stalls, stalls of both, hangs in `hold`, and times without a force."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        bench = Bench(monkeypatch)
        guarded = GuardedDevice(bench.watched, 1)
        renewed = bench.ms

        def tick(force: tuple[float, ...]) -> None:
            nonlocal renewed
            reading = guarded.read(0, bench.now())
            before = len(bench.zeroed)
            if reading is None:
                assert guarded.let_go()
            else:
                guarded.hold(force)
            assert len(bench.zeroed) == before or bench.arm.force == ZERO
            renewed = bench.ms

        for what, ms in happens:
            if what in ("tick", "zero"):
                for _ in range(ms):
                    tick(ONE if what == "tick" else ZERO)
                    before = len(bench.zeroed)
                    bench.look(1.0, step=1.0)
                    assert len(bench.zeroed) == before, "it was renewed a millisecond ago"
            elif what == "still":
                bench.look(ms)
                if bench.ms - renewed > 150 + 2 * 10 + 30 + 1 and ms > 50:
                    assert bench.arm.force == ZERO
            elif what == "both":
                bench.ms += ms
            else:
                bench.arm.holds = meanwhile(lambda ms=ms: bench.look(ms))
                tick(ONE)
                bench.arm.holds = None
        assert bench.words[ACKED] <= bench.words[FIRED]
        assert bench.words[DONE] <= bench.words[FIRED]


# Live


@pytest.mark.parametrize("blow", [
    blow if blow == "SIGKILL" else pytest.param(blow, marks=pytest.mark.full) for blow in BLOWS])
def test_the_force_of_an_end_that_no_signal_reaches_ends_at_zero(blow: str, tmp_path: Path) -> None:
    took, _ = trial(BLOWS[blow][0], tmp_path)
    assert 0.0 < took < PATIENCE
    events = [event for event in read_events(tmp_path / "slave") if event["what"] == "watchdog"]
    assert "its force was set to zero" in events[-1]["why"]
    assert events[-1]["k"] > 100


class Site:
    """A slave that drives a motor of its own, and a master."""

    def __init__(self, command: Callable[..., Command], folder: Path, *knobs: str) -> None:
        self.command, self.folder, self.knobs = command, folder, knobs
        self.motor = Motor(folder / "motor")
        self.slave = self.start()
        self.master = command("master", *SCENE, *knobs, "--peer", f"127.0.0.1:{self.slave.port()}", "--json", "--out",
                              str(folder / "master"))

    def start(self, out: str = "slave", port: int = 0) -> Command:
        return self.command("teleop.bench.watchdog", str(self.folder / "motor"), *SCENE, *self.knobs, "--listen",
                            f"127.0.0.1:{port}", "--json", "--out", str(self.folder / out))

    def pushes(self) -> bool:
        return abs(self.motor.force) > FORCE

    def watchdogs(self) -> list[int]:
        """The watchdog processes of this motor."""
        return [pid for pid, words in running().items() if "device_watchdog" in words and str(self.folder) in words]


@pytest.fixture
def site(command: Callable[..., Command], tmp_path: Path) -> Iterator[Callable[..., Site]]:
    sites: list[Site] = []

    def make(*knobs: str) -> Site:
        sites.append(Site(command, tmp_path, *knobs))
        return sites[-1]

    yield make
    for one in sites:
        one.slave.process.kill()
    until(lambda: not any(one.watchdogs() for one in sites), "a watchdog stays behind")


def test_an_end_that_was_stopped_goes_on_in_the_safe_state_and_its_watchdog_is_armed_again_until_that_is_killed(
    site: Callable[..., Site]
) -> None:
    one = site()
    for _ in range(2):
        until(one.pushes, "no force came about")
        one.slave.signal(signal.SIGSTOP)
        until(lambda: one.motor.force == 0.0, "the force was not set to zero")
        one.slave.signal(signal.SIGCONT)
    until(one.pushes, "the force did not come back")
    os.kill(one.watchdogs()[0], signal.SIGKILL)
    one.slave.end()
    told = summary(one.folder / "slave")
    assert told["status"] == "stopped"
    assert "its watchdog process does not answer" in told["sentence"]
    assert one.motor.force == 0.0
    whats = [event["what"] for event in read_events(one.folder / "slave")]
    whys = [event["why"] for event in read_events(one.folder / "slave") if event["what"] == "safe"]
    assert whats.count("watchdog") >= 2
    assert sum("watchdog has set its force to zero" in why for why in whys) >= 2
    assert whats.count("released") >= 2


def test_an_end_that_was_stopped_for_longer_than_its_device_holds_a_force_begins_at_zero(
    command: Callable[..., Command], tmp_path: Path
) -> None:
    """Shorter than the watchdog of the link waits, 0.8 s: its force came back at once, to a device that had let go."""
    slave = command("slave", *SCENE, "--listen", "127.0.0.1:0", "--json", "--out", str(tmp_path / "slave"))
    command("master", *SCENE, "--peer", f"127.0.0.1:{slave.port()}", "--json", "--out", str(tmp_path / "master"))
    while not (slave.event("live")["k"] > 300 and slave.event("live")["gain"] == 1.0):
        pass
    slave.signal(signal.SIGSTOP)
    time.sleep(0.6)
    slave.signal(signal.SIGCONT)
    while slave.event("live")["gain"] < 1.0:
        pass
    slave.signal(signal.SIGTERM)
    assert slave.end()[0] == 0
    trace = load_result(tmp_path / "slave").trace
    after = int(np.argmax(np.diff(trace["t"]))) + 1
    assert trace["t"][after] - trace["t"][after - 1] > 0.55
    assert np.abs(trace["f_s"][after - 50:after]).max() > 0.1, "there was a force that could come back"
    assert (trace["g_s"][after], trace["f_s"][after]) == (0.0, 0.0)
    assert max(np.diff(trace["g_s"][after:]) / np.diff(trace["t"][after:])) < 100.0, "along a ramp, not at once"


def test_an_end_that_ends_cleanly_takes_its_watchdog_with_it_and_is_not_zeroed(site: Callable[..., Site]) -> None:
    one = site("--set", "duration=0.6")
    until(one.watchdogs, "there is no watchdog")
    assert one.slave.end()[0] == 0
    assert one.watchdogs() == []
    assert one.motor.force == 0.0
    acted = [event for event in summary(one.folder / "slave")["slave"]["events"] if event["what"] == "watchdog"]
    assert one.motor.zeroed_ns == 0 or acted, "without a stall of this machine"


def test_two_ends_do_not_drive_one_device_and_a_watchdog_outlives_every_signal_that_can_be_ignored(
    site: Callable[..., Site]
) -> None:
    """And lets go of a driver that hangs then."""
    one = site()
    until(one.pushes, "no force came about")
    one.start("second").refused("another end drives this device already", "teleop.bench.watchdog:zeroing",
                                f"for example by kill {one.slave.process.pid}")
    assert not (one.folder / "second").exists()
    until(lambda: len(one.watchdogs()) == 1, "the watchdog of the second end stays behind")
    (watchdog,) = one.watchdogs()
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGUSR2", "SIGPIPE", "SIGALRM", "SIGTSTP"):
        os.kill(watchdog, signal.Signals[name])
    assert os.getsid(watchdog) != os.getsid(one.slave.process.pid)
    one.motor.order = HANG
    until(lambda: one.motor.zeroed_ns, "the watchdog is gone")
    assert one.motor.force == 0.0
    one.slave.process.kill()
    one.slave.end()
    until(lambda: not one.watchdogs(), "a watchdog stays behind")


def test_an_end_that_is_started_again_is_never_zeroed_by_the_watchdog_of_the_one_before(
    site: Callable[..., Site]
) -> None:
    one = site()
    until(one.pushes, "no force came about")
    port = int(json.loads(one.slave.lines[0])["port"])
    one.slave.process.kill()
    one.slave = one.start("again", port)
    until(lambda: one.motor.zeroed_ns, "the force was not set to zero")
    one.slave.live(lambda numbers: numbers["gain"] == 1.0)  # how much it pushes depends on how far the hand has come
    assert len(one.watchdogs()) == 1
    began = one.motor.zeroed_ns
    time.sleep(0.5)
    acted = [event for event in read_events(one.folder / "again") if event["what"] == "watchdog"]
    assert one.motor.zeroed_ns == began or acted, "without a stall of this machine"


PROGRAM = """
import sys
from teleop.live.end import end_main
from teleop.live.devices.device_watchdog import DeviceWatchdog
from slave.robot import SimulatedSlave


def make(scene):
    device = SimulatedSlave(scene)
    device.watchdog = DeviceWatchdog(open="my_arm:zeroing")
    return device


raise SystemExit(end_main("s", make))
"""


def test_a_watchdog_whose_module_runs_the_end_is_told_how_to_write_it(
    command: Callable[..., Command], tmp_path: Path
) -> None:
    (tmp_path / "my_arm.py").write_text(PROGRAM)
    end = command("my_arm", "hard_wall", "--listen", "127.0.0.1:0", "--json", "--out", str(tmp_path / "out"))
    end.refused("ran as a program", 'if __name__ == "__main__"')
    assert not (tmp_path / "out").exists()


def test_a_watchdog_finds_a_device_module_that_lies_beside_the_scene_alone(
    command: Callable[..., Command], tmp_path: Path
) -> None:
    own = tmp_path / "own"
    own.mkdir()
    (own / "lever.py").write_text("def zeroing():\n    return lambda: None\n")
    (own / "scene_of_mine.py").write_text("from scenarios.hard_wall import scene as scene\n")
    (tmp_path / "my_end.py").write_text(PROGRAM.replace("my_arm:zeroing", "lever:zeroing").replace(
        "raise SystemExit", "if __name__ == '__main__':\n    raise SystemExit"))
    end = command("my_end", str(own / "scene_of_mine.py"), "--listen", "127.0.0.1:0", "--json", "--out",
                  str(tmp_path / "out"))
    assert end.event("listening")["port"] > 0, "its watchdog has opened the lever"
    end.signal(signal.SIGINT)
    end.end()
