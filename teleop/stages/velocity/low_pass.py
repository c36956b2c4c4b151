"""Backward difference through a first-order low-pass.

Between two readings the difference d = (x(k) - x(k-1))/T is held, so dv/dt = omega (d - v) with
omega = 2 pi cutoff has the exact solution

    v(k) = v(k-1) + r (d(k) - v(k-1)),    r = 1 - exp(-omega T),

    V(z)/X(z) = r (1 - 1/z) / (T (1 - (1 - r)/z)).

A longer span has the rate of that span, so two steps under one d are one of twice the span.

Error. Of a velocity error at the start exp(-omega t) is left. For an acceleration of at most a the lag is at most
a (T/2 + T (1 - r)/r), about a/omega for a cutoff well below 1/T. Readings whose errors lie in an interval of width w
add at most w r/T, about w omega: the newest reading weighs r/T, all before it together -r/T.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import expm1, pi
from typing import Annotated

from teleop.errors import number
from teleop.knob import Knob

TINY = 1e-300  # s: what a span of zero is divided by


@dataclass(frozen=True, kw_only=True, slots=True)
class LowPass:
    """First-order low-pass of the backward difference."""

    cutoff: Annotated[float, Knob("Hz", "frequency at which the gain is 1/sqrt(2)", above=0.0)] = 30.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "cutoff", number("cutoff", self.cutoff, above=0.0))

    def coefficients(self, dt: float) -> tuple[float]:
        """The cutoff in rad/s: the rate follows from the span of each reading."""
        return (2.0 * pi * self.cutoff,)

    def start(self, x: float) -> tuple[float, float]:
        """At rest at `x` (m)."""
        return x, 0.0

    @staticmethod
    def step(
        c: tuple[float], s: tuple[float, float], x: float, span: float
    ) -> tuple[float, tuple[float, float]]:
        """Velocity (m/s) at the reading `x` (m), `span` seconds after the one before, and the next state."""
        before, v = s
        span = max(span, TINY)
        v -= expm1(-c[0] * span) * ((x - before) / span - v)
        return v, (x, v)
