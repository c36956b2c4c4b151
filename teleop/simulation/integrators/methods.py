"""Fixed-step methods, written as what they do to a body beside a wall that cannot pull.

Each takes n equal sub-steps of `h = dt/n` per tick, with the motor's force held. None locates a change of
contact: the explicit ones look at the wall where they evaluate its force, the implicit ones solve for the
contact inside each stage.

Formulas: Hairer, Norsett & Wanner, "Solving Ordinary Differential Equations I" (explicit), Hairer & Wanner II,
IV.5-6 (implicit); SDIRK2 is Alexander's L-stable one with gamma = 1 - 1/sqrt(2), SIAM J. Numer. Anal. 14 (1977).
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, sqrt
from typing import Any, NamedTuple

import numpy as np

from teleop.physics.plant import Move

GAMMA = 1.0 - sqrt(0.5)  # of SDIRK2


class Touch(NamedTuple):
    """A body and what it touches: `m p'' + b p' + g = f` with `g = k p + d p'` where p > edge and g > floor, else 0.

    `p = side (x - at)`. A wall has edge = floor = 0, a bond -inf, free space edge = inf.
    """

    m: float
    b: float
    k: float = 0.0
    d: float = 0.0
    side: float = 1.0
    at: float = 0.0
    edge: float = inf
    floor: float = 0.0


class IntegrationMethod(NamedTuple):
    """A fixed-step method: what it is called, and how it moves a body beside a wall.

    `coefficients(touch, h)` are what `move` needs beside the wall itself and the number of sub-steps.
    """

    name: str
    label: str
    order: int  # of its error over a run, while no contact changes
    coefficients: Callable[[Touch, float], tuple[Any, ...]]
    move: Move


def wall_coefficients(method: IntegrationMethod, touch: Touch, h: float, n: int) -> tuple[Any, ...]:
    """Coefficients of `method.move` for n sub-steps of h; `wall_force` needs the first four."""
    _, _, k, d, side, at, edge, floor = touch
    return side, at, k, d, edge, floor, n, *method.coefficients(touch, h)


# Explicit methods: the wall's force is evaluated where they are.


def _explicit(touch: Touch, h: float) -> tuple[Any, ...]:
    return touch.m, touch.b, h


def _euler(c: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
    side, at, k, d, edge, floor, n, m, b, h = c
    p, u, f = side * (x - at), side * v, side * f
    for _ in range(n):
        pull = f - b * u
        if p > edge:
            g = k * p + d * u
            if g > floor:
                pull -= g
        p, u = p + h * u, u + h * pull / m
    return at + side * p, side * u, 0


def _semi_implicit(c: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
    side, at, k, d, edge, floor, n, m, b, h = c
    p, u, f = side * (x - at), side * v, side * f
    for _ in range(n):
        pull = f - b * u
        if p > edge:
            g = k * p + d * u
            if g > floor:
                pull -= g
        u += h * pull / m
        p += h * u
    return at + side * p, side * u, 0


def _verlet(c: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
    """Half a kick with the dampers as they are, a drift, half a kick with the dampers as they will be.

    Of second order with damping too: Brunger, Brooks & Karplus, Chem. Phys. Lett. 105 (1984).
    """
    side, at, k, d, edge, floor, n, m, b, h = c
    p, u, f, half = side * (x - at), side * v, side * f, 0.5 * h / m
    free, touching = 1.0 / (1.0 + half * b), 1.0 / (1.0 + half * (b + d))
    for _ in range(n):
        pull = f - b * u
        if p > edge:
            g = k * p + d * u
            if g > floor:
                pull -= g
        u += half * pull
        p += h * u
        after = free * (u + half * f)
        if p > edge:
            w = touching * (u + half * (f - k * p))
            if k * p + d * w > floor:
                after = w
        u = after
    return at + side * p, side * u, 0


def _rk4(c: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
    side, at, k, d, edge, floor, n, m, b, h = c
    p, u, f, half = side * (x - at), side * v, side * f, 0.5 * h
    for _ in range(n):
        a1 = (f - b * u - _push(k, d, edge, floor, p, u)) / m
        p2, u2 = p + half * u, u + half * a1
        a2 = (f - b * u2 - _push(k, d, edge, floor, p2, u2)) / m
        p3, u3 = p + half * u2, u + half * a2
        a3 = (f - b * u3 - _push(k, d, edge, floor, p3, u3)) / m
        p4, u4 = p + h * u3, u + h * a3
        a4 = (f - b * u4 - _push(k, d, edge, floor, p4, u4)) / m
        p += h / 6.0 * (u + 2.0 * (u2 + u3) + u4)
        u += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
    return at + side * p, side * u, 0


def _push(k: float, d: float, edge: float, floor: float, p: float, u: float) -> float:
    if p > edge:
        g = k * p + d * u
        if g > floor:
            return g
    return 0.0


# Diagonally implicit methods: one solved stage after the other.


class ImplicitStage(NamedTuple):
    """The stage `U = u + s a(P, U)`, `P = p + s U`: `U = free_u u + free_f f` without touch, else `stiff_*`."""

    k: float
    d: float
    edge: float
    floor: float
    s: float
    free_u: float
    free_f: float
    stiff_u: float
    stiff_f: float


def solve(c: Any, p: float, u: float, f: float) -> tuple[float, float]:
    """The stage's (P, U), its contact solved; c is `ImplicitStage`.

    The wall's force does not fall where U grows, so there is one solution: out of touch, in contact, or on the
    surface itself, where the damper's force jumps and takes the value between that holds the body there.
    """
    k, d, edge, floor, s, free_u, free_f, stiff_u, stiff_f = c
    v = free_u * u + free_f * f
    q = p + s * v
    if q <= edge or k * q + d * v <= floor:
        return q, v
    v = stiff_u * u + stiff_f * (f - k * p)
    q = p + s * v
    if q <= edge:
        return edge, (edge - p) / s
    return q, v


def _stage(touch: Touch, s: float) -> tuple[float, ...]:
    m, b, k, d, _, _, edge, floor = touch
    free, stiff = 1.0 + s * b / m, 1.0 + s * (b + d) / m + s * s * k / m
    return tuple(ImplicitStage(k, d, edge, floor, s, 1.0 / free, s / m / free, 1.0 / stiff, s / m / stiff))


def _backward_euler(c: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
    side, at, _, _, _, _, n, stage = c
    p, u, f = side * (x - at), side * v, side * f
    for _ in range(n):
        p, u = solve(stage, p, u, f)
    return at + side * p, side * u, 0


def _midpoint(c: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
    side, at, _, _, _, _, n, stage = c
    p, u, f = side * (x - at), side * v, side * f
    for _ in range(n):
        q, w = solve(stage, p, u, f)
        p, u = 2.0 * q - p, 2.0 * w - u
    return at + side * p, side * u, 0


def _trapezoid(c: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
    side, at, k, d, edge, floor, n, stage, m, b, half = c
    p, u, f = side * (x - at), side * v, side * f
    for _ in range(n):
        a = (f - b * u - _push(k, d, edge, floor, p, u)) / m
        p, u = solve(stage, p + half * u, u + half * a, f)
    return at + side * p, side * u, 0


def _sdirk2(c: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
    side, at, _, _, _, _, n, stage, on = c
    p, u, f = side * (x - at), side * v, side * f
    for _ in range(n):
        q, w = solve(stage, p, u, f)
        p, u = solve(stage, p + on * (q - p), u + on * (w - u), f)
    return at + side * p, side * u, 0


# Radau IIA with two stages: the stages are solved together, one matrix for each of their four contacts.


def _radau_maps(touch: Touch, h: float) -> tuple[Any, ...]:
    """For contact in none, the first, the second, both stages: (P1, U1, P2, U2) as rows of (p, u, f)."""
    m, b, k, d, _, _, _, _ = touch
    a = h * np.array([[5.0, -1.0], [9.0, 3.0]]) / 12.0
    maps = []
    for which in range(4):
        on = np.array([which & 1, which >> 1], dtype=float)
        # U = u + a (f - (b + d) U - k P)/m with P = p + a U, d and k only where there is contact
        left = np.eye(2) + a @ (np.diag(b + d * on) + np.diag(k * on) @ a) / m
        speed = np.linalg.solve(left, np.stack([-a @ (k * on) / m, np.ones(2), a @ np.ones(2) / m], axis=1))
        depth = a @ speed + np.array([1.0, 0.0, 0.0])
        maps.append(tuple(np.concatenate([depth[0], speed[0], depth[1], speed[1]]).tolist()))
    return (tuple(maps),)


def _radau(c: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
    """Contact as it was at the start, then as the stages have it, until they agree with themselves."""
    side, at, k, d, edge, floor, n, maps = c
    p, u, f = side * (x - at), side * v, side * f
    for _ in range(n):
        which = 3 if p > edge and k * p + d * u > floor else 0
        for _ in range(4):
            p1p, p1u, p1f, u1p, u1u, u1f, p2p, p2u, p2f, u2p, u2u, u2f = maps[which]
            q, w = p1p * p + p1u * u + p1f * f, u1p * p + u1u * u + u1f * f
            r, z = p2p * p + p2u * u + p2f * f, u2p * p + u2u * u + u2f * f
            mode = (q > edge and k * q + d * w > floor) + 2 * (r > edge and k * r + d * z > floor)
            if mode == which:
                break
            which = mode
        p, u = r, z
    return at + side * p, side * u, 0


METHODS = (
    IntegrationMethod("euler", "explicit Euler", 1, _explicit, _euler),
    IntegrationMethod("semi_implicit_euler", "semi-implicit Euler", 1, _explicit, _semi_implicit),
    IntegrationMethod("verlet", "velocity Verlet", 2, _explicit, _verlet),
    IntegrationMethod("rk4", "Runge-Kutta 4", 4, _explicit, _rk4),
    IntegrationMethod("backward_euler", "backward Euler", 1, lambda t, h: (_stage(t, h),), _backward_euler),
    IntegrationMethod("midpoint", "implicit midpoint", 2, lambda t, h: (_stage(t, 0.5 * h),), _midpoint),
    IntegrationMethod("trapezoid", "trapezoid", 2, lambda t, h: (_stage(t, 0.5 * h), t.m, t.b, 0.5 * h), _trapezoid),
    IntegrationMethod("sdirk2", "SDIRK2", 2, lambda t, h: (_stage(t, GAMMA * h), (1.0 - GAMMA) / GAMMA), _sdirk2),
    IntegrationMethod("radau", "Radau IIA, two stages", 3, _radau_maps, _radau),
)
