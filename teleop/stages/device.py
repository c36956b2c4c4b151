"""Device between the body and its law: encoder, velocity estimator, late and slow force.

These set a device's Z-width. At a tick, in this order: the encoder's reading of the position, the velocity made of it,
the observer and the law, the computation's delay, the renewal of the force; then the passivity controller, watchdog and
cap, if the scene has them. The law sees the readings; the trace records both, `q` beside `x` and `v_hat` beside `v`.
The plant moves in continuous time, so the tick is the sampling interval and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from teleop.errors import Refused, whole_number
from teleop.stages.encoder import Encoder

MOST_DELAY = 100_000  # ticks: the line is kept as a tuple


class VelocityEstimator(Protocol):
    """Velocity from positions, one reading a tick (`teleop.stages.velocity`). The state is a flat tuple of floats."""

    def coefficients(self, dt: float) -> tuple[Any, ...]: ...
    def start(self, x: float) -> tuple[float, ...]: ...

    @staticmethod
    def step(c: Any, s: Any, x: float, span: float) -> tuple[float, tuple[float, ...]]:
        """Velocity (m/s) and next state from a reading x (m), `span` s after the one before."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class Device:
    """An end's device. None, `every` = 1 and `delay` = 0 leave a part out.

    Without an encoder positions are read as they are, without an estimator velocities too. `every` n: the force is
    renewed at every n-th tick and held in between. `delay` d: it acts d ticks after the reading it was computed from.
    The actuator's saturation is the scene's `cap`.
    """

    encoder: Encoder | None = None
    velocity: VelocityEstimator | None = None
    every: int = 1
    delay: int = 0

    def __post_init__(self) -> None:
        if self.encoder is not None and not isinstance(self.encoder, Encoder):
            raise Refused(f"encoder must be an Encoder, not {self.encoder!r}; write for example "
                          "encoder=Encoder(step=1e-5)")
        if self.velocity is not None and (isinstance(self.velocity, type) or not all(
                hasattr(self.velocity, each) for each in ("coefficients", "start", "step"))):
            raise Refused("velocity must be something with coefficients, start, step, not "
                          f"{self.velocity!r}; write for example velocity=BackwardDifference()")
        object.__setattr__(self, "every", whole_number("every", self.every, low=1))
        object.__setattr__(self, "delay", whole_number("delay", self.delay, low=0, high=MOST_DELAY))
