"""Authority over a handle that an operator shares with a policy, and the tank of the policy's energy: their arithmetic.

`teleop.stages.handover` has the rules in words.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

GRIPS = 0.05  # s for which a hand has to resist before it takes over


class Standing(IntEnum):
    """State of authority, as `policy_m` has it; with all but POLICY it is the operator's."""

    OPERATOR = 0  # the policy's switch is off
    POLICY = 1
    GRIPPED = 2  # the operator took over by force
    LATE = 3  # no action came in time
    PAUSED = 4  # the link is not there, or the clutch is open


class Rules(NamedTuple):
    """Coefficients of authority and of the tank."""

    up: float  # of a, a tick
    yields: float  # of a, a tick of a policy that gives way
    patience: float  # ticks
    grip: float  # share of f_max
    grips: float  # ticks
    full: float  # J
    soft: float  # J
    power: float  # W


def standing(c: Rules, was: float, wants: float, allowed: float, quiet: float, resisted: float) -> float:
    """The `Standing` of a tick. `quiet`: ticks since an action; `resisted`: ticks for which a hand resisted."""
    if not wants > 0.0:
        return 0.0
    if was == 2.0 or (was == 1.0 and resisted > c.grips):
        return 2.0
    if not allowed > 0.0:
        return 4.0
    return 3.0 if quiet > c.patience else 1.0


def share_step(c: Rules, a: float, now: float, passed: float) -> float:
    """The policy's share after a tick; down by the ticks that passed, up by one of those that are run."""
    if now == 1.0:
        return min(a + c.up, 1.0)
    return max(a - passed * (c.yields if now > 2.0 else c.up), 0.0)


def tank_step(c: Rules, E: float, work: float, span: float) -> float:
    """Energy left in the tank (J) after a work (J) over `span` s."""
    return min(E - work + c.power * span, c.full)
