"""Ranges of a law's parameters, and the evolution strategy that draws points in them.

The range of each number follows from its knob's bounds and its default. The strategy is CMA-ES, with covariance matrix
adaptation: it is asked for points and is then handed their ranks. Source: N. Hansen, "The CMA evolution strategy: a
tutorial", arXiv:1604.00772 (2016), section 4 and table 1, without its negative weights.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from math import ceil, exp, floor, log, log10, sqrt
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from teleop.errors import Refused, enumerated, nearest
from teleop.knob import Declared, knobs_of_fields
from teleop.law import law_name
from teleop.law.offers import seed_energy, stores
from teleop.sweeps.grid import Range

FACTOR = 30.0  # on either side of the default, where a knob has no bound


class NothingToTune(Refused):
    """A law without a number that a search may change."""


class Ranges(NamedTuple):
    """The ranges of the knobs that are searched, and the other knobs with the reason that they are not."""

    searched: dict[str, Range]  # by name, with "law." before it
    held: dict[str, str]


def ranges_of(law: Any, fixed: Collection[str] = ()) -> Ranges:
    """The ranges of the numbers of `law`, except those in `fixed` ("law.K"), which somebody has set.

    A knob that declares a span (`teleop.knob`) goes through that, by equal ratios if it begins above 0. One that
    declares from what its value follows stays.

    For the other knobs:

    - a value above 0 goes by equal ratios, from 1/30 of it, or the lower bound, to 30 times it, or the upper bound;
    - between a lower bound of 0, or below, and an upper one it goes evenly, if the value is a tenth of that range or
      more, or the lower bound itself;
    - a value of 0 without an upper bound goes evenly from 0 to the greatest value among the law's knobs of its unit,
      and stays if there is none.

    So does any that the law's seed energy, E_law(0), depends on: energy that is given out unpaid is not for
    tuning. Raises `NothingToTune` for a law that has no number to change, and `Refused` for a name in `fixed` that it
    has not.
    """
    knobs = {name: each for name, each in knobs_of_fields(type(law)).items() if each.kind is float}
    values = {name: float(getattr(law, name)) for name in knobs}
    unknown = next((name for name in fixed if name.removeprefix("law.") not in values), None)
    if unknown is not None:
        raise Refused(f"law {law_name(law)} has no knob {unknown.removeprefix('law.')!r}; "
                      f"{nearest(unknown.removeprefix('law.'), values)}")
    searched: dict[str, Range] = {}
    held: dict[str, str] = {}
    for name, each in knobs.items():
        if f"law.{name}" in fixed:
            held[name] = "as set"
            continue
        if each.knob.stays:
            held[name] = f"{values[name]:g}: {each.knob.stays}"
            continue
        if _seeds_energy(law, name):
            held[name] = f"{values[name]:g}: the energy that the law may give out unpaid depends on it"
            continue
        span = _range(each, values[name], [values[peer] for peer, declared in knobs.items()
                                           if peer != name and declared.knob.unit == each.knob.unit != ""])
        if span is None:
            held[name] = f"{values[name]:g}: neither its value nor its bounds say where to look"
        else:
            searched[f"law.{name}"] = span
    if not searched:
        why = f"{enumerated(values)} as set" if fixed and values else "no number of its own"
        raise NothingToTune(f"law {law_name(law)} has nothing to tune ({why}); run it as it is: teleop run SCENE "
                            f"--set law={law_name(law)}")
    return Ranges(searched, held)


def _seeds_energy(law: Any, name: str) -> bool:
    """True if the energy that the law begins with depends on this number: more of it is no better law."""
    value = getattr(law, name)
    try:
        return stores(law) and any(seed_energy(replace(law, **{name: changed})) != seed_energy(law)
                                   for changed in (0.5 * value, value + 1e-3))
    except Refused:  # out of the knob's bounds
        return False


def _range(each: Declared, value: float, alike: list[float]) -> Range | None:
    knob = each.knob
    if knob.span is not None:
        return Range(*knob.span, log=knob.span[0] > 0.0)
    low = knob.low if knob.low is not None else knob.above
    if low is not None and low <= 0.0 and knob.high is not None and not low < value < low + 0.1 * (knob.high - low):
        return Range(low, knob.high) if knob.low is not None else Range(value / FACTOR, knob.high, log=True)
    if value > 0.0:
        bottom = max(value / FACTOR, low if low is not None else 0.0)
        top = knob.high if knob.high is not None else value * FACTOR
        return Range(bottom, top, log=True) if bottom < top else None
    most = max(alike, default=0.0)
    return Range(0.0, most) if value == 0.0 and low == 0.0 and knob.high is None and most > 0.0 else None


def value_at(span: Range, u: float) -> float:
    """The value at the part `u` of a range, 0 to 1, to four digits, as a person types it and a table shows it."""
    value = float(f"{span.at(u):.4g}")
    return min(max(value, min(span.low, span.high)), max(span.low, span.high))


def round_beyond(value: float, bound: float) -> float:
    """Round a bound that a value is moved to, in four digits, on beyond it.

    >>> round_beyond(3.0, 40.239), round_beyond(50.0, 40.239), round_beyond(40.239, 40.239)
    (40.24, 40.23, 40.239)
    """
    if bound in (value, 0.0):
        return bound
    grain = 10.0 ** (floor(log10(abs(bound))) - 3)
    steps = bound / grain
    return float(f"{(ceil(steps) if bound > value else floor(steps)) * grain:.4g}")


def part(span: Range, value: float) -> float:
    """The part of a range at which a value lies, clamped to 0 .. 1."""
    if span.log:
        low = max(value, min(span.low, span.high))
        u = log(low / span.low) / log(span.high / span.low)
    else:
        u = (value - span.low) / (span.high - span.low)
    return min(max(u, 0.0), 1.0)


class Strategy:
    """A strategy from `mean` with the standard deviation `step`, over any coordinates; `key` keys its draws."""

    def __init__(self, mean: Sequence[float], step: float, key: tuple[int, int]) -> None:
        n = len(mean)
        self.mean, self.step, self.n = np.array(mean, dtype=float), step, n
        self.size = max(10, 4 + int(3.0 * log(n)))
        weights = log(0.5 * (self.size + 1)) - np.log(np.arange(1, self.size // 2 + 1))
        self.weights = weights / weights.sum()
        self.mu = float(1.0 / (self.weights @ self.weights))
        self.c_s = (self.mu + 2.0) / (n + self.mu + 5.0)
        self.d_s = 1.0 + 2.0 * max(0.0, sqrt((self.mu - 1.0) / (n + 1.0)) - 1.0) + self.c_s
        self.c_c = (4.0 + self.mu / n) / (n + 4.0 + 2.0 * self.mu / n)
        self.c_1 = 2.0 / ((n + 1.3) ** 2 + self.mu)
        self.c_mu = min(1.0 - self.c_1, 2.0 * (self.mu - 2.0 + 1.0 / self.mu) / ((n + 2.0) ** 2 + self.mu))
        self.norm = sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n))  # of a normal vector, expected
        self.C, self.p_s, self.p_c = np.eye(n), np.zeros(n), np.zeros(n)
        self.axes, self.lengths = np.eye(n), np.ones(n)
        self.generation = 0
        self._dice = np.random.Philox(key=np.array([key[0], key[1] + 1], np.uint64))

    @property
    def spread(self) -> float:
        """The largest standard deviation along any axis, in parts of a range."""
        return float(self.step * self.lengths.max())

    def ask(self) -> list[list[float]]:
        """The points of a generation."""
        raw = (np.asarray(self._dice.random_raw(self.size * self.n), np.uint64) >> np.uint64(11)).astype(float)
        normal = NormalDist().inv_cdf
        z = np.array([normal((each + 0.5) * 2.0**-53) for each in raw]).reshape(self.size, self.n)
        drawn: list[list[float]] = (self.mean + self.step * (z * self.lengths) @ self.axes.T).tolist()
        return drawn

    def tell(self, drawn: Sequence[Sequence[float]], orders: Sequence[tuple[float, ...]]) -> None:
        """Take in the orders of the last generation's points; the least is best."""
        ranked = sorted(range(len(drawn)), key=lambda i: (orders[i], i))[:len(self.weights)]
        y = (np.array([drawn[i] for i in ranked]) - self.mean) / self.step
        mean = self.weights @ y
        self.mean = self.mean + self.step * mean
        self.generation += 1
        white = self.axes @ ((self.axes.T @ mean) / self.lengths)
        self.p_s = (1.0 - self.c_s) * self.p_s + sqrt(self.c_s * (2.0 - self.c_s) * self.mu) * white
        size = float(np.linalg.norm(self.p_s))
        slow = size / sqrt(1.0 - (1.0 - self.c_s) ** (2 * self.generation)) < (1.4 + 2.0 / (self.n + 1.0)) * self.norm
        self.p_c = (1.0 - self.c_c) * self.p_c + slow * sqrt(self.c_c * (2.0 - self.c_c) * self.mu) * mean
        lost = (1.0 - slow) * self.c_c * (2.0 - self.c_c)
        self.C = ((1.0 - self.c_1 - self.c_mu + self.c_1 * lost) * self.C + self.c_1 * np.outer(self.p_c, self.p_c)
                  + self.c_mu * (self.weights * y.T) @ y)
        self.step *= exp(min(1.0, self.c_s / self.d_s * (size / self.norm - 1.0)))
        values, self.axes = np.linalg.eigh(0.5 * (self.C + self.C.T))
        self.lengths = np.sqrt(np.maximum(values, 1e-20))


def fold(point: Sequence[float]) -> list[float]:
    """Parts of ranges, reflected at 0 and 1.

    >>> fold([0.25, -0.25, 1.25, 2.5])
    [0.25, 0.25, 0.75, 0.5]
    """
    return [min(x % 2.0, 2.0 - x % 2.0) for x in point]
