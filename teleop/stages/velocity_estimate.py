"""The velocity estimator: velocity from the readings of the position. Recorded as `v_hat`, beside the true `v`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from teleop.stages.end import Column, End, Places, Run, Stage, elapsed, per_axis
from teleop.stages.record import Record


class Estimate(Record):
    """The estimator in one axis."""

    est: Any  # its state


class VelocityStage(Stage):
    """A velocity estimator of `teleop.stages.velocity`, or one of the user's own, in each axis."""

    name: ClassVar[str] = "velocity"
    reading: ClassVar[bool] = True
    estimate: Callable[..., Any]
    c_est: Any

    def __init__(self, e: str, axes: int) -> None:
        super().__init__(e, axes)
        self.axes = tuple([Estimate(f"{e}{i}") for i in range(axes)])

    @staticmethod
    def given(scene: Any, e: str, dt: float, places: Places) -> Any:
        own = [device.velocity for device in scene.per_axis(f"device_{e}")]
        return (tuple([each.coefficients(dt) for each in own]),
                tuple([each.start(x) for each, x in zip(own, places, strict=True)]))

    def columns(self, e: End) -> tuple[Column, ...]:
        return (per_axis(f"v_hat_{e.name}", e.axes, "v_read"),)

    def memory(self, e: End) -> tuple[tuple[Record, str], ...]:
        return tuple([(own, "est") for own in self.axes])

    def begin(self, run: Run, e: End, given: Any) -> None:
        self.c_est = given[0]
        for a, own in zip(e.axes, self.axes, strict=True):
            own.est = given[1][a.i]
            a.v_read = 0.0

    def read(self, run: Run, e: End, k: int) -> None:
        for a, own in zip(e.axes, self.axes, strict=True):
            a.v_read, own.est = self.estimate(self.c_est[a.i], own.est, a.x_read, elapsed(run, e))
