"""The fixed-step methods on a body that is not piecewise linear: Hunt-Crossley contact, Coulomb friction.

The equation is that of `teleop/physics/sdirk.py`, `m u' = f - b u - g(p, u) - fc Sgn(u + s)` with f and s held, and an
implicit method solves its stages by that file's `stage`: contact and friction are solved for, each stage has one
solution. An explicit method evaluates the force where it is; at rest over the ground friction takes the value
between its bounds that holds the body. Radau IIA is left out: its two stages are coupled, and no scalar solver
has them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from teleop.physics.sdirk import BOND, GAMMA, HUNT_CROSSLEY, NOTHING, ON, Core, power, resistance_force, stage
from teleop.simulation.integrators.methods import IntegrationMethod

# What takes n sub-steps of h: (equation, depth, speed, f, s, h, n) -> depth, speed.
Advance = Callable[[Core, float, float, float, float, float, int], tuple[float, float]]


def move_stepped(c: Any, x: float, v: float, f: float, z: Any, s: float = 0.0) -> tuple[float, float, int, Any]:
    """Move by n sub-steps a tick; c is (side, at, equation, advance, h, n), s as in `implicit_plant`."""
    side, at, core, advance, h, n = c
    p, u = advance(core, side * (x - at), side * v, side * f, side * s, h, n)
    return at + side * p, side * u, 0, z


def stepped_force(c: Any, x: float, v: float, z: Any) -> float:  # noqa: ARG001 - the signature of every force
    """`f_env` as the left limit; c as in `move_stepped`."""
    side, at, core = c[:3]
    return float(side * resistance_force(core, side * (x - at), side * v))


def held_stepped(core: Core, advance: Advance, dt: float, n: int) -> Callable[..., tuple[float, float, Any]]:
    """`move_held` of a master with friction by n sub-steps a tick."""
    h, b = dt / n, core[2]

    def move(_: Any, x: float, v: float, f_m: float, r0: float, r1: float, z: Any) -> tuple[float, float, Any]:
        s = (r1 - r0) / dt
        y, w = advance(core, x - r0, v - s, -(f_m + b * s), s, h, n)
        return r1 + y, s + w, z

    return move


def acceleration(c: Core, p: float, u: float, f: float, s: float) -> float:
    """Acceleration that the explicit methods evaluate."""
    push = f - c[2] * u - resistance_force(c, p, u)
    fc = c[7]
    if fc > 0.0:
        v = u + s
        push -= fc if v > 0.0 else -fc if v < 0.0 else min(max(push, -fc), fc)
    return push / c[1]


def _euler(c: Core, p: float, u: float, f: float, s: float, h: float, n: int) -> tuple[float, float]:
    for _ in range(n):
        p, u = p + h * u, u + h * acceleration(c, p, u, f, s)
    return p, u


def _semi_implicit(c: Core, p: float, u: float, f: float, s: float, h: float, n: int) -> tuple[float, float]:
    for _ in range(n):
        u += h * acceleration(c, p, u, f, s)
        p += h * u
    return p, u


def _verlet(c: Core, p: float, u: float, f: float, s: float, h: float, n: int) -> tuple[float, float]:
    half = 0.5 * h
    for _ in range(n):
        u += half * acceleration(c, p, u, f, s)
        p += h * u
        u = kicked(c, p, u, half, f, s)
    return p, u


def kicked(c: Core, p: float, w: float, tau: float, f: float, s: float) -> float:
    """The speed U after a kick at p with dampers and friction as they will be, which is linear in U piece by piece.

    `m (U - w) = tau (f - b U - g(p, U) - fc Sgn(U + s))`, g there being `max(0, push + damp U)`, of a bond without max.
    """
    kind, m, b, k, d, n, lam, fc = c
    push = damp = 0.0
    if kind == BOND or (kind != NOTHING and p > 0.0):
        push, damp = k * p, d
        if kind == HUNT_CROSSLEY:
            push = k * power(p, n)
            damp = push * lam
    mass, drive = m + tau * b, m * w + tau * f
    if fc > 0.0:
        over = drive + mass * s - tau * resistance_force(c, p, -s)
        if -tau * fc <= over <= tau * fc:
            return 0.0 - s
        drive -= tau * fc if over > 0.0 else -tau * fc
    if kind != BOND and push + damp * drive / mass <= 0.0:
        return drive / mass
    return (drive - tau * push) / (mass + tau * damp)


def _rk4(c: Core, p: float, u: float, f: float, s: float, h: float, n: int) -> tuple[float, float]:
    half = 0.5 * h
    for _ in range(n):
        a1 = acceleration(c, p, u, f, s)
        u2 = u + half * a1
        a2 = acceleration(c, p + half * u, u2, f, s)
        u3 = u + half * a2
        a3 = acceleration(c, p + half * u2, u3, f, s)
        u4 = u + h * a3
        a4 = acceleration(c, p + h * u3, u4, f, s)
        p += h / 6.0 * (u + 2.0 * (u2 + u3) + u4)
        u += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
    return p, u


def _backward_euler(c: Core, p: float, u: float, f: float, s: float, h: float, n: int) -> tuple[float, float]:
    for _ in range(n):
        u, _ = stage(c, p, u, h, f, s)
        p += h * u
    return p, u


def _midpoint(c: Core, p: float, u: float, f: float, s: float, h: float, n: int) -> tuple[float, float]:
    half = 0.5 * h
    for _ in range(n):
        w, _ = stage(c, p, u, half, f, s)
        p, u = p + h * w, 2.0 * w - u
    return p, u


def _trapezoid(c: Core, p: float, u: float, f: float, s: float, h: float, n: int) -> tuple[float, float]:
    half = 0.5 * h
    for _ in range(n):
        y, w = p + half * u, u + half * acceleration(c, p, u, f, s)
        u, _ = stage(c, y, w, half, f, s)
        p = y + half * u
    return p, u


def _sdirk2(c: Core, p: float, u: float, f: float, s: float, h: float, n: int) -> tuple[float, float]:
    tau = GAMMA * h
    for _ in range(n):
        w, _ = stage(c, p, u, tau, f, s)
        y, u = p + (h - tau) * w, u + ON * (w - u)
        u, _ = stage(c, y, u, tau, f, s)
        p = y + tau * u
    return p, u


ADVANCE: dict[str, Advance] = {
    "euler": _euler, "semi_implicit_euler": _semi_implicit, "verlet": _verlet, "rk4": _rk4,
    "backward_euler": _backward_euler, "midpoint": _midpoint, "trapezoid": _trapezoid, "sdirk2": _sdirk2,
}


def goes(method: IntegrationMethod) -> bool:
    """True if the method is known on a body that is not piecewise linear."""
    return method.name in ADVANCE
