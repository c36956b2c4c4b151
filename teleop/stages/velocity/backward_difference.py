"""Backward difference: the mean velocity since the reading before.

    v(k) = (x(k) - x(k-1))/T        V(z)/X(z) = (1 - 1/z)/T

Error. For an acceleration of at most a, |v(k) - dx/dt| <= a T/2, the lag of half a tick; readings whose
errors lie in an interval of width w (one step of an encoder) add at most w/T. Behind an encoder every
value is a multiple of step/T: 0.01 m/s for 10 um at 1 kHz, however slow the motion.
"""

from __future__ import annotations

from dataclasses import dataclass

TINY = 1e-300  # s: what a span of zero is divided by


@dataclass(frozen=True, kw_only=True, slots=True)
class BackwardDifference:
    """The last difference of position over its time."""

    def coefficients(self, dt: float) -> tuple[()]:
        """Nothing is worked out beforehand."""
        return ()

    def start(self, x: float) -> tuple[float]:
        """At rest at `x` (m)."""
        return (x,)

    @staticmethod
    def step(
        c: tuple[()], s: tuple[float], x: float, span: float
    ) -> tuple[float, tuple[float]]:
        """Velocity (m/s) at the reading `x` (m), `span` seconds after the one before, and the next state."""
        return (x - s[0]) / max(span, TINY), (x,)
