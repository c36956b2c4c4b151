"""The alarm of a live end: none of its instants is early, lost or waited for twice; and the relay's timer."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise

import pytest

from teleop.live.process.ticker import Alarm, Timer

pytestmark = pytest.mark.live
MS = 1_000_000


def ring(
    alarm: Alarm, start: int, interval: int, count: int, busy: Callable[[int], None] = lambda _: None
) -> list[int]:
    """The times (ns from the start) at which so many waits of an alarm were over; `busy` is called between two of them.

    A wait may be over after the next instant: the machine may take the processor away at any point.
    """
    alarm.set(start, interval)
    over: list[int] = []
    for i in range(count):
        if i:
            busy(i)
        alarm.wait()
        over.append(time.monotonic_ns() - start)
    return over


@pytest.mark.parametrize("spin_ns", [0, 150_000, 3 * MS, 40 * MS])
def test_it_waits_until_its_instant_and_once_for_each(spin_ns: int) -> None:
    """Even if it is to wait awake for longer than from one instant to the next."""
    over = ring(Alarm(spin_ns), time.monotonic_ns() + 20 * MS, 5 * MS, 12)
    assert over[0] >= 0
    assert all(then // (5 * MS) < now // (5 * MS) for then, now in pairwise(over)), "none twice, and none early"
    assert ring(Alarm(spin_ns), time.monotonic_ns() + 20 * MS, 0, 1)[0] >= 0


class Clock:
    """The module `time` with a clock of its own, which goes on by a microsecond whenever it is read."""

    def __init__(self) -> None:
        self.now, self.slept = 0, list[int]()

    def monotonic_ns(self) -> int:
        self.now += 1000
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(round(seconds * 1e9))
        self.now += self.slept[-1]


@pytest.mark.parametrize("spin_ns", [0, 150_000, 3 * MS, 12 * MS])
def test_it_sleeps_up_to_its_instant_and_waits_for_the_rest_awake(
    spin_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, start = Clock(), 20 * MS
    monkeypatch.setattr("teleop.live.process.ticker.time", clock)
    alarm = Alarm(spin_ns)
    alarm.set(start, 5 * MS)
    for due in (start, start + 5 * MS, start + 10 * MS):
        left = due - spin_ns - clock.now - 1000
        clock.slept.clear()
        alarm.wait()
        assert due <= clock.now < due + 2000
        assert clock.slept == ([left] if left > 0 else [])
    clock.now = start + 30 * MS + 77_000
    alarm.wait()
    assert clock.now < start + 30 * MS + 80_000, "late, it is over at once, for all that have passed together"
    alarm.wait()
    assert start + 35 * MS <= clock.now < start + 35 * MS + 2000


def test_instants_that_were_missed_are_left_out_and_the_next_is_not_early() -> None:
    """Whoever waits was busy over some of them: they are over once together, and the grid stays."""
    interval = 20 * MS
    over = ring(Alarm(2 * MS), time.monotonic_ns() + 20 * MS, interval, 6, lambda i: time.sleep(0.07 * (i == 2)))
    instants = [at // interval for at in over]
    assert instants == sorted(set(instants))
    assert instants[2] - instants[1] >= 3


def test_it_may_be_set_again_between_two_waits() -> None:
    alarm, start = Alarm(3 * MS), time.monotonic_ns() + 20 * MS
    for step in (0, 7 * MS, 9 * MS, 30 * MS):
        assert ring(alarm, start + step, 0, 1)[0] >= 0


def test_an_instant_that_has_passed_is_not_waited_for_and_the_grid_stays() -> None:
    start = time.monotonic_ns() - 12_345 * MS
    over = ring(Alarm(), start, 20 * MS, 3)
    assert over[0] >= 12_345 * MS
    assert all(then // (20 * MS) < now // (20 * MS) for then, now in pairwise(over))


@pytest.mark.skipif(Timer().fd < 0, reason="there is no timerfd here")
def test_a_timer_counts_its_rings_and_is_read_without_waiting() -> None:
    timer = Timer()
    with pytest.raises(OSError, match="cannot be set"):
        timer.set(time.monotonic_ns(), -MS)
    assert timer.expirations() == 0
    began = time.monotonic_ns()
    timer.set(began - 1000 * MS, MS)
    time.sleep(0.001)
    told = timer.expirations()
    assert told >= 1000
    assert timer.expirations() + told <= 1001 + (time.monotonic_ns() - began) // MS, "those are told"
    timer.close()
