"""Who moves the hand: of several pages the one whose pointer moved last.

A page that drags says so again every quarter of a second, though its pointer is still. One that says nothing for
`HOLDS`, having vanished or been put behind other windows, has let go: until then the hand stays where it was.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import NamedTuple

HOLDS = 1.0  # s

Place = tuple[float, ...]  # m, per axis


class _Pointer(NamedTuple):
    to: Place
    moved: float  # when it came to another place, s
    heard: float  # when its page said so last, s


class Drag:
    """The pointers of all pages that drag, by their page."""

    def __init__(self) -> None:
        self._pointers: dict[Hashable, _Pointer] = {}

    def move(self, page: Hashable, to: Place, now: float) -> None:
        """The pointer of `page` is at `to`, at the time `now` (s)."""
        before = self._pointers.get(page)
        same = before is not None and before.to == to
        self._pointers[page] = _Pointer(to, before.moved if before is not None and same else now, now)

    def let_go(self, page: Hashable) -> None:
        """The pointer of `page` is up."""
        self._pointers.pop(page, None)

    def target(self, now: float) -> Place | None:
        """Where the hand is to go; None: nobody drags."""
        for page, pointer in list(self._pointers.items()):
            if now - pointer.heard > HOLDS:
                del self._pointers[page]
        newest = max(self._pointers.values(), key=lambda pointer: pointer.moved, default=None)
        return None if newest is None else newest.to
