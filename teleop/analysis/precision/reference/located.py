"""Piecewise linear bodies as the independent reference moves them: what the exact steps are compared with."""

from __future__ import annotations

from math import inf, sqrt

from teleop.analysis.precision.reference.reference import settle
from teleop.physics.plant import Gripped
from teleop.physics.sdirk import BOND, NOTHING, WALL, Core
from teleop.simulation.integrators.methods import Touch

MOST_RADIANS = 500.0  # of a piece's own motion within a tick that a step-by-step integrator still follows


def located(touch: Touch, dt: float, x: float, v: float, f: float, solver: str) -> tuple[float, float, int]:
    """`settle` for a body that touches something linear, in its own coordinates."""
    at, side = touch.at, touch.side
    p, u, changes = settle(equation(touch), side * (x - at), side * v, side * f, 0.0, dt, solver)
    return at + side * p, side * u, changes


def equation(touch: Touch) -> Core:
    """The same equation as `settle` has it."""
    m, b, k, d, _, _, edge, _ = touch
    return BOND if edge == -inf else WALL if edge == 0.0 else NOTHING, m, b, k, d, 1.5, 0.0, 0.0


def radians(touch: Touch, dt: float) -> float:
    """How far the fastest rate of any piece goes within a tick."""
    m, b, k, d, _, _, edge, _ = touch
    return (b / m if edge == inf else max(sqrt(k / m), (b + d) / m)) * dt


def gripped_touch(grip: Gripped) -> Touch:
    """The held master's equation in `y = x - x_ref`, under the force `-(f_m + b s)` while the reference has slope s."""
    return Touch(grip.mass, grip.b, grip.k, grip.d, edge=-inf, floor=-inf)
