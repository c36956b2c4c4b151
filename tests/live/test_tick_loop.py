"""The loop of a live end: its selector calls timers' readers, and everything else goes on as in asyncio's own."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from teleop.live.process.ticker import Alarm, TickLoop
from tests.waiting import PATIENCE

MS = 1_000_000
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
