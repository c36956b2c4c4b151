"""An alarm that is awake before its instants: it still never rings before them, loses none and counts none twice."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import pytest

from teleop.live.ticker import Alarm, Timer

pytestmark = [pytest.mark.live, pytest.mark.skipif(Timer().fd < 0, reason="there is no timerfd here")]
MS = 1_000_000


def ring(
    alarms: Callable[[asyncio.AbstractEventLoop, Callable[[], None]], Alarm], start: int, interval: int, until: int,
    busy: Callable[[int], None] = lambda _: None,
) -> list[int]:
    """When it rang, ns from the start; `busy` keeps the loop from the alarm at each ring."""
    rang: list[int] = []

    async def run() -> None:
        def wake() -> None:
            rang.append(time.monotonic_ns() - start)
            busy(len(rang))

        alarm = alarms(asyncio.get_running_loop(), wake)
        alarm.set(start, interval)
        while time.monotonic_ns() < start + until:
            await asyncio.sleep(0.002)
        alarm.close()

    asyncio.run(run())
    return rang


@pytest.mark.parametrize("spin_ns", [0, 150_000, 3 * MS, 40 * MS])
@pytest.mark.parametrize("interval", [0, 5 * MS])
def test_it_rings_at_or_after_its_instant_and_once_for_each(spin_ns: int, interval: int) -> None:
    """Even if it is to wait awake for longer than from one instant to the next."""
    rang = ring(lambda loop, wake: Alarm(loop, wake, spin_ns), time.monotonic_ns() + 20 * MS, interval, 100 * MS)
    assert rang[0] >= 0
    if not interval:
        assert len(rang) == 1
        return
    instants = [at // interval for at in rang]
    assert instants == sorted(set(instants))  # none twice: each ring belongs to an instant of its own
    assert instants[-1] >= 10


def test_instants_that_were_missed_are_left_out_and_the_next_is_not_early() -> None:
    """The loop is kept busy over some of them: they ring once together, and the grid stays."""
    interval = 20 * MS

    def busy(count: int) -> None:
        if count == 2:
            time.sleep(0.07)

    rang = ring(lambda loop, wake: Alarm(loop, wake, 2 * MS), time.monotonic_ns() + 20 * MS, interval, 300 * MS, busy)
    instants = [at // interval for at in rang]
    assert instants == sorted(set(instants))
    assert instants[2] - instants[1] >= 3
    assert len(instants) <= 14


def test_it_may_be_set_again_while_it_rings() -> None:
    alarm: list[Alarm] = []
    start = time.monotonic_ns() + 20 * MS
    steps = [0, 7 * MS, 9 * MS, 30 * MS]

    def made(loop: asyncio.AbstractEventLoop, wake: Callable[[], None]) -> Alarm:
        alarm.append(Alarm(loop, wake, 3 * MS))
        return alarm[0]

    def again(count: int) -> None:
        if count < len(steps):
            alarm[0].set(start + steps[count])

    rang = ring(made, start, 0, 80 * MS, again)
    assert len(rang) == len(steps)
    assert all(at >= step for at, step in zip(rang, steps, strict=True))


def test_a_timer_counts_its_rings_and_is_read_without_waiting() -> None:
    timer = Timer()
    assert timer.rang() == 0
    timer.set(time.monotonic_ns() - 1000 * MS, MS)
    time.sleep(0.001)
    assert timer.rang() >= 1000
    assert timer.rang() < 900  # those are told
    timer.close()
