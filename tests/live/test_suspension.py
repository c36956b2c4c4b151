"""A machine that was suspended: seen by its clocks, and what a live end makes of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from teleop import Watchdog, load_scene
from teleop.live.driving import ClockDriver
from teleop.live.process.ticker import LEAST_NS, Suspension, boottime

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
    both = pair(replace(load_scene("canonical", duration=3.0, wall=0.005), link=None, watchdog=dog))
    slave = both.shells["s"]
    slept = [0]

    def boot() -> int:
        if slave.endpoint._tick > 400:
            slept[0] = 5 * S
        return time.monotonic_ns() + slept[0]

    drive = ClockDriver.drive

    def suspended_once(driver: ClockDriver) -> None:
        if driver.shell is slave:
            driver.suspension = Suspension(boot)
        drive(driver)

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
