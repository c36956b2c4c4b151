"""Sessions of two ends: the exchange, the common tick grid, the life of a session, the next one, the farewell.

    master                      slave
      HELLO  manifest   ->
                        <-   WELCOME manifest      (or REFUSE and a sentence: who has not run yet stops)
      START  time of tick 0  ->
                        <-   START                 (the same, to say it has come)
      FORTH ...         <->  BACK ...
                        <-   RENEW  why     (of a slave whose session is over)
      BYE    a reason   <->  BYE

The states and what leads from one to the next are the tables of `teleop.protocol.states`. The master repeats what is
not answered, and measures the slave's clock by the round trips (`teleop.protocol.estimates`).
The master places tick 0 a little ahead on its own clock and sends it as a time on the slave's, so that
both ends count the same ticks: a packet's number is the tick it was sent at.

A session can be over for one of the ends while the run goes on: if nothing came for `RENEW_NS`; if its own packets did
not arrive at the other end for as long, as the echoes of that one say; if it stood still without noticing; or if it is
told so. From then on it sends no message of the session and takes none, and only another session releases it. The
master asks for that under the next number, which tells the slave as well; the slave asks with RENEW. Neither gives up
the session that is over before it has let go of its device, so that no force is cut off. A slave takes up a master that
was started anew in the same way. The end that kept running has the grid: a master that joins a running slave takes
tick 0 from its WELCOME, a slave that joins a running master is told a tick 0 that has passed. `met` counts sessions;
with each of them both ends begin their law from rest. Runs that go by packets have no silence to heal: `heals=False`.

A HELLO is as long as its answer at least, so that no sender can have a third party flooded with answers. A START echoes
the send time of a WELCOME, and counts only if this very slave has sent it: who has not seen that cannot start a
session, and one that was recorded cannot be played to a slave that was started anew.

`Liveness` judges a session by the peer's messages and by their echoes of ours. It is over if nothing came for
`renew_ns`, or if this end's own packets did not arrive at the other end for as long. Before the first message a link
may just be long: the master waits `first_ns` for it, doubled from one session to the next, and a slave waits on. Times
are ns.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from teleop.protocol.estimates import AHEAD_NS, MOST_RTT_NS, ClockExchange
from teleop.protocol.manifest import EVERY, INSECURE, MOST_CLOCK_NS, TICK_0, manifest_difference, parted
from teleop.protocol.packet import MOST_CONTROL, Code, Echo, Kind, Packet, code_of, encode, one_line
from teleop.protocol.states import CARRIES_DATA, MASTER, MEETING, SLAVE, Cause, Reason, SessionEvent, SessionState
from teleop.scene.playout import Fixed
from teleop.scene.scene import Scene

RENEW_NS = 1_000_000_000  # of silence, and a session is over
FIRST_NS = 2_000_000_000  # the same before its first message: doubled whenever none came, for a link may be that long


def renew_after(scene: Scene, lets_go_ns: int) -> int:
    """Silence (ns) after which a session of a scene is over, for an end that lets go `lets_go_ns` after a message.

    What came last may be played long after it was sent: until then there is a force, which no session may cut off.
    """
    played = round(scene.played_as.delay * 1e9) if isinstance(scene.played_as, Fixed) else 0
    return max(RENEW_NS, played + lets_go_ns + RENEW_NS // 10)


class Liveness:
    """Life of a session as one end knows it. The methods give the reason why the session is over, None while it is not.

    `begun_ns`: when the session began; before that nothing can have come. `renew_ns` is longer for an end that takes
    longer to let go of its device. `sound_ns`: until then there is nothing to judge, if nothing else ends the session.
    """

    def __init__(self, *, master: bool) -> None:
        self.renew_ns = RENEW_NS
        self.begun_ns = 0
        self._master = master
        self._first_ns = FIRST_NS
        self._heard_ns: int | None = None  # when the newest message came
        self._answered = False  # did a message come that shows that the peer hears this end
        self.sound_ns = 0

    def begin(self, begun_ns: int) -> None:
        """A session begins at `begun_ns`."""
        self._heard_ns = None
        self._answered = False
        self.sound_ns = 0
        self.begun_ns = begun_ns

    def wait_longer(self) -> None:
        """The next session waits twice as long for its first message, if this one had no answer."""
        self._first_ns = FIRST_NS if self._answered else min(2 * self._first_ns, MOST_RTT_NS)

    def silent(self, now: int) -> bool:
        """True if nothing has come for so long that the session is no longer kept."""
        if self._heard_ns is not None:
            return now - self._heard_ns > self.renew_ns
        return now - self.begun_ns > (self._first_timeout_ns if self._master else self.renew_ns)

    def judge(self, now: int) -> str | None:
        """Judge at every tick."""
        if now <= self.sound_ns:
            return None
        if self.silent(now):
            if self._master or self._heard_ns is not None:  # before its first message a link may just be long
                return f"nothing came for {self.renew_ns / 1e9:g} s"
        elif self._master and not self._answered and now - self.begun_ns > 2 * self._first_timeout_ns:
            return "nothing of this end arrives at the other"  # there and back it takes twice as long
        return None

    def message(self, now: int, sent_ns: int | None) -> str | None:
        """Take note of a new message of the peer, sent at `sent_ns` by this end's clock."""
        first = self._heard_ns is None
        self._heard_ns = now
        self.sound_ns = now + self.renew_ns if self._answered or not self._master else 0
        if first and sent_ns is not None and sent_ns - self.begun_ns > self.renew_ns:
            return f"its first {self.renew_ns / 1e9:g} s did not arrive"
        return None

    def echo(self, echo: Echo) -> str | None:
        """Take note of what the peer's newest message says of ours: which one came last, and how long before."""
        first = not self._answered
        self._answered = True
        if first and echo.sent_ns - self.begun_ns > self.renew_ns:
            return f"nothing of its first {self.renew_ns / 1e9:g} s arrived at the other end"
        if echo.held_ns > self.renew_ns:
            return f"nothing of this end arrived at the other for {self.renew_ns / 1e9:g} s"
        return None

    @property
    def _first_timeout_ns(self) -> int:
        """Time (ns) that a master waits for the first message."""
        return max(self._first_ns, self.renew_ns)


AGAIN_NS = 50_000_000  # what is not answered is sent again after this
OVER = "the session is over"
NEXT = 16  # numbers: a HELLO of one of these after a session's own is of its master, who renews it
ROOM = 96  # bytes: what a WELCOME says beyond its HELLO
SHORTEST = 1200  # bytes of a HELLO: the sentence of a REFUSE fits, whole if it is in English
MOST_WELCOMED = 1024  # answers that a slave remembers, to know a START by
REPEATED = {
    True: {SessionState.ASKING: Kind.HELLO, SessionState.RENEWING: Kind.HELLO, SessionState.STARTING: Kind.START,
           SessionState.OVER: Kind.START},
    False: {SessionState.OVER: Kind.RENEW},
}
"""By role (True: the master), what is sent in a state, every `AGAIN_NS`, until it is answered."""


class SessionBegun(NamedTuple):
    """An event: the two ends have met, and the session of this number has begun."""

    number: int


class Session:
    """Session of an end, its side of the exchange. `now` is the end's own monotonic clock in ns.

    `start_ns` becomes the time of tick 0 on that clock; `failure` the sentence with which this end must stop;
    `farewell` the reason that the peer gave for leaving, `left` says whether it left before its end; `ended` the reason
    why the session is over for this end, from then until another begins. `every`: this end ticks at every so many
    ticks of the grid. `met` counts the sessions that this end has begun. `heals=False`: no silence ends the session.
    """

    def __init__(
        self, *, master: bool, manifest: Mapping[str, str], number: int | None = None, every: int = 1,
        heals: bool = True,
    ) -> None:
        self.master = master
        self.manifest = dict(manifest)
        self.number = number  # of the session; a slave takes that of the master that starts it
        self.every, self.peer_every = every, 1
        self.state = SessionState.ASKING if master else SessionState.LISTENING
        self.carries_data = False  # is the state one of `CARRIES_DATA`: asked for at every datagram
        self.start_ns: int | None = None
        self.failure: str | None = None
        self.farewell: str | None = None
        self.left = False
        self.ended: Reason | None = None
        self.met = 0
        self.joined = False  # was the other end running already when this one came
        self.in_the_open = False  # has a relay said so by `INSECURE`: nothing proves it, nor that there is none
        self.renews = True  # may another session follow one that is over: not while a person holds the clutch open
        self.zero_force = True  # does this end's device hold no force: before that no session follows one that is over
        self.start_rtt_ns = 0  # at most as long took the round trip with which a slave was started
        self.clock = ClockExchange()
        self.liveness = Liveness(master=master)
        self.new_events: list[SessionBegun] = []  # since they were taken last
        self._code = Code.NONE  # of the reason why it is over
        self._table = MASTER if master else SLAVE
        self._repeated = REPEATED[master]
        self._heals = heals
        self._former: int | None = None  # the session that this master is renewing: the slave may be in it still
        self._next_ns: int | None = None  # when what is not answered is sent again
        self._asking: int | None = None  # the session of the HELLO that this slave has answered last
        self._welcomed: dict[tuple[int, int], int] = {}  # by session and send time of a WELCOME: the master's `every`
        self._welcome_ns = 0  # send time of the last WELCOME that this master has had

    @property
    def meeting(self) -> bool:
        """True while an exchange has yet to be done."""
        return self.state in MEETING

    @property
    def rtt_ns(self) -> int | None:
        """The fastest round trip of the exchange; known to the master."""
        return self.clock.rtt_ns

    @property
    def offset_ns(self) -> int:
        """The peer's clock less ours; known to the master."""
        return self.clock.offset_ns

    def take_events(self) -> list[SessionBegun]:
        """The sessions that have begun since this was asked last."""
        events, self.new_events = self.new_events, []
        return events

    def take(self, event: SessionEvent) -> bool:
        """Go where the table leads with `event`; False if it leads nowhere from here: the event is ignored."""
        state = self._table.get((self.state, event))
        if state is None:
            return False
        self.state = state
        self.carries_data = state in CARRIES_DATA
        return True

    def receive(self, packet: Packet, now: int, room: int = MOST_CONTROL) -> list[bytes]:
        """Take a control packet of `room` bytes; the datagrams to send back at once."""
        if not self.belongs(packet, now):
            return []
        kind = packet.kind
        if kind is Kind.HELLO:
            return self._answer_hello(packet, now, room)
        if kind is Kind.WELCOME and self.master:
            return self._answer_welcome(packet, now)
        if kind is Kind.START and isinstance(packet.payload, int) and not self.master:
            return self._answer_start(packet, packet.payload, now, room)
        if kind is Kind.START:
            self.take(SessionEvent.START)
        elif kind is Kind.RENEW:
            ordered = code_of(packet) in (Code.CLUTCH, Code.TURN)
            self.end(f"{OVER}: {packet.payload}", Cause.ORDERED if ordered else Cause.SESSION_OVER)
        elif kind is Kind.REFUSE and self.take(SessionEvent.REFUSE):
            self.failure = str(packet.payload)
        elif kind is Kind.BYE and self.take(SessionEvent.BYE):
            self.farewell = str(packet.payload)
            self.left = code_of(packet) is not Code.FINISHED
        return []

    def belongs(self, packet: Packet, now: int) -> bool:
        """True if this packet is of this session, or of one that this slave may take up.

        One session at a time: while messages of it come, none takes its place.
        """
        if self.state is SessionState.RENEWING and packet.kind in (Kind.BYE, Kind.RENEW):
            return packet.session in (self.number, self._former)
        if self.master or packet.kind not in (Kind.HELLO, Kind.START, Kind.BYE):
            return packet.session == self.number and packet.kind is not (Kind.HELLO if self.master else Kind.RENEW)
        if packet.kind is Kind.HELLO:
            return self._is_free(now) or self._is_renewed_by(packet)
        if packet.kind is Kind.BYE:
            return packet.session == (self.number if self.met else self._asking)
        answers = packet.echo is not None and (packet.session, packet.echo.sent_ns) in self._welcomed
        return packet.session == self.number or (answers and self._is_free(now))

    def silent(self, now: int) -> bool:
        """True if the session is over, or nothing has come in it for so long that it is no longer kept."""
        return self._heals and (self.ended is not None or self.liveness.silent(now))

    def judge(self, now: int) -> None:
        """Judge whether the session is over for this end: to be asked at every tick."""
        if now > self.liveness.sound_ns and self.carries_data and self._heals:
            self._end_if(self.liveness.judge(now))

    def end(self, why: str | Code, cause: Cause = Cause.SESSION_OVER) -> None:
        """The session is over for this end: it sends and takes no messages, and is released by another one alone.

        `why`: a sentence, or the code of what a person has ordered.
        """
        if self._heals and self.take(SessionEvent.END):
            self._code = why if isinstance(why, Code) else Code.NONE
            self.ended = Reason(cause, why) if isinstance(why, str) else Reason(Cause.ORDERED, why.sentence)
            self._next_ns = None

    def take_data(self, now: int, sent_ns: int | None = None) -> None:
        """A new message of the peer: it has had START, and it is there. `sent_ns`: when it was sent, by our clock."""
        if self.state is not SessionState.RUNNING:  # where it leads nowhere else
            self.take(SessionEvent.DATA)
        why = self.liveness.message(now, sent_ns)
        if why is not None:
            self._end_if(why)

    def take_echo(self, echo: Echo) -> None:
        """Take the echo in the peer's newest message: which of ours arrived last, and how long before it was sent."""
        why = self.liveness.echo(echo)
        if why is not None:
            self._end_if(why)

    def begin(self, start_ns: int, now: int) -> bool:
        """The two have met: the session begins, on the grid whose tick 0 is at `start_ns`. False if it may not."""
        if not self.take(SessionEvent.BEGIN):
            return False
        self.start_ns = start_ns
        self.ended = None
        self.met += 1
        self.liveness.begin(max(now, min(start_ns, now + MOST_RTT_NS)) + (self.rtt_ns or 0))
        return True

    def due(self, now: int) -> list[bytes]:
        """Datagrams to send again, since nothing answered them."""
        if self.state is SessionState.RUNNING and now <= self.liveness.sound_ns:
            return []  # nearly always
        self.judge(now)
        if self.master and self.zero_force and self.renews and self.take(SessionEvent.ZERO_FORCE):
            self._renew()
        kind = self._repeated.get(self.state)
        if kind is None or (self._next_ns is not None and now < self._next_ns):
            return []
        self._next_ns = now + AGAIN_NS
        if kind is Kind.RENEW:
            return [self._packet(kind, now, "" if self.ended is None else self.ended.why, code=self._code)]
        return [self._hello(now) if kind is Kind.HELLO else self._start(now)]

    def bye(self, reason: str | None, now: int) -> list[bytes]:
        """The farewell to send when this end leaves, None: at its end; nothing if it never met a peer."""
        code = Code.FINISHED if reason is None else Code.NONE
        numbers = [self._asking if self.number is None else self.number, self._former if self.meeting else None]
        return [self._packet(Kind.BYE, now, reason or code.sentence, number=each, code=code)
                for each in numbers if each is not None]

    def _end_if(self, why: str | None) -> None:
        if why is not None:
            self.end(f"{OVER}: {why}")

    def _is_free(self, now: int) -> bool:
        """True if another session may be begun with this slave."""
        return self.number is None or (self.zero_force and self.renews and self.silent(now))

    def _is_renewed_by(self, hello: Packet) -> bool:
        """True if this HELLO is of the master of this session, who begins another."""
        return bool(self.met) and self.number is not None and 0 < (hello.session - self.number) % 2**64 <= NEXT

    def _renew(self) -> None:
        assert self.number is not None
        self._former = self.number
        self.number = (self.number + 1) % 2**64
        self.clock.restart()
        self.liveness.wait_longer()
        self._next_ns = None

    def _hello(self, now: int) -> bytes:
        hello = self._packet(Kind.HELLO, now, self._entries())
        size = max(SHORTEST, len(hello) + ROOM)
        if size > MOST_CONTROL:
            size = MOST_CONTROL - ROOM  # its answer would not fit: it is refused where it is written
        return self._packet(Kind.HELLO, now, self._entries(), size=size)

    def _start(self, now: int) -> bytes:
        assert self.start_ns is not None
        return self._packet(Kind.START, now, self.start_ns + self.offset_ns, Echo(self._welcome_ns, 0))

    def _entries(self) -> dict[str, str]:
        """The manifest, and what this end tells beside it."""
        extras = {EVERY: str(self.every)} if self.every != 1 else {}
        if not self.master and self.start_ns is not None:
            extras[TICK_0] = str(self.start_ns)
        return {**self.manifest, **extras}

    def _answer_hello(self, hello: Packet, now: int, room: int) -> list[bytes]:
        if not self._is_free(now):
            self.end(f"{OVER}: the master asks for another", Cause.ASKED_AGAIN)
            return []
        if not self.take(SessionEvent.HELLO):
            return []
        theirs, extras = parted(hello.payload)
        self.in_the_open = self.in_the_open or INSECURE in extras
        difference = manifest_difference(self.manifest, theirs)
        if difference is None:
            self._asking = hello.session
            self._welcomed[hello.session, now] = extras.get(EVERY, 1)
            if len(self._welcomed) > MOST_WELCOMED:
                del self._welcomed[next(iter(self._welcomed))]
            reply = self._packet(Kind.WELCOME, now, self._entries(), Echo(hello.sent_ns, 0), number=hello.session)
        else:
            if self.take(SessionEvent.REFUSE):
                self._asking = hello.session
                self.failure = f"the master asks for another run: {difference}"
            why = f"the slave is set up for another run: {manifest_difference(theirs, self.manifest)}"
            reply = self._packet(Kind.REFUSE, now, why, number=hello.session)
            if len(reply) > room >= SHORTEST:  # in other letters than English ones a sentence has more bytes
                fits = one_line(why).encode()[: room - len(reply)].decode(errors="ignore")
                reply = self._packet(Kind.REFUSE, now, fits, number=hello.session)
        return [reply] if len(reply) <= room else []

    def _answer_start(self, start: Packet, tick_0: int, now: int, room: int) -> list[bytes]:
        if not -MOST_CLOCK_NS <= tick_0 <= now + AHEAD_NS:
            return []  # implausible time, or further ahead than any master sets it: ignore
        if start.session != self.number or self.meeting:
            assert start.echo is not None  # it would not belong
            if not self.begin(tick_0, now):
                return []
            self.joined = self.joined or (self.met == 1 and tick_0 < now)
            self.number = start.session
            self.peer_every = self._welcomed[start.session, start.echo.sent_ns]
            self.start_rtt_ns = max(0, now - start.echo.sent_ns)
            self.new_events.append(SessionBegun(start.session))
        elif not self.take(SessionEvent.START):
            return []
        reply = self._packet(Kind.START, now, tick_0)
        return [reply] if len(reply) <= room else []

    def _answer_welcome(self, welcome: Packet, now: int) -> list[bytes]:
        if not self.take(SessionEvent.WELCOME):
            return []
        theirs, extras = parted(welcome.payload)
        self.in_the_open = self.in_the_open or INSECURE in extras
        difference = manifest_difference(self.manifest, theirs)
        if difference is not None:
            if self.take(SessionEvent.REFUSE):
                self.failure = f"the slave is set up for another run: {difference}"
            return [self._packet(Kind.BYE, now, "the master refused")]
        if not self.clock.take(welcome, now):
            return []
        self.peer_every = extras.get(EVERY, 1)
        self._welcome_ns = welcome.sent_ns
        self._next_ns = now + AGAIN_NS
        theirs_0 = extras.get(TICK_0)
        if theirs_0 is not None and theirs_0 - self.offset_ns > now + AHEAD_NS:
            return []  # implausible time: ignore
        if not self.clock.enough:
            return [self._hello(now)]
        self.joined = self.joined or (theirs_0 is not None and self.start_ns is None)
        self.begin(self.clock.tick_0(self.start_ns, theirs_0, now), now)
        self.new_events.append(SessionBegun(welcome.session))
        return [self._start(now)]

    def _packet(
        self, kind: Kind, now: int, payload: dict[str, str] | str | int, echo: Echo | None = None,
        *, number: int | None = None, size: int | None = None, code: Code = Code.NONE,
    ) -> bytes:
        session = self.number if number is None else number
        assert session is not None
        return encode(Packet(kind, session, code, now, echo, payload), size)
