"""The numbers of a law's messages in a packet: those of each axis in turn, and behind them what waves have come to.

Of an end that couples its axes, each total (`teleop.kind`) is one for all of them, see `teleop.law.offers`: it is sent
once, with the first axis.
"""

from __future__ import annotations

from typing import Any

from teleop.kind import totals

_new: Any = tuple.__new__  # twice as fast as the class


class Layout:
    """Messages of type `kind`, one for each axis, as a flat tuple. `couples`: their sender couples its axes."""

    __slots__ = ("_axes", "_kept", "_kind", "_own", "_places", "width")

    def __init__(self, kind: Any, axes: int, *, couples: bool) -> None:
        once = totals(kind) if couples else ()
        self._kind, self._axes, self._own = kind, axes, len(kind._fields)
        self._kept = [i for i, field in enumerate(kind._fields) if field not in once]
        self.width = self._own + (axes - 1) * len(self._kept)  # numbers in a packet
        first = list(range(self._own))
        self._places = [first]  # of each axis, where its fields stand in the packet
        for i in range(1, axes):
            places = first.copy()
            for n, field in enumerate(self._kept):
                places[field] = self._own + (i - 1) * len(self._kept) + n
            self._places.append(places)

    def flat(self, messages: tuple[Any, ...]) -> tuple[float, ...]:
        """The numbers of the messages of all axes, each a float: a law may give an int, or a number of numpy's."""
        if len(messages) == 1:
            return tuple(map(float, messages[0]))
        more = [message[i] for message in messages[1:] for i in self._kept]
        return tuple(map(float, [*messages[0], *more]))

    def messages(self, numbers: tuple[float, ...]) -> tuple[Any, ...]:
        """The messages of all axes; what stands behind them in `numbers` is not theirs."""
        if self._axes == 1:
            return (_new(self._kind, numbers[:self._own]),)
        return tuple([_new(self._kind, [numbers[at] for at in places]) for places in self._places])
