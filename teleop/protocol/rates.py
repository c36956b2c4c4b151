"""Ends at different rates: what one of them plays of the other's messages at a tick of its own.

Both count the ticks of one grid; an end takes every `mine`-th of them, its peer every `theirs`-th. A slower peer's
message stands for all the ticks until its next one is due, and is played at each of them. A faster one's messages of
the ticks since the last are played together: of a sample or a position their mean, of a total the newest
(`teleop.kind`), and of a position on the axes of a rotation too, where it is a rotation vector: no mean of these is
one. What waves have come to is cumulative too, so the newest message has it all (`teleop.stages.wave_integral`): ends
at different rates exchange waves in no other way. Where neither rate is a multiple of the other the mean is that over
the ticks of the grid, at each of which the last message stands, for its sender's tick at most.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from teleop.kind import positions, totals
from teleop.stages.wave_integral import Integrals


class Heard(NamedTuple):
    """One message as it came: the law's, per axis, the sender's energy stamp, and what its waves have come to."""

    rx: tuple[Any, ...]
    E_in: float | None
    waves: tuple[Integrals, ...] | None = None  # per axis, where they are sent along


class Messages(Protocol):
    """Where messages wait until a tick plays them."""

    def put(self, packet: int, tick: int, entry: Heard) -> None: ...
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
        """What tick k plays, the one before having been `last`: the number of a packet, and the message."""
        mine, theirs = self.mine, self.theirs
        if mine == theirs == 1:
            return inbox.take(k)
        ticks = range(max(last + 1, k - mine + 1), k + 1)
        if mine % theirs and theirs % mine:
            stood = [each for j in ticks if (each := self._standing(inbox, j)) is not None]
            return self._mean(stood) if stood else None
        came = [got for j in ticks if (got := inbox.take(j)) is not None]
        if came:
            got = self._mean(came)
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

    def _mean(self, came: list[tuple[int, Heard]]) -> tuple[int, Heard]:
        """Mean of the messages that came for one tick."""
        if len(came) == 1:
            return came[0]
        newest, heard = came[-1]
        rx = []
        for i in range(len(heard.rx)):
            newest_of = self._turned if i in self._turning else self._totals
            fields = zip(self._kind._fields, *[each.rx[i] for _, each in came], strict=True)
            rx.append(self._kind(*[numbers[-1] if name in newest_of else sum(numbers) / len(came)
                                   for name, *numbers in fields]))
        return newest, heard._replace(rx=tuple(rx))
