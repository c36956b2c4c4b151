"""The arrivals of packets: a whole direction drawn up front, or packet by packet as they are sent.

Both forms give the same packets at the same nanosecond, because ties have a rule: at every place in the
chain, packets of the same time go in the order of their numbers. Rows of packets are (number, time), in whole
nanoseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from heapq import heappop, heappush
from typing import Any, ClassVar, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from channel.rng import Bools, Ints, Rng
from teleop.errors import Refused


def by_time(packet: Ints, time_ns: Ints) -> tuple[Ints, Ints]:
    """The rows sorted by (time, packet number); rows that already are sorted are returned as they came."""
    if len(time_ns) < 2:
        return packet, time_ns
    step = np.diff(time_ns)
    if step.min() > 0 or bool(np.all((step > 0) | ((step == 0) & (np.diff(packet) >= 0)))):
        return packet, time_ns
    rows = np.lexsort((packet, time_ns))
    return packet[rows], time_ns[rows]


def by_number(packet: Ints, time_ns: Ints) -> tuple[Ints, Ints]:
    """The rows sorted by (packet number, time)."""
    if len(packet) < 2 or bool(np.all(np.diff(packet) > 0)):
        return packet, time_ns
    rows = np.lexsort((time_ns, packet))
    return packet[rows], time_ns[rows]


def nanoseconds(time: float) -> int:
    """A time in s as a whole number of ns, to the nearest."""
    return round(time * 1e9)


def later(packet: Ints, time_ns: Ints, delay: NDArray[np.float64]) -> tuple[Ints, Ints]:
    """The rows after a delay of their own each, s (n,), to the nearest ns, sorted again."""
    return by_time(packet, time_ns + np.rint(delay * 1e9).astype(np.int64))


Order = Literal["any", "time", "number"]
State = Any  # an effect's own: the schedule hands it back unchanged

ENTRY = 250  # bytes of memory that a packet under way takes up beside its load: a tuple, its numbers, the load's object


class Carrier(Protocol):
    """An effect as the schedule uses it; see `channel.effect.Effect`, which describes each member."""

    order: ClassVar[Order]

    @property
    def constant_ns(self) -> int | None: ...

    def begin(self, rng: Rng) -> State: ...

    def carry(self, state: State, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, State]: ...


class TwoWay(Protocol):
    """A path between the two ends: an effect, a chain of effects, or a link."""

    def in_direction(self, direction: int) -> Sequence[Carrier]:
        """The effects that a packet passes in this direction (0: fwd, master to slave; 1: bwd)."""
        ...


class Arrivals(NamedTuple):
    """The packets that come out of one direction, sorted by (time, number): lost ones absent, doubled ones twice."""

    packet: Ints  # (m,)
    time_ns: Ints  # (m,), ns from the start of the session


class Verdicts(NamedTuple):
    """The packets that one effect was given and gave; one that is in and not out was lost."""

    effect: str
    packet_in: Ints
    time_in: Ints
    packet_out: Ints
    time_out: Ints


class Delivery(NamedTuple):
    """A packet that has arrived, when, and the bytes it was sent with."""

    packet: int
    time_ns: int
    load: bytes


def arrivals(link: TwoWay, direction: int, count: int, dt_ns: int, seed: int, size: int,
             sent: Bools | None = None) -> Arrivals:
    """The arrivals when packets 0..count-1 are sent at k*dt_ns, each of `size` bytes on the wire.

    `sent`: which of them are, (count,); None: all.
    """
    packet, time_ns = _sent(count, dt_ns)
    if sent is not None:
        packet, time_ns = packet[sent], time_ns[sent]
    for done in _passed(link, direction, packet, time_ns, seed, size):
        packet, time_ns = done.packet_out, done.time_out
    return Arrivals(packet, time_ns)


def verdicts(link: TwoWay, direction: int, count: int, dt_ns: int, seed: int, size: int) -> list[Verdicts]:
    """The log of `arrivals`: what each effect of the chain did, first to last."""
    return list(_passed(link, direction, *_sent(count, dt_ns), seed, size))


def _sent(count: int, dt_ns: int) -> tuple[Ints, Ints]:
    packet = np.arange(whole("count", count, 0), dtype=np.int64)
    return packet, packet * whole("dt_ns", dt_ns, 1)


def _passed(link: TwoWay, direction: int, packet: Ints, time_ns: Ints, seed: int, size: int) -> Iterator[Verdicts]:
    whole("size", size, 1)
    for place, effect in enumerate(link.in_direction(direction)):
        if effect.order == "number":
            packet, time_ns = by_number(packet, time_ns)
        state = effect.begin(Rng(seed, direction, place))
        out, time_out, _ = effect.carry(state, packet, time_ns, size)
        yield Verdicts(repr(effect), packet, time_ns, out, time_out)
        packet, time_ns = out, time_out


class Stream:
    """Direction of a link, live: `send` packets as they come, ask for what is `due`.

    `now_ns` counts from the start of the session and never goes back; packet numbers grow. Fed with the send
    times of `arrivals`, it gives `arrivals`. Effects decide at once, so a packet is carried on through the
    chain when it is sent, up to the first one that must see packets in time order (a queue): there it waits
    in the heap for its time. `log` is called with the `Verdicts` of every packet at every effect.
    """

    def __init__(self, link: TwoWay | None, direction: int, seed: int, size: int,
                 log: Callable[[Verdicts], object] | None = None) -> None:
        self._effects = link.in_direction(direction) if link is not None else ()
        self._size = whole("size", size, 1)
        self.queues = any(e.order == "time" for e in self._effects)  # must packets enter in order of time
        self._states: list[State] = [e.begin(Rng(seed, direction, p)) for p, e in enumerate(self._effects)]
        self._log = log
        self._heap: list[tuple[int, int, int, int, bytes]] = []  # time, place, packet, serial, load
        self._serial = 0
        self._constant_ns = _constant_ns(self._effects) if log is None else None
        self.bytes = 0  # of memory that the packets under way take up
        self.sent = self.doubled = self.lost = self.delivered = 0
        """Counters: at any time, sent + doubled = lost + delivered + under_way."""
        nothing = np.empty(0, np.int64)
        for place in range(len(self._effects)):  # an effect that cannot carry this size says so now
            self._carry(place, nothing, nothing)

    def send(self, packet: int, now_ns: int, load: bytes = b"") -> None:
        """A packet, 0..2^63-1, enters the link."""
        self.sent += 1
        if self._constant_ns is not None:
            heappush(self._heap, (now_ns + self._constant_ns, len(self._effects), packet, self._serial, load))
            self._serial += 1
            self.bytes += len(load) + ENTRY
            return
        self._onward(0, np.array([packet], np.int64), np.array([now_ns], np.int64), load)

    def due(self, now_ns: int) -> list[tuple[int, int]]:
        """(packet, time_ns) of all that arrived up to now, sorted by (time, number)."""
        return [(packet, time_ns) for packet, time_ns, _ in self.deliver(now_ns)]

    def deliver(self, now_ns: int) -> list[Delivery]:
        """The same with what the packets carry."""
        out: list[Delivery] = []
        heap, end = self._heap, len(self._effects)
        while heap and heap[0][0] <= now_ns:
            time_ns, place, packet, _, load = heappop(heap)
            self.bytes -= len(load) + ENTRY
            if place == end:
                out.append(Delivery(packet, time_ns, load))
            else:
                row = np.array([packet], np.int64), np.array([time_ns], np.int64)
                self._onward(place + 1, *self._carry(place, *row), load)
        self.delivered += len(out)
        return out

    def next_ns(self) -> int | None:
        """The time to ask again: that of the next arrival or event inside, None if nothing is under way."""
        return self._heap[0][0] if self._heap else None

    @property
    def under_way(self) -> int:
        """Packets inside the link, copies included."""
        return len(self._heap)

    def _onward(self, place: int, packet: Ints, time_ns: Ints, load: bytes) -> None:
        """Carries rows as far as they can go before their time, and lays them down there."""
        while place < len(self._effects) and self._effects[place].order != "time":
            packet, time_ns = self._carry(place, packet, time_ns)
            place += 1
        for number, time in zip(packet.tolist(), time_ns.tolist(), strict=True):
            heappush(self._heap, (time, place, number, self._serial, load))
            self._serial += 1
            self.bytes += len(load) + ENTRY

    def _carry(self, place: int, packet: Ints, time_ns: Ints) -> tuple[Ints, Ints]:
        effect = self._effects[place]
        out, time_out, self._states[place] = effect.carry(self._states[place], packet, time_ns, self._size)
        added = len(out) - len(packet)
        self.doubled += max(added, 0)
        self.lost += max(-added, 0)
        if self._log is not None and len(packet):
            self._log(Verdicts(repr(effect), packet, time_ns, out, time_out))
        return out, time_out


def _constant_ns(effects: Sequence[Carrier]) -> int | None:
    """The delay of every packet (ns), if a constant delay is all that these effects do; otherwise None.

    A relay then needs no numpy for a packet.
    """
    delays = [effect.constant_ns for effect in effects]
    return None if None in delays else sum(delay for delay in delays if delay is not None)


def whole(name: str, value: object, low: int) -> int:
    """`value` as a whole number of at least `low`, or `Refused`."""
    if isinstance(value, bool) or not isinstance(value, int) or value < low:
        raise Refused(f"{name} must be a whole number from {low} on, not {value!r}; for example {name}=100")
    return value
