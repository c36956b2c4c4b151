"""The fixed-step methods and scipy's on a body whose surroundings remember: three linear states, one matrix.

    m x'' + c x' + k x + g z = f,        tau z' = h x' - z

as in `teleop/physics/relaxing.py`: tissue that relaxes, and a master damped electrically. A Runge-Kutta method makes of
the state's matrix A a rational function, its stability function R(h A); the split ones kick speed and z together and
let the position drift. So any of them is a matrix per sub-step, taken n times.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite, nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.simulation.integrators.methods import GAMMA, IntegrationMethod

Matrix = NDArray[Any]
Steps = Callable[[float, float, float, float], tuple[float, float, float]]  # x, v, z, f after a tick

# R as the coefficients of 1, z, z^2, ... above and below the line: Hairer & Wanner II, IV.3.
STABILITY: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "euler": ((1.0, 1.0), (1.0,)),
    "rk4": ((1.0, 1.0, 1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0), (1.0,)),
    "backward_euler": ((1.0,), (1.0, -1.0)),
    "midpoint": ((1.0, 0.5), (1.0, -0.5)),
    "trapezoid": ((1.0, 0.5), (1.0, -0.5)),
    "sdirk2": ((1.0, 1.0 - 2.0 * GAMMA), (1.0, -2.0 * GAMMA, GAMMA * GAMMA)),
    "radau": ((1.0, 1.0 / 3.0), (1.0, -2.0 / 3.0, 1.0 / 6.0)),
}


class Branch(NamedTuple):
    """The coefficients of the equation above."""

    m: float
    c: float
    k: float
    g: float
    h: float
    tau: float


def rates(branch: Branch) -> Matrix:
    """The rates of (x, v, z, f) as a matrix; f rests."""
    m, c, k, g, h, tau = branch
    return np.array([[0.0, 1.0, 0.0, 0.0], [-k / m, -c / m, -g / m, 1.0 / m],
                     [0.0, h / tau, -1.0 / tau, 0.0], [0.0, 0.0, 0.0, 0.0]])


def sub_step(method: IntegrationMethod, branch: Branch, step: float) -> Matrix:
    """Make one sub-step of (x, v, z, f)."""
    a, one = step * rates(branch), np.eye(4)
    if method.name in STABILITY:
        above, below = (sum(r * np.linalg.matrix_power(a, i) for i, r in enumerate(part))
                        for part in STABILITY[method.name])
        return np.asarray(np.linalg.solve(below, above))
    drift, kick = a.copy(), a.copy()
    drift[1:], kick[0] = 0.0, 0.0
    if method.name == "verlet":
        return np.asarray(np.linalg.solve(one - 0.5 * kick, (one + drift) @ (one + 0.5 * kick)))
    return np.asarray((one + drift) @ (one + kick))


def stepped(method: IntegrationMethod, branch: Branch, dt: float, n: int) -> Steps:
    """n sub-steps of a method over dt."""
    rows = sub_step(method, branch, dt / n)[:3].tolist()
    (a11, a12, a13, b1), (a21, a22, a23, b2), (a31, a32, a33, b3) = rows

    def steps(x: float, v: float, z: float, f: float) -> tuple[float, float, float]:
        push, kick, pour = b1 * f, b2 * f, b3 * f
        for _ in range(n):
            x, v, z = (a11 * x + a12 * v + a13 * z + push, a21 * x + a22 * v + a23 * z + kick,
                       a31 * x + a32 * v + a33 * z + pour)
        return x, v, z

    return steps


def solved(branch: Branch, dt: float, solver: str, rtol: float) -> Steps:
    """Call scipy's `solver` once over dt; NaN where it gives up."""
    from scipy.integrate import solve_ivp

    a = rates(branch)[:3]
    system = a[:, :3]
    options: Any = {"jac": system} if solver == "Radau" else {}

    def steps(x: float, v: float, z: float, f: float) -> tuple[float, float, float]:
        if not isfinite(abs(x) + abs(v) + abs(z) + abs(f)):
            return nan, nan, nan
        push = a[:, 3] * f
        done = solve_ivp(lambda _, y: system @ y + push, (0.0, dt), (x, v, z), solver, rtol=rtol,
                         atol=1e-3 * rtol, **options)
        x, v, z = map(float, done.y[:, -1])
        return (x, v, z) if done.success else (nan, nan, nan)

    return steps


def bonded(steps: Steps) -> Callable[..., tuple[float, float, int, tuple[float]]]:
    """`move_relaxing` by `steps`; its c is (at, k, *`Step3`)."""

    def move(c: Any, x: float, v: float, f: float, z: tuple[float]) -> tuple[float, float, int, tuple[float]]:
        at = c[0]
        q, v, phi = steps(x - at, v, z[0], f)
        return at + q, v, 0, (phi,)

    return move


def step_held(steps: Steps, dt: float, b: float) -> Callable[..., tuple[float, float, tuple[float]]]:
    """`move_held` of a master damped electrically, by `steps`; b is the damping of the master alone."""

    def move(_: Any, x: float, v: float, f_m: float, r0: float, r1: float, z: tuple[float]
             ) -> tuple[float, float, tuple[float]]:
        s = (r1 - r0) / dt
        y, w, u = steps(x - r0, v - s, z[0] - s, -(f_m + b * s))
        return r1 + y, s + w, (s + u,)

    return move
