"""The relay between two live ends, without its sockets: datagrams and `now` go in, datagrams come out.

There is a `Flow`, with a link of its own, for each master that has shown its address, and only the slave decides which
of them it takes up. A flow that was taken up stays while both speak in it. Any other is passed on a little, holds
nothing that others need, and is over after a while.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator
from typing import NamedTuple

from channel.schedule import ENTRY, Stream, TwoWay
from teleop.live.net.bulk import Bulk
from teleop.live.net.wire import Address, Wire
from teleop.protocol.session import RENEW_NS

MOST = 2**18  # datagrams under way, both directions and all copies
MOST_BYTES = 2**25  # of memory for them: what comes beyond it is dropped
_NUMBERS = 2**62


class Counts(NamedTuple):
    """Counts of one direction's datagrams so far.

    received + doubled = lost + overflowed + rejected + delivered + under_way.
    """

    received: int
    doubled: int  # copies the link made
    lost: int  # by the link
    overflowed: int  # came when MOST, or MOST_BYTES, were under way
    rejected: int  # with a number that no packet can have
    delivered: int
    under_way: int
    most_under_way: int


class Relay:
    """Both directions of a link (None: a perfect one) for one session.

    `now_ns` counts from the session's start; a clock that goes back, or a datagram from before the start, is taken
    as the latest time at which one came. A datagram may have come before `due` was asked last: it is due by when it
    came, not by when it was read, unless the link has a queue, which has moved on. Direction 0 is from master to
    slave, 1 from slave to master.

    A datagram without a packet number belongs to the session itself, to its start, stop and farewell. It is
    passed on at once and whole, because a scene's link describes what happens to the law's messages; ends
    that could not agree to start, or that never heard of the other's stop, would say nothing about the law.
    """

    def __init__(self, link: TwoWay | None, seed: int, size: int) -> None:
        self._streams = tuple(Stream(link, direction, seed, size) for direction in (0, 1))
        self._control: list[tuple[int, int, bytes]] = []  # time, direction, data
        self._controls = [0, 0]  # how many of them in each direction
        self._now = 0
        self._latest = [0, 0]  # the latest in each direction
        self._received = [0, 0]
        self._passed = [0, 0]  # control datagrams delivered
        self._overflowed = [0, 0]
        self._rejected = [0, 0]
        self._most = [0, 0]

    def receive(self, direction: int, packet_number: int | None, data: bytes, now_ns: int) -> None:
        """A datagram at in from the end where `direction` begins."""
        stream = self._streams[direction]
        at = self._latest[direction] = max(now_ns, self._now if stream.queues else self._latest[direction])
        self._now = max(self._now, at)
        self._received[direction] += 1
        fwd, bwd = self._streams
        full = fwd.bytes + bwd.bytes + len(data) + ENTRY > MOST_BYTES
        if full or fwd.under_way + bwd.under_way + len(self._control) >= MOST:
            self._overflowed[direction] += 1
        elif packet_number is None:
            self._control.append((at, direction, data))
            self._controls[direction] += 1
        elif 0 <= packet_number < _NUMBERS:
            stream.send(packet_number, at, data)
        else:
            self._rejected[direction] += 1
        under_way = self._under_way(direction)
        self._most[direction] = max(self._most[direction], under_way)

    def due(self, now_ns: int) -> list[tuple[int, bytes]]:
        """(direction, data) of all that has to go out by now, in order of time; the session's own first."""
        self._now = max(self._now, now_ns)
        out: list[tuple[int, bytes]] = []
        if self._control:
            out = [(direction, data) for _, direction, data in self._control]
            self._passed = [passed + count for passed, count in zip(self._passed, self._controls, strict=True)]
            self._control, self._controls = [], [0, 0]
        fwd, bwd = [stream.deliver(self._now) for stream in self._streams]
        if fwd and bwd:
            arrived = [(load.time_ns, direction, load.load)
                       for direction, loads in enumerate((fwd, bwd)) for load in loads]
            arrived.sort(key=lambda one: one[:2])
            return out + [(direction, data) for _, direction, data in arrived]
        return out + [(0, load.load) for load in fwd] + [(1, load.load) for load in bwd]

    def next_ns(self) -> int | None:
        """The time to ask `due` again, None if nothing is under way."""
        fwd, bwd = self._streams
        soon, then = fwd.next_ns(), bwd.next_ns()
        if soon is None or (then is not None and then < soon):
            soon = then
        if self._control and (soon is None or self._control[0][0] < soon):
            soon = self._control[0][0]
        return soon

    def counts(self, direction: int) -> Counts:
        """Counts of one direction's datagrams so far, the session's own included."""
        stream = self._streams[direction]
        return Counts(received=self._received[direction], doubled=stream.doubled, lost=stream.lost,
                      overflowed=self._overflowed[direction], rejected=self._rejected[direction],
                      delivered=stream.delivered + self._passed[direction],
                      under_way=self._under_way(direction), most_under_way=self._most[direction])

    def _under_way(self, direction: int) -> int:
        return self._streams[direction].under_way + self._controls[direction]


QUIET_NS = RENEW_NS  # a flow in which the master, or the slave, has been silent for so long gives way to others
UNMET_NS = 5_000_000_000  # a flow that the slave has not taken up is over after this; a handshake is given up by then
UNMET_MOST = 256  # datagrams that it may send to the slave until then; an honest handshake has some forty
MOST_FLOWS = 32


class Flow:
    """The flow of the master at address `master`; the slave is reached through `wire`, or answers from `slave`.

    `sealed`: the wire is this flow's alone, which tells the slave's answers to one master from those to another. Where
    several flows share one (sessions in the open), `mark` does: the bytes with which bodies of its session begin.
    """

    def __init__(self, master: Address, slave: Address, wire: Wire, bulk: Bulk, relay: Relay, now: int,
                 *, sealed: bool, mark: bytes = b"") -> None:
        self.master, self.slave, self.home = master, slave, slave
        self.wire, self.bulk, self.relay, self.sealed, self.mark = wire, bulk, relay, sealed, mark
        self.origin: int | None = now if sealed else None  # our clock at its link's time 0 (ns)
        self.numbers = [0, 0]  # of the next sealed datagram in each direction
        self.hellos: deque[int] = deque(maxlen=64)  # numbers of its hellos: an answer to one bears its number
        self._began = self._master_ns = now
        self._slave_ns: int | None = None  # when the slave last spoke in it, None: it has not taken it up

    def master_spoke(self, now: int) -> bool:
        """The master has sent something. False: too much for a flow that was not taken up."""
        self._master_ns = now
        return self.is_accepted or self.numbers[0] < UNMET_MOST

    def slave_spoke(self, now: int) -> None:
        """The slave has sent what it sends to a master that it has taken up and to no other."""
        self._slave_ns = now

    @property
    def is_accepted(self) -> bool:
        """True if the slave has taken it up."""
        return self._slave_ns is not None

    def runs(self, now: int) -> bool:
        """True if both ends send in it, the slave from its configured address.

        From another address any sender could answer itself.
        """
        if self._slave_ns is None or self.slave != self.home:
            return False
        return now - self._slave_ns < QUIET_NS and now - self._master_ns < QUIET_NS

    def is_over(self, now: int) -> bool:
        """True if its time has passed and the slave has not taken it up."""
        return not self.is_accepted and now - self._began >= UNMET_NS

    def rests(self, now: int) -> bool:
        """True if it is over, or its master was silent so long that another hello begins another flow."""
        return self.is_over(now) or now - self._master_ns >= QUIET_NS

    def due(self) -> int | None:
        """The time at which the next datagram has to go out, on our clock (ns); None: nothing is under way."""
        soon = self.relay.next_ns()
        return None if soon is None else soon + (self.origin or 0)


class Flows:
    """The flows of a relay by their masters' addresses, `MOST_FLOWS` at most; and what became of those before."""

    def __init__(self, close: Callable[[Wire], None]) -> None:
        self._close = close  # the wire of a flow that is gone, if it was its own
        self._flows: dict[Address, Flow] = {}  # oldest first
        self._past: list[Counts | None] = [None, None]

    def __iter__(self) -> Iterator[Flow]:
        return iter(list(self._flows.values()))

    def of(self, master: Address) -> Flow | None:
        """The flow of the master at this address."""
        return self._flows.get(master)

    def held_by(self, now: int) -> Address | None:
        """The master whose flow runs, None if none does. While one does, no other begins."""
        return next((flow.master for flow in self._flows.values() if flow.runs(now)), None)

    def has_room(self, host: str, now: int) -> bool:
        """True if there is room for a flow of this host; flows that do not run are ended to make it.

        First of those that are over; then of the oldest of the host that has most of them, if that is another host with
        more of them than this one would have. So no host can keep out others, however many ports it sends from.
        """
        for flow in self:
            if flow.is_over(now):
                self.end(flow)
        if len(self._flows) < MOST_FLOWS:
            return True
        idle = [flow for flow in self._flows.values() if not flow.runs(now)]
        each = Counter(flow.master[0] for flow in idle)
        most, count = each.most_common(1)[0] if each else (host, 0)
        if count <= each[host] + 1:
            return False
        self.end(next(flow for flow in idle if flow.master[0] == most))
        return True

    def begin(self, flow: Flow) -> Flow:
        """Keep a flow, in place of the one that its master has had."""
        before = self._flows.get(flow.master)
        if before is not None:
            self.end(before)
        self._flows[flow.master] = flow
        return flow

    def end(self, flow: Flow) -> None:
        """Forget a flow; what was under way in it is lost, and what became of the rest stays counted."""
        if self._flows.get(flow.master) is flow:
            del self._flows[flow.master]
        self._count(flow)
        if flow.sealed:
            self._close(flow.wire)

    def _count(self, flow: Flow) -> None:
        """Keep what became of the datagrams of a link that is over."""
        self._past = [_sum(past, flow.relay.counts(direction), over=True) for direction, past in enumerate(self._past)]

    def turn(self, flow: Flow, relay: Relay) -> None:
        """Have the flow go on over another link; what was under way is lost, and what became of the rest counted."""
        self._count(flow)
        flow.relay = relay

    def end_others(self, met: Flow, now: int) -> None:
        """The slave has taken up one: those that it had taken up before, and that do not run, are over."""
        for flow in self:
            if flow is not met and flow.is_accepted and not flow.runs(now):
                self.end(flow)

    def counts(self, direction: int) -> Counts:
        """Counts of one direction's datagrams, over all present and past flows."""
        total = self._past[direction]
        for flow in self._flows.values():
            total = _sum(total, flow.relay.counts(direction))
        return total or Relay(None, 0, 1).counts(direction)


def _sum(past: Counts | None, counts: Counts, *, over: bool = False) -> Counts:
    """Both together; `over`: what is under way in `counts` is lost."""
    if over:
        counts = counts._replace(lost=counts.lost + counts.under_way, under_way=0)
    if past is None:
        return counts
    both = Counts(*[a + b for a, b in zip(past, counts, strict=True)])
    return both._replace(most_under_way=max(past.most_under_way, counts.most_under_way))
