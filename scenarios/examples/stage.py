"""A stage of your own before the law: a velocity estimator, beside the ones that come with it. Run it as it stands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from master import Grip, Sine
from teleop import BackwardDifference, Device, Encoder, LowPass, MassDamper, Scene, VirtualWall, number, run


@dataclass(frozen=True, kw_only=True, slots=True)
class AlphaBeta:
    """An alpha-beta tracker (Benedict & Bordner 1962): predict by the velocity, mend both by the reading."""

    alpha: float = 0.3  # share of the difference from the prediction that mends the position, 0 to 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "alpha", number("alpha", self.alpha, above=0.0, high=1.0))

    def coefficients(self, dt: float) -> tuple[float, float]:
        """alpha and beta, by the rule of least transient error."""
        return self.alpha, self.alpha * self.alpha / (2.0 - self.alpha)

    def start(self, x: float) -> tuple[float, float]:
        """At rest at `x` (m)."""
        return x, 0.0

    @staticmethod
    def step(
        c: tuple[float, float], s: tuple[float, float], x: float, span: float
    ) -> tuple[float, tuple[float, float]]:
        """Velocity (m/s) at the reading `x` (m), `span` s after the one before, and the next state."""
        alpha, beta = c
        span = max(span, 1e-300)
        predicted = s[0] + s[1] * span
        v = s[1] + beta / span * (x - predicted)
        return v, (predicted + alpha * (x - predicted), v)


def velocity_error(estimator: Any) -> float:
    """The rms error (m/s) of an estimator behind a coarse encoder, on a handle that a hand moves to and fro."""
    trace = run(Scene(
        law=VirtualWall(K=300.0, at=0.0), master=MassDamper(mass=0.1, damping=0.5),
        hand=Grip(mass=0.4, k=400.0, d=5.0, reference=Sine(amplitude=0.03, frequency=1.0)),
        device_m=Device(encoder=Encoder(step=5e-5), velocity=estimator), duration=4.0,
    )).trace
    return float(((trace["v_hat_m"] - trace["v_m"]) ** 2).mean() ** 0.5)


if __name__ == "__main__":
    for each in (BackwardDifference(), LowPass(cutoff=30.0), AlphaBeta()):
        print(f"{type(each).__name__:<18} {1e3 * velocity_error(each):5.1f} mm/s rms")
