"""The relay between two live ends, without its sockets: datagrams and `now` go in, datagrams come out."""

from __future__ import annotations

from typing import NamedTuple

from channel.schedule import Stream, Way

MOST = 2**18  # datagrams under way, both directions and all copies
_NUMBERS = 2**62


class Counts(NamedTuple):
    """What became of one direction's datagrams so far.

    received + doubled = lost + overflowed + rejected + delivered + under_way.
    """

    received: int
    doubled: int  # copies the link made
    lost: int  # by the link
    overflowed: int  # came when MOST were under way
    rejected: int  # with a number that no packet can have
    delivered: int
    under_way: int
    most_under_way: int


class Relay:
    """Both directions of a link (None: a perfect one) for one session.

    `now_ns` counts from the session's start; a clock that goes back, or a datagram from before the start, is
    taken as the latest time seen. Direction 0 is from master to slave, 1 from slave to master.

    A datagram without a packet number belongs to the session itself, to its start, stop and farewell. It is
    passed on at once and whole, because a scene's link describes what happens to the law's messages; ends
    that could not agree to start, or that never heard of the other's stop, would say nothing about the law.
    """

    def __init__(self, link: Way | None, seed: int, size: int) -> None:
        self._streams = tuple(Stream(link, direction, seed, size) for direction in (0, 1))
        self._control: list[tuple[int, int, bytes]] = []  # time, direction, data
        self._controls = [0, 0]  # how many of them in each direction
        self._now = 0
        self._received = [0, 0]
        self._passed = [0, 0]  # control datagrams delivered
        self._overflowed = [0, 0]
        self._rejected = [0, 0]
        self._most = [0, 0]

    def receive(self, direction: int, packet_number: int | None, data: bytes, now_ns: int) -> None:
        """A datagram came in from the end where `direction` begins."""
        self._now = max(self._now, now_ns)
        self._received[direction] += 1
        if sum(stream.under_way for stream in self._streams) + len(self._control) >= MOST:
            self._overflowed[direction] += 1
        elif packet_number is None:
            self._control.append((self._now, direction, data))
            self._controls[direction] += 1
        elif 0 <= packet_number < _NUMBERS:
            self._streams[direction].send(packet_number, self._now, data)
        else:
            self._rejected[direction] += 1
        self._most[direction] = max(self._most[direction], self._under_way(direction))

    def due(self, now_ns: int) -> list[tuple[int, bytes]]:
        """(direction, data) of all that has to go out by now, in order of time; the session's own first."""
        self._now = max(self._now, now_ns)
        out = [(direction, data) for _, direction, data in self._control]
        self._passed = [passed + more for passed, more in zip(self._passed, self._controls, strict=True)]
        self._control, self._controls = [], [0, 0]
        arrived = [(load.time_ns, direction, load.load)
                   for direction, stream in enumerate(self._streams) for load in stream.deliver(self._now)]
        arrived.sort(key=lambda one: one[:2])
        return out + [(direction, data) for _, direction, data in arrived]

    def next_ns(self) -> int | None:
        """When to ask `due` again, None if nothing is under way."""
        times = [time for stream in self._streams if (time := stream.next_ns()) is not None]
        if self._control:
            times.append(self._control[0][0])
        return min(times, default=None)

    def counts(self, direction: int) -> Counts:
        """What became of one direction's datagrams so far, the session's own included."""
        stream = self._streams[direction]
        return Counts(received=self._received[direction], doubled=stream.doubled, lost=stream.lost,
                      overflowed=self._overflowed[direction], rejected=self._rejected[direction],
                      delivered=stream.delivered + self._passed[direction],
                      under_way=self._under_way(direction), most_under_way=self._most[direction])

    def _under_way(self, direction: int) -> int:
        return self._streams[direction].under_way + self._controls[direction]
