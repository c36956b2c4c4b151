"""The live loop of one end: a timer, a socket and a device around an `Endpoint`."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable
from typing import Any, Protocol

from teleop.endpoint import Axes, Endpoint, Reading, Stepped
from teleop.live.address import shown
from teleop.live.interrupt import Interrupt
from teleop.live.record import Recorder
from teleop.live.ticker import Alarm
from teleop.live.wire import DRAIN, Wire
from teleop.lockstep import divergence
from teleop.scene import Scene

SAY_NS = 250_000_000  # between two live lines
HUSH = "finished"  # the farewell of an end that ran to its end: no reason for the other to stop
AGAIN = 0.02  # s: a stepped end sends its last packets again after this silence
SILENT = 250  # such silences in a row, and a stepped end gives the other up
HEED = 15  # arrivals or silences, and a stepped end heeds a farewell: last packets may come behind it
LINGER = 50  # such pauses at most for the farewell of the other
OPEN_NS = 1_000_000_000  # of silence, after which a peer is listened for from anywhere
EARLY_NS = 10_000_000  # so long before tick 0 the first exchange is over at the latest


class Device(Protocol):
    """A master device or a slave robot, as the live loop uses it."""

    def read(self, k: int) -> Reading:
        """What it reads at tick k; the force held since the last reading acted until now."""
        ...

    def hold(self, force: Axes) -> None:
        """Hold this force (N, per axis) from now on."""
        ...


class Shell:
    """Runs one end: `await shell.run()` returns when the run is over; then `status` and `sentence` say how."""

    def __init__(
        self, endpoint: Endpoint, device: Device, wire: Wire, recorder: Recorder, say: Callable[[dict[str, Any]], None],
        *, patience: float | None, interrupt: Interrupt,
    ) -> None:
        self.endpoint, self.device, self.wire, self.recorder = endpoint, device, wire, recorder
        self.scene: Scene = endpoint.scene
        self.status, self.sentence = "stopped", "did not start"
        self.ticks = self.skipped = 0
        self.data_sent = 0
        self.insecure = False  # in the open beyond loopback, as somebody asked
        self.realtime: dict[str, str] | None = None  # what the system gave of it, if it was asked
        self.cpu: float | None = None  # share of a core while it ran
        self.run_time: float | None = None  # s, of that
        self._late_most = 0  # ns, since the last live line
        self._shown: tuple[Reading, Axes, tuple[float, ...]] | None = None
        self._say, self._patience, self._interrupt = say, patience, interrupt
        self._over = asyncio.Event()
        self._broken: Exception | None = None  # what a callback of the loop raised
        self._last = -1  # the last tick that was due
        self._ran = 0  # the last tick that ran
        self._recent: tuple[bytes, ...] = ()  # the last two DATA datagrams, to send again when stepped
        self._arrived: asyncio.Event | None = None
        self._said_ns = 0
        self._heard_ns = 0  # when the last message came
        self._listening = False  # to everybody, for it was silent

    async def run(self) -> None:
        """The whole run: first exchange, ticks, farewell. An interrupt ends it cleanly; what is a bug raises."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self.wire.sock, self._guarded, self._drain)
        try:
            if await self._meet():
                gc.collect()
                gc.freeze()  # what is here stays: no collection has to look at it again
                used, began = time.process_time_ns(), time.monotonic_ns()
                if isinstance(self.endpoint.inbox, Stepped):
                    await self._by_packets(self.endpoint.inbox)
                else:
                    await self._by_clock(loop)
                self.run_time = (time.monotonic_ns() - began) / 1e9
                self.cpu = (time.process_time_ns() - used) / 1e9 / max(1e-9, self.run_time)
            if self._broken is not None:
                raise self._broken
        except Exception as error:
            self._over.clear()
            self.stop(f"it failed with {type(error).__name__}: {error}")
            raise
        finally:
            loop.remove_reader(self.wire.sock)
            self.device.hold((0.0,) * self.scene.axes)
            self.recorder.close()
            for _ in range(3):  # a farewell may be lost too
                self._send(self._bye())
                await asyncio.sleep(0.002)
            self.wire.end()

    async def _by_clock(self, loop: asyncio.AbstractEventLoop) -> None:
        """Tick when the timer rings.

        Messages matter at ticks alone, so the socket is read there and wakes nobody in between: that saves a
        third of the processor time, and a flood cannot take more than `DRAIN` datagrams' worth of a tick.
        """
        loop.remove_reader(self.wire.sock)
        self.wire.keep_to_peer()
        self._heard_ns = time.monotonic_ns()
        start = self.endpoint.session.start_ns
        assert start is not None
        alarm = Alarm(loop, lambda: self._guarded(self._wake))
        try:
            alarm.set(start, self.scene.dt_ns)
            await self._over.wait()
        finally:
            alarm.close()

    async def _by_packets(self, inbox: Stepped) -> None:
        """Tick when the peer's packet of the tick before has come; what is lost on the way is sent again."""
        self._arrived = asyncio.Event()
        for k in range(self.scene.ticks):
            if not await self._until_there(inbox, k - 1):
                break
            self._last = k
            self.tick(k, now := time.monotonic_ns(), 0)
            self._announce(now)
        else:
            self._finish()
        for _ in range(LINGER):  # the peer may still wait for the last packets
            if self.endpoint.session.farewell is not None or self._broken is not None:
                return
            self._send([*self._recent, *self._bye()])
            await asyncio.sleep(AGAIN)

    async def _until_there(self, inbox: Stepped, packet: int) -> bool:
        """Wait for the peer's packet; False if the run is over, or nothing has come for a time."""
        assert self._arrived is not None
        quiet = 0
        while not self._over.is_set():
            if inbox.has(packet):
                return True
            left = self.endpoint.session.farewell not in (None, HUSH)
            if quiet > (HEED if left else SILENT):
                self.stop(f"the other end left: {self.endpoint.session.farewell or 'it fell silent'}")
            if self._interrupt.name is not None:
                self.stop(f"it was asked to stop ({self._interrupt.name})")
            self._arrived.clear()
            try:
                await asyncio.wait_for(self._arrived.wait(), AGAIN)
                quiet = quiet + 1 if left else 0
            except TimeoutError:
                quiet += 1
                self.wire.due(time.monotonic_ns())
                self._send([*self._recent, *self.endpoint.session.due(time.monotonic_ns())])
        return False

    def stop(self, why: str) -> None:
        """End the run now, as a stop that is none of the scene's doing."""
        self._end("stopped", f"stopped at t = {(self._last + 1) * self.scene.dt_ns / 1e9:.3f} s: {why}")

    def _bye(self) -> list[bytes]:
        """The farewell that says how the run ended for this end."""
        return self.endpoint.session.bye(HUSH if self.status == "ok" else self.sentence, time.monotonic_ns())

    async def _meet(self) -> bool:
        """The first exchange; False if the run was over before it began."""
        session, stepped = self.endpoint.session, self.endpoint.stepped
        began = time.monotonic_ns()
        while not self._over.is_set():
            now = time.monotonic_ns()
            if session.failure is not None:
                self._end("refused", session.failure)
            elif session.farewell not in (None, HUSH):
                self._end("refused", f"the other end left before the run began: {session.farewell}")
            elif self._interrupt.name is not None:
                self.stop(f"it was asked to stop ({self._interrupt.name})")
            elif session.start_ns is not None:
                # Until then what was lost of the exchange can be said again.
                if stepped or now > session.start_ns - EARLY_NS:
                    return True
            elif self._patience is not None and now - began > self._patience * 1e9:
                self._end("refused", self._nobody(self._patience))
            self._send(session.due(now))
            self.wire.due(now)
            await asyncio.sleep(0.005)
        return False

    def _nobody(self, patience: float) -> str:
        peer, line = self.wire.peer, self.wire.line
        if line is not None and line.trouble is not None:
            return f"no peer was let in in {patience:g} s: {line.trouble}"
        if peer is None:
            return f"no master came in {patience:g} s; start one that has this address as its --peer, or --wait longer"
        return f"no answer from {shown(peer)} in {patience:g} s; start the other end first, and check address and port"

    def _guarded(self, callback: Callable[[], None]) -> None:
        """Call `callback`; what it raises ends the run. The event loop itself would only log it and go on."""
        try:
            callback()
        except Exception as error:
            self._broken = self._broken or error
            self._over.set()

    def _send(self, datagrams: list[bytes]) -> None:
        for data in datagrams:
            self.wire.send(data)

    def _drain(self) -> None:
        session = self.endpoint.session
        for _ in range(DRAIN):
            got = self.wire.receive()
            if got is None:
                break
            data, address, came = got
            if data is None:
                continue
            meeting, before = session.start_ns is None, self.endpoint.way.count
            replies = self.endpoint.receive(data, came)
            if replies and meeting:  # it has shown that it belongs to this session
                self.wire.peer = address  # later, a stranger's copy of a packet must not draw ours to it
            elif self._deaf_again(before):
                self.wire.peer = address
                self.wire.keep_to_peer()
            self.wire.follow()
            self._send(replies)
        if self._arrived is not None:
            self._arrived.set()

    def _deaf_again(self, before: int) -> bool:
        """Has a new message of this session come, after a silence in which anybody was listened to?"""
        return self._listening and self.endpoint.way.count > before

    def _listen(self, now: int, before: int) -> None:
        """After a silence listen to everybody: the peer, or the channel, may come back from another port."""
        if self.endpoint.way.count > before:
            self._heard_ns, self._listening = now, False
        elif now - self._heard_ns > OPEN_NS and not self._listening:
            self._listening = True
            self.wire.listen_to_all()

    def _wake(self) -> None:
        now = time.monotonic_ns()
        session, scene = self.endpoint.session, self.scene
        assert session.start_ns is not None
        k = (now - session.start_ns) // scene.dt_ns
        if k <= self._last or self._over.is_set():
            return
        before = self.endpoint.way.count  # of new messages: a copy of an old one proves nothing
        self._drain()
        self._listen(now, before)
        if session.farewell not in (None, HUSH):
            self.stop(f"the other end left: {session.farewell}")
            return
        if self._interrupt.name is not None:
            self.stop(f"it was asked to stop ({self._interrupt.name})")
            return
        late = now - (session.start_ns + k * scene.dt_ns)
        self.skipped += min(k, scene.ticks) - self._last - 1  # missed ticks are left out whole, never caught up
        self._last = k
        if k >= scene.ticks:
            self._finish()
            return
        self.tick(k, now, late)
        self._send(session.due(now))
        self.wire.due(now)
        self._announce(now)

    def _announce(self, now: int) -> None:
        if now - self._said_ns > SAY_NS and self._shown is not None:
            self._said_ns = now
            try:
                self._say(self.live_numbers())
            except OSError:  # whoever read along has left: that is no reason to let go of the robot
                self._said_ns = 1 << 63

    def tick(self, k: int, now: int, late: int) -> None:
        """Read, compute, hold, send, record: one tick of this end."""
        reading = self.device.read(k)
        if self.ticks and self.beyond(reading):
            return
        out = self.endpoint.tick(k, now, reading)
        failed = self.endpoint.force_failed
        if failed is None:
            self.device.hold(out.force)
        if out.datagram is not None:
            self.wire.send(out.datagram)
            self.data_sent += 1
            self._recent = (*self._recent[-1:], out.datagram)
        elif self.endpoint.stepped and failed is None:
            failed = "the message"  # the other end cannot step without it
        self.recorder.add(k, late, out.played, out.row)
        self.ticks += 1
        self._ran = k
        self._late_most = max(self._late_most, late)
        if failed is None:
            self._shown = reading, out.force, out.row
        else:
            self._end("diverged", divergence(self.scene, k, f"{failed} is not finite"))

    def beyond(self, reading: Reading) -> bool:
        """Has the motion left the scene's bounds? Then the run is over, at the tick before this one."""
        limit = self.scene.x_limit
        if all(-limit < x < limit for x in reading.x):
            return False
        self._end("diverged", divergence(self.scene, self._ran, f"x_{self.endpoint.e} passed {limit:g} m"))
        return True

    def live_numbers(self) -> dict[str, Any]:
        """What the live line shows."""
        assert self._shown is not None
        reading, force, row = self._shown
        late, self._late_most = self._late_most, 0
        way = self.endpoint.way
        return {
            "end": self.endpoint.e, "k": self._ran, "x": reading.x[0], "f": force[0], "late_us": late / 1e3,
            "delay": way.recent / 1e9 if way.count else None, "gain": self.endpoint.gain(row),
        }

    def _finish(self) -> None:
        if self.beyond(self.device.read(self.scene.ticks)):
            return
        missed = f", {self.skipped} of them skipped" if self.skipped else ""
        self._end("ok", f"ran to its end, {self.scene.ticks} ticks of {self.scene.dt:g} s{missed}")

    def _end(self, status: str, sentence: str) -> None:
        if not self._over.is_set():
            self.status, self.sentence = status, sentence
            self._over.set()
