"""How two ends agree to run, and to go on after one of them was away: the exchange, the common tick grid, the farewell.

    master                      slave
      HELLO  manifest   ->
                        <-   WELCOME manifest      (or REFUSE and a sentence: who has not run yet stops)
      START  time of tick 0  ->
                        <-   START                 (the same, to say it has come)
      FORTH ...         <->  BACK ...
                        <-   RENEW  why     (of a slave whose session is over)
      BYE    a reason   <->  BYE

The master repeats what is not answered. Each WELCOME echoes its HELLO, which bounds the slave's clock
against the master's: the offset is taken from the fastest round trip and is uncertain by half of that.
The master places tick 0 a little ahead on its own clock and sends it as a time on the slave's, so that
both ends count the same ticks: a packet's number is the tick it was sent at.

A session can be over for one of the ends while the run goes on: if nothing came for `RENEW_NS`; if its own packets did
not arrive at the other end for as long, as the echoes of that one say; if it stood still without noticing; or if it is
told so. From then on it sends no message of the session and takes none, and only another session releases it. The
master asks for that under the next number, which tells the slave as well; the slave asks with RENEW. Neither gives up
the session that is over before it has let go of its device, so that no force is cut off. A slave takes up a master that
was started anew in the same way. Whoever was running already has the grid: a master that joins a running slave takes
tick 0 from its WELCOME, a slave that joins a running master is told a tick 0 that has passed. `met` counts sessions;
with each of them both ends begin their law from rest. Runs that go by packets have no silence to heal: `heals=False`.

A HELLO is as long as its answer at least, so that nobody can have a third party flooded with answers. A START echoes
the send time of a WELCOME, and counts only if this very slave has sent it: who has not seen that cannot start a
session, and one that was recorded cannot be played to a slave that was started anew.
"""

from __future__ import annotations

from collections.abc import Mapping

from teleop.protocol.estimates import MOST_RTT_NS
from teleop.protocol.manifest import EVERY, INSECURE, MOST_CLOCK_NS, TICK_0, manifest_difference, parted
from teleop.protocol.packet import MOST_CONTROL, Echo, Kind, Packet, encode, one_line

AGAIN_NS = 50_000_000  # what is not answered is sent again after this
ROUNDS = 5  # HELLO/WELCOME round trips before the clock offset is taken: one, and four after it that are no faster
FASTER_NS = 1_000_000  # by so much: what waited at a process that stood still is answered faster from one to the next
LEAD_NS = 150_000_000  # tick 0 is this far ahead when START is first sent
AHEAD_NS = LEAD_NS + 3 * MOST_RTT_NS  # the furthest that tick 0 can be ahead
RENEW_NS = 1_000_000_000  # of silence, and a session is over
FIRST_NS = 2_000_000_000  # the same before its first message: doubled whenever none came, for a link may be that long
OVER = "the session is over"
NEXT = 16  # numbers: a HELLO of one of these after a session's own is of its master, who renews it
ROOM = 96  # bytes: what a WELCOME says beyond its HELLO
SHORTEST = 1200  # bytes of a HELLO: the sentence of a REFUSE fits, whole if it is in English
MOST_WELCOMED = 1024  # answers that a slave remembers, to know a START by


class Session:
    """One end's side of the exchange. `now` is the end's own monotonic clock in ns.

    `start_ns` becomes the time of tick 0 on that clock; `failure` the sentence with which this end must
    stop; `farewell` the reason the peer gave for leaving. `every`: this end ticks at every so many ticks of the grid.
    """

    def __init__(
        self, *, master: bool, manifest: Mapping[str, str], number: int | None = None, every: int = 1,
        heals: bool = True,
    ) -> None:
        self.master = master
        self.manifest = dict(manifest)
        self.number = number  # of the session; a slave takes that of the master that starts it
        self._former: int | None = None  # the session that this master is renewing: the slave may be in it still
        self.every, self.peer_every = every, 1
        self.start_ns: int | None = None
        self.failure: str | None = None
        self.farewell: str | None = None
        self.offset_ns = 0  # the peer's clock less ours (known to the master)
        self.rtt_ns: int | None = None  # of the fastest first exchange
        self._grid_rtt_ns: int | None = None  # the round trip by which the grids of the two ends were set to be one
        self.met = 0  # sessions that this end has begun
        self.joined = False  # was the other end running already when this one came
        self.meeting = True  # is the exchange still to be done
        self.in_the_open = False  # has a relay said so by `INSECURE`: nothing proves it, nor that there is none
        self.ended: str | None = None  # why the session is over for this end, which waits for another
        self.let_go = True  # does this end hold no force: before that no session takes the place of one that is over
        self._rounds, self._since_ns = 0, 0  # of the exchange, and when the first of them was over
        self._acknowledged = not master
        self._next_ns: int | None = None
        self._asking: int | None = None  # the session of the HELLO that this slave has answered last
        self._welcomed: dict[tuple[int, int], int] = {}  # by session and send time of a WELCOME: the master's `every`
        self._welcome_ns = 0  # send time of the last that this master has had
        self.begun_ns = 0  # when the session began: before that nothing can have come
        self._heard_ns: int | None = None  # when the newest message came in it
        self._answered = False  # did one come that shows that the peer hears this end
        self._sound_ns = 0  # until then nothing is to be judged, if nothing else ends the session
        self._heals = heals
        self._first_ns = FIRST_NS
        self.start_rtt_ns = 0  # at most as long took the round trip with which a slave was started
        self.renew_ns = RENEW_NS  # longer for an end that takes longer to let go

    def receive(self, packet: Packet, now: int, room: int = MOST_CONTROL) -> list[bytes]:
        """Take a control packet of `room` bytes; the datagrams to send back at once."""
        if not self.belongs(packet, now):
            return []
        if packet.kind is Kind.HELLO:
            return self._welcome(packet, now, room)
        if packet.kind is Kind.START and isinstance(packet.payload, int) and not self.master:
            return self._start(packet, packet.payload, now, room)
        if packet.kind is Kind.RENEW:
            self.end(f"{OVER}: {packet.payload}")
        if packet.kind is Kind.WELCOME and self.master and self.meeting:
            return self._measure(packet, now)
        if packet.kind is Kind.START:
            self._acknowledged = True
        if packet.kind is Kind.REFUSE and not self.met:
            self.failure = str(packet.payload)
        if packet.kind is Kind.BYE:
            self.farewell = str(packet.payload)
        return []

    def belongs(self, packet: Packet, now: int) -> bool:
        """Is this packet of our session, or of one that this slave may take up?

        One session at a time: one that is heard is not taken over.
        """
        if packet.kind in (Kind.BYE, Kind.RENEW) and self.meeting and self._former is not None:
            return packet.session in (self.number, self._former)
        if self.master or packet.kind not in (Kind.HELLO, Kind.START, Kind.BYE):
            return packet.session == self.number and packet.kind is not (Kind.RENEW if not self.master else Kind.HELLO)
        if packet.kind is Kind.HELLO:
            return self._free(now) or self._renews(packet)
        if packet.kind is Kind.BYE:
            return packet.session == (self.number if self.met else self._asking)
        answers = packet.echo is not None and (packet.session, packet.echo.sent_ns) in self._welcomed
        return packet.session == self.number or (answers and self._free(now))

    def silent(self, now: int) -> bool:
        """Is the session over, or has nothing come in it for so long that it is no longer kept?"""
        if not self._heals:
            return False
        if self.ended is not None:
            return True
        if self._heard_ns is None and self.master:
            return now - self.begun_ns > max(self._first_ns, self.renew_ns)
        return now - (self.begun_ns if self._heard_ns is None else self._heard_ns) > self.renew_ns

    def judge(self, now: int) -> None:
        """See whether the session is over for this end: to be asked at every tick."""
        if now <= self._sound_ns or self.meeting or self.ended is not None:
            return
        if self.silent(now):
            if self.master or self._heard_ns is not None:  # before its first message a link may just be long
                self.end(f"{OVER}: nothing came for {self.renew_ns / 1e9:g} s")
        elif self.master and not self._answered and now - self.begun_ns > 2 * max(self._first_ns, self.renew_ns):
            self.end(f"{OVER}: nothing of this end arrives at the other")  # there and back it takes twice as long

    def end(self, why: str) -> None:
        """The session is over for this end: it sends and takes no messages, and is released by another one alone."""
        if self._heals and self.met and not self.meeting and self.ended is None:
            self.ended, self._next_ns = why, None

    def mute(self) -> bool:
        """Is nothing of the law's to be sent? Nor in a session that is over: the peer has to notice."""
        return self.meeting or self.ended is not None

    def data_came(self, now: int, sent_ns: int | None = None) -> None:
        """A new message of the peer: it has had START, and it is there. `sent_ns`: when it was sent, by our clock."""
        first = self._heard_ns is None
        self._acknowledged, self._heard_ns = True, now
        self._sound_ns = now + self.renew_ns if self._answered or not self.master else 0
        if first and sent_ns is not None and sent_ns - self.begun_ns > self.renew_ns:
            self.end(f"{OVER}: its first {self.renew_ns / 1e9:g} s did not arrive")

    def answer_came(self, echo: Echo) -> None:
        """What the peer's newest message says of ours: which one arrived last, and how long before it was sent."""
        first, self._answered = not self._answered, True
        if first and echo.sent_ns - self.begun_ns > self.renew_ns:
            self.end(f"{OVER}: nothing of its first {self.renew_ns / 1e9:g} s arrived at the other end")
        elif echo.held_ns > self.renew_ns:
            self.end(f"{OVER}: nothing of this end arrived at the other for {self.renew_ns / 1e9:g} s")

    def _free(self, now: int) -> bool:
        """May a slave be taken up?"""
        return self.number is None or (self.let_go and self.silent(now))

    def _renews(self, hello: Packet) -> bool:
        """Is this HELLO of the master of this session, who begins another?"""
        return bool(self.met) and self.number is not None and 0 < (hello.session - self.number) % 2**64 <= NEXT

    def begin(self, start_ns: int, now: int) -> None:
        """The two have met: the session begins, on the grid whose tick 0 is at `start_ns`."""
        self.start_ns, self.meeting, self.ended = start_ns, False, None
        self._heard_ns, self._answered, self._sound_ns = None, False, 0
        self.begun_ns = max(now, min(start_ns, now + MOST_RTT_NS)) + (self.rtt_ns or 0)
        self.met += 1

    def due(self, now: int) -> list[bytes]:
        """What is to be sent now because it was not answered."""
        if self.failure:
            return []
        self.judge(now)
        if self.master and self.ended is not None and self.let_go and not self.meeting:
            self._renew()
        if self.ended is None and not (self.master and (self.meeting or not self._acknowledged)):
            return []
        if self._next_ns is not None and now < self._next_ns:
            return []
        self._next_ns = now + AGAIN_NS
        if not self.master:
            return [self._packet(Kind.RENEW, now, str(self.ended))]
        if self.meeting:
            return [self._hello(now)]
        assert self.start_ns is not None
        return [self._packet(Kind.START, now, self.start_ns + self.offset_ns, Echo(self._welcome_ns, 0))]

    def bye(self, reason: str, now: int) -> list[bytes]:
        """The farewell to send when this end leaves; nothing if it never met anybody."""
        numbers = [self._asking if self.number is None else self.number, self._former if self.meeting else None]
        return [self._packet(Kind.BYE, now, reason, number=each) for each in numbers if each is not None]

    def _renew(self) -> None:
        assert self.number is not None
        self._former = self.number
        self.number = (self.number + 1) % 2**64
        self.meeting, self.rtt_ns, self._rounds, self._acknowledged = True, None, 0, False
        self._first_ns = FIRST_NS if self._answered else min(2 * self._first_ns, MOST_RTT_NS)
        self._next_ns = None

    def _hello(self, now: int) -> bytes:
        hello = self._packet(Kind.HELLO, now, self._told())
        size = max(SHORTEST, len(hello) + ROOM)
        if size > MOST_CONTROL:
            size = MOST_CONTROL - ROOM  # its answer would not fit: it is refused where it is written
        return self._packet(Kind.HELLO, now, self._told(), size=size)

    def _told(self) -> dict[str, str]:
        own = {EVERY: str(self.every)} if self.every != 1 else {}
        if not self.master and self.start_ns is not None:
            own[TICK_0] = str(self.start_ns)
        return {**self.manifest, **own}

    def _welcome(self, hello: Packet, now: int, room: int) -> list[bytes]:
        if not self._free(now):
            self.end(f"{OVER}: the master asks for another")
            return []
        theirs, told = parted(hello.payload)
        self.in_the_open = self.in_the_open or INSECURE in told
        difference = manifest_difference(self.manifest, theirs)
        if difference is None:
            self._asking = hello.session
            self._welcomed[hello.session, now] = told.get(EVERY, 1)
            if len(self._welcomed) > MOST_WELCOMED:
                del self._welcomed[next(iter(self._welcomed))]
            reply = self._packet(Kind.WELCOME, now, self._told(), Echo(hello.sent_ns, 0), number=hello.session)
        else:
            if not self.met:
                self._asking = hello.session
                self.failure = f"the master asks for another run: {difference}"
            why = f"the slave is set up for another run: {manifest_difference(theirs, self.manifest)}"
            reply = self._packet(Kind.REFUSE, now, why, number=hello.session)
            if len(reply) > room >= SHORTEST:  # in other letters than English ones a sentence has more bytes
                fits = one_line(why).encode()[: room - len(reply)].decode(errors="ignore")
                reply = self._packet(Kind.REFUSE, now, fits, number=hello.session)
        return [reply] if len(reply) <= room else []

    def _start(self, start: Packet, tick_0: int, now: int, room: int) -> list[bytes]:
        if not -MOST_CLOCK_NS <= tick_0 <= now + AHEAD_NS:
            return []  # of a clock that nobody has, or further ahead than any master sets it
        if start.session != self.number or self.meeting:
            self.joined = self.joined or (not self.met and tick_0 < now)
            self.number = start.session
            assert start.echo is not None  # it would not belong
            self.peer_every = self._welcomed[start.session, start.echo.sent_ns]
            self.start_rtt_ns = max(0, now - start.echo.sent_ns)
            self.begin(tick_0, now)
        reply = self._packet(Kind.START, now, tick_0)
        return [reply] if len(reply) <= room else []

    def _measure(self, welcome: Packet, now: int) -> list[bytes]:
        theirs, told = parted(welcome.payload)
        self.in_the_open = self.in_the_open or INSECURE in told
        difference = manifest_difference(self.manifest, theirs)
        if difference is not None:
            if not self.met:
                self.failure = f"the slave is set up for another run: {difference}"
            return [self._packet(Kind.BYE, now, "the master refused")]
        if welcome.echo is None:
            return []
        rtt = now - welcome.echo.sent_ns - welcome.echo.held_ns
        if not 0 <= rtt <= MOST_RTT_NS or abs(welcome.sent_ns) > MOST_CLOCK_NS:
            return []  # forged, or of a clock that nobody has
        if self.rtt_ns is None or rtt < self.rtt_ns - FASTER_NS:
            self._rounds, self._since_ns = 1, now  # what was asked before may have waited just as long
        elif welcome.echo.sent_ns >= self._since_ns:
            self._rounds += 1
        if self.rtt_ns is None or rtt < self.rtt_ns:
            self.rtt_ns = rtt
            self.offset_ns = welcome.sent_ns - (now - rtt // 2)
        self.peer_every = told.get(EVERY, 1)
        self._welcome_ns = welcome.sent_ns
        self._next_ns = now + AGAIN_NS
        if TICK_0 in told and told[TICK_0] - self.offset_ns > now + AHEAD_NS:
            return []  # likewise
        if self._rounds < ROUNDS:
            return [self._hello(now)]
        grids = [self.start_ns] if self.start_ns is not None else []
        if TICK_0 in told and grids and self._is_better_known(told[TICK_0] - grids[0]):
            self.offset_ns = told[TICK_0] - grids[0]  # the two ends have one grid still
        else:
            self._grid_rtt_ns = self.rtt_ns
        if TICK_0 in told:
            self.joined |= not grids
            grids.append(told[TICK_0] - self.offset_ns)
        # Of two grids that came apart the one that is further on: ticks cannot be taken back, only left out.
        tick_0 = min(grids) if grids else now + LEAD_NS + 2 * self.rtt_ns
        self.begin(tick_0, now)
        return [self._packet(Kind.START, now, tick_0 + self.offset_ns, Echo(self._welcome_ns, 0))]

    def _is_better_known(self, offset_ns: int) -> bool:
        """Does `offset_ns`, by which the grids of the two ends are one, say more of the clocks than this exchange does?

        It does if it was measured by a round trip less than half as long, and this one does not contradict it: one way
        may be slow at the moment, and the grids would be set apart by half of that for good.
        """
        assert self.rtt_ns is not None
        rtt, before = self.rtt_ns, self._grid_rtt_ns
        return before is not None and rtt > 2 * before and abs(offset_ns - self.offset_ns) <= (rtt + before) // 2

    def _packet(
        self, kind: Kind, now: int, payload: dict[str, str] | str | int, echo: Echo | None = None,
        *, number: int | None = None, size: int | None = None,
    ) -> bytes:
        session = self.number if number is None else number
        assert session is not None
        return encode(Packet(kind, session, 0, now, echo, payload), size)
