"""The figures that a kernel works out as it goes, and the functions that they are worked out with."""

from __future__ import annotations

from math import isfinite, sqrt

from teleop.simulation.metrics import TINY
from teleop.simulation.rest import LATE

KEPT = {  # metric -> what is kept for it along the run
    "x_err_rms": "x_err", "x_err_max": "x_err", "f_err_rms": "f_err", "f_err_max": "f_err", "f_m_max": "f_m_max",
    "f_s_max": "f_s_max", "f_h_max": "f_h_max", "f_env_max": "f_env_max", "E_link_min": "waves", "E_link_end": "waves",
    "E_port_min": "energy", "E_port_end": "energy", "E_law_min": "stored", "E_law_end": "stored",
    "g_m_min": "watchdog", "g_s_min": "watchdog",
}
SWINGS = tuple([f"swing_{i}" for i in range(LATE)])  # of the late windows, see `teleop.simulation.rest`


def kept(name: str) -> str:
    """What is kept along the run for a figure."""
    return "rest" if name in SWINGS else KEPT[name]


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


MAGNITUDES = {1: magnitude1, 2: magnitude2, 3: magnitude3}


def sound(numbers: tuple[float, ...]) -> float:
    """1.0 if all are finite, else 0.0."""
    for number in numbers:
        if not isfinite(number):
            return 0.0
    return 1.0
