"""The live loop of one end: a timer, a socket and a device around an `Endpoint`."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable
from typing import Any

from teleop.law.contract import not_finite
from teleop.live import fault
from teleop.live.devices.guarded_device import Device, Stand, deadline_of
from teleop.live.hearing import Hearing
from teleop.live.leaving import UNRELEASED, leave, let_go
from teleop.live.meeting import meet
from teleop.live.net.wire import DRAIN, SHARE, Wire
from teleop.live.process.interrupt import Interrupt
from teleop.live.process.suspension import Suspension, boottime
from teleop.live.process.ticker import Alarm
from teleop.live.records.record import Recorder
from teleop.live.records.summary import live_numbers
from teleop.live.security import tell_relayed
from teleop.protocol.endpoint import Axes, Endpoint, Reading, Stepped
from teleop.protocol.guard import Event
from teleop.protocol.packet import Kind, peek
from teleop.protocol.session import FINISHED
from teleop.scene.scene import Scene
from teleop.simulation.outcome import divergence

SAY_NS = 250_000_000  # between two live lines


class Shell:
    """Runs one end: `await shell.run()` returns when the run is over; then `status` and `sentence` say how."""

    def __init__(
        self, endpoint: Endpoint, device: Device, wire: Wire, recorder: Recorder, say: Callable[[dict[str, Any]], None],
        *, patience: float | None, interrupt: Interrupt,
    ) -> None:
        self.endpoint, self.wire, self.recorder = endpoint, wire, recorder
        self.hearing = Hearing(endpoint, wire)
        self.suspension = Suspension(boottime())
        self.stand = Stand(device, endpoint.scene.axes, trusted=endpoint.stepped)
        if (deadline := deadline_of(device, endpoint)) is not None:
            endpoint.guard.lapse_after(deadline)
        self.scene: Scene = endpoint.scene
        self.status, self.sentence = "stopped", "did not start"
        self.ticks = self.skipped = self.data_sent = 0
        self.insecure = False  # in the open beyond loopback, as somebody asked
        self.realtime: dict[str, str] | None = None  # what the system gave of it, if it was asked
        self.cpu: float | None = None  # share of a core while it ran
        self.run_time: float | None = None  # s, of that
        self.spin_ns = 0  # how long before a tick this end wakes, to wait for it awake
        self.first = 0  # its first tick
        self.dropped: int | None = None  # datagrams that the system did not hand over
        self._share_ns = int(endpoint.own.dt_ns * SHARE)
        self.late_most = 0  # ns, since the last live line
        self._noted_met = self._noted = 0  # sessions, and events of the guard, that are in the record
        self._alarm: Alarm | None = None
        self._set_to = 0  # the start of the grid that the timer is set to
        self.shown: tuple[Reading, Axes] | None = None
        self._say, self.patience, self.interrupt = say, patience, interrupt
        self.hint: Callable[[str], None] = lambda _sentence: None  # told why there is nobody, while that is waited for
        self.over = asyncio.Event()
        self.free = False  # it has let go of its device, or given that up
        self.fault: BaseException | None = None  # what a part of it raised, of which the run has ended
        self.last = -endpoint.every  # the last tick that was due
        self.ran = 0  # the last tick that ran
        self.recent: tuple[bytes, ...] = ()  # the last two DATA datagrams, to send again when stepped
        self.arrived: asyncio.Event | None = None
        self._said_ns = 0

    async def run(self) -> None:
        """The whole run: first exchange, ticks, farewell. Whatever is raised on the way ends it: see `fault`."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self.wire.sock, self.guarded, self._drain)
        try:
            gc.collect()  # now: between the first exchange and tick 0 there are 10 ms at most
            if await meet(self):
                gc.freeze()  # what is here stays: no collection has to look at it again
                used, began = time.process_time_ns(), time.monotonic_ns()
                if isinstance(self.endpoint.inbox, Stepped):
                    from teleop.live.lockstep import by_packets

                    await by_packets(self, self.endpoint.inbox)
                else:
                    await self._by_clock(loop)
                    await let_go(self)
                self.run_time = (time.monotonic_ns() - began) / 1e9
                self.cpu = (time.process_time_ns() - used) / 1e9 / max(1e-9, self.run_time)
        except BaseException as error:
            self._fail(error)
            if (task := asyncio.current_task()) is not None and task.cancelling():
                raise  # it was this task that was cancelled, from elsewhere
        finally:
            loop.remove_reader(self.wire.sock)
            await leave(self)

    async def _by_clock(self, loop: asyncio.AbstractEventLoop) -> None:
        """Tick when the timer rings. Messages matter at ticks alone, so the socket is read there: see `Wire`."""
        loop.remove_reader(self.wire.sock)
        self.hearing.begin()
        self.suspension.passed()  # before there was a session it cost nothing
        self._alarm = Alarm(loop, lambda: self.guarded(self._wake), self.spin_ns)
        if self.endpoint.session.joined:
            self._join(self._due() + 1)
        elif (reading := self.stand.read(0, time.monotonic_ns())) is not None:
            self.endpoint.place(reading.x)
        self._arm()
        try:
            await self.over.wait()
        finally:
            self._alarm.close()

    def _due(self) -> int:
        """The newest of this end's ticks that is due by now."""
        start = self.endpoint.session.start_ns
        assert start is not None
        every = self.endpoint.every
        return (time.monotonic_ns() - start) // (self.scene.dt_ns * every) * every

    def _arm(self) -> None:
        """Set the timer to the grid, which a new session or the master's clock may have moved."""
        start, span = self.endpoint.session.start_ns, self.scene.dt_ns * self.endpoint.every
        assert start is not None
        assert self._alarm is not None
        self._set_to = start
        self._alarm.set(start + ((time.monotonic_ns() - start) // span + 1) * span, span)  # tick 0 may be far ahead

    def _join(self, k: int) -> None:
        """Take part from about tick k on in a run that the other end has been running."""
        k = max(0, k) // self.endpoint.every * self.endpoint.every
        if k < self.scene.ticks:
            self.stand.read(k, time.monotonic_ns())  # a simulated device has to come there first
        self.last = self._due()
        if self.last >= self.scene.ticks:
            self.end("refused", "the run was over when this end came; start both ends again")
            return
        self.first = self.last + self.endpoint.every
        self.endpoint.join(self.first)

    def stop(self, why: str) -> None:
        """End the run now, as a stop that is none of the scene's doing."""
        self.end("stopped", f"stopped at t = {self.so_far():.3f} s: {why}")

    def bye(self) -> list[bytes]:
        """The farewell that says how the run ended for this end."""
        return self.endpoint.session.bye(FINISHED if self.status == "ok" else self.sentence, time.monotonic_ns())

    def guarded(self, callback: Callable[[], None]) -> None:
        """Call `callback`; whatever it raises ends the run: see `teleop.live.fault`."""
        try:
            callback()
        except BaseException as error:
            self._fail(error)

    def _fail(self, error: BaseException) -> None:
        """Hold no force from this moment on: something was raised. The first such error is what the run ended of."""
        self.stand.closed = True
        self.stand.let_go()
        if self.fault is None:
            self.fault = error
            why = fault.sentence(error, self.scene.law, "master" if self.endpoint.e == "m" else "slave")
            if self.status != UNRELEASED:  # which weighs more
                self.status, self.sentence = "stopped", f"stopped at t = {self.so_far():.3f} s: {why}"
        self.over.set()

    def so_far(self) -> float:
        """The time of the run (s) up to which this end has come."""
        return (self.last + 1) * self.scene.dt_ns / 1e9

    def send(self, datagrams: list[bytes]) -> None:
        for data in datagrams:
            self.wire.send(data)

    def _drain(self) -> None:
        session, taken = self.endpoint.session, 0
        until = time.monotonic_ns() + self._share_ns
        while taken < DRAIN or time.monotonic_ns() < until:
            taken += 1
            got = self.wire.receive()
            if got is None:
                break
            data, address, came = got
            if data is None:
                continue
            if self.hearing.is_strange(data, address):
                continue
            met = session.met
            replies = self.endpoint.receive(data, came)
            if session.met != met or (replies and not met):
                self.wire.peer = address  # a stranger's copy of a packet must not draw ours to it
            self.wire.follow()
            for reply in replies:
                if peek(reply)[0] in (Kind.WELCOME, Kind.REFUSE):
                    self.wire.answer(reply, address)
                else:
                    self.wire.send(reply)
        if self.arrived is not None:
            self.arrived.set()

    def say_again(self, now: int) -> None:
        """Send what was not answered. A new session is asked for where this end was told to ask."""
        session, wire = self.endpoint.session, self.wire
        if session.meeting and wire.asked is not None:
            wire.peer = wire.asked
        self.send(session.due(now))
        wire.due(now)

    def _wake(self) -> None:
        session, scene = self.endpoint.session, self.scene
        if (slept := self.suspension.passed()):
            self.endpoint.stood_still(slept)
        now = time.monotonic_ns()
        before = self.hearing.heard()
        self._drain()  # first, for it tells of what came while this process was away, and of where the grid is
        self.hearing.listen(now, before)
        if session.farewell not in (None, FINISHED):
            self.stop(f"the other end left: {session.farewell}")
        elif self.interrupt.name is not None:
            self.stop(f"it was asked to stop ({self.interrupt.name})")
        assert session.start_ns is not None
        every = self.endpoint.every
        k = (now - session.start_ns) // (scene.dt_ns * every) * every
        if session.start_ns != self._set_to:
            self._arm()
        if self.over.is_set():
            return
        if k < self.last and self.last >= 0:  # a new session's grid is behind: no force until it is there again
            self._hold(self.endpoint.left_out(self.last, "the grid of ticks went back"))
        if k <= self.last:
            self.say_again(now)
            return
        late = now - (session.start_ns + k * scene.dt_ns)
        # missed ticks are left out whole, never caught up
        self.skipped += (min(k, -(-scene.ticks // every) * every) - self.last) // every - 1
        self.last = k
        if k >= scene.ticks:
            self.finish()
            return
        self.tick(k, now, late)
        self.say_again(now)
        self.announce(now)

    def announce(self, now: int) -> None:
        if now - self._said_ns > SAY_NS and self.shown is not None:
            self._said_ns = now
            try:
                self._say(live_numbers(self))
            except (OSError, ValueError):  # whoever read along has left: that is no reason to let go of the robot
                self._said_ns = 1 << 63

    def tick(self, k: int, now: int, late: int) -> None:
        """Read, compute, hold, send, record: one tick of this end."""
        stand = self.stand
        reading = stand.read(k, now)
        if stand.dead(now):
            self.stop(f"the device fails: {stand.trouble}")
            return
        trouble = None if stand.trouble is None else f"the device: {stand.trouble}"
        if reading is None:
            self._hold(self.endpoint.left_out(k, str(trouble)))
            self.note()
            return
        if self.ticks and self.beyond(reading):
            return
        out = self.endpoint.tick(k, now, reading, trouble)
        failed = self.endpoint.force_failed
        if failed is None:
            self._hold(out.force)
        if out.datagram is not None:
            self.wire.send(out.datagram)
            self.data_sent += 1
            self.recent = (*self.recent[-1:], out.datagram)
        elif failed is None and (self.endpoint.stepped or self.endpoint.message_failed):
            failed = "the message"  # the other end cannot go on without it
        self.recorder.add(k, late, out.played, out.row)
        self.ticks += 1
        self.ran = k
        self.late_most = max(self.late_most, late)
        if failed is None:
            self.shown = reading, out.force
        else:
            self.endpoint.guard.tell(k, "safe", f"the law: {failed} is not finite")
            self.end("diverged", divergence(self.scene, k, not_finite(self.scene.law, failed)))
        self.note()

    def _hold(self, force: Axes) -> None:
        """Have the device hold `force`. What did not take it may hold anything, and begins again at zero."""
        if not self.stand.hold(force):
            self.endpoint.held.lost()

    def note(self) -> None:
        """Write down what has happened since the last time."""
        events = self.endpoint.guard.events
        while self._noted < len(events):
            self.recorder.note(events[self._noted])
            self._noted += 1
        session = self.endpoint.session
        if session.met != self._noted_met and session.number is not None:
            self._noted_met = session.met
            self.recorder.note(Event(self.ran, "met", f"session {session.number:016x}"))
            tell_relayed(self)

    def beyond(self, reading: Reading) -> bool:
        """Has the motion left the scene's bounds? Then the run is over, at the tick before this one."""
        limit = self.scene.x_limit
        if all(-limit < x < limit for x in reading.x):
            return False
        self.endpoint.guard.tell(self.ran, "safe", f"the motion: x_{self.endpoint.e} passed {limit:g} m")
        self.note()
        self.end("diverged", divergence(self.scene, self.ran, f"x_{self.endpoint.e} passed {limit:g} m"))
        return True

    def finish(self) -> None:
        reading = self.stand.read(self.scene.ticks, time.monotonic_ns())
        if reading is not None and self.beyond(reading):
            return
        missed = f", {self.skipped} of them skipped" if self.skipped else ""
        joined = f"joined at t = {self.first * self.scene.dt_ns / 1e9:.3f} s and " if self.first else ""
        due = -(-(self.scene.ticks - self.first) // self.endpoint.every)
        self.end("ok", f"{joined}ran to its end, {due} ticks of {self.endpoint.own.dt:g} s{missed}")

    def end(self, status: str, sentence: str) -> None:
        if not self.over.is_set():
            self.status, self.sentence = status, sentence
            self.over.set()


fault.named(Shell.announce, "the live line")
