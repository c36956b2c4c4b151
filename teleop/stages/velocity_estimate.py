"""The velocity estimator: velocity from the readings of the position. Recorded as `v_hat`, beside the true `v`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from teleop.stages.end import Column, End, Places, Record, Run, Stage, elapsed, per_axis


class Estimate(Record):
    """The estimator in one axis."""

    est: Any  # its state


class VelocityStage(Stage):
    """A velocity estimator of `teleop.stages.velocity`, or one of the user's estimator, in each axis."""

    name: ClassVar[str] = "velocity"
    axis_kind: ClassVar[type[Record]] = Estimate
    reading: ClassVar[bool] = True
    estimate: Callable[..., Any]
    c_est: Any

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        estimator = [device.velocity for device in scene.per_axis(f"device_{e}")]
        return (tuple([each.coefficients(dt) for each in estimator]),
                tuple([each.start(x) for each, x in zip(estimator, places, strict=True)]))

    def columns(self, e: End) -> tuple[Column, ...]:
        return (per_axis(f"v_hat_{e.name}", e.axes, "v_read"),)

    def memory(self, e: End) -> tuple[tuple[Record, str], ...]:
        return tuple([(estimator, "est") for estimator in self.axes])

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.c_est = numbers[0]
        for a, estimator in zip(e.axes, self.axes, strict=True):
            estimator.est = numbers[1][a.i]
            a.v_read = 0.0

    def read(self, run: Run, e: End, k: int) -> None:
        for a, estimator in zip(e.axes, self.axes, strict=True):
            a.v_read, estimator.est = self.estimate(self.c_est[a.i], estimator.est, a.x_read, elapsed(run, e))
