"""The figures that a kernel works out as it goes, and the functions that they are worked out with."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

from teleop.simulation.felt import SUMS, TINY, names, ranks
from teleop.simulation.rest import LATE

ALONG = {  # metric that is itself kept along the run -> what else is with it
    "x_err_rms": "x_err", "x_err_max": "x_err", "f_err_rms": "f_err", "f_err_max": "f_err", "f_m_max": "f_m_max",
    "f_s_max": "f_s_max", "f_h_max": "f_h_max", "f_env_max": "f_env_max", "E_link_min": "waves", "E_link_end": "waves",
    "E_port_min": "energy", "E_port_end": "energy", "E_law_min": "stored", "E_law_end": "stored",
    "sent_fwd": "told", "sent_bwd": "told", "g_m_min": "watchdog", "g_s_min": "watchdog",
}
KEPT = {**{name: (what,) for name, what in ALONG.items()}, **SUMS, "energy_out": ("energy",)}  # what is kept for each
SWINGS = tuple([f"swing_{i}" for i in range(LATE)])  # of the late windows, see `teleop.simulation.rest`


def kept(name: str) -> tuple[str, ...]:
    """What is kept along the run for a figure."""
    return ("rest",) if name in SWINGS else KEPT[name]


class Layout(NamedTuple):
    """What a kernel keeps along its run: figures by themselves, groups of sums, and the largest steps of the force."""

    along: tuple[str, ...]
    groups: tuple[str, ...]
    ranks: int

    def names(self, axes: int) -> tuple[str, ...]:
        """All that it gives, in order."""
        return (*self.along, *[name for group in self.groups for name in names(group, axes, self.ranks)])


def layout(measures: Sequence[str], ticks: int) -> Layout:
    """What is kept for these figures of a run of so many ticks."""
    along = [name for name in measures if name in ALONG or name in SWINGS]
    if "energy_out" in measures and "E_port_min" not in along:
        along.append("E_port_min")
    groups = dict.fromkeys([group for name in measures if name in SUMS for group in SUMS[name]])
    return Layout(tuple(along), tuple(groups), ranks(ticks) if "ranks" in groups else 0)


def most(top: float, size: float) -> float:
    """The greater of both; NaN stays."""
    return size if size > top or size != size else top  # noqa: PLR0124 - only NaN differs from itself


def least(low: float, size: float) -> float:
    """The smaller of both; NaN stays."""
    return size if size < low or size != size else low  # noqa: PLR0124


def root_mean(total: float, count: int) -> float:
    """Root of a mean square; NaN of nothing."""
    return sqrt(total / count) if count > 0 else float("nan")


def known(value: float, count: int) -> float:
    """A figure of so many values; NaN of none."""
    return value if count > 0 else float("nan")


def magnitude1(a: float) -> float:
    """Magnitude in one axis."""
    return abs(a)


def magnitude2(a: float, b: float) -> float:
    """Magnitude in two axes, without squares that overflow where it does not."""
    top = max(abs(a), abs(b), TINY)
    a, b = a / top, b / top
    return top * sqrt(a * a + b * b)


def magnitude3(a: float, b: float, c: float) -> float:
    """Magnitude in three axes, as of two."""
    top = max(abs(a), abs(b), abs(c), TINY)
    a, b, c = a / top, b / top, c / top
    return top * sqrt(a * a + b * b + c * c)


def magnitude_of(*axes: float) -> float:
    """Magnitude in any number of axes, as of two."""
    top = TINY
    for a in axes:
        top = max(top, abs(a))
    total = 0.0
    for a in axes:
        total = total + a / top * (a / top)
    return top * sqrt(total)


MAGNITUDES = {1: magnitude1, 2: magnitude2, 3: magnitude3}  # written out: of few axes that is quicker
