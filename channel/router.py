"""The choice of datagrams that are passed on between masters and the slave, without clock or loop.

The slave alone chooses which master has the link: see `channel.relay`. With keys a master has a flow once it has shown
its address by a cookie of the relay's (`Cookies`), and a port towards the slave for itself, so that the slave judges
each by itself, as if there were no relay. As RFC 6347, 4.2.1 has it for a server, a hello without a good cookie is
answered with one, no longer than the hello, and forgotten. `teleop.protocol.secure.dtls_record` has the form of these
cookies; a slave asks for one of its own behind it.

In the open masters are told apart by their sessions' numbers. The first exchange of any is passed on, at a bounded rate
(`Introductions`), and the one to which the slave answers START or sends its messages has a flow. Nothing proves who
sends a HELLO without keys. So the relay keeps a session's number (64 random bits) and its sender, for the last
`MOST_ASKED` sessions. The bounded rate keeps a flood of HELLOs from the slave, which has to answer each.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from hmac import compare_digest, digest
from typing import Any

from msgpack import packb, unpackb

from channel.relay import Counts, Flow, Flows, Relay
from teleop.errors import Refused
from teleop.live.net.bulk import Bulk
from teleop.live.net.wire import Address, Wire, host_port
from teleop.protocol.manifest import INSECURE, manifest_difference, manifest_of
from teleop.protocol.packet import MOST_CONTROL, Kind, Packet, decode, encode, peek
from teleop.protocol.secure.dtls_record import (
    DATA,
    EXTRA,
    HANDSHAKE,
    MTU,
    OVERHEAD,
    DtlsRecord,
    cookie_of,
    cookie_record,
    records,
    without_cookie,
)
from teleop.protocol.session import RENEW_NS
from teleop.scene.scene import Scene

MOST_ASKED = 4096  # sessions
EACH_NS, EACH_MOST = 10_000_000, 16  # between two datagrams of one sender on the average, for all but so many
ALL_NS, ALL_MOST = 1_000_000, 100  # the same of all senders; each that is passed on costs a slave 0.1 ms
MOST_SENDERS = 1024


class Introductions:
    """The sessions that were asked for. Times are in ns, of any clock that does not go back."""

    def __init__(self) -> None:
        self._requests: dict[int, tuple[Address, int]] = {}  # by session: who, and when last; oldest first
        self._slaves: dict[int, Address] = {}  # of those among them that were answered from elsewhere than was said
        self._each: dict[Address, int] = {}  # when what was passed on of a sender is made up for; the latest last
        self._all = 0  # the same of all

    def may_pass(self, sender: Address, now: int) -> bool:
        """Spend the slave's time for one datagram of this sender; False if none is left."""
        each, every = max(now, self._each.get(sender, 0)), max(now, self._all)
        if each - now >= EACH_MOST * EACH_NS or every - now >= ALL_MOST * ALL_NS:
            return False
        self._all = every + ALL_NS
        self._each.pop(sender, None)
        self._each[sender] = each + EACH_NS
        if len(self._each) > MOST_SENDERS:
            del self._each[next(iter(self._each))]
        return True

    def ask(self, session: int, sender: Address, now: int) -> bool:
        """A HELLO from `sender`. False: another sender asks for this very session, and has not fallen silent."""
        master, last = self._requests.get(session, (sender, now))
        if master != sender and now - last < RENEW_NS:
            return False
        self._requests.pop(session, None)
        self._requests[session] = sender, now
        if len(self._requests) > MOST_ASKED:
            oldest = next(iter(self._requests))
            del self._requests[oldest]
            self._slaves.pop(oldest, None)
        return True

    def master_of(self, session: int | None) -> Address | None:
        """The address from which the HELLO of this session came, None if there was none."""
        return None if session is None else self._requests.get(session, (None, 0))[0]

    def forget(self, session: int) -> None:
        """The slave has taken it up: what still comes of it, when it is over, begins nothing."""
        self._requests.pop(session, None)
        self._slaves.pop(session, None)

    def welcome(self, session: int, slave: Address, home: Address) -> None:
        """A WELCOME came from `slave`; one from `home`, where the slave was said to be, counts for more than others."""
        if slave == home:
            self._slaves.pop(session, None)
        else:
            self._slaves.setdefault(session, slave)

    def slave_of(self, session: int, home: Address) -> Address:
        """The address from which the slave answers in this session."""
        return self._slaves.get(session, home)


SLOT_NS = 30_000_000_000  # a cookie is good for one to two of these


class Cookies:
    """Cookies under a `secret` (32 random bytes of this process), each for one address and one handshake."""

    def __init__(self, secret: bytes) -> None:
        self._secret = secret

    def of(self, hello: DtlsRecord, address: Address, now: int) -> bytes:
        """The cookie (32 bytes) for a hello from `address`; `now` in ns, of any clock that does not go back."""
        return self._of(hello, address, now // SLOT_NS)

    def is_good(self, brought: bytes, hello: DtlsRecord, address: Address, now: int) -> bool:
        """True if this is the cookie that a hello from `address` was given."""
        slot = now // SLOT_NS
        return any(compare_digest(brought, self._of(hello, address, when)) for when in (slot, slot - 1))

    def _of(self, hello: DtlsRecord, address: Address, slot: int) -> bytes:
        request = f"{address[0]}|{address[1]}|{slot}|".encode() + hello.random
        return digest(self._secret, request, sha256)


MOST_SAID = 5  # unknown hosts can say HELLO too
SEALED = range(20, 26)  # first bytes of DTLS records (RFC 9147)
LONGEST = MOST_CONTROL + OVERHEAD  # bytes of a sealed packet
BODY = 6  # where a packet's body begins, with its session
_FORTH, _BACK, _START = Kind.FORTH, Kind.BACK, Kind.START


class Router:
    """The choice of datagrams that are passed on between masters and one slave.

    All that comes in goes through `from_near` and `from_far`.

    `near`: the wire where masters come in; `far`: the one towards the slave that sessions in the open share, whose peer
    is where the slave was said to be. `port`: makes another wire towards it, one for each master with keys, and `close`
    is told when it is done with. `beyond`: an address of either side that is beyond this machine, None if both are on
    it; then nothing but what is sealed is passed on, unless `insecure` asks for it, which both ends are then told.
    """

    def __init__(self, scene: Scene, seed: int, near: Wire, far: Wire, *, port: Callable[[Address], Wire],
                 close: Callable[[Wire], None], secret: bytes, beyond: Address | None = None,
                 insecure: bool = False) -> None:
        assert far.peer is not None
        self.near, self.far, self.home = near, far, far.peer
        self.bulks = Bulk(near), Bulk(far)
        self.foreign = 0  # datagrams that are no packets of a session that is passed on
        self.unsealed = 0  # datagrams in the open that were not passed on, since only sealed ones are
        self.flows = Flows(close)
        self._dt_ns, self._ticks, self._size = scene.dt_ns, scene.ticks, scene.wire_size
        self._link: Any = scene.link  # a scene asks less of its link than a relay does
        self._seed, self._port, self._beyond = seed, port, beyond
        self._sealed_only, self._tells = beyond is not None and not insecure, beyond is not None and insecure
        self._manifest = {key: text for key, text in manifest_of(scene).items() if key not in ("link", "delay")}
        self._said_unsealed = False
        self._differed: list[str] = []  # what was said of masters that run another scene
        self._open: Flow | None = None  # the flow of the session in the open that the slave took up last
        self._introductions = Introductions()
        self._introduced = [0, 0]  # datagrams of first exchanges, passed on in each direction
        self._cookies = Cookies(secret)
        self._elsewhere: list[Address] = []  # from where a slave answered that was said to be elsewhere

    def turn(self, scene: Scene) -> None:
        """Go on with the link of another scene.

        Sessions in the open that begin from now on have it. What is under way is of a session that both ends end, and
        goes its way until the next begins. Sessions with keys are not told apart from here: they have it at once, and
        what is under way in them is lost.
        """
        self._dt_ns, self._ticks, self._size, self._link = scene.dt_ns, scene.ticks, scene.wire_size, scene.link
        self._manifest = {key: text for key, text in manifest_of(scene).items() if key not in ("link", "delay")}
        for flow in self.flows:
            if flow.sealed:
                self.flows.turn(flow, self._relay())

    def from_near(self, data: bytes, sender: Address, now: int) -> None:
        """Take a datagram from the masters' side that came at `now` (ns, monotonic clock)."""
        flow = self.flows.of(sender)
        if data and data[0] in SEALED:
            self._sealed_from_near(flow, data, sender, now)
            return
        kind, seq = peek(data)
        if self._sealed_only:
            self._leave_out(kind is not None, sender)
            return
        if kind is None:
            self.foreign += 1
        elif kind is not _FORTH and kind is not _BACK:  # whose a message is, the ends look at
            self._exchange(flow, kind, data, sender, now)
        elif flow is None or flow is not self._open or seq >= self._ticks or len(data) > self._size:
            self.foreign += 1
        else:
            flow.master_spoke(now)
            self._carry(flow, 0, seq, data, now)

    def from_far(self, flow: Flow | None, data: bytes, sender: Address, now: int) -> None:
        """The same from the slave's side, through the wire of `flow`, or None: through the one that is shared."""
        if flow is not None:
            self._sealed_from_far(flow, data, sender, now)
            return
        kind, seq = peek(data)
        if self._sealed_only:
            self._leave_out(kind is not None, sender)
            return
        if kind is None or (data[0] in SEALED):
            self.foreign += 1
            return
        flow, message = self._open, kind is _FORTH or kind is _BACK
        if flow is None or not data.startswith(flow.mark, BODY):
            flow = self._answered(kind, data, sender, now)
            if flow is None:
                return
        if sender != flow.slave or (message and (seq >= self._ticks or len(data) > self._size)):
            self.foreign += 1
            return
        if kind is _BACK or kind is _START:
            flow.slave_spoke(now)
        self._carry(flow, 1, seq if message else None, data, now)

    def _exchange(self, flow: Flow | None, kind: Kind, data: bytes, sender: Address, now: int) -> None:
        """A packet of the session's own from a master, in the open."""
        if flow is not None and flow is self._open and data.startswith(flow.mark, BODY):
            flow.master_spoke(now)
            self._carry(flow, 0, None, data, now)
            return
        known = self._introductions
        packet = decode(data, 0) if self._is_free(sender, now) and known.may_pass(sender, now) else None
        if not isinstance(packet, Packet):
            self.foreign += 1
            return
        if kind is Kind.HELLO:
            is_known = known.ask(packet.session, sender, now)
            if is_known:
                self._compare(packet)
        else:
            is_known = known.master_of(packet.session) == sender
        if not is_known:
            self.foreign += 1
            return
        self._introduced[0] += 1
        self.far.answer(self._marked(packet, data), known.slave_of(packet.session, self.home))

    def _answered(self, kind: Kind, data: bytes, sender: Address, now: int) -> Flow | None:
        """An answer of the slave's in a session that it has not taken up yet; the flow of one that it takes up now."""
        known, session = self._introductions, _session_of(data)
        master = known.master_of(session)
        if master is None or session is None:
            self.foreign += 1
            return None
        if kind is Kind.WELCOME:
            known.welcome(session, sender, self.home)
            self._tell_elsewhere(sender)
        slave = known.slave_of(session, self.home)
        if sender != slave or not self._is_free(master, now):
            self.foreign += 1
            return None
        if kind is not _START and kind is not _BACK:
            self._introduced[1] += 1
            packet = decode(data, 0) if self._tells else None
            self.near.answer(self._marked(packet, data) if isinstance(packet, Packet) else data, master)
            return None
        if not self.flows.has_room(master[0], now):
            self.foreign += 1
            return None
        if self._open is not None:
            self.flows.end(self._open)  # the slave has one session at a time
        known.forget(session)
        mark = b"\x96" + packb(session)
        self._open = self.flows.begin(Flow(master, self.home, self.far, self.bulks[1], self._relay(), now, sealed=False,
                                           mark=mark))
        self._open.slave = slave
        self._open.slave_spoke(now)
        self.flows.end_others(self._open, now)
        return self._open

    def _sealed_from_near(self, flow: Flow | None, data: bytes, sender: Address, now: int) -> None:
        """Take a sealed datagram of a master. Its number counts the datagrams in order of arrival."""
        handshake = data[0] != DATA
        parts = (records(data) or []) if handshake and len(data) <= MTU + EXTRA else []
        hello = parts[0] if parts and parts[0].is_hello else None
        if hello is not None:
            if flow is None or not flow.sealed or flow.rests(now):
                flow = self._greet(hello, cookie_of(parts), len(data), sender, now)
                if flow is None:
                    return
            flow.hellos.append(hello.number)
            data = without_cookie(parts, len(data))
        well = len(data) <= LONGEST and (bool(parts) if handshake else flow is not None and flow.is_accepted)
        if flow is None or not flow.sealed or not well or not flow.master_spoke(now):
            self.foreign += 1
            return
        self._carry(flow, 0, flow.numbers[0], data, now)
        flow.numbers[0] += 1

    def _greet(self, hello: DtlsRecord, cookie: bytes, size: int, sender: Address, now: int) -> Flow | None:
        """A hello of a master without a flow: it gets one if it brings its cookie, and else a cookie."""
        if not self._is_free(sender, now):
            self.foreign += 1
            return None
        if not self._cookies.is_good(cookie, hello, sender, now):
            reply = cookie_record(hello, self._cookies.of(hello, sender, now))
            self.foreign += 1
            if len(reply) <= size:
                self.near.answer(reply, sender)
            return None
        try:
            wire = self._port(self.home) if self.flows.has_room(sender[0], now) else None
        except (Refused, OSError):  # no port is left, or no file
            wire = None
        if wire is None:
            self.foreign += 1
            return None
        return self.flows.begin(Flow(sender, self.home, wire, Bulk(wire), self._relay(), now, sealed=True))

    def _sealed_from_far(self, flow: Flow, data: bytes, sender: Address, now: int) -> None:
        """Take a sealed datagram of the slave."""
        if not data or data[0] not in SEALED or len(data) > LONGEST:
            self.foreign += 1
            return
        parts = (records(data) or []) if data[0] != DATA else []
        if sender != flow.slave and not flow.numbers[1] and any(one.is_request and one.number in flow.hellos
                                                                for one in parts):
            flow.slave = sender
            self._tell_elsewhere(sender)
        if sender != flow.slave:
            self.foreign += 1
            return
        # What is sealed the slave sends to whom it has let in alone: its Finished is the first of that.
        if data[0] == DATA or any((one.type, one.epoch) == (HANDSHAKE, 1) for one in parts):
            met = flow.is_accepted
            flow.slave_spoke(now)
            if not met:
                self.flows.end_others(flow, now)
        self._carry(flow, 1, flow.numbers[1], data, now)
        flow.numbers[1] += 1

    def _is_free(self, sender: Address, now: int) -> bool:
        """True if a session of this sender may begin: not while another's runs; its own master may ask anew."""
        return self.flows.held_by(now) in (None, sender)

    def _relay(self) -> Relay:
        return Relay(self._link, self._seed, self._size)

    def _carry(self, flow: Flow, direction: int, number: int | None, data: bytes, now: int) -> None:
        """Put a datagram on the flow's link. Time 0 of a session in the open is that of its tick 0."""
        if flow.origin is None and number is not None:
            flow.origin = now - number * self._dt_ns
        flow.relay.receive(direction, number, data, 0 if flow.origin is None else now - flow.origin)

    def _leave_out(self, packet: bool, sender: Address) -> None:
        """Count a datagram in the open that is not passed on; say so of the first that is a packet of an end."""
        self.unsealed += 1
        if packet and self._beyond is not None and not self._said_unsealed:
            self._said_unsealed = True
            print(f"channel: dropped a packet without keys from {host_port(sender)}, and will drop all others: "
                  f"{host_port(self._beyond)} is beyond this machine, where such a link can be read, changed and taken "
                  "over; give both ends --key and --peer-fingerprint, or this channel --insecure in a network you "
                  "trust", file=sys.stderr, flush=True)

    def _marked(self, packet: Packet, data: bytes) -> bytes:
        """A HELLO or WELCOME that tells its receiver that the link is in the open beyond this machine, if it is."""
        if not self._tells or not isinstance(packet.payload, dict):
            return data
        marked = packet._replace(payload={**packet.payload, INSECURE: "1"})
        for size in (len(data), None):  # no longer than it was, if it has the room
            with suppress(Refused):
                return encode(marked, size)
        return data

    def _tell_elsewhere(self, sender: Address) -> None:
        """The slave answers from there. Said once, for from elsewhere any sender could answer a HELLO of its own."""
        if sender not in (self.home, *self._elsewhere) and len(self._elsewhere) < MOST_SAID:
            self._elsewhere.append(sender)
            at = host_port(sender)
            print(f"channel: the slave answers from {at}; start this channel with --peer {at}, or any sender can take "
                  "the link from a session that runs", file=sys.stderr, flush=True)

    def counts(self, direction: int) -> Counts:
        """Counts of one direction's datagrams, over all sessions."""
        first, rest = self._introduced[direction], self.flows.counts(direction)
        return rest._replace(received=rest.received + first, delivered=rest.delivered + first)

    def _compare(self, hello: Packet) -> None:
        """Say so if the master runs another scene: the link would be another one. The link itself may differ."""
        assert isinstance(hello.payload, dict)
        theirs = {key: text for key, text in hello.payload.items() if key in self._manifest}
        difference = manifest_difference(self._manifest, theirs)
        if difference is not None and difference not in self._differed and len(self._differed) < MOST_SAID:
            self._differed.append(difference)
            sentence = f"channel: the master runs another scene than this channel: {difference}"
            print(sentence, file=sys.stderr, flush=True)



def _session_of(data: bytes) -> int | None:
    """The session of a packet that `peek` has found to be one."""
    try:
        session = unpackb(data[BODY : BODY + int.from_bytes(data[4:6], "big")], use_list=False)[0]
    except Exception:  # an unknown host's bytes
        return None
    return session if type(session) is int and session >= 0 else None
