"""The relay between two live ends, without its sockets: datagrams and `now` go in, datagrams come out."""

from __future__ import annotations

from typing import NamedTuple

from channel.schedule import ENTRY, Stream, TwoWay

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
        self._came = [0, 0]  # the latest in each direction
        self._received = [0, 0]
        self._passed = [0, 0]  # control datagrams delivered
        self._overflowed = [0, 0]
        self._rejected = [0, 0]
        self._most = [0, 0]

    def receive(self, direction: int, packet_number: int | None, data: bytes, now_ns: int) -> None:
        """A datagram came in from the end where `direction` begins."""
        stream = self._streams[direction]
        came = self._came[direction] = max(now_ns, self._now if stream.queues else self._came[direction])
        self._now = max(self._now, came)
        self._received[direction] += 1
        one, other = self._streams
        full = one.bytes + other.bytes + len(data) + ENTRY > MOST_BYTES
        if full or one.under_way + other.under_way + len(self._control) >= MOST:
            self._overflowed[direction] += 1
        elif packet_number is None:
            self._control.append((came, direction, data))
            self._controls[direction] += 1
        elif 0 <= packet_number < _NUMBERS:
            stream.send(packet_number, came, data)
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
            self._passed = [passed + more for passed, more in zip(self._passed, self._controls, strict=True)]
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
        one, other = self._streams
        soon, then = one.next_ns(), other.next_ns()
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
