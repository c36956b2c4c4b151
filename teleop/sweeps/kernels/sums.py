"""Sums that a kernel keeps along its run, for the figures of `teleop.simulation.felt`, which says what they mean."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import Any

from teleop.simulation.felt import AT_END, names
from teleop.stages.end import Axis, End, Record, Run
from teleop.stages.scaling import of_master


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
        """Records and fields of a group's sums, as in `teleop.simulation.felt.names`; `places`: the master first."""
        if group == "turns":
            return tuple([cell for place, acc in zip(places, self.turns, strict=False) for cell in (
                (place, "rise"), (place, "fall"), (acc, "count"), (acc, "first"), (acc, "latest"))])
        if group in AT_END:
            return tuple([(acc, f"end_{group}") for acc in self.axes])
        if group == "ranks":
            return tuple([(acc, "size") for acc in self.ranks])
        per_axis = {f"free_{one}{i}": (acc, f"free_{one}")
                    for i, acc in enumerate(self.axes) for one in ("a", "v", "f")}
        return tuple([per_axis.get(name, (self, name)) for name in names(group, len(self.axes), 0)])

    def begin(self, run: Run, request: Any) -> None:
        """Before the first tick."""
        if "free" in self.groups or "jerk" in self.groups:
            for acc in self.axes:
                acc.v_was = acc.f_was = 0.0
        if "free" in self.groups:
            self.away = 1.0
            self.moved = self.free_n = 0.0
            self.free_aa = self.free_av = self.free_vv = 0.0
            self.free_fa = self.free_fv = self.free_ff = 0.0
            for acc in self.axes:
                acc.free_a = acc.free_v = acc.free_f = 0.0
        if "jerk" in self.groups:
            self.jerk_sq = 0.0
            for rank in self.ranks:
                rank.size = 0.0
        if len(self.at_end) > 0:
            self.late = request[-1]
            for acc in self.axes:
                for field in self.at_end:
                    setattr(acc, field, 0.0)
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
            for m, acc in zip(run.m.axes, self.axes, strict=True):
                acc.a = m.v - acc.v_was if self.free > 0.0 else 0.0
                acc.v = 0.5 * (m.v + acc.v_was) if self.free > 0.0 else 0.0
                acc.f = acc.f_was if self.free > 0.0 else 0.0
                acc.free_a = acc.free_a + acc.a
                acc.free_v = acc.free_v + acc.v
                acc.free_f = acc.free_f + acc.f
            self.free_n = self.free_n + self.free
            self.free_aa = self.free_aa + reduce(add, [acc.a * acc.a for acc in self.axes])
            self.free_av = self.free_av + reduce(add, [acc.a * acc.v for acc in self.axes])
            self.free_vv = self.free_vv + reduce(add, [acc.v * acc.v for acc in self.axes])
            self.free_fa = self.free_fa + reduce(add, [acc.f * acc.a for acc in self.axes])
            self.free_fv = self.free_fv + reduce(add, [acc.f * acc.v for acc in self.axes])
            self.free_ff = self.free_ff + reduce(add, [acc.f * acc.f for acc in self.axes])

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
        for acc in self.ranks:
            self.below = acc.size if self.jump > acc.size else self.jump
            acc.size = self.jump if self.jump > acc.size else acc.size
            self.jump = self.below

    def keep(self, run: Run) -> None:
        """Keep the values that the next tick is compared with."""
        for m, acc in zip(run.m.axes, self.axes, strict=True):
            acc.v_was = m.v
            acc.f_was = m.f

    def end(self, run: Run, k: int) -> None:
        """Forces and places of the last `END`."""
        if k >= self.late:
            for m, acc in zip(run.m.axes, self.axes, strict=True):
                if "f_m" in self.groups:
                    acc.end_f_m = acc.end_f_m + m.f
                if "x_m" in self.groups:
                    acc.end_x_m = acc.end_x_m + place_of_law(run.m, m)
            if run.has.slave:
                self.end_slave(run)

    def end_slave(self, run: Run) -> None:
        """Forces and positions of the slave at the end."""
        for s, acc in zip(run.s.axes, self.axes, strict=True):
            if "f_env" in self.groups:
                acc.end_f_env = acc.end_f_env + s.f_ext
            if "x_s" in self.groups:
                acc.end_x_s = acc.end_x_s + s.x
            if "touch" in self.groups:
                acc.end_touch = acc.end_touch + (1.0 if abs(s.f_ext) > 0.0 else 0.0)

    def turn(self, run: Run, k: int, start: Any, window: Any) -> None:
        """The velocities of the master in the last three of the late windows, of which the first begins at `start`."""
        if k >= start + 3 * window:
            for a, acc in zip(run.m.axes, self.turns, strict=True):
                if a.v > acc.level:
                    if acc.armed > 0.0:
                        acc.count = acc.count + 1.0
                        acc.latest = k - (a.v - acc.level) / (a.v - acc.v_was)
                        acc.first = acc.latest if acc.first < 0.0 else acc.first
                    acc.armed = 0.0
                elif a.v < -acc.level:
                    acc.armed = 1.0
                acc.v_was = a.v
        elif k >= start + 2 * window:
            for a, acc in zip(run.m.axes, self.turns, strict=True):
                acc.level = 0.25 * abs(a.v) if 0.25 * abs(a.v) > acc.level else acc.level


def place_of_law(e: End, a: Axis) -> Any:
    """The place of one axis as the law is told it and in its units, m."""
    if e.stage.handover and e.stage.handover.moves:
        return place_of_operator(e, a) - e.stage.handover.axes[a.i].away
    return place_of_operator(e, a)


def place_of_operator(e: End, a: Axis) -> Any:
    """The place of one axis without what an open clutch left out, in the law's units, m."""
    if e.stage.operator:
        return a.x - e.stage.operator.axes[a.i].offset
    return of_master(e.stage.scaling, a, "x", "scale_x") if e.stage.scaling else a.x


def force_of_law(e: End, a: Axis) -> Any:
    """The external force of one axis in the units of the law, N."""
    return of_master(e.stage.scaling, a, "f_ext", "scale_f") if e.stage.scaling else a.f_ext
