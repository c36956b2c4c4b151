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


OPERATOR, POLICY, GRIPPED, LATE, PAUSED = map(float, Standing)  # as all engines know numbers


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
        return OPERATOR
    if was == GRIPPED or (was == POLICY and resisted > c.grips):
        return GRIPPED
    if not allowed > 0.0:
        return PAUSED
    return LATE if quiet > c.patience else POLICY


def share_step(c: Rules, a: float, now: float, passed: float) -> float:
    """The policy's share after a tick; down by the ticks that passed, up by one of those that are run."""
    if now == POLICY:
        return min(a + c.up, 1.0)
    return max(a - passed * (c.yields if now > GRIPPED else c.up), 0.0)


def tank_step(c: Rules, E: float, work: float, span: float) -> float:
    """Energy left in the tank (J) after a work (J) over `span` s."""
    return min(E - work + c.power * span, c.full)
