"""A machine that was suspended: seen by its clocks, and what a live end makes of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Any

import pytest

from teleop.live.driving import ClockDriver
from teleop.live.process.ticker import LEAST_NS, Suspension, boottime
from teleop.scene.loading import load_scene
from teleop.stages.watchdog import Watchdog

S = 1_000_000_000


class Clocks:
    """A clock that counts suspension and one that does not; the process is held up for `held` at the next reading."""

    def __init__(self) -> None:
        self.now, self.slept, self.held = 5 * S, 3 * S, 0

    def _read(self, what: int) -> int:
        self.now, self.held = self.now + 100 + self.held, 0
        return self.now + what

    def boot(self) -> int:
        return self._read(self.slept)

    def mono(self) -> int:
        return self._read(0)


def test_what_one_clock_counts_and_the_other_does_not_is_a_suspension_and_is_told_once() -> None:
    clocks = Clocks()
    seen = Suspension(clocks.boot, clocks.mono)
    clocks.now += 100 * S
    assert seen.duration() == 0
    clocks.slept += 5 * S
    assert seen.duration() == pytest.approx(5 * S, abs=1000)
    assert seen.duration() == 0


@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_process_that_is_held_up_between_the_two_clocks_was_not_suspended(which: int) -> None:
    clocks = Clocks()
    held = [0, 0, 0]
    held[which] = S
    clocks.held = held[0]
    seen = Suspension(clocks.boot, clocks.mono)
    for once in held[1:]:
        clocks.held = once
        assert seen.duration() == 0
    mono, boot = clocks.mono, clocks.boot
    between = Suspension(boot, lambda: mono() + 0 * clocks.now)
    for _ in range(3):
        assert between.duration() == 0


def test_without_such_a_clock_nothing_is_seen_and_with_this_machines_nothing_that_was_not() -> None:
    assert Suspension(None).duration() == 0
    seen = Suspension(boottime())
    for _ in range(1000):
        assert seen.duration() == 0


@pytest.mark.live
def test_a_live_end_whose_machine_was_suspended_is_safe_at_once_and_goes_on_in_another_session(
    pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    dog = Watchdog(timeout=0.8, ramp=0.05, settle=0.05)
    both = pair(replace(load_scene("canonical", duration=4.0, wall=0.005), link=None, watchdog=dog))
    slave = both.shells["s"]
    asked, slept = count(), [0]

    def boot() -> int:
        if next(asked) == 800:
            slept[0] = 5 * S
        return time.monotonic_ns() + slept[0]

    drive = ClockDriver.drive

    async def suspended_once(driver: ClockDriver) -> None:
        if driver.shell is slave:
            driver.suspension = Suspension(boot)
        await drive(driver)

    monkeypatch.setattr(ClockDriver, "drive", suspended_once)
    both.run()
    assert both.errors == {"m": None, "s": None}
    assert both.status() == {"m": "ok", "s": "ok"}
    events = slave.endpoint.guard.events
    told = next(i for i, event in enumerate(events) if event.why.startswith("stood still"))
    assert events[told].what == "safe"
    assert "suspended for 5.000 s" in events[told].why
    after = [event.what for event in events[told:]]
    assert after.index("session") < after.index("released"), "another session alone releases it"
    assert LEAST_NS < S


@pytest.mark.live
@pytest.mark.parametrize("cut", ["m", "s"])
def test_an_outage_one_way_lets_both_go_and_ends_in_another_session(cut: str, pair: Callable[..., Any]) -> None:
    """The messages of one end are lost for 1.6 s, at its socket."""
    dog = Watchdog(timeout=0.2, ramp=0.05, settle=0.1)
    both = pair(replace(load_scene("hard_wall", duration=9.0, law="direct"), link=None, watchdog=dog))
    ends, wire = {e: shell.endpoint for e, shell in both.shells.items()}, both.shells[cut].wire
    send, since = wire.send, [0]

    def lossy(data: bytes) -> None:
        k = ends[cut]._tick
        since[0] = since[0] or (time.monotonic_ns() if k > 1500 else 0)
        if not since[0] or time.monotonic_ns() - since[0] > 1.6 * S:
            send(data)

    wire.send = lossy
    both.run()
    assert both.status() == {"m": "ok", "s": "ok"}
    for e, end in ends.items():
        whats = [(event.what, event.why.split(":")[0]) for event in end.guard.events if event.k > 1490]
        assert whats[0][0] == "safe"
        assert end.session.met >= 2
        first = next(i for i, what in enumerate(whats) if what[0] == "session")
        assert "released" not in [what for what, _ in whats[:first]], f"{e} was released into the session before"
        assert "released" in [what for what, _ in whats[first:]]
    deaf = [event.why for event in ends[cut].guard.events if event.k > 1490 and event.what == "safe"]
    assert deaf[0].startswith(("no answer", "a stall"))


@pytest.mark.live
def test_a_delay_that_grows_lets_a_live_end_go_although_packets_come_all_the_while(
    pair: Callable[..., Any]
) -> None:
    """What the master sends is held up at its socket, for ever longer: by half a second a second."""
    dog = Watchdog(timeout=0.3, ramp=0.05, settle=0.1, age=0.5)
    both = pair(replace(load_scene("hard_wall", duration=5.0, law="direct"), link=None, watchdog=dog))
    wire, slave = both.shells["m"].wire, both.shells["s"].endpoint
    send, began, waiting = wire.send, time.monotonic_ns(), []

    def late(data: bytes) -> None:
        now = time.monotonic_ns()
        growing = both.shells["m"].endpoint._tick > 1000
        if not growing and not waiting:
            nonlocal began
            began = now
        waiting.append((now + max(0, (now - began) // 2), data))
        while waiting and waiting[0][0] <= now:
            send(waiting.pop(0)[1])

    wire.send = late
    both.run()
    assert both.status() == {"m": "ok", "s": "ok"}
    causes = [event.why for event in slave.guard.events if event.what == "safe" and event.k > 1000]
    assert any(why.startswith("age: messages come more than 0.5 s") for why in causes), causes
    assert slave.guard.old > 100
    assert slave.guard.gain == 0.0
