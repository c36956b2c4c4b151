"""The computation's delay: the force acts some ticks after the reading that it was computed from.

A tick that is left out computes none, so the one before stands for it.
"""

from __future__ import annotations

from typing import Any, ClassVar

from teleop.stages.end import End, Places, Record, Run, Stage


class Delayed(Record):
    """The forces of one axis that do not act yet."""

    delay_line: tuple[float, ...]


class ComputeDelayStage(Stage):
    """The delay line of `Device(delay=...)`, in ticks; zero force until it is filled."""

    name: ClassVar[str] = "compute_delay"
    axis_kind: ClassVar[type[Record]] = Delayed

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return (0.0,) * scene.per_axis(f"device_{e}")[0].delay

    def memory(self, e: End) -> tuple[tuple[Record, str], ...]:
        return tuple([(line, "delay_line") for line in self.axes])

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        for line in self.axes:
            line.delay_line = numbers

    def late(self, run: Run, e: End, ticks: int, since: int) -> None:
        for line in self.axes:
            for _ in range(ticks - 1):
                line.delay_line = line.delay_line[1:] + (line.delay_line[-1],)  # noqa: RUF005 - as below

    def act(self, run: Run, e: End, k: int) -> None:
        for a, line in zip(e.axes, self.axes, strict=True):
            line.delay_line = line.delay_line + (a.f_cmd,)  # noqa: RUF005 - compiled code knows no star
            a.f_cmd = line.delay_line[0]
            line.delay_line = line.delay_line[1:]
