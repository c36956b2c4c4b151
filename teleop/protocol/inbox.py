"""Playout: which packet a tick plays, out of those that a link delivered.

A packet sent at tick k arrives at tick `max(k+1, ceil(time/dt))`. With playout zero or hold the newest
wins: a tick plays the greatest number that has come, if it is greater than every one played before. With
a fixed playout delay, packet k is played at exactly tick k + D if it has come by then, and never
otherwise. Either way a packet is played at most once and the numbers played only grow.

`Inbox` plays packets tick by tick, as their datagrams come; `teleop.simulation.plan` gives the same for a whole
direction of a link that was drawn up front.
"""

from __future__ import annotations

from typing import Generic, TypeVar

from teleop.errors import Refused
from teleop.scene.playout import Fixed, Playout

Entry = TypeVar("Entry")

_REMEMBERED = 65536  # packet numbers behind the newest within which an inbox tells copies apart


class Inbox(Generic[Entry]):
    """The same rule for packets as they come: put in at any time, taken tick by tick.

    Packets may be put before the tick they arrive at, which then waits for them, or after it was taken: then
    they arrive at the next one. Ticks may be skipped: with newest-wins their packets compete at the tick
    that follows; with a fixed delay their packets are late, for their instant has passed. Holds at most
    `room` packets besides those a fixed delay keeps, none of them more than that many ticks ahead; more
    are refused and counted, never raised, since what a peer sends decides it.
    """

    __slots__ = (
        "_coming", "_copies", "_delay", "_kept", "_queued", "_room", "_tick", "_waits", "_window",
        "duplicates", "late", "overtaken", "played", "received", "refused",
    )

    def __init__(self, playout: Playout, dt_ns: int, *, room: int = 4096, tick: int = -1) -> None:
        from teleop.protocol.packet import Window  # with msgpack, which a run in virtual time does without

        if room < 1:
            raise Refused(f"an inbox needs room for at least one packet, not {room}; write room=4096")
        self._delay = playout.ticks(dt_ns) if isinstance(playout, Fixed) else None
        self._room = room + (self._delay or 0)
        span = min(self._room, _REMEMBERED)
        self._window = Window(ahead=span, size=span)
        self._coming: dict[int, list[tuple[int, Entry]]] = {}  # by the tick of arrival
        self._queued = 0  # packets in there
        self._copies: dict[int, int] = {}  # further copies of them, by the tick of arrival
        self._waits: dict[int, int] = {}  # for each of them, the earliest tick that a copy of it waits for
        self._kept: dict[int, Entry] = {}  # fixed: those that arrived, by number, until their tick
        self._tick = tick  # the last one taken; an end that joins a run begins behind its first ticks
        self.received = self.duplicates = self.played = self.overtaken = self.late = self.refused = 0

    @property
    def waiting(self) -> int:
        """Packets that arrived and whose tick is still ahead."""
        return len(self._kept)

    def put(self, packet: int, tick: int, entry: Entry) -> None:
        """Packet number `packet` (at least 0) arrives at `tick`, carrying `entry`."""
        if tick <= self._tick:
            tick = self._tick + 1
        if tick <= packet:
            tick = packet + 1
        if self._queued + len(self._kept) >= self._room or tick > self._tick + self._room:
            self.refused += 1
            return
        if self._waits.get(packet, tick + 1) <= tick:
            # It cannot come first, so it takes no room: it is only counted.
            self._copies[tick] = self._copies.get(tick, 0) + 1
            return
        self._waits[packet] = tick
        self._queued += 1
        if tick in self._coming:
            self._coming[tick].append((packet, entry))
        else:
            self._coming[tick] = [(packet, entry)]

    def take(self, tick: int) -> tuple[int, Entry] | None:
        """What `tick` plays: the packet's number and its entry, or None. Raises `Refused` going backwards."""
        last = self._tick
        if tick <= last:
            raise Refused(f"tick {tick} was taken already; take a tick after {last}")
        self._tick = tick
        if self._queued == 1 and self._delay is None and not self._copies and tick in self._coming:  # nearly always
            self._queued = 0
            self._waits.clear()
            return self._newest(self._coming.pop(tick))
        arrived = self._arrived(tick, skipped=tick != last + 1) if self._queued or self._copies else []
        if self._delay is not None:
            return self._exactly(tick - self._delay, arrived, skipped=tick != last + 1)
        return self._newest(arrived) if arrived else None

    def _arrived(self, tick: int, *, skipped: bool) -> list[tuple[int, Entry]]:
        due = sorted(k for k in self._coming if k <= tick) if skipped else [tick]
        arrived = [item for k in due for item in self._coming.pop(k, ())]
        self._queued -= len(arrived)
        for packet, _ in arrived:
            self._waits.pop(packet, None)
        if self._copies:
            for k in [k for k in self._copies if k <= tick]:
                self.duplicates += self._copies.pop(k)
        return arrived

    def _is_first(self, packet: int) -> bool:
        """Count an arrival; is it the first copy, as far as the window remembers?"""
        if self._window.judge(packet, self._tick) == "duplicate":
            self.duplicates += 1
            return False
        self.received += 1
        return True

    def _newest(self, arrived: list[tuple[int, Entry]]) -> tuple[int, Entry] | None:
        # The newest that came at the earlier ticks is the newest played: it won its own tick.
        newest, fresh = self._window.newest, None
        for item in arrived:
            if not self._is_first(item[0]):
                continue
            if item[0] < newest:
                self.overtaken += 1
                continue
            self.overtaken += fresh is not None
            newest, fresh = item[0], item
        self.played += fresh is not None
        return fresh

    def _exactly(
        self, wanted: int, arrived: list[tuple[int, Entry]], *, skipped: bool
    ) -> tuple[int, Entry] | None:
        kept = self._kept
        for packet, entry in arrived:
            if not self._is_first(packet):
                continue
            if packet < wanted:
                self.late += 1
            else:
                kept[packet] = entry
        if skipped:
            for packet in [k for k in kept if k < wanted]:
                del kept[packet]
                self.late += 1
        if wanted not in kept:
            return None
        self.played += 1
        return wanted, kept.pop(wanted)
