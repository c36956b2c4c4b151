"""The clutch, and the distance between master and slave that it leaves.

While it is held the two ends have no session, and the hand moves the master alone. When it is let go, a new session
counts the positions from where each end is: from then on the master is by an offset beside the slave.

A turn keeps that offset: the master is brought beside the slave before the next session.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping

from teleop.live.page.following import Follower
from teleop.scene.axes import scales
from teleop.scene.scene import Scene

Place = tuple[float, ...]  # m, per axis


class Clutch:
    """`is_open`: as the ends have been told."""

    def __init__(self, scene: Scene) -> None:
        self.is_open = False
        self._scales = tuple([scale_x for scale_x, _ in scales(scene)])
        self._axes = scene.axes
        self._held: set[Hashable] = set()
        self._offset = (0.0,) * scene.axes  # m, of the master
        self._turning = False  # the next session is that of a turn, which keeps the offset
        self._met: float | None = None  # the tick at which a session began whose offset is not known yet

    def hold(self, page: Hashable, *, held: bool) -> None:
        """A page holds it, or lets it go; it is open while any does."""
        if held:
            self._held.add(page)
        else:
            self._held.discard(page)

    def changes(self) -> bool:
        """True if the ends have to be told that it `is_open`, or no longer is."""
        changed = self.is_open != bool(self._held)
        self.is_open = bool(self._held)
        return changed

    def turned(self, *, again: bool) -> None:
        """The ends are told to turn; `again`: and to go back to the scene's start."""
        self._turning = not again

    def met(self, k: float) -> None:
        """The master has begun a session at tick k."""
        self._met, self._turning = None if self._turning else k, False

    def measure(self, followers: Mapping[str, Follower]) -> None:
        """Take the offset as soon as the records have come to the session's begin."""
        if self._met is None or any(not each.newest or each.newest[-1][0] < self._met for each in followers.values()):
            return
        places = self._places(followers, self._met)
        self._met = None
        if places is not None:
            self._offset = tuple(a - b for a, b in zip(*places, strict=True))

    def aligned(self, followers: Mapping[str, Follower]) -> list[float] | None:
        """Where the master (m, per axis) is to be for the hand to feel what the slave touches; None: not known."""
        places = self._places(followers, float("inf"))
        return None if places is None else [x + offset for x, offset in zip(places[1], self._offset, strict=True)]

    def _places(self, followers: Mapping[str, Follower], k: float) -> tuple[Place, Place] | None:
        """Of master and slave at tick k, in the master's metres."""
        found = []
        for e, own in (("m", (1.0,) * self._axes), ("s", self._scales)):
            row = followers[e].at(k) if e in followers else None
            if row is None:
                return None
            found.append(tuple(x / scale for x, scale in zip(row[followers[e].places[f"x_{e}"]], own, strict=True)))
        return found[0], found[1]
