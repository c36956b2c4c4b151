"""Sums that a kernel keeps along its run, for the figures of `teleop.simulation.felt`, which says what they mean."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import Any

from teleop.simulation.felt import AT_END, names
from teleop.stages.end import Axis, End, Record, Run


class AxisSums(Record):
    """Sums of one axis of both ends."""

    v_was: float  # of the master at the tick before, m/s
    f_was: float
    a: float  # what is summed of this tick: change of velocity, mean velocity, force
    v: float
    f: float
    free_a: float
    free_v: float
    free_f: float
    end_f_m: float
    end_f_env: float
    end_x_m: float
    end_x_s: float
    end_touch: float


class Rank(Record):
    """Size of one of the largest steps of the force so far."""

    size: float


class BandCrossings(Record):
    """Crossings of a band about 0, from below to above it, by the velocity of one axis of the master."""

    v_was: float
    level: float  # of the band, m/s: a quarter of the greatest speed in the third of the late windows from the end
    armed: float  # 1.0 once it was below the band
    count: float  # in the last two windows
    first: float  # tick of the first, between two ticks where the line through their velocities leaves the band
    latest: float


class FigureSums(Record):
    """The sums of these groups."""

    moved: float  # 1.0 once the slave has moved
    away: float  # 1.0 as long as the slave has touched nothing
    free: float  # both
    free_n: float
    free_aa: float
    free_av: float
    free_vv: float
    free_fa: float
    free_fv: float
    free_ff: float
    jerk_sq: float
    jump: float
    below: float
    late: int  # the first tick of the last `END`

    def __init__(self, axes: int, groups: Sequence[str], ranks: int) -> None:
        super().__init__("sums")
        self.groups = frozenset(groups)
        self.at_end = tuple([f"end_{group}" for group in AT_END if group in groups])
        self.axes = tuple([AxisSums(f"{i}_sums") for i in range(axes)])
        self.ranks = tuple([Rank(f"rank{i}") for i in range(ranks)])
        self.least = self.ranks[-1:]
        self.turns = tuple([BandCrossings(f"{i}_turns") for i in range(axes)])

    def cells(self, group: str, places: Sequence[Record]) -> tuple[tuple[Record, str], ...]:
        """Records and fields of a group's sums, ordered as `teleop.simulation.felt.names`; `places`: the master first."""
        if group == "turns":
            return tuple([cell for place, own in zip(places, self.turns, strict=False) for cell in (
                (place, "rise"), (place, "fall"), (own, "count"), (own, "first"), (own, "latest"))])
        if group in AT_END:
            return tuple([(own, f"end_{group}") for own in self.axes])
        if group == "ranks":
            return tuple([(own, "size") for own in self.ranks])
        per_axis = {f"free_{one}{i}": (own, f"free_{one}")
                    for i, own in enumerate(self.axes) for one in ("a", "v", "f")}
        return tuple([per_axis.get(name, (self, name)) for name in names(group, len(self.axes), 0)])

    def begin(self, run: Run, asked: Any) -> None:
        """Before the first tick."""
        if "free" in self.groups or "jerk" in self.groups:
            for own in self.axes:
                own.v_was = own.f_was = 0.0
        if "free" in self.groups:
            self.away = 1.0
            self.moved = self.free_n = 0.0
            self.free_aa = self.free_av = self.free_vv = 0.0
            self.free_fa = self.free_fv = self.free_ff = 0.0
            for own in self.axes:
                own.free_a = own.free_v = own.free_f = 0.0
        if "jerk" in self.groups:
            self.jerk_sq = 0.0
            for rank in self.ranks:
                rank.size = 0.0
        if len(self.at_end) > 0:
            self.late = asked[-1]
            for own in self.axes:
                for field in self.at_end:
                    setattr(own, field, 0.0)
        if "turns" in self.groups:
            for turn in self.turns:
                turn.v_was = turn.level = turn.armed = turn.count = 0.0
                turn.first = turn.latest = -1.0

    def feel(self, run: Run, k: int) -> None:
        """The motion of the master against the force that it was held over, while the slave moves in free space."""
        for s in run.s.axes:
            self.away = self.away if abs(s.f_ext) <= 0.0 else 0.0
            self.moved = 1.0 if abs(s.v) > 0.0 else self.moved
        self.free = self.away * self.moved
        if k > 0:
            for m, own in zip(run.m.axes, self.axes, strict=True):
                own.a = m.v - own.v_was if self.free > 0.0 else 0.0
                own.v = 0.5 * (m.v + own.v_was) if self.free > 0.0 else 0.0
                own.f = own.f_was if self.free > 0.0 else 0.0
                own.free_a = own.free_a + own.a
                own.free_v = own.free_v + own.v
                own.free_f = own.free_f + own.f
            self.free_n = self.free_n + self.free
            self.free_aa = self.free_aa + reduce(add, [own.a * own.a for own in self.axes])
            self.free_av = self.free_av + reduce(add, [own.a * own.v for own in self.axes])
            self.free_vv = self.free_vv + reduce(add, [own.v * own.v for own in self.axes])
            self.free_fa = self.free_fa + reduce(add, [own.f * own.a for own in self.axes])
            self.free_fv = self.free_fv + reduce(add, [own.f * own.v for own in self.axes])
            self.free_ff = self.free_ff + reduce(add, [own.f * own.f for own in self.axes])

    def smooth(self, run: Run, step: Any, k: int) -> None:
        """A step of the force against the hand, N."""
        if k > 0:
            self.jerk_sq = self.jerk_sq + step * step
            for rank in self.least:
                self.jump = step
                if step > rank.size:
                    self.rank()

    def rank(self) -> None:
        """A step in its place among the largest."""
        for own in self.ranks:
            self.below = own.size if self.jump > own.size else self.jump
            own.size = self.jump if self.jump > own.size else own.size
            self.jump = self.below

    def keep(self, run: Run) -> None:
        """Keep the values that the next tick is compared with."""
        for m, own in zip(run.m.axes, self.axes, strict=True):
            own.v_was = m.v
            own.f_was = m.f

    def end(self, run: Run, k: int) -> None:
        """Forces and places of the last `END`."""
        if k >= self.late:
            for m, own in zip(run.m.axes, self.axes, strict=True):
                if "f_m" in self.groups:
                    own.end_f_m = own.end_f_m + m.f
                if "x_m" in self.groups:
                    own.end_x_m = own.end_x_m + place_of_law(run.m, m)
            if run.has.slave:
                self.end_slave(run)

    def end_slave(self, run: Run) -> None:
        """Forces and positions of the slave at the end."""
        for s, own in zip(run.s.axes, self.axes, strict=True):
            if "f_env" in self.groups:
                own.end_f_env = own.end_f_env + s.f_ext
            if "x_s" in self.groups:
                own.end_x_s = own.end_x_s + s.x
            if "touch" in self.groups:
                own.end_touch = own.end_touch + (1.0 if abs(s.f_ext) > 0.0 else 0.0)

    def turn(self, run: Run, k: int, start: Any, window: Any) -> None:
        """The velocities of the master in the last three of the late windows, of which the first begins at `start`."""
        if k >= start + 3 * window:
            for a, own in zip(run.m.axes, self.turns, strict=True):
                if a.v > own.level:
                    if own.armed > 0.0:
                        own.count = own.count + 1.0
                        own.latest = k - (a.v - own.level) / (a.v - own.v_was)
                        own.first = own.latest if own.first < 0.0 else own.first
                    own.armed = 0.0
                elif a.v < -own.level:
                    own.armed = 1.0
                own.v_was = a.v
        elif k >= start + 2 * window:
            for a, own in zip(run.m.axes, self.turns, strict=True):
                own.level = 0.25 * abs(a.v) if 0.25 * abs(a.v) > own.level else own.level


def place_of_law(e: End, a: Axis) -> Any:
    """The place of one axis as the law is told it and in its units, m."""
    if e.stage.operator:
        return a.x - e.stage.operator.axes[a.i].offset
    return a.x / e.stage.scaling.axes[a.i].scale_x if e.stage.scaling else a.x


def force_of_law(e: End, a: Axis) -> Any:
    """The external force of one axis in the units of the law, N."""
    return a.f_ext / e.stage.scaling.axes[a.i].scale_f if e.stage.scaling else a.f_ext
