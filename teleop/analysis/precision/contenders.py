"""Solvers of scipy's as contenders: `solve_ivp` over each tick, the wall's force in the right-hand side, no events."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from math import isfinite, nan
from typing import Any

from teleop.physics.plant import Plant
from teleop.physics.sdirk import Core, resistance_force
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies, exact_bodies
from teleop.simulation.integrators import relaxed
from teleop.simulation.integrators.methods import Touch
from teleop.simulation.integrators.parts import core_of, rebuilt, relaxing_branch, slave_of
from teleop.simulation.integrators.stepped import touch_of


@dataclass(frozen=True, kw_only=True, slots=True)
class Contender:
    """A way to move the bodies: the stack's own, a fixed-step method with `substeps`, or scipy's solver with `rtol`.

    The stack's own is `exact` where every body has a closed form, else `default`.
    """

    method: str
    label: str
    bodies: Bodies
    substeps: int | None = None
    rtol: float | None = None

    @property
    def step(self) -> str:
        """Number of its sub-steps, or its rtol."""
        return str(self.substeps) if self.substeps else f"{self.rtol:.0e}" if self.rtol else ""

    @property
    def key(self) -> str:
        """Name among all contenders, for example `rk4/16`."""
        return f"{self.method}/{self.step}" if self.step else self.method


Rate = Callable[[float, Any, float], tuple[float, float]]  # (t, (p, u), f) -> (p', u')

SOLVERS = ("DOP853", "LSODA", "Radau")
TOLERANCES = (1e-3, 1e-6, 1e-9)  # relative; absolute 1e-3 of it, in m and m/s


def there() -> bool:
    """True if scipy is installed."""
    return find_spec("scipy") is not None


def outsider_bodies(scene: Scene, solver: str, rtol: float) -> Bodies:
    """The scene with its slave moved by one call of `solver` per tick; the master, which is linear, stays exact."""
    dt = scene.dt_ns / 1e9

    def moved(still: Plant, environment: Any) -> Plant:
        if (equation := core_of(still)) is not None:
            side, at, core = equation
            return still._replace(move=_solved(_resisted(core), side, at, dt, solver, rtol), start=(), report=None)
        if (branch := relaxing_branch(still, environment, slave_of(scene))) is not None:
            return still._replace(move=relaxed.bonded(relaxed.solved(branch, dt, solver, rtol)))
        touch = touch_of(still, slave_of(scene))
        return still._replace(move=_solved(_touching(touch), touch.side, touch.at, dt, solver, rtol))

    return exact_bodies(scene)._replace(slaves=rebuilt(scene, moved))


def _resisted(core: Core) -> Rate:
    """The rates of depth and speed of a body without friction in what resists it."""
    m, b = core[1], core[2]

    def rate(_: float, y: Any, f: float) -> tuple[float, float]:
        p, u = y
        return u, (f - b * u - resistance_force(core, p, u)) / m

    return rate


def _touching(touch: Touch) -> Rate:
    """The rates of depth and speed of a body beside a wall, bonded or free."""
    m, b, k, d, _, _, edge, floor = touch

    def rate(_: float, y: Any, f: float) -> tuple[float, float]:
        p, u = y
        pull = f - b * u
        if p > edge:
            g = k * p + d * u
            if g > floor:
                pull -= g
        return u, pull / m

    return rate


def _solved(rate: Rate, side: float, at: float, dt: float, solver: str, rtol: float) -> Callable[..., tuple[Any, ...]]:
    """`move` by one call of `solver` over the tick; NaN where it gives up."""
    from scipy.integrate import solve_ivp

    def move(_: Any, x: float, v: float, f: float, *inner: Any) -> tuple[Any, ...]:
        if not isfinite(abs(x) + abs(v) + abs(f)):
            return nan, nan, 0, *inner
        start = side * (x - at), side * v
        done = solve_ivp(rate, (0.0, dt), start, solver, args=(side * f,), rtol=rtol, atol=1e-3 * rtol)
        if not done.success:
            return nan, nan, 0, *inner
        return at + side * float(done.y[0, -1]), side * float(done.y[1, -1]), 0, *inner

    return move
