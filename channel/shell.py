"""The live loop of the relay: two sockets and a timer around a `Relay`, and who has the link.

The master sends to where the channel listens; the channel passes on to the slave, its peer, what the scene's link lets
through, when it lets it through; and back.
"""

from __future__ import annotations

import gc
import sys
import time
from collections import deque
from collections.abc import Sequence
from selectors import EVENT_READ, DefaultSelector
from typing import TYPE_CHECKING, Any

from msgpack import packb

from channel.relay import Counts, Relay
from teleop.live.address import Address, shown
from teleop.live.bulk import Bulk
from teleop.live.interrupt import Interrupt
from teleop.live.ticker import Timer
from teleop.live.wire import Wire
from teleop.manifest import manifest_difference
from teleop.packet import Kind, Packet, decode, peek
from teleop.scene import Scene
from teleop.session import RENEW_NS

if TYPE_CHECKING:
    from teleop.secure.record import Record

MOST_SAID = 5  # strangers can say HELLO too, and nobody may be reading
QUIET_NS = RENEW_NS  # a session whose master, or whose slave, has said nothing for so long gives way to another one
TURN_NS = 2_000_000_000  # a master that the slave has not taken up gives way after this, whatever it says
SEALED = range(20, 26)  # first bytes of DTLS records (RFC 9147)
LEAD_NS = 100_000  # the relay is called so long before a datagram is due, for it takes time to wake up and come to it
SOON_NS = 30_000  # what is due so soon after another is waited for too, before anything is taken in
LOOK_S = 0.05  # between two looks at whether it is to end
BODY = 6  # where a packet's body begins, with its session
NOBODYS = b"\xff"  # how no packet's body begins
_FORTH, _BACK, _START = Kind.FORTH, Kind.BACK, Kind.START


class RelayShell:
    """Two sockets and a timer around a `Relay`, one session after the other.

    Who begins when no session runs has the link for `TURN_NS`; within that the slave has to take it up, or the next
    one may try. A session runs while both ends speak in it, the slave from where it was said to be; then only those
    two are listened to. What a master alone says holds nothing, since anybody can say it.
    """

    def __init__(self, scene: Scene, seed: int, near: Wire, far: Wire) -> None:
        self.wires = (near, far)  # where direction 0 and direction 1 come in
        self.foreign = 0  # datagrams that are no packets of this session
        self._dt_ns, self._ticks = scene.dt_ns, scene.ticks
        link: Any = scene.link  # a scene asks less of its link than a relay does
        self._water = link, seed, scene.wire_size
        self.relay = Relay(*self._water)
        self._past: list[Counts | None] = [None, None]  # of the sessions before
        self._manifest = {key: text for key, text in scene.manifest().items() if key not in ("link", "delay")}
        self._session: int | None = None
        self._differed = 0  # masters that were said to run another scene
        self._origin: int | None = None  # our clock at tick 0
        self._home = far.peer
        self._begun_ns: int | None = None  # when the master that has the link got it; None: nobody has begun
        self._near_ns = 0  # when it last spoke
        self._far_ns: int | None = None  # when the slave last spoke in the session; None: it has not taken it up
        self._mark = NOBODYS  # how the bodies of the session's packets begin
        self._finished = b""  # the last record with which a slave with keys took up a master
        self._asked: deque[int] = deque(maxlen=64)  # numbers of the hellos of one with keys: an answer has one of them
        self._elsewhere: list[Address] = []  # from where a slave answered that was said to be elsewhere
        self._bulks = (Bulk(near), Bulk(far))
        self._set_to: int | None = None  # what the timer is set for
        self._carried = [0, 0]  # sealed datagrams in each direction

    def run(self, interrupt: Interrupt) -> None:
        """Relay until Ctrl-C or SIGTERM."""
        timer = Timer()
        gc.collect()
        gc.freeze()
        with DefaultSelector() as selector:
            for wire in self.wires:
                selector.register(wire.sock, EVENT_READ)
            if timer.fd >= 0:
                selector.register(timer.fd, EVENT_READ)
            try:
                while interrupt.name is None:
                    self._sleep(selector, timer)
                    self._deliver()
                    for direction, bulk in enumerate(self._bulks):
                        for data, sender, came in bulk.receive():
                            self._take(direction, data, sender, came)
                    self._pass_on()  # the session's own do not wait
            finally:
                if timer.fd >= 0:
                    timer.close()

    def _sleep(self, selector: DefaultSelector, timer: Timer) -> None:
        """Until something comes, or is about to be due."""
        due = self._due()
        if due is None:
            selector.select(LOOK_S)
            return
        left = due - LEAD_NS - time.monotonic_ns()
        if left <= 0:
            return
        if timer.fd < 0:
            selector.select(min(LOOK_S, left / 1e9))
            return
        if due != self._set_to:
            timer.set(due - LEAD_NS)
            self._set_to = due
        if any(key.fd == timer.fd for key, _ in selector.select(LOOK_S)):
            timer.rang()

    def _deliver(self) -> None:
        """Wait awake for what is about to be due, and send it. Datagrams can wait meanwhile: they are stamped."""
        until = time.monotonic_ns() + LEAD_NS
        due = self._due()
        while due is not None and due <= until:
            while (now := time.monotonic_ns()) < due:
                pass
            self._pass_on()
            until, due = min(until, now + SOON_NS), self._due()

    def _take(self, direction: int, data: bytes, sender: Address, now: int) -> None:
        if not data:
            self.foreign += 1
            return
        if data[0] in SEALED:
            self._carry(direction, data, sender, now)
            return
        kind, seq = peek(data)
        message = kind is _FORTH or kind is _BACK  # whose it is, the ends look at
        if not message and kind in (Kind.HELLO, Kind.WELCOME):
            self._introduce(direction, data, sender, now)
        wire = self.wires[direction]
        if message and direction == 0 and wire.peer is None:
            wire.peer = sender  # of a session that began before this channel was started anew, or a stranger: see _held
        if kind is None or sender != wire.peer or (message and seq >= self._ticks):
            self.foreign += 1
            return
        if direction == 0:
            self._near_ns = now
        elif (kind is _BACK or kind is _START) and sender == self._home and data.startswith(self._mark, BODY):
            self._far_ns = now  # of this session: a slave goes on sending for a while to a master that is no more
        if message and self._origin is None:
            self._origin = now - seq * self._dt_ns
        at = 0 if self._origin is None else now - self._origin
        self.relay.receive(direction, seq if message else None, data, at)

    def _carry(self, direction: int, data: bytes, sender: Address, now: int) -> None:
        """Pass on what only the ends can read. Its number is that of its coming, and the link is for all of it."""
        from teleop.secure.record import DATA, records

        wire, handshake = self.wires[direction], data[0] != DATA
        found = (records(data) or []) if handshake else []
        begins = direction == 0 and any(one.is_hello for one in found)
        own = sender == wire.peer and self._begun_ns is not None and now - self._near_ns < QUIET_NS
        if begins and not own and not self._held(now):
            self._begin(sender, now)
            self._origin, self._carried = now, [0, 0]
        if sender == wire.peer and direction == 0:
            self._asked.extend(one.number for one in found if one.is_hello)
        asked = any(one.is_request and one.number in self._asked for one in found)
        if asked and direction == 1 and not self._carried[1]:  # and has had a hello, or could not have its number
            self._is_at(sender)
        if sender != wire.peer or self._origin is None:
            self.foreign += 1
            return
        if direction == 0:
            self._near_ns = now
        elif self._takes_up(found) or (self._far_ns is not None and not handshake):
            self._far_ns = now
        self.relay.receive(direction, self._carried[direction], data, now - self._origin)
        self._carried[direction] += 1

    def _takes_up(self, found: Sequence[Record]) -> bool:
        """Does the slave take up whose handshake it is? Its Finished, sealed and of the number 0, comes only then.

        A copy of the last one says nothing: it may be of the master before.
        """
        from teleop.secure.record import HANDSHAKE

        last = next((one.data for one in found if (one.type, one.epoch, one.number) == (HANDSHAKE, 1, 0)), b"")
        if not last or last == self._finished or self.wires[1].peer != self._home:
            return False
        self._finished = last
        return True

    def _is_at(self, sender: Address) -> None:
        """The slave answers from there. Said once, for from elsewhere anybody could answer a HELLO of his own."""
        self.wires[1].peer = sender
        if sender not in (self._home, *self._elsewhere) and len(self._elsewhere) < MOST_SAID:
            self._elsewhere.append(sender)
            print(f"channel: the slave answers from {shown(sender)}; start this channel with --peer {shown(sender)}, "
                  "or anybody can take the link from a session that runs", file=sys.stderr, flush=True)

    def _held(self, now: int) -> bool:
        """Has somebody the link, so that nobody else may begin: a session that runs, or one whose turn it is?"""
        if self._begun_ns is None or now - self._near_ns >= QUIET_NS:
            return False
        running = self._far_ns is not None and now - self._far_ns < QUIET_NS
        return running or now - self._begun_ns < TURN_NS

    def _begin(self, sender: Address, now: int) -> None:
        """Another session has the link. Who had it without being taken up has no other turn: that would be no end."""
        if sender != self.wires[0].peer or self._begun_ns is None or self._far_ns is not None:
            self._begun_ns = now
        self.wires[0].peer, self.wires[1].peer = sender, self._home
        self._near_ns, self._far_ns, self._set_to = now, None, None
        self._session, self._mark = None, NOBODYS
        self._asked.clear()
        self._anew()

    def _introduce(self, direction: int, data: bytes, sender: Address, now: int) -> None:
        """Learn from a HELLO or WELCOME which session this is and where its ends are."""
        packet = decode(data, 0)
        if not isinstance(packet, Packet):
            return
        free = sender == self.wires[0].peer or not self._held(now)  # its own master may ask anew at any time
        if packet.kind is Kind.HELLO and direction == 0 and packet.session != self._session and free:
            self._compare(packet)
            self._begin(sender, now)
            self._session, self._origin, self._mark = packet.session, None, b"\x96" + packb(packet.session)
        if packet.session == self._session and self._origin is None and direction == (packet.kind is Kind.WELCOME):
            if direction == 1:
                self._is_at(sender)
            self.wires[direction].peer = sender

    def _anew(self) -> None:
        """Another session has the link; what was under way of the one before is lost."""
        self._past = [self.counts(direction) for direction in (0, 1)]
        self.relay = Relay(*self._water)

    def counts(self, direction: int) -> Counts:
        """What became of one direction's datagrams, of all sessions."""
        own, past = self.relay.counts(direction), self._past[direction]
        if past is None:
            return own
        both = Counts(*[a + b for a, b in zip(own, past, strict=True)])
        return both._replace(lost=both.lost + past.under_way, under_way=own.under_way,
                             most_under_way=max(own.most_under_way, past.most_under_way))

    def _compare(self, hello: Packet) -> None:
        """Say so if the master runs another scene: the link would be another one. The link itself may differ."""
        assert isinstance(hello.payload, dict)
        theirs = {key: text for key, text in hello.payload.items() if key in self._manifest}
        difference = manifest_difference(self._manifest, theirs)
        if difference is not None and self._differed < MOST_SAID:
            self._differed += 1
            told = f"channel: the master runs another scene than this channel: {difference}"
            print(told, file=sys.stderr, flush=True)

    def _due(self) -> int | None:
        """When something has to go out, on our clock."""
        soon = self.relay.next_ns()
        return None if soon is None or self._origin is None else self._origin + soon

    def _pass_on(self) -> None:
        origin = self._origin
        now = 0 if origin is None else time.monotonic_ns() - origin
        out: tuple[list[bytes], list[bytes]] = ([], [])
        for direction, data in self.relay.due(now):
            out[direction].append(data)
        for direction, datagrams in enumerate(out):
            if datagrams:
                self._bulks[1 - direction].send(datagrams)
