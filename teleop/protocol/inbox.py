"""Playout: the packet that a tick plays, out of the packets that a link delivered.

A packet sent at tick k arrives at tick `max(k+1, ceil(time/dt))`. With playout zero or hold the newest
wins: a tick plays the greatest number that has come, if it is greater than every one played before. With
a fixed playout delay, packet k is played at exactly tick k + D if it has come by then, and never
otherwise. Either way a packet is played at most once and the numbers played only grow.

`Inbox` plays packets tick by tick, as their datagrams come; `teleop.simulation.plan` gives the same for a whole
direction of a link that was drawn up front.

`Resampling` serves ends at different rates. Both count the ticks of one grid; an end takes every `mine`-th of them, its
peer every `theirs`-th. A slower peer's message stands for all the ticks until its next one is due, and is played at
each of them. The messages of a faster one since the last tick are played together: the mean of a sample or a position,
the newest of a total (`teleop.kind`). The newest is played of a rotation vector too, for no mean of these is one. The
integrals of waves are cumulative, so the newest message has it all (`teleop.stages.wave_integral`): ends at different
rates exchange waves in no other way. Where neither rate is a multiple of the other, the mean is over the ticks of the
grid, at each of which the last message stands, for its sender's tick at most.
"""

from __future__ import annotations

from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from teleop.errors import Refused
from teleop.kind import positions, totals
from teleop.scene.playout import Fixed, Playout
from teleop.stages.wave_integral import Integrals


class Heard(NamedTuple):
    """Message as received: the law's, per axis, the sender's energy stamp, and the integrals of its waves."""

    rx: tuple[Any, ...]
    E_in: float | None
    waves: tuple[Integrals, ...] | None = None  # per axis, where they are sent along


class Messages(Protocol):
    """Store where messages wait until a tick plays them."""

    def add(self, packet: int, tick: int, entry: Heard) -> None: ...
    def take(self, tick: int) -> tuple[int, Heard] | None: ...


class Resampling:
    """Takes messages of type `kind` out of an inbox, at every `mine`-th tick. `turning`: the axes of rotations."""

    def __init__(self, kind: Any, *, mine: int, turning: frozenset[int] = frozenset()) -> None:
        self.mine, self.theirs = mine, 1
        self._kind, self._turning = kind, turning
        self._totals, self._turned = totals(kind), totals(kind) + positions(kind)
        self._last: tuple[int, tuple[int, Heard]] | None = None  # when a message was played last, and which

    @property
    def played(self) -> int | None:
        """The tick of the grid at which a packet was played last; None where every tick plays its own, or none."""
        return None if self._last is None else self._last[0]

    def begin(self, theirs: int) -> None:
        """A session with a peer that ticks at every `theirs`-th tick."""
        self.theirs, self._last = theirs, None

    def take(self, inbox: Messages, last: int, k: int) -> tuple[int, Heard] | None:
        """Packet number and message that tick k plays, the tick before being `last`; None: nothing."""
        mine, theirs = self.mine, self.theirs
        if mine == theirs == 1:
            return inbox.take(k)
        ticks = range(max(last + 1, k - mine + 1), k + 1)
        if mine % theirs and theirs % mine:
            stood = [each for j in ticks if (each := self._standing(inbox, j)) is not None]
            return self._mean(stood) if stood else None
        messages = [got for j in ticks if (got := inbox.take(j)) is not None]
        if messages:
            got = self._mean(messages)
            self._last = (k, got)
            return got
        if self._last is None or k - self._last[0] + mine > theirs:
            return None
        return self._last[1]

    def _standing(self, inbox: Messages, j: int) -> tuple[int, Heard] | None:
        """The message that stands at tick j of the grid, if one does."""
        got = inbox.take(j)
        if got is not None:
            self._last = (j, got)
        return self._last[1] if self._last is not None and j - self._last[0] < self.theirs else None

    def _mean(self, messages: list[tuple[int, Heard]]) -> tuple[int, Heard]:
        """Mean of the messages that messages for one tick."""
        if len(messages) == 1:
            return messages[0]
        newest, heard = messages[-1]
        rx = []
        for i in range(len(heard.rx)):
            newest_of = self._turned if i in self._turning else self._totals
            fields = zip(self._kind._fields, *[each.rx[i] for _, each in messages], strict=True)
            rx.append(self._kind(*[numbers[-1] if name in newest_of else sum(numbers) / len(messages)
                                   for name, *numbers in fields]))
        return newest, heard._replace(rx=tuple(rx))


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
        "_coming", "_copies", "_delay", "_early", "_queued", "_room", "_tick", "_waits", "_window",
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
        self._early: dict[int, Entry] = {}  # fixed: those that arrived, by number, until their tick
        self._tick = tick  # the last one taken; an end that joins a run begins behind its first ticks
        self.received = self.duplicates = self.played = self.overtaken = self.late = self.refused = 0

    @property
    def waiting(self) -> int:
        """Packets that arrived and whose tick is still ahead."""
        return len(self._early)

    def add(self, packet: int, tick: int, entry: Entry) -> None:
        """Packet number `packet` (at least 0) arrives at `tick`, carrying `entry`."""
        if tick <= self._tick:
            tick = self._tick + 1
        if tick <= packet:
            tick = packet + 1
        if self._queued + len(self._early) >= self._room or tick > self._tick + self._room:
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
        """Number and entry of the packet that `tick` plays, or None. Raises `Refused` going backwards."""
        last = self._tick
        if tick <= last:
            raise Refused(f"tick {tick} was taken already; take a tick after {last}")
        self._tick = tick
        if tick == last + 1 and self._delay is None and not self._copies:  # nearly always
            at_once = self._coming.pop(tick, None)
            if at_once is None:
                return None
            self._queued -= len(at_once)
            for packet, _ in at_once:
                self._waits.pop(packet, None)
            return self._newest(at_once)
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

    def _exactly(self, wanted: int, arrived: list[tuple[int, Entry]], *, skipped: bool) -> tuple[int, Entry] | None:
        early = self._early
        for packet, entry in arrived:
            if not self._is_first(packet):
                continue
            if packet < wanted:
                self.late += 1
            else:
                early[packet] = entry
        if skipped:
            for packet in [k for k in early if k < wanted]:
                del early[packet]
                self.late += 1
        if wanted not in early:
            return None
        self.played += 1
        return wanted, early.pop(wanted)
