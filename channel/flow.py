"""A flow: one master's address and what passes between it and the slave, on a link of its own.

A relay has a flow for each master that has shown its address, and only the slave decides which of them it takes up. A
flow that was taken up stays while both speak in it; any other is passed on a little, holds nothing that others need,
and is over after a while.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator

from channel.relay import Counts, Relay
from teleop.live.net.bulk import Bulk
from teleop.live.net.wire import Address, Wire
from teleop.protocol.liveness import RENEW_NS

QUIET_NS = RENEW_NS  # a flow in which the master, or the slave, has been silent for so long gives way to others
UNMET_NS = 5_000_000_000  # a flow that the slave has not taken up is over after this; a handshake is given up by then
UNMET_MOST = 256  # datagrams that it may send to the slave until then; an honest handshake has some forty
MOST_FLOWS = 32


class Flow:
    """The flow of the master at address `master`; the slave is reached through `wire`, or answers from `slave`.

    `own`: the wire is this flow's alone, which tells the slave's answers to one master from those to another. Where
    several flows share one (sessions in the open), `mark` does: the bytes with which bodies of its session begin.
    """

    def __init__(self, master: Address, slave: Address, wire: Wire, bulk: Bulk, relay: Relay, now: int,
                 *, own: bool, mark: bytes = b"") -> None:
        self.master, self.slave, self.home = master, slave, slave
        self.wire, self.bulk, self.relay, self.own, self.mark = wire, bulk, relay, own, mark
        self.origin: int | None = now if own else None  # our clock at its link's time 0 (ns)
        self.numbers = [0, 0]  # of the next sealed datagram in each direction
        self.asked: deque[int] = deque(maxlen=64)  # numbers of its hellos: an answer to one bears its number
        self._began = self._master_ns = now
        self._slave_ns: int | None = None  # when the slave last spoke in it, None: it has not taken it up

    def master_spoke(self, now: int) -> bool:
        """The master has sent something. False: too much for a flow that was not taken up."""
        self._master_ns = now
        return self.met or self.numbers[0] < UNMET_MOST

    def slave_spoke(self, now: int) -> None:
        """The slave has sent what it sends to a master that it has taken up and to no other."""
        self._slave_ns = now

    @property
    def met(self) -> bool:
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
        return not self.met and now - self._began >= UNMET_NS

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

    def begin(self, flow: Flow) -> None:
        """Keep a flow, in place of the one that its master has had."""
        before = self._flows.get(flow.master)
        if before is not None:
            self.end(before)
        self._flows[flow.master] = flow

    def end(self, flow: Flow) -> None:
        """Forget a flow; what was under way in it is lost, and what became of the rest stays counted."""
        if self._flows.get(flow.master) is flow:
            del self._flows[flow.master]
        self._count(flow)
        if flow.own:
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
            if flow is not met and flow.met and not flow.runs(now):
                self.end(flow)

    def counts(self, direction: int) -> Counts:
        """Counts of one direction's datagrams, over all present and past flows."""
        total = self._past[direction]
        for flow in self._flows.values():
            total = _sum(total, flow.relay.counts(direction))
        return total or Relay(None, 0, 1).counts(direction)


def _sum(one: Counts | None, other: Counts, *, over: bool = False) -> Counts:
    """Both together; `over`: what is under way in `other` is lost."""
    if over:
        other = other._replace(lost=other.lost + other.under_way, under_way=0)
    if one is None:
        return other
    both = Counts(*[a + b for a, b in zip(one, other, strict=True)])
    return both._replace(most_under_way=max(one.most_under_way, other.most_under_way))
