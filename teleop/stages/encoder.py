"""The encoder: positions in whole steps. Recorded as `q`, beside the true `x`."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, isfinite
from typing import Any, ClassVar

from teleop.errors import number
from teleop.stages.end import Column, End, Places, Run, Stage, per_axis

MOST_COUNTED = 2.0**53  # steps that compiled code and Python count alike


@dataclass(frozen=True, kw_only=True, slots=True)
class Encoder:
    """Positions in whole steps: `step floor(x/step + phase)`, step in m; phase 0 floors, 0.5 rounds to the nearest."""

    step: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "step", number("step", self.step, above=0.0))
        object.__setattr__(self, "phase", number("phase", self.phase, low=0.0, high=1.0))

    def coefficients(self) -> tuple[float, float]:
        """Coefficients of `encode`."""
        return self.step, self.phase


def encode(c: tuple[float, float], x: float) -> float:
    """The encoder's reading of x; c is (step, phase). What is not finite, or beyond counting, stays as it is."""
    step, phase = c
    count = x / step + phase
    if abs(count) < MOST_COUNTED:
        return step * floor(count)
    return step * count if isfinite(count) else x  # every float is whole from there on


class EncoderStage(Stage):
    """The law and all other stages are told the reading, the record has both."""

    name: ClassVar[str] = "encoder"
    reading: ClassVar[bool] = True
    c_enc: Any  # (step, phase) for each axis

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        c = tuple([device.encoder.coefficients() for device in scene.per_axis(f"device_{e}")])
        places[:] = [encode(step_phase, x) for step_phase, x in zip(c, places, strict=True)]
        return c

    def columns(self, e: End) -> tuple[Column, ...]:
        return (per_axis(f"q_{e.name}", e.axes, "x_read"),)

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.c_enc = numbers
        for a in e.axes:
            a.x_read = encode(self.c_enc[a.i], a.x)

    def read(self, run: Run, e: End, k: int) -> None:
        for a in e.axes:
            a.x_read = encode(self.c_enc[a.i], a.x)
