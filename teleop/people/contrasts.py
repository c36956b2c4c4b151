"""Contrasts of conditions: one number for each person and condition, compared by person, condition and place.

Each person's difference between two conditions is explained by the contrast and by the places at which the person met
them,

    d_i = contrast + place(first) - place(second) + rest,

by least squares over the people; the person itself is gone from a difference. So learning over places, which a
balanced order shares out evenly, is no part of the rest: a paired t on the same numbers has it in its variance and is
conservative, and trials put together as if each were a person give far too many false alarms. With two conditions this
is the model of person, condition and place; with more it asks for no equal variances of all differences.

Effect sizes (D. Lakens, "Calculating and reporting effect sizes", Front. Psychol. 4:863, 2013): d_z is the contrast
over the standard deviation of the rest, g_z the same times J(df) = gamma(df/2)/(sqrt(df/2) gamma((df-1)/2)), its
interval that of the noncentral t. Between people: the difference of the means over the pooled standard deviation.
Correction: S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J. Statist. 6, 1979.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, inf, isfinite, lgamma, nan, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.people.fit import special

Floats = NDArray[np.float64]


class Value(NamedTuple):
    """A measure of a person in a condition, which they met at a place."""

    person: int
    condition: str
    place: int
    value: float


@dataclass(frozen=True, slots=True)
class Contrast:
    """First condition less the second."""

    first: str
    second: str
    people: int  # with both conditions, or in the two together
    estimate: float
    low: float
    high: float
    t: float
    df: float
    p: float
    effect: float  # d_z, or d_s between people
    corrected: float  # g_z, or g_s
    p_corrected: float = nan

    def effect_interval(self, alpha: float = 0.05) -> tuple[float, float]:
        """The interval of the corrected effect size."""
        low, high = noncentrality(self.t, self.df, alpha)
        return low * self.corrected / self.t, high * self.corrected / self.t


def within(values: Sequence[Value], first: str, second: str, alpha: float = 0.05) -> Contrast | None:
    """The contrast of two conditions that the same people met; None where there are too few of them."""
    by_person: dict[int, dict[str, Value]] = {}
    for each in values:
        by_person.setdefault(each.person, {})[each.condition] = each
    pairs = [(of[first], of[second]) for of in by_person.values() if first in of and second in of]
    if len(pairs) < 3:
        return None
    places = sorted({each.place for pair in pairs for each in pair})
    difference = np.array([a.value - b.value for a, b in pairs])
    columns = [np.ones(len(pairs)), *(np.array([float(a.place == place) - float(b.place == place) for a, b in pairs])
                                      for place in places[1:])]
    return _tested(first, second, len(pairs), np.stack(columns, 1), difference, alpha)


def between(values: Sequence[Value], first: str, second: str, alpha: float = 0.05) -> Contrast | None:
    """The contrast of two conditions that different people met; None where there are too few of them."""
    of_pair = [each for each in values if each.condition in (first, second)]
    is_first = np.array([float(each.condition == first) for each in of_pair])
    n, m = is_first.sum(), len(of_pair) - is_first.sum()
    if min(n, m) < 2:
        return None
    design = np.stack([is_first, np.ones(len(of_pair))], 1)
    return _tested(first, second, len(of_pair), design, np.array([each.value for each in of_pair]), alpha)


def _tested(first: str, second: str, people: int, design: Floats, y: Floats, alpha: float) -> Contrast | None:
    """Test the first coefficient of least squares; None where the others explain it as well, as a fixed order does."""
    functions = special()
    solution, _, rank, _ = np.linalg.lstsq(design, y, rcond=None)
    df = len(y) - int(rank)
    if df < 1 or np.linalg.matrix_rank(design[:, 1:]) == rank:
        return None
    rest = y - design @ solution
    sigma = sqrt(float(rest @ rest) / df)
    scale = sqrt(float(np.linalg.pinv(design.T @ design)[0, 0]))  # of d = contrast/sigma: t = d/scale
    error = sigma * scale
    estimate = float(solution[0])
    if not error > 0.0 or estimate == 0.0:
        return None
    t = estimate / error
    half = float(functions.stdtrit(df, 1.0 - 0.5 * alpha)) * error
    return Contrast(first, second, people, estimate, estimate - half, estimate + half, t, df,
                    float(2.0 * functions.stdtr(df, -abs(t))), t * scale, t * scale * small_sample(df))


def small_sample(df: float) -> float:
    """Hedges' factor J.

    >>> round(small_sample(9), 5)
    0.91387
    """
    return exp(lgamma(0.5 * df) - lgamma(0.5 * (df - 1.0))) / sqrt(0.5 * df) if df > 1 else nan


def noncentrality(t: float, df: float, alpha: float) -> tuple[float, float]:
    """The noncentralities under which t is the upper, and the lower, alpha/2 quantile."""
    nctdtr = special().nctdtr

    def end(share: float) -> float:
        low, high = t - 40.0, t + 40.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            got = float(nctdtr(df, middle, t))
            is_low = got > share if isfinite(got) else middle < t  # far out scipy has no number
            low, high = (middle, high) if is_low else (low, middle)
        return 0.5 * (low + high)

    return end(1.0 - 0.5 * alpha), end(0.5 * alpha)


def holm(p: Sequence[float]) -> list[float]:
    """The p values of one family, corrected.

    >>> [round(each, 3) for each in holm([0.01, 0.04, 0.03])]
    [0.03, 0.06, 0.06]
    """
    corrected, least = [0.0] * len(p), 0.0
    for rank, i in enumerate(sorted(range(len(p)), key=lambda i: p[i])):
        least = max(least, min(1.0, (len(p) - rank) * p[i]))
        corrected[i] = least
    return corrected


def paired_power(d_z: float, n: int, alpha: float = 0.05) -> float:
    """The power of a two-sided paired t test of n people.

    >>> round(paired_power(0.5, 34), 6)
    0.807778
    """
    return _power(n - 1, d_z * sqrt(n), alpha)


def unpaired_power(d: float, n: int, alpha: float = 0.05) -> float:
    """The power of a two-sided t test between two groups of n people each."""
    return _power(2 * n - 2, d * sqrt(0.5 * n), alpha)


def _power(df: float, noncentral: float, alpha: float) -> float:
    """The share of noncentral t beyond the two-sided quantile of t."""
    functions = special()
    t = float(functions.stdtrit(df, 1.0 - 0.5 * alpha))
    return float(1.0 - functions.nctdtr(df, noncentral, t) + functions.nctdtr(df, noncentral, -t))


def people_needed(power: Callable[[float, int, float], float], d: float, wanted: float, alpha: float = 0.05,
                  most: int = 100_000) -> int:
    """The least n with this power of `paired_power` or `unpaired_power`; `most` if none has it.

    >>> people_needed(paired_power, 0.8, 0.8)
    15
    """
    low, high = 2, 4
    while power(d, high, alpha) < wanted and high < most:
        low, high = high, 2 * high
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if power(d, middle, alpha) >= wanted else (middle + 1, high)
    return low


def mean_interval(values: Sequence[float], alpha: float) -> tuple[float, float, float]:
    """Mean over people and its interval, which has no bounds for one of them."""
    y = np.array(values)
    mean = float(y.mean())
    if len(y) < 2:
        return mean, -inf, inf
    half = float(special().stdtrit(len(y) - 1, 1.0 - 0.5 * alpha)) * float(y.std(ddof=1)) / sqrt(len(y))
    return mean, mean - half, mean + half
