"""The live loop of one end: a timer, a socket and a device around an `Endpoint`."""

from __future__ import annotations

import asyncio
import gc
import signal
import socket
import time
from collections.abc import Callable
from typing import Any, Protocol

from teleop.endpoint import Axes, Endpoint, Reading, Stepped
from teleop.live.record import Recorder
from teleop.live.ticker import Alarm
from teleop.lockstep import divergence
from teleop.scene import Scene

DRAIN = 16  # datagrams taken at one tick or wake-up: more would let a flood starve the tick
SAY_NS = 250_000_000  # between two live lines
HUSH = "finished"  # the farewell of an end that ran to its end: no reason for the other to stop
AGAIN = 0.02  # s: a stepped end sends its last packets again after this silence
SILENT = 250  # such silences in a row, and a stepped end gives the other up
LINGER = 50  # such pauses at most for the farewell of the other
Address = tuple[str, int]


class Device(Protocol):
    """A master device or a slave robot, as the live loop uses it."""

    def read(self, k: int) -> Reading:
        """What it reads at tick k; the force held since the last reading acted until now."""
        ...

    def hold(self, force: Axes) -> None:
        """Hold this force (N, per axis) from now on."""
        ...


class Wire:
    """A non-blocking UDP socket with one peer. Nothing that happens on it raises into the loop."""

    def __init__(self, sock: socket.socket, peer: Address | None) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.sock, self.peer = sock, peer
        self.sent = self.unsent = 0

    def send(self, data: bytes) -> None:
        """To the peer, if there is one yet. What the system does not take now is lost, as on any network."""
        if self.peer is None:
            return
        try:
            self.sock.sendto(data, self.peer)
            self.sent += 1
        except OSError:
            self.unsent += 1

    def receive(self) -> tuple[bytes, Address] | None:
        """A datagram and where it came from, or None if there is none now."""
        try:
            data, address = self.sock.recvfrom(65536)
        except OSError:  # nothing there, or the peer's port is not open (yet)
            return None
        return data, address[:2]


class Shell:
    """Runs one end: `await shell.run()` returns when the run is over; then `status` and `sentence` say how."""

    def __init__(
        self, endpoint: Endpoint, device: Device, wire: Wire, recorder: Recorder, say: Callable[[dict[str, Any]], None],
        *, patience: float | None,
    ) -> None:
        self.endpoint, self.device, self.wire, self.recorder = endpoint, device, wire, recorder
        self.scene: Scene = endpoint.scene
        self.status, self.sentence = "stopped", "did not start"
        self.ticks = self.skipped = 0
        self.data_sent = 0
        self.cpu: float | None = None  # share of a core while it ran
        self._late_most = 0  # ns, since the last live line
        self._shown: tuple[Reading, Axes, tuple[float, ...]] | None = None
        self._say, self._patience = say, patience
        self._over = asyncio.Event()
        self._last = -1  # the last tick that was due
        self._ran = 0  # the last tick that ran
        self._recent: tuple[bytes, ...] = ()  # the last two DATA datagrams, to send again when stepped
        self._arrived: asyncio.Event | None = None
        self._said_ns = 0

    async def run(self) -> None:
        """The whole run: first exchange, ticks, farewell. Ctrl-C and SIGTERM end it cleanly."""
        loop = asyncio.get_running_loop()
        for name in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(name, self.stop, f"it was asked to stop ({name.name})")
        loop.add_reader(self.wire.sock, self._drain)
        try:
            if await self._meet():
                gc.collect()
                gc.freeze()  # what is here stays: no collection has to look at it again
                used, began = time.process_time_ns(), time.monotonic_ns()
                if isinstance(self.endpoint.inbox, Stepped):
                    await self._by_packets(self.endpoint.inbox)
                else:
                    await self._by_clock(loop)
                self.cpu = (time.process_time_ns() - used) / max(1, time.monotonic_ns() - began)
        finally:
            loop.remove_reader(self.wire.sock)
            self.device.hold((0.0,) * self.scene.axes)
            self.recorder.close()
            for _ in range(3):  # a farewell may be lost too
                self.wire.send(self.endpoint.session.bye(self._farewell(), time.monotonic_ns()))
                await asyncio.sleep(0.002)

    async def _by_clock(self, loop: asyncio.AbstractEventLoop) -> None:
        """Tick when the timer rings.

        Messages matter at ticks alone, so the socket is read there and wakes nobody in between: that saves a
        third of the processor time, and a flood cannot take more than `DRAIN` datagrams' worth of a tick.
        """
        loop.remove_reader(self.wire.sock)
        alarm = Alarm(loop, self._wake)
        start = self.endpoint.session.start_ns
        assert start is not None
        alarm.set(start, self.scene.dt_ns)
        await self._over.wait()
        alarm.close()

    async def _by_packets(self, inbox: Stepped) -> None:
        """Tick when the peer's packet of the tick before has come; what is lost on the way is sent again."""
        self._arrived = asyncio.Event()
        for k in range(self.scene.ticks):
            if not await self._until(lambda k=k: inbox.has(k - 1)):  # type: ignore[misc]
                return
            self.tick(k, now := time.monotonic_ns(), 0)
            self._announce(now)
        self._finish()
        for _ in range(LINGER):  # the peer may still wait for the last packets
            if self.endpoint.session.farewell is not None:
                return
            for data in (*self._recent, self.endpoint.session.bye(self._farewell(), time.monotonic_ns())):
                self.wire.send(data)
            await asyncio.sleep(AGAIN)

    async def _until(self, ready: Callable[[], bool]) -> bool:
        """Wait for `ready`; False if the run is over, or nothing has come for a time."""
        assert self._arrived is not None
        quiet = 0
        while not ready():
            if self._over.is_set():
                return False
            if self.endpoint.session.farewell not in (None, HUSH) or quiet > SILENT:
                self.stop(f"the other end left: {self.endpoint.session.farewell or 'it fell silent'}")
                return False
            self._arrived.clear()
            try:
                await asyncio.wait_for(self._arrived.wait(), AGAIN)
                quiet = 0
            except TimeoutError:
                quiet += 1
                for data in (*self._recent, *self.endpoint.session.due(time.monotonic_ns())):
                    self.wire.send(data)
        return not self._over.is_set()

    def stop(self, why: str) -> None:
        """End the run now, as a stop that is none of the scene's doing."""
        self._end("stopped", f"stopped at t = {(self._last + 1) * self.scene.dt_ns / 1e9:.3f} s: {why}")

    def _farewell(self) -> str:
        return HUSH if self.status == "ok" else self.sentence

    async def _meet(self) -> bool:
        """The first exchange; False if the run was over before it began."""
        session = self.endpoint.session
        began = time.monotonic_ns()
        while not self._over.is_set():
            now = time.monotonic_ns()
            if session.failure is not None:
                self._end("refused", session.failure)
            elif session.start_ns is not None:
                return True
            elif session.farewell is not None:
                self._end("stopped", f"the other end left before the run began: {session.farewell}")
            elif self._patience is not None and now - began > self._patience * 1e9:
                self._end("refused", f"no answer from {_text(self.wire.peer)} in {self._patience:g} s; "
                                     f"start the other end first, and check the address and the port")
            for data in session.due(now):
                self.wire.send(data)
            await asyncio.sleep(0.005)
        return False

    def _drain(self) -> None:
        for _ in range(DRAIN):
            got = self.wire.receive()
            if got is None:
                break
            data, address = got
            replies = self.endpoint.receive(data, time.monotonic_ns())
            if replies:
                self.wire.peer = address  # it has shown that it belongs to this session
            for reply in replies:
                self.wire.send(reply)
        if self._arrived is not None:
            self._arrived.set()

    def _wake(self) -> None:
        now = time.monotonic_ns()
        session, scene = self.endpoint.session, self.scene
        assert session.start_ns is not None
        k = (now - session.start_ns) // scene.dt_ns
        if k <= self._last:
            return
        self._drain()
        if session.farewell not in (None, HUSH):
            self.stop(f"the other end left: {session.farewell}")
            return
        if k >= scene.ticks:
            self._finish()
            return
        late = now - (session.start_ns + k * scene.dt_ns)
        self.skipped += k - self._last - 1  # missed ticks are left out whole, never caught up
        self._last = k
        self.tick(k, now, late)
        for data in session.due(now):
            self.wire.send(data)
        self._announce(now)

    def _announce(self, now: int) -> None:
        if now - self._said_ns > SAY_NS and self._shown is not None:
            self._said_ns = now
            self._say(self.live_numbers())

    def tick(self, k: int, now: int, late: int) -> None:
        """Read, compute, hold, send, record: one tick of this end."""
        reading = self.device.read(k)
        if self.beyond(reading):
            return
        out = self.endpoint.tick(k, now, reading)
        self.recorder.add(k, late, out.played, out.row)
        self.ticks += 1
        self._ran = k
        self._late_most = max(self._late_most, late)
        if self.endpoint.force_failed is not None:
            self._end("diverged", divergence(self.scene, k, f"{self.endpoint.force_failed} is not finite"))
            return
        self.device.hold(out.force)
        if out.datagram is not None:
            self.wire.send(out.datagram)
            self.data_sent += 1
            self._recent = (*self._recent[-1:], out.datagram)
        self._shown = reading, out.force, out.row

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


def _text(peer: Address | None) -> str:
    return "the other end" if peer is None else f"{peer[0]}:{peer[1]}"
