"""Drivers of a live end: the first reading and exchange, its ticks by the clock or by packets, the way out."""

from __future__ import annotations

import gc
import time

from teleop.errors import Refused
from teleop.live.leaving import leave, let_go
from teleop.live.net.filter import of_next, of_records, of_session
from teleop.live.net.wire import Wire, host_port
from teleop.live.process.ticker import Alarm, Suspension, boottime
from teleop.live.shell import Shell, name_part
from teleop.protocol.endpoint import Endpoint, Stepped
from teleop.protocol.packet import VERSION, Rejection
from teleop.protocol.session import RENEW_NS
from teleop.protocol.states import Cause

OPEN_NS = RENEW_NS  # of silence, after which a peer is listened for from anywhere
SEALED_OPEN_NS = 100_000_000  # the same with keys: the peer may have moved, and the session goes on if it is found
LOOK = 0.005  # s between two looks at a device that cannot be read yet, and at whether a peer is to be waited for
AGAIN = 0.02  # s: the last packets are sent again after this wait
SILENT = 250  # such waits in which nothing of the session came, and the other is given up
HEED = 15  # such waits, and a farewell is heeded: last packets may come behind it
LINGER = 50  # such pauses at most for the farewell of the other
HINT_NS = 2_000_000_000  # of waiting for a peer, and the terminal is told what may be wrong
EARLY_NS = 10_000_000  # so long before tick 0 the exchange is over at the latest


def first_reading(shell: Shell) -> bool:
    """Read the device, before the other end is asked for anything, and begin the record; False if there is no run.

    A device that cannot be read yet is asked again, for as long as one that fails during a run.
    """
    try:
        while shell.device.read(0, now := time.monotonic_ns()) is None:
            if shell.device.dead(now):
                shell.outcome.end("refused", f"the device cannot be read: {shell.device.trouble}")
            elif shell.interrupt.name is not None:
                shell.stop(f"it was asked to stop ({shell.interrupt.name})")
            if shell.outcome.over:
                return False
            time.sleep(LOOK)
        shell.endpoint.senses(bool(shell.device.sensor), shell.device.switches)
    except Refused as refused:
        shell.outcome.end("refused", str(refused))
        return False
    shell.recorder.begin(shell.device.force_source)
    shell.retake_signals()
    return True


def meet(shell: Shell) -> bool:
    """The first exchange; False if the run was over before it began."""
    session, stepped = shell.endpoint.session, shell.endpoint.stepped
    began, hinted = time.monotonic_ns(), ""
    while not shell.outcome.over:
        now = time.monotonic_ns()
        if session.failure is not None:
            shell.outcome.end("refused", session.failure)
        elif session.left:
            shell.outcome.end("refused", f"the other end left before the run began: {session.farewell}")
        elif shell.interrupt.name is not None:
            shell.stop(f"it was asked to stop ({shell.interrupt.name})")
        elif session.start_ns is not None and not session.meeting:
            # Until then what was lost of the exchange can be said again.
            if stepped or now > session.start_ns - EARLY_NS:
                return True
        elif shell.peer_timeout is not None and now - began > shell.peer_timeout * 1e9:
            shell.outcome.end("refused", _why_no_peer(shell, f"in {shell.peer_timeout:g} s"))
        elif now - began > HINT_NS and _has_hint(shell):
            if (hint := _why_no_peer(shell, "yet")) != hinted:
                shell.hint(hint)
            hinted = hint
        shell.say_again(now)
        shell.listen(LOOK)
    return False


def _has_hint(shell: Shell) -> bool:
    """True if the reason is known why no peer has answered."""
    secure_link = shell.wire.secure_link
    if secure_link is not None and secure_link.trouble is not None:
        return True
    return shell.connection.configured is not None or _has_foreign_packets(shell)


def _why_no_peer(shell: Shell, since: str) -> str:
    """Why there is no peer, as far as it is known."""
    peer, secure_link = shell.connection.peer, shell.wire.secure_link
    if secure_link is not None and secure_link.trouble is not None:
        why = f"no peer was let in {since}: {secure_link.trouble}"
    elif peer is None:
        why = f"no master came {since}; start one that has this address as its --peer, or --wait longer"
    else:
        why = f"no answer from {host_port(peer)} {since}; start the other end first, and check address and port"
    if secure_link is None and shell.endpoint.rejected[Rejection.VERSION.value]:
        return f"{why}; what came is of another wire version than {VERSION}: install the same release at both ends"
    keys = "; what came was from no such end: has one of the two keys, and the other none?"
    return why + keys * _has_foreign_packets(shell)


def _has_foreign_packets(shell: Shell) -> bool:
    """True if packets arrived that no end of this kind sends."""
    secure_link = shell.wire.secure_link
    return sum(shell.endpoint.rejected.values() if secure_link is None else secure_link.dropped.values()) > 0


name_part(meet, "the first exchange")


class Listening:
    """Filter of the hosts that reach `wire`, and so `endpoint`. Times are ns of the monotonic clock."""

    def __init__(self, endpoint: Endpoint, wire: Wire) -> None:
        self.endpoint, self.wire = endpoint, wire
        self.to_all = False  # for the peer was silent
        self._since_ns = 0  # when it changed
        self._open_ns = OPEN_NS if wire.secure_link is None else SEALED_OPEN_NS

    def go_on(self, endpoint: Endpoint) -> None:
        """Listen for another endpoint of the same session."""
        self.endpoint = endpoint

    def update(self, now: int, begun: bool) -> None:
        """After a silence listen to all: the peer, or the channel, may come back from another port.

        `begun`: a session has begun since this was called last.
        """
        heard_ns, session = self.endpoint.heard_ns, self.endpoint.session
        if now - heard_ns <= self._open_ns and session.carries_data and not (begun or self.to_all):
            return  # nearly always
        if begun or (self.to_all and heard_ns > self._since_ns):
            self._since_ns = now
            self._keep_to_peer()
        elif not self.to_all and (now - max(heard_ns, self._since_ns) > self._open_ns or not session.carries_data):
            self._since_ns = now
            self.to_all = True
            self.wire.listen_to_all()

    def _keep_to_peer(self) -> None:
        endpoint, number, secure_link = self.endpoint, self.endpoint.session.number, self.wire.secure_link
        self.to_all = secure_link is not None and not secure_link.settled
        if self.to_all:
            self.wire.listen_to_all()  # the answer may come from the address that is in question
        elif secure_link is not None:
            self.wire.keep_to_peer(of_records())
        elif number is not None:
            shapes = of_session(number, endpoint.scene.wire_size, endpoint.format.hears)
            self.wire.keep_to_peer(shapes if endpoint.session.master else shapes + of_next(number))


def run(shell: Shell, *, spin_ns: int = 0) -> None:
    """The whole run: first reading, first exchange, ticks, farewell; then `shell.outcome` says how it ended.

    `spin_ns`: how long before a tick this end wakes, to wait for it awake. Whatever is raised on the way ends the run:
    see `Shell.fail`.
    """
    try:
        gc.collect()  # now: between the first exchange and tick 0 there are 10 ms at most
        if first_reading(shell) and meet(shell):
            gc.freeze()  # what is here stays: no collection has to look at it again
            used, began = time.process_time_ns(), time.monotonic_ns()
            try:
                if isinstance(shell.endpoint.inbox, Stepped):
                    by_packets(shell, shell.endpoint.inbox)
                else:
                    ClockDriver(shell, spin_ns).drive()
                    let_go(shell)
            finally:
                counts = shell.counts  # those of the last part, if it was turned
                counts.run_time = (time.monotonic_ns() - began) / 1e9
                counts.cpu = (time.process_time_ns() - used) / 1e9 / max(1e-9, counts.run_time)
    except BaseException as error:
        shell.fail(error)
    try:
        leave(shell)
    except BaseException as error:  # a handler of signals that a driver has set may raise at any line
        shell.fail(error)
        leave(shell)


class ClockDriver:
    """Ticks by the clock. Messages matter at ticks alone, so the socket is read there: see `Wire`."""

    def __init__(self, shell: Shell, spin_ns: int) -> None:
        self.shell = shell
        self.session = shell.endpoint.session
        self.listening = Listening(shell.endpoint, shell.wire)
        self.suspension = Suspension(boottime())
        self._dt_ns, self._ticks = shell.scene.dt_ns, shell.scene.ticks  # kept, for a scene works them out anew
        self._span_ns = self._dt_ns * shell.endpoint.every
        self._set_to = 0  # the start of the grid that the alarm is set to
        self._alarm = Alarm(spin_ns)

    def drive(self) -> None:
        """Tick until the run is over; with the force renewed carry out orders, and without whoever gives them, leave.

        Nothing else has to be done meanwhile, so this is all the loop there is: an event loop between timer and tick,
        its caches cold, cost as much again as waking up.
        """
        shell, outcome, alarm = self.shell, self.shell.outcome, self._alarm
        self.listening.update(time.monotonic_ns(), shell.take_events())
        if self.session.joined:
            self._join(self._due() + 1)
        elif (reading := shell.device.read(0, time.monotonic_ns())) is not None:
            shell.endpoint.place(reading.x)
        shell.retake_signals()
        self._arm()
        while not outcome.over:
            alarm.wait()
            self.wake()
            if shell.obey is not None and not outcome.over and not shell.obey():
                shell.stop("the process that gave it orders has ended")

    def _start_ns(self) -> int:
        """The time of tick 0."""
        start = self.session.start_ns
        assert start is not None
        return start

    def _due(self) -> int:
        """The newest of this end's ticks that is due by now."""
        return (time.monotonic_ns() - self._start_ns()) // self._span_ns * self.shell.endpoint.every

    def _arm(self) -> None:
        """Set the alarm to the grid, which a new session or the master's clock may have moved."""
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

    def _go_on(self) -> None:
        """Follow the end to its new scene: see `teleop.live.turning`."""
        self.listening.go_on(self.shell.endpoint)
        self._ticks = self.shell.scene.ticks

    def wake(self) -> None:
        """Read the socket, judge the messages, and run the tick if it is due."""
        shell, counts, session = self.shell, self.shell.counts, self.session
        if shell.interrupt.lost:
            shell.retake_signals()
        if (slept := self.suspension.duration()):
            shell.endpoint.stood_still(slept)
        if self.listening.endpoint is not shell.endpoint:
            self._go_on()
        now = time.monotonic_ns()
        shell.drain()  # first, for it tells of what came while this process was away, and of where the grid is
        self.listening.update(now, shell.take_events())
        if session.left:
            shell.stop(f"the other end left: {session.farewell}")
        elif shell.interrupt.name is not None:
            shell.stop(f"it was asked to stop ({shell.interrupt.name})")
        start, every = session.start_ns, shell.endpoint.every
        assert start is not None
        k = (now - start) // self._span_ns * every
        if start != self._set_to:
            self._arm()
        if shell.outcome.over:
            return
        if k < counts.last and counts.last >= 0:  # a new session's grid is behind: no force until it is there again
            shell.hold(shell.endpoint.left_out(counts.last, "the grid of ticks went back", Cause.CLOCK))
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


def by_packets(shell: Shell, inbox: Stepped) -> None:
    """Tick when the peer's packet of the tick before has come; what is lost on the way is sent again."""
    driver = PacketDriver(shell, inbox)
    for k in range(shell.scene.ticks):
        if not driver.has_come(k - 1):
            break
        shell.counts.last = k
        shell.tick(k, now := time.monotonic_ns(), 0)
        shell.live_line.announce(now)
    else:
        shell.finish()
    let_go(shell)  # before it waits for anything
    for _ in range(LINGER):  # the peer may still wait for the last packets
        if shell.endpoint.session.farewell is not None:
            return
        driver.send_again()
        shell.bye()
        until = time.monotonic() + AGAIN
        while (left := until - time.monotonic()) > 0.0:
            shell.listen(left)


class PacketDriver:
    """Waits for the packets of the peer, and knows for how long nothing of the session has come."""

    def __init__(self, shell: Shell, inbox: Stepped) -> None:
        self.shell, self.inbox = shell, inbox

    def send_again(self) -> None:
        """Send the last packets again."""
        for data in self.shell.recent:
            self.shell.wire.send(data)

    def has_come(self, packet: int) -> bool:
        """Wait for the peer's packet; False if the run is over, or nothing has come for a time."""
        shell, session, quiet = self.shell, self.shell.endpoint.session, 0
        heard, again = shell.endpoint.received, time.monotonic() + AGAIN
        while not shell.outcome.over:
            if self.inbox.has(packet):
                return True
            if quiet > (HEED if session.left else SILENT):
                shell.stop(f"the other end left: {session.farewell or 'it fell silent'}")
            if shell.interrupt.name is not None:
                shell.stop(f"it was asked to stop ({shell.interrupt.name})")
            shell.listen(max(0.0, again - time.monotonic()))
            if time.monotonic() < again:
                continue  # something came, perhaps from an unknown host: that is no reason to wait longer
            quiet = quiet + 1 if session.left or shell.endpoint.received == heard else 0
            heard, again = shell.endpoint.received, time.monotonic() + AGAIN
            self.send_again()
            shell.say_again(time.monotonic_ns())
        return False
