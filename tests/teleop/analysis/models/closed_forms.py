"""Closed forms that the general conditions are compared with: walls on a filtered velocity, and spring-dampers."""

from __future__ import annotations

from math import exp, pi

import numpy as np
from numpy.typing import NDArray

from teleop.analysis.models.peak import highest
from teleop.analysis.models.sampled import Impedance, Needed, frequency


def filtered_wall(K: float, B: float, T: float, cutoff: float) -> Impedance:
    """A spring K (N/m) with a damper B (N s/m) whose velocity passes a sampled first-order low-pass of `cutoff` (Hz).

    v_f(k) = a v_f(k-1) + (1 - a) v(k),  a = exp(-2 pi cutoff T).
    """
    a = exp(-2.0 * pi * cutoff * T)
    return lambda z: K * T / (1.0 - 1.0 / z) + B * (1.0 - a) / (1.0 - a / z)


def wall_damping(K: float, B: float, T: float, d: int = 0) -> Needed:
    """The damping that a spring-damper with d ticks of delay asks for, to 1e-12 of it:

        b = max over th of  (K T/2) sin((2d+1) th/2)/sin(th/2) - B cos((d+1) th).

    d = 0 gives K T/2 + |B| (Colgate and Schenkel 1997); B = 0 gives K (T/2 + d T) (N. Diolaiti, G. Niemeyer, F.
    Barbagli and J. K. Salisbury, "Stability of haptic rendering", IEEE Trans. Robotics 22(2), 2006). A trigonometric
    polynomial, so the search is certain to find its maximum.
    """
    def curve(th: NDArray[np.float64]) -> NDArray[np.float64]:
        half = 0.5 * th
        found: NDArray[np.float64] = (
            0.5 * K * T * np.sin((2 * d + 1) * half) / np.sin(half) - B * np.cos((d + 1) * th))
        return found

    found = highest(curve, d + 1)
    still = K * T * (d + 0.5) - B  # the limit at th = 0
    return Needed(still, 0.0) if still >= found.value else Needed(found.value, frequency(found, T))


def alpha_max_spring_damper(delta: float, K: float, B: float, T: float) -> float | None:
    """`alpha_max` of a spring-damper without delay: gamma - B^2/(delta + B - K T/2); None if delta < gamma."""
    half = 0.5 * K * T
    gamma = half + B
    if delta < gamma:
        return None
    room = delta + B - half
    return gamma - B * B / room if room > 0.0 else gamma
