"""Shell of a live end: its `Connection`, socket, device and record; how its run ended, and which part failed.

What drives it, tick by tick, stands in `driving`; how it lets go of its device in `leaving`.

KeyboardInterrupt, SystemExit, CancelledError and the panics of compiled extensions are no `Exception`. So a live end
takes whatever is raised, of any type, for a fault: no force at once, the end of the run, a sentence on the part.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from teleop.errors import Refused, enumerated, number_of, plural
from teleop.law.contract import Method, not_finite, refusal
from teleop.live.devices.guarded_device import GuardedDevice, LiveDevice, deadline_of
from teleop.live.live_line import LiveLine, Say
from teleop.live.net.wire import DRAIN, Wire
from teleop.live.options import tell_insecure
from teleop.live.orders import SHARE, intake
from teleop.live.process.interrupt import Interrupt
from teleop.live.process.realtime import RealTime
from teleop.live.records.end_result import UNRELEASED
from teleop.live.records.record import RecordWriter
from teleop.protocol.connection import Connection
from teleop.protocol.endpoint import Axes, Endpoint, Reading
from teleop.protocol.guard import Event
from teleop.protocol.packet import one_line
from teleop.protocol.session import SessionBegun
from teleop.scene.scene import Scene
from teleop.simulation.ending import divergence
from teleop.terminal.options import DONE, complain

MOST_TIMES = 5  # that signals are taken back: while a device is opened and read first, before tick 0, and two more
TRACEBACK = "error.txt"
MAY_BE_ON = "THE FORCE MAY STILL BE ON, switch the device off"
PARTS: dict[CodeType, str] = {
    GuardedDevice.read.__code__: "the device, asked for a reading,",
    GuardedDevice.hold.__code__: "the device, given a force,",
    Endpoint.tick.__code__: "the law",
    Endpoint.receive.__code__: "the reading of a packet",
    LiveLine.announce.__code__: "the live line",
    **{part.__code__: "the record"
       for part in (RecordWriter.begin, RecordWriter.add, RecordWriter.note, RecordWriter.flush)},
}


def part_of(frames: Iterable[FrameType]) -> str | None:
    """The part that the innermost of these frames, which come last, is in; None of no part that has a name here."""
    names = [PARTS[frame.f_code] for frame in frames if frame.f_code in PARTS]
    return names[-1] if names else None


def fault_sentence(error: BaseException, law: Any = None, method: str = "") -> str:
    """The part that raised `error`, and its text; a method of `law` with the line in its file.

    `method`: the law's method at this end; an error that comes of using its answer names it.
    """
    if isinstance(error, Refused):
        return str(error)
    if law is not None and (refused := refusal(law, error)) is not None:
        return str(refused)
    part = part_of(frame for frame, _ in traceback.walk_tb(error.__traceback__))
    if law is not None and part == PARTS[Endpoint.tick.__code__]:
        part = f"the answer of {Method(law, method).label}{Method(law, method).first_line()}"
    detail = f": {text}" if (text := one_line(_error_text(error))) else ""
    return f"{part or 'the live loop'} raised {type(error).__name__}{detail}"


def name_part(function: Any, part: str) -> None:
    """Call the part that `function` belongs to `part` in sentences."""
    PARTS[function.__code__] = part


def _error_text(error: Any) -> str:
    try:
        return str(error)
    except BaseException:  # an exception's own __str__ may be what is broken
        return ""


def write_traceback(error: BaseException, folder: Path) -> None:
    """The traceback, for the author of the part; raises OSError if the disk takes no more."""
    (folder / TRACEBACK).write_text("".join(traceback.format_exception(error)), errors="backslashreplace")


class Outcome:
    """The end of one run: `status` (ok, stopped, diverged, refused or unreleased), its `sentence`, and `over`.

    `fault`: what a part of the end raised, of which the run has ended; None if nothing did.
    """

    def __init__(self) -> None:
        self.status = "stopped"
        self.sentence = "did not start"
        self.over = False
        self.fault: BaseException | None = None

    def end(self, status: str, sentence: str) -> None:
        """The run is over; the first call counts."""
        if not self.over:
            self.status = status
            self.sentence = sentence
            self.over = True

    def fail(self, error: BaseException, why: str, t: float) -> None:
        """The run is over at time `t` (s), for a part of the end raised `error`; the first error counts."""
        if self.fault is None:
            self.fault = error
            if self.status != UNRELEASED:  # which weighs more
                self.status = "stopped"
                self.sentence = f"stopped at t = {t:.3f} s: {why}"
        self.over = True

    def unreleased(self, why: str) -> None:
        """The device did not take zero force."""
        self.status = UNRELEASED
        self.sentence += f"; {why}: {MAY_BE_ON}"


@dataclass
class EndCounts:
    """Counts of a live end. `last`: the last tick that was due; `ran`: the last one that ran."""

    last: int
    ticks: int = 0
    skipped: int = 0
    in_read: int = 0  # ticks that went by while the device was read
    longest_read: int = 0  # of those reads, ns
    data_sent: int = 0
    first: int = 0  # the first tick
    ran: int = 0
    cpu: float | None = None  # share of a core while it ran
    run_time: float | None = None  # s, of that
    dropped: int | None = None  # datagrams that the system did not hand over

    @property
    def skipped_share(self) -> float:
        """Share of the ticks so far that were skipped."""
        return self.skipped / max(1, self.skipped + self.ticks)


class Shell:
    """Owns one end. `driving` and `leaving` call it; it calls neither of them."""

    def __init__(
        self, endpoint: Endpoint, device: LiveDevice, wire: Wire, recorder: RecordWriter, say: Say,
        *, peer_timeout: float | None, interrupt: Interrupt,
    ) -> None:
        self.endpoint, self.wire, self.recorder, self.interrupt = endpoint, wire, recorder, interrupt
        self.scene: Scene = endpoint.scene
        endpoint.witness = recorder.inputs
        self.connection = Connection(endpoint, wire.peer, sealed=wire.secure_link is not None)
        self.device = GuardedDevice(device, endpoint.scene.axes, trusted=endpoint.stepped)
        if (deadline := deadline_of(device, endpoint)) is not None:
            endpoint.guard.lapse_after(deadline)
        self.outcome = Outcome()
        self.counts = EndCounts(last=-endpoint.every)
        self._span_ns = endpoint.every * endpoint.scene.dt_ns  # another scene keeps both
        self.live_line = LiveLine(endpoint, lambda numbers: say(numbers | {"skipped": self.counts.skipped_share}))
        self.insecure = False  # the link is in the open beyond loopback, as --insecure allows or a relay reports
        self.realtime: RealTime | None = None  # the scheduling of its process
        self.peer_timeout = peer_timeout  # s for the first exchange; None: without a bound
        self.hint: Callable[[str], None] = lambda _sentence: None  # takes the reason why no peer is there
        self.free = False  # it has let go of its device, or given that up
        self.recent: tuple[bytes, ...] = ()  # the last two DATA datagrams, to send again when stepped
        self.report: Callable[[Event], None] = lambda _event: None  # takes each event as it is recorded
        self.obey: Callable[[], bool] | None = None  # carries out orders, if it takes any; False: there are no more
        self._share_ns = int(endpoint.end_scene.dt_ns * SHARE)

    def go_on(self, endpoint: Endpoint, recorder: RecordWriter, counts: EndCounts) -> None:
        """Go on with another endpoint of the same session, grid and device: see `teleop.live.turning`."""
        self.endpoint = self.connection.endpoint = endpoint
        self.scene, self.recorder, self.counts = endpoint.scene, recorder, counts
        endpoint.witness = recorder.inputs
        self.live_line.go_on(endpoint)

    def retake_signals(self) -> None:
        """Take back the signals that a driver or a library has taken for itself, and name them."""
        self.interrupt.retake()
        if names := self.interrupt.pop_retaken():
            why = (f"a driver or a library had taken {enumerated(names)} for itself; taken back, so that "
                   f"{plural(len(names), 'it ends', 'they end')} this run with its force at zero")
            self.note(Event(self.counts.ran, "signals", why))
            complain(why, DONE)
            if self.interrupt.times > MOST_TIMES:
                self.stop(f"a driver or a library takes {enumerated(names)} for itself again and again, and a signal "
                          "could end this process with its force on; have it leave signals alone")

    def so_far(self) -> float:
        """The time of the run (s) up to which this end has come."""
        return (self.counts.last + 1) * self.scene.dt_ns / 1e9

    def stop(self, why: str) -> None:
        """End the run now, as a stop that is none of the scene's doing."""
        self.outcome.end("stopped", f"stopped at t = {self.so_far():.3f} s: {why}")

    def guarded(self, callback: Callable[[], object]) -> None:
        """Call `callback`; whatever it raises ends the run."""
        try:
            callback()
        except BaseException as error:
            self.fail(error)

    def fail(self, error: BaseException) -> None:
        """Hold no force from this moment on: something was raised."""
        self.device.closed = True
        self.device.let_go()
        method = "master" if self.endpoint.e == "m" else "slave"
        self.outcome.fail(error, fault_sentence(error, self.scene.laws[0], method), self.so_far())

    def bye(self) -> None:
        """Send the farewell that says how the run ended for this end."""
        reason = None if self.outcome.status == "ok" else self.outcome.sentence
        for data, to in self.connection.bye(reason, time.monotonic_ns()):
            self.wire.answer(data, to)

    def drain(self) -> None:
        """Take in the datagrams that came: `DRAIN` of them at least, and more for `SHARE` of a tick."""
        connection, wire = self.connection, self.wire
        for _ in intake(self._share_ns, least=DRAIN):
            datagram = wire.receive()
            if datagram is None:
                break
            data, address, arrival_ns = datagram
            if data is not None:
                replies = connection.receive(data, address, arrival_ns)
                if wire.peer is not connection.peer or wire.secure_link is not None:
                    wire.go_with(connection.peer)
                for reply, to in replies:
                    wire.answer(reply, to)

    def listen(self, seconds: float) -> None:
        """Wait until something comes, for so long at most, and take it in."""
        self.wire.wait(seconds)
        self.drain()

    def say_again(self, now: int) -> None:
        """Send again the messages that were not answered."""
        for data, to in self.connection.due(now):
            self.wire.go_with(self.connection.peer)
            self.wire.answer(data, to)
        if self.wire.secure_link is not None:
            self.wire.due(now)

    def take_events(self) -> bool:
        """Record the events since this was called last; True if a session has begun."""
        if not self.endpoint.guard.new_events and not self.endpoint.session.new_events:
            return False  # nearly always
        begun = False
        for event in self.connection.events():
            if isinstance(event, SessionBegun):
                begun = True
                self.note(Event(self.counts.ran, "met", f"session {event.number:016x}"))
                if self.endpoint.session.in_the_open and not self.insecure:
                    self.insecure = True
                    tell_insecure("a channel on the way carries this link beyond its machine,")
            else:
                self.note(event)
        return begun

    def note(self, event: Event) -> None:
        """Record an event, and report it to the process that gives this end its orders."""
        self.recorder.note(event)
        self.report(event)

    def tick(self, k: int, now: int, late: int) -> None:
        """Read, compute, hold, send, record: one tick of this end, which runs `late` ns late."""
        device, counts, endpoint = self.device, self.counts, self.endpoint
        began = time.monotonic_ns()
        reading = device.read(k, now)
        if (took := time.monotonic_ns() - began) > self._span_ns:
            counts.in_read += took // self._span_ns
            counts.longest_read = max(counts.longest_read, took)
        trouble = device.trouble
        if trouble is not None:
            if device.dead(now):
                self.stop(f"the device fails: {trouble}")
                return
            trouble = f"the device: {trouble}"
        if reading is None:
            self.hold(endpoint.left_out(k, str(trouble)))
            self.take_events()
            return
        if counts.ticks and self.beyond(reading):
            return
        force, datagram, row, played = endpoint.tick(k, now, reading, trouble)
        failed = endpoint.force_failed
        if failed is None and not device.hold(force):
            endpoint.held.lost()
        if datagram is not None:
            self.wire.send(datagram)
            counts.data_sent += 1
            if endpoint.stepped:
                self.recent = (*self.recent[-1:], datagram)
        elif failed is None and (endpoint.stepped or endpoint.message_failed):
            failed = "the message"  # the other end cannot go on without it
        self.recorder.add(k, late, played, row)
        counts.ticks += 1
        counts.ran = k
        if failed is None:
            self.live_line.tick(k, late, reading, force, row)
        else:
            endpoint.guard.tell(k, "safe", f"the law: {failed} is not finite")
            self.outcome.end("diverged", divergence(self.scene, k, not_finite(self.scene.laws[0], failed)))
        self.take_events()

    def hold(self, force: Axes) -> None:
        """Have the device hold `force`. What did not take it may hold anything, and begins again at zero."""
        if not self.device.hold(force):
            self.endpoint.held.lost()

    def beyond(self, reading: Reading) -> bool:
        """True if the motion has left the scene's bounds; the run is over then, at the tick before this one."""
        limit, ran = self.scene.x_limit, self.counts.ran
        if -limit < min(reading.x) and max(reading.x) < limit and isfinite(sum(reading.x)):
            return False  # nearly always
        if all(-limit < x < limit for x in reading.x):
            return False
        passed = f"x_{self.endpoint.e} passed {limit:g} m"
        self.endpoint.guard.tell(ran, "safe", f"the motion: {passed}")
        self.take_events()
        self.outcome.end("diverged", divergence(self.scene, ran, passed))
        return True

    def finish(self) -> None:
        """The run has come to its end."""
        scene, counts = self.scene, self.counts
        reading = self.device.read(scene.ticks, time.monotonic_ns())
        if reading is not None and self.beyond(reading):
            return
        missed = f", {counts.skipped} of them skipped" if counts.skipped else ""
        joined = f"joined at t = {counts.first * scene.dt_ns / 1e9:.3f} s and " if counts.first else ""
        due = -(-(scene.ticks - counts.first) // self.endpoint.every)
        ran = f"{joined}ran to its end, {number_of(due, 'tick')} of {self.endpoint.end_scene.dt:g} s"
        self.outcome.end("ok", ran + missed)
