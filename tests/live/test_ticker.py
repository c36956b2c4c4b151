"""The alarm and the loop of a live end: none of its instants is early, lost or told twice, and all else goes on."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable, Coroutine
from typing import Any, NamedTuple

import pytest

from teleop.live.process.ticker import Alarm, TickLoop, Timer
from tests.waiting import PATIENCE

pytestmark = [pytest.mark.live, pytest.mark.skipif(Timer().fd < 0, reason="there is no timerfd here")]
MS = 1_000_000


class Ring(NamedTuple):
    """Times of one ring, ns from the start: when it rang, and the instant that it rang for."""

    at: int
    instant: int


def ring(
    alarms: Callable[[asyncio.AbstractEventLoop, Callable[[], None]], Alarm], start: int, interval: int,
    enough: Callable[[list[Ring]], bool], busy: Callable[[int], None] = lambda _: None,
    loop: Callable[[], asyncio.AbstractEventLoop] | None = None,
) -> list[Ring]:
    """The rings of an alarm until there are enough, and for 40 ms more.

    `busy` keeps the loop from the alarm at each ring. A ring may come after the next instant: the machine may take
    the processor away at any point. Which instant it is for is known to the alarm alone.
    """
    rang: list[Ring] = []

    async def run() -> None:
        def wake() -> None:
            rang.append(Ring(time.monotonic_ns() - start, alarm._due - alarm._interval - start))
            busy(len(rang))

        alarm = alarms(asyncio.get_running_loop(), wake)
        alarm.set(start, interval)
        end = time.monotonic() + PATIENCE
        while not enough(rang):
            assert time.monotonic() < end, rang
            await asyncio.sleep(0.002)
        await asyncio.sleep(0.04)
        alarm.close()

    with asyncio.Runner(loop_factory=loop) as runner:
        runner.run(run())
    return rang


@pytest.mark.parametrize("loop", [None, TickLoop])
@pytest.mark.parametrize("spin_ns", [0, 150_000, 3 * MS, 40 * MS])
@pytest.mark.parametrize("interval", [0, 5 * MS])
def test_it_rings_at_or_after_its_instant_and_once_for_each(
    spin_ns: int, interval: int, loop: Callable[[], asyncio.AbstractEventLoop] | None
) -> None:
    """Even if it is to wait awake for longer than from one instant to the next."""
    last = 12 * interval
    rang = ring(lambda loop, wake: Alarm(loop, wake, spin_ns), time.monotonic_ns() + 20 * MS, interval,
                lambda rang: bool(rang) and rang[-1].instant >= last, loop=loop)
    assert all(one.at >= one.instant for one in rang)
    instants = [one.instant for one in rang]
    if not interval:
        assert instants == [0]
        return
    assert instants == sorted(set(instants)), "none twice"
    assert {instant % interval for instant in instants} == {0}


class StandIn:
    """A timer and its clock: it rings when the test says, and time passes only while it is waited for awake."""

    fd = 0

    def __init__(self, now: int) -> None:
        self.now, self.rings, self.asked = now, 0, (0, 0)

    def add_reader(self, _fd: int, wake: Callable[[], None]) -> None:
        self.wake = wake

    def set(self, due_ns: int, interval_ns: int) -> None:
        self.asked = due_ns, interval_ns

    def expirations(self) -> int:
        rings, self.rings = self.rings, 0
        return rings

    def monotonic_ns(self) -> int:
        self.now += 1000
        return self.now

    def ring(self, now: int, rings: int) -> None:
        """The loop sees the timer at `now`, so many of its instants after it last did."""
        self.now, self.rings = max(now, self.now), rings
        self.wake()


@pytest.mark.parametrize("spin_ns", [150_000, 3 * MS, 12 * MS])
def test_each_instant_that_the_timer_tells_has_one_ring_and_several_at_once_are_that_of_the_last(
    spin_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    it = StandIn(0)
    monkeypatch.setattr("teleop.live.process.ticker.Timer", lambda: it)
    monkeypatch.setattr("teleop.live.process.ticker.time", it)
    rang: list[int] = []
    alarm = Alarm(it, lambda: rang.append(it.now), spin_ns)  # type: ignore[arg-type]  # a stand-in for the loop
    start = 20 * MS
    alarm.set(start, 5 * MS)
    assert it.asked == (start - spin_ns, 5 * MS)
    for instant, rings in ((0, 1), (1, 1), (2, 1), (5, 3), (6, 1)):
        it.ring(start + instant * 5 * MS - spin_ns, rings)
        assert start + instant * 5 * MS <= rang[-1] < start + instant * 5 * MS + 2000
    it.ring(it.now, 0)
    assert len(rang) == 5, "what was set again meanwhile does not ring"
    it.ring(start + 9 * 5 * MS, 1)
    assert len(rang) == 6, "late, it rings at once"


def test_instants_that_were_missed_are_left_out_and_the_next_is_not_early() -> None:
    """The loop is kept busy over some of them: they ring once together, and the grid stays."""
    interval = 20 * MS

    def busy(count: int) -> None:
        if count == 2:
            time.sleep(0.07)

    rang = ring(lambda loop, wake: Alarm(loop, wake, 2 * MS), time.monotonic_ns() + 20 * MS, interval,
                lambda rang: bool(rang) and rang[-1].instant >= 8 * interval, busy)
    instants = [one.instant // interval for one in rang]
    assert instants == sorted(set(instants))
    assert instants[2] - instants[1] >= 3
    assert all(one.at >= one.instant == k * interval for one, k in zip(rang, instants, strict=True))


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

    rang = ring(made, start, 0, lambda rang: len(rang) >= len(steps), again)
    assert [one.instant for one in rang] == steps
    assert all(one.at >= one.instant for one in rang)


def test_a_timer_counts_its_rings_and_is_read_without_waiting() -> None:
    timer = Timer()
    assert timer.expirations() == 0
    began = time.monotonic_ns()
    timer.set(began - 1000 * MS, MS)
    time.sleep(0.001)
    told = timer.expirations()
    assert told >= 1000
    assert timer.expirations() + told <= 1001 + (time.monotonic_ns() - began) // MS, "those are told"
    timer.close()


SENT = 2_000_000  # bytes


def in_loop(run: Callable[[TickLoop], Coroutine[Any, Any, None]]) -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, TickLoop)
        await asyncio.wait_for(run(loop), PATIENCE)

    with asyncio.Runner(loop_factory=TickLoop) as runner:
        runner.run(main())


def test_while_a_timer_rings_sockets_are_read_and_written_and_tasks_run() -> None:
    rang: list[int] = []

    async def run(loop: TickLoop) -> None:
        one, other = socket.socketpair()
        with one, other:
            one.setblocking(False)
            other.setblocking(False)
            alarm = Alarm(loop, lambda: rang.append(1))
            alarm.set(time.monotonic_ns(), MS)
            sending = asyncio.create_task(loop.sock_sendall(one, bytes(SENT)))  # more than there is room for
            got = 0
            while got < SENT:
                got += len(await loop.sock_recv(other, SENT // 50))
                await asyncio.sleep(0.0005)
            await sending
            alarm.close()

    in_loop(run)
    assert len(rang) >= 10


def test_what_a_ring_sets_is_waited_for_no_longer_than_until_the_next() -> None:
    """The selector returns after each ring: what became ready by it, an event, is looked at at once."""
    async def run(loop: TickLoop) -> None:
        for _ in range(5):
            event = asyncio.Event()
            alarm = Alarm(loop, event.set)
            alarm.set(time.monotonic_ns() + MS)  # once: no other ring would wake the loop
            await event.wait()
            alarm.close()

    in_loop(run)


def test_a_reader_that_raises_is_reported_and_rings_again() -> None:
    rang: list[int] = []
    told: list[Any] = []

    def wake() -> None:
        rang.append(1)
        raise RuntimeError("of a reader")

    async def run(loop: TickLoop) -> None:
        loop.set_exception_handler(lambda _, context: told.append(context["exception"]))
        alarm = Alarm(loop, wake)
        alarm.set(time.monotonic_ns(), MS)
        while len(rang) < 3:
            await asyncio.sleep(0.001)
        alarm.close()

    in_loop(run)
    assert len(told) == len(rang)
    assert {str(error) for error in told} == {"of a reader"}


def test_a_timer_that_was_closed_rings_no_more() -> None:
    rang: list[int] = []

    async def run(loop: TickLoop) -> None:
        alarm = Alarm(loop, lambda: rang.append(1))
        alarm.set(time.monotonic_ns(), MS)
        while not rang:
            await asyncio.sleep(0.001)
        alarm.close()
        before = len(rang)
        await asyncio.sleep(0.01)
        assert len(rang) == before

    in_loop(run)


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
def test_what_ends_a_process_comes_through(stop: type[BaseException]) -> None:
    def wake() -> None:
        raise stop

    async def run(loop: TickLoop) -> None:
        Alarm(loop, wake).set(time.monotonic_ns())
        await asyncio.sleep(PATIENCE)

    with pytest.raises(stop):
        in_loop(run)
