"""The greatest value of a function of frequency on (0, pi] rad per sample."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Points = NDArray[np.complex128]
FIRST = 3e-5  # rad: near enough to the limit at 0 (an even function is 1e-10 of itself off), far enough for rounding
PER_TURN = 64  # places on each half turn of the delay's phase
ROUNDS = 12


class Peak(NamedTuple):
    """A greatest value and where it is."""

    value: float
    th: float  # rad per sample


def grid(turns: float = 0.0) -> Reals:
    """Places on (0, pi]: equal ratios from near 0, and equal steps, 64 to every half turn of a phase turns * th."""
    first = FIRST / (2.0 * turns + 1.0)
    even = np.linspace(0.0, pi, PER_TURN * (int(turns) + 16) + 1)[1:]
    return np.union1d(np.geomspace(first, pi, 2048), even)


def highest(curve: Callable[[Reals], Any], turns: float = 0.0) -> Peak:
    """The maximum of `curve(th)`, sampled on `grid` and zoomed in on, to about 1e-12 of it.

    Every place that is no lower than its neighbours and within 1 % of the span from the highest is looked at. That
    misses nothing for a curve that is a trigonometric polynomial of degree n <= turns + 15, such as that of a
    spring-damper: by Bernstein's inequality |curve''| <= n^2 max |curve|, so between places pi/(64 n) apart it rises
    by less than 0.03 % of that. For any other curve the condition is that it has no peak narrower than the places.
    A value that is not finite counts as endless. A maximum that the limit at 0 has as well, to 1e-9, is there.
    """
    th = grid(turns)
    values = _values(curve, th)
    best = int(values.argmax())
    if not np.isfinite(values[best]):
        return Peak(float("inf"), float(th[best]))
    left, right = np.r_[-np.inf, values[:-1]], np.r_[values[1:], -np.inf]
    span = float(np.ptp(values[np.isfinite(values)]))
    tops = np.flatnonzero((values >= left) & (values >= right) & (values >= values[best] - 0.01 * span))
    tops = tops[np.argsort(-values[tops])][:64]
    low, high = th[np.maximum(tops - 1, 0)], th[np.minimum(tops + 1, len(th) - 1)]
    peak = Peak(float(values[best]), float(th[best]))
    for _ in range(ROUNDS):  # all of them at once, each interval to an eighth
        inner = np.linspace(low, high, 17)
        shown = _values(curve, inner.ravel()).reshape(inner.shape)
        at = shown.argmax(axis=0)
        column = np.arange(len(at))
        top = int(shown[at, column].argmax())
        if shown[at[top], top] > peak.value:
            peak = Peak(float(shown[at[top], top]), float(inner[at[top], top]))
        low, high = inner[np.maximum(at - 1, 0), column], inner[np.minimum(at + 1, 16), column]
    level = peak.value - values[0] <= 1e-9 * abs(peak.value)
    return Peak(peak.value, float(th[0])) if level else peak


def _values(curve: Callable[[Reals], Any], th: Reals) -> Reals:
    with np.errstate(all="ignore"):
        values = np.asarray(curve(th), dtype=float)
    return np.where(np.isnan(values), np.inf, values)
