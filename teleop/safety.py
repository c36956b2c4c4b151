"""Watchdog and force cap: tick functions that a scene names, the same in virtual time and live.

They act on the force that the law asks for, in this order: the watchdog's gain, the cap, the slew
limit. What is left is the force that is held, and what the law is told of as `f_held`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from teleop.errors import number


class DogLimits(NamedTuple):
    patience: float  # ticks without a fresh packet that are still fine
    step: float  # change of the gain a tick


@dataclass(frozen=True, kw_only=True)
class Watchdog:
    """No fresh packet for `timeout` seconds: the force ramps to zero over `ramp` seconds.

    When packets come again the force ramps back over the same time. Silence counts from the start of
    the run, so over a link slower than `timeout` the first thing that happens is a ramp.
    """

    timeout: float = 0.1
    ramp: float = 0.05

    def __post_init__(self) -> None:
        number("timeout", self.timeout, above=0.0)
        number("ramp", self.ramp, low=0.0)

    def limits(self, dt: float) -> DogLimits:
        # Half a tick of grace, so that a timeout of n ticks means n whatever n*dt rounds to.
        return DogLimits(self.timeout / dt + 0.5, min(1.0, dt / self.ramp) if self.ramp > 0.0 else 1.0)


def watch(c: DogLimits, gain: float, silent: int) -> float:
    """The watchdog's next gain in [0, 1], after `silent` ticks in a row without a fresh packet."""
    patience, step = c
    if silent > patience:
        return gain - step if gain > step else 0.0
    return gain + step if gain < 1.0 - step else 1.0


class CapLimits(NamedTuple):
    f_max: float  # N
    step: float  # N a tick


@dataclass(frozen=True, kw_only=True)
class Cap:
    """|f| <= f_max (N) and |df/dt| <= slew (N/s), per axis; `slew=None` leaves the second out."""

    f_max: float
    slew: float | None = None

    def __post_init__(self) -> None:
        number("f_max", self.f_max, low=0.0)
        if self.slew is not None:
            number("slew", self.slew, above=0.0)

    def limits(self, dt: float) -> CapLimits:
        return CapLimits(self.f_max, float("inf") if self.slew is None else self.slew * dt)


def cap(c: CapLimits, f: float, f_held: float) -> float:
    """`f` within the cap, and within one tick's slew of `f_held`. NaN stays NaN: it must be seen."""
    f_max, step = c
    # min and max keep their first argument when the comparison with NaN fails.
    return max(min(max(min(f, f_max), -f_max), f_held + step), f_held - step)
