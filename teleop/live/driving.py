"""What drives a live end: the first reading and exchange, its ticks by the clock or by packets, the way out."""

from __future__ import annotations

import asyncio
import gc
import time
from contextlib import suppress
from functools import partial

from teleop.live.leaving import leave, leave_without_loop, let_go
from teleop.live.listening import Listening
from teleop.live.lockstep import by_packets
from teleop.live.meeting import first_reading, meet
from teleop.live.process.ticker import Alarm, Suspension, boottime, in_tick_loop
from teleop.live.shell import Shell
from teleop.protocol.endpoint import Stepped
from teleop.protocol.session import FINISHED


def run_in_loop(shell: Shell, *, spin_ns: int = 0) -> None:
    """`run` in a loop of its own. No force is left on where the loop itself fails, in which no coroutine goes on."""
    with suppress(BaseException):  # it is known to the shell
        in_tick_loop(run(shell, spin_ns=spin_ns), shell.fail)
    leave_without_loop(shell)


async def run(shell: Shell, *, spin_ns: int = 0) -> None:
    """The whole run: first reading, first exchange, ticks, farewell; then `shell.outcome` says how it ended.

    `spin_ns`: how long before a tick this end wakes, to wait for it awake. Whatever is raised on the way ends the run:
    see `teleop.live.fault`.
    """
    loop = asyncio.get_running_loop()
    try:
        gc.collect()  # now: between the first exchange and tick 0 there are 10 ms at most
        if await first_reading(shell) and await _met(shell):
            gc.freeze()  # what is here stays: no collection has to look at it again
            used, began = time.process_time_ns(), time.monotonic_ns()
            if isinstance(shell.endpoint.inbox, Stepped):
                await by_packets(shell, shell.endpoint.inbox)
            else:
                await ClockDriver(shell, loop, spin_ns).drive()
                await let_go(shell)
            counts = shell.counts  # those of the last part, if it was turned
            counts.run_time = (time.monotonic_ns() - began) / 1e9
            counts.cpu = (time.process_time_ns() - used) / 1e9 / max(1e-9, counts.run_time)
    except BaseException as error:
        shell.fail(error)
        if (task := asyncio.current_task()) is not None and task.cancelling():
            raise  # it was this task that was cancelled, from elsewhere
    finally:
        loop.remove_reader(shell.wire.sock)
        await leave(shell)


async def _met(shell: Shell) -> bool:
    """The first exchange; until it begins nothing that comes is answered."""
    loop = asyncio.get_running_loop()
    loop.add_reader(shell.wire.sock, shell.guarded, shell.drain)
    try:
        return await meet(shell)
    finally:
        loop.remove_reader(shell.wire.sock)


class ClockDriver:
    """Ticks when the timer rings. Messages matter at ticks alone, so the socket is read there: see `Wire`."""

    def __init__(self, shell: Shell, loop: asyncio.AbstractEventLoop, spin_ns: int) -> None:
        self.shell = shell
        self.session = shell.endpoint.session
        self.listening = Listening(shell.endpoint, shell.wire)
        self.suspension = Suspension(boottime())
        self._dt_ns, self._ticks = shell.scene.dt_ns, shell.scene.ticks  # kept, for a scene works them out anew
        self._span_ns = self._dt_ns * shell.endpoint.every
        self._set_to = 0  # the start of the grid that the timer is set to
        self._alarm = Alarm(loop, partial(shell.guarded, self._ring), spin_ns)

    async def drive(self) -> None:
        """Tick until the run is over."""
        shell = self.shell
        try:
            self.listening.update(time.monotonic_ns(), shell.take_events())
            if self.session.joined:
                self._join(self._due() + 1)
            elif (reading := shell.device.read(0, time.monotonic_ns())) is not None:
                shell.endpoint.place(reading.x)
            shell.retake_signals()
            self._arm()
            await shell.outcome.over.wait()
        finally:
            self._alarm.close()

    def _start_ns(self) -> int:
        """The time of tick 0."""
        start = self.session.start_ns
        assert start is not None
        return start

    def _due(self) -> int:
        """The newest of this end's ticks that is due by now."""
        return (time.monotonic_ns() - self._start_ns()) // self._span_ns * self.shell.endpoint.every

    def _arm(self) -> None:
        """Set the timer to the grid, which a new session or the master's clock may have moved."""
        start, span = self._start_ns(), self._span_ns
        self._set_to = start
        self._alarm.set(start + ((time.monotonic_ns() - start) // span + 1) * span, span)  # tick 0 may be far ahead

    def _join(self, k: int) -> None:
        """Take part from about tick k on in a run that the other end has been running."""
        shell, every = self.shell, self.shell.endpoint.every
        k = max(0, k) // every * every
        if k < shell.scene.ticks:
            shell.device.read(k, time.monotonic_ns())  # a simulated device has to come there first
        shell.counts.last = self._due()
        if shell.counts.last >= shell.scene.ticks:
            shell.outcome.end("refused", "the run was over when this end came; start both ends again")
            return
        shell.counts.first = shell.counts.last + every
        shell.endpoint.join(shell.counts.first)

    def _ring(self) -> None:
        """Run the tick, and with the force renewed carry out orders; without whoever gives them, leave."""
        self.wake()
        orders = self.shell.orders
        if orders is not None and not self.shell.outcome.over.is_set():
            orders.read()
            if orders.over:
                self.shell.stop("the process that gave it orders has ended")

    def _go_on(self) -> None:
        """The end was turned: see `teleop.live.turning`."""
        self.listening.go_on(self.shell.endpoint)
        self._ticks = self.shell.scene.ticks

    def wake(self) -> None:
        """Do what is due: read the socket, judge what came, and run the tick."""
        shell, counts, session = self.shell, self.shell.counts, self.session
        if shell.interrupt.lost:
            shell.retake_signals()
        if (slept := self.suspension.passed()):
            shell.endpoint.stood_still(slept)
        if self.listening.endpoint is not shell.endpoint:
            self._go_on()
        now = time.monotonic_ns()
        shell.drain()  # first, for it tells of what came while this process was away, and of where the grid is
        self.listening.update(now, shell.take_events())
        if session.farewell is not None and session.farewell != FINISHED:
            shell.stop(f"the other end left: {session.farewell}")
        elif shell.interrupt.name is not None:
            shell.stop(f"it was asked to stop ({shell.interrupt.name})")
        start, every = self._start_ns(), shell.endpoint.every
        k = (now - start) // self._span_ns * every
        if start != self._set_to:
            self._arm()
        if shell.outcome.over.is_set():
            return
        if k < counts.last and counts.last >= 0:  # a new session's grid is behind: no force until it is there again
            shell.hold(shell.endpoint.left_out(counts.last, "the grid of ticks went back"))
        if k <= counts.last:
            shell.say_again(now)
            return
        late = now - (start + k * self._dt_ns)
        if k - counts.last != every or k >= self._ticks:
            # missed ticks are left out whole, never caught up
            counts.skipped += (min(k, -(-self._ticks // every) * every) - counts.last) // every - 1
        counts.last = k
        if k >= self._ticks:
            shell.finish()
            return
        shell.tick(k, now, late)
        shell.say_again(now)
        shell.live_line.announce(now)
