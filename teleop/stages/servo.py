"""A position servo's shaft, for the record: the law is told less of it than a run in virtual time knows.

`shaft` is its true position, beside the `x` that the law is told, and `touch` the true torque on it, beside the f_h or
f_env that the servo's own error shows.
"""

from __future__ import annotations

from typing import Any, ClassVar

from teleop.physics.servo import true_hold, true_touch
from teleop.stages.end import Column, End, Record, Run, Stage, per_axis
from teleop.stages.memory import at


class Shaft(Record):
    """The shaft of one axis."""

    shaft: float
    touch: float


class ServoStage(Stage):
    """Columns of `teleop.physics.servo.Servo`; a live end has none, for its device does not know."""

    name: ClassVar[str] = "servo"
    axis_kind: ClassVar[type[Record]] = Shaft
    reading: ClassVar[bool] = True

    def columns(self, e: End) -> tuple[Column, ...]:
        if e.has.live:
            return ()
        return tuple([per_axis(f"{name}_{e.name}", self.axes, name) for name in ("shaft", "touch")])

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.read(run, e, 0)

    def read(self, run: Run, e: End, k: int) -> None:
        if not e.has.live:
            for a, shaft in zip(e.axes, self.axes, strict=True):
                shaft.shaft = a.z[0][0]
                if e.name == "s":
                    shaft.touch = true_touch(a.c, a.z)
                else:
                    shaft.touch = true_hold(a.c, a.z, at(a.r, k), a.slope) if run.has.hand else 0.0
