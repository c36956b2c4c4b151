"""The axes of figures: where a value lies on one, and the ticks, at round numbers."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor, isfinite, log10
from typing import NamedTuple

from teleop.sweeps.pictures.layout import PlottedKnob, spaced
from teleop.terminal.table import PREFIX

GREATEST = 1e30  # a value beyond is drawn as one that does not exist: nothing that is measured is as large


class PlotAxis(NamedTuple):
    """From `low` to `high`; `bend` > 0: linear up to there on either side of zero, by decades beyond it."""

    low: float
    high: float
    log: bool = False
    bend: float = 0.0

    def at(self, value: float) -> float:
        """The place of a value: 0 at `low`, 1 at `high`."""
        low, high = self._bent(self.low), self._bent(self.high)
        return (self._bent(value) - low) / (high - low)

    def _bent(self, value: float) -> float:
        if self.log:
            return log10(max(value, 1e-300))
        if self.bend > 0.0 and abs(value) > self.bend:
            return (0.5 + log10(abs(value) / self.bend)) * (1.0 if value > 0.0 else -1.0)
        return 0.5 * value / self.bend if self.bend > 0.0 else value

    def ticks(self, most: int = 5) -> list[tuple[float, str]]:
        """At most `most` ticks, or one more: their values and labels."""
        if self.log or self.bend > 0.0:
            return self._decades(most)
        step = step_of(self.high - self.low, most)
        first, last = ceil(self.low / step - 1e-9), floor(self.high / step + 1e-9)
        digits = max(0, -floor(log10(step) + 1e-9))
        return [(i * step, number(i * step, digits)) for i in range(first, last + 1)]

    def _decades(self, most: int) -> list[tuple[float, str]]:
        least = self.low if self.log else self.bend
        first, last = ceil(log10(least) - 1e-9), floor(log10(max(abs(self.high), abs(self.low), least)) + 1e-9)
        every = max(1, ceil((last - first + 1) / most))
        steps = [10.0**power for power in range(first, last + 1, every)]
        if len(steps) < 2 and self.log:  # within a decade or two: 2 and 5 too
            steps = [mark * 10.0**power for power in range(first - 1, last + 1) for mark in (1.0, 2.0, 5.0)]
        if not self.log:
            steps = [*(-each for each in reversed(steps)), 0.0, *steps]
        slack = 1e-9 * (self.high - self.low)
        return [(each, short(each)) for each in steps if self.low - slack <= each <= self.high + slack]


def step_of(span: float, most: int) -> float:
    """The least step of 1, 2 or 5 times a power of ten that gives at most `most` steps over `span`.

    >>> step_of(10.0, 5), step_of(0.07, 4)
    (2.0, 0.02)
    """
    rough = span / most
    power = 10.0 ** floor(log10(rough))
    return next(float(f"{mark * power:.3g}") for mark in (1.0, 2.0, 5.0, 10.0) if mark * power >= rough * (1.0 - 1e-9))


def number(value: float, digits: int) -> str:
    """A number with so many digits behind the point, large and tiny ones by a power of ten."""
    if value == 0.0:
        return "0"
    return f"{value:.{digits}f}" if digits <= 6 and abs(value) < 1e6 else f"{value:.3g}"


def short(value: float) -> str:
    """A tick on an axis of decades."""
    return f"{value:g}" if value == 0.0 or 1e-3 <= abs(value) < 1e5 else f"{value:.0e}".replace("e-0", "e-").replace(
        "e+0", "e")


def around(low: float, high: float) -> PlotAxis:
    """A linear axis that shows all from `low` to `high` with a little room; where that is one value, around it."""
    if not (isfinite(low) and isfinite(high)) or low > high:
        return PlotAxis(0.0, 1.0)
    span = high - low
    if span <= 1e-9 * max(abs(low), abs(high)):
        span = 2.0 * max(abs(low), 1e-12 if low == 0.0 else 0.0) or 1.0
        return PlotAxis(low - 0.5 * span, high + 0.5 * span) if low else PlotAxis(-1.0, 1.0)
    return PlotAxis(low - 0.05 * span, high + 0.05 * span)


def along(values: Sequence[float], log: str = "linear", bend: float = 0.0) -> PlotAxis:
    """The axis for values in order, from the first to the last: linear, log, or symlog with its `bend`."""
    low, high = values[0], values[-1]
    if not high > low:
        return around(low, high)
    return PlotAxis(low, high, log == "log", bend if log == "symlog" else 0.0)


def thousands(peak: float) -> int:
    """The power of a thousand whose SI prefix suits a greatest magnitude.

    >>> thousands(0.03), thousands(20.0), thousands(4e3)
    (-1, 0, 1)
    """
    if not (isfinite(peak) and peak > 0.0):
        return 0
    return max(min(PREFIX), min(floor(log10(peak) / 3.0), max(PREFIX)))


def axis_of(knob: PlottedKnob) -> PlotAxis:
    """The axis of a knob with numbers, spaced as its values are."""
    return along(knob.values, *spaced(knob.values))


def plain_number(title: str) -> str:
    """A title without what matplotlib would need before a dollar sign."""
    return title.replace(r"\$", "$").replace("\n", ", ")
