"""Levant's robust exact differentiator, first order, with implicit Euler steps.

Source: A. Levant, "Robust exact differentiation via sliding mode technique", Automatica 34(3), 1998;
with sigma = z0 - x,

    dz0/dt = z1 - lambda0 sqrt(L) |sigma|^(1/2) sign(sigma)        dz1/dt = -lambda1 L sign(sigma),

L a bound of |d2x/dt2| and (lambda0, lambda1) = (1.5, 1.1) as usual. z1 is the velocity.

Discretisation. Explicit Euler steps over the sign chatter by O(L T) for ever. With both right sides
taken at the *end* of the step (V. Acary and B. Brogliato, "Implicit Euler numerical scheme and chattering-free
implementation of sliding mode systems", Systems & Control Letters 59(5), 2010) the sign at zero is the set [-1, 1],
of which one number fits. With sigma' = z0' - x' after the step, the prediction's error q = z0 + T z1 - x',
a = lambda0 sqrt(L) T and c = lambda1 L T^2,

    sigma' + a |sigma'|^(1/2) s + c s = q,    s in sign(sigma'),

whose left side grows from -inf to inf with one vertical piece, so there is exactly one solution:

    |q| <= c:  s = q/c,      sigma' = 0,                                                z1' = z1 - q/T = (x' - z0)/T
    else:      s = sign(q),  |sigma'|^(1/2) = 2 r/(a + sqrt(a^2 + 4 r)),  r = |q| - c,  z1' = z1 - s lambda1 L T.

So it is a backward difference while the acceleration seen is below lambda1 L, and limits the rate where it is not.

Error. In sliding q = -(x(k+1) - 2 x(k) + x(k-1)), at most L T^2 < c for |d2x/dt2| <= L: sliding, once there, lasts, and
|z1 - dx/dt| <= L T/2. From rest it is there 1.25 v/L after a motion of steady velocity v begins (measured), and under
the worst constant acceleration, L away from z1, after 10 v/L = v/((lambda1 - 1) L). Readings off by at most eps: while
eps <= 0.025 L T^2 sliding lasts, since the second difference stays below c, and the error is at most L T/2 + 2 eps/T;
above L T^2 it is O(sqrt(L eps)), the best rate there is (Levant 1998): measured below 2.6 sqrt(L eps) for random,
two-valued and quantised noise. So L should not be far above the accelerations that come.
Scaling: x and L by alpha make v by alpha; time by beta and x by beta^2 make v by beta.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Annotated

from teleop.errors import number
from teleop.knob import Knob

LAMBDA0, LAMBDA1 = 1.5, 1.1  # A. Levant, "Higher-order sliding modes, differentiation ...", Int. J. Control 76, 2003
TINY = 1e-300  # s: what a span of zero is divided by


@dataclass(frozen=True, kw_only=True, slots=True)
class Levant:
    """Sliding-mode differentiator, exact for an acceleration below L and robust to noise."""

    L: Annotated[float, Knob("m/s^2", "bound of the acceleration", above=0.0)]

    def __post_init__(self) -> None:
        object.__setattr__(self, "L", number("L", self.L, above=0.0))

    def coefficients(self, dt: float) -> tuple[float, float]:
        """lambda0 sqrt(L) and lambda1 L; a and c follow from the span of each reading."""
        return LAMBDA0 * sqrt(self.L), LAMBDA1 * self.L

    def start(self, x: float) -> tuple[float, float]:
        """At rest at `x` (m)."""
        return x, 0.0

    @staticmethod
    def step(
        c: tuple[float, float], s: tuple[float, float], x: float, span: float
    ) -> tuple[float, tuple[float, float]]:
        """Velocity (m/s) at the reading `x` (m), `span` seconds after the one before, and the next state."""
        root_gain, gain = c
        z0, z1 = s
        span = max(span, TINY)
        off = z0 + span * z1 - x
        reach = gain * span * span
        if abs(off) <= reach:
            v = (x - z0) / span
            return v, (x, v)
        sign = off / abs(off)  # NaN where the reading is not finite
        a, over = root_gain * span, abs(off) - reach
        root = 2.0 * over / (a + sqrt(a * a + 4.0 * over))
        v = z1 - gain * span * sign
        return v, (x + sign * root * root, v)
