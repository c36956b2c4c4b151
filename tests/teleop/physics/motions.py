"""Motions with friction and contact as the tests draw them, and an independent solution of each."""

from __future__ import annotations

import math
import random
from typing import Any, NamedTuple

from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from teleop.physics.implicit import Effort
from teleop.physics.sdirk import BOND, HUNT_CROSSLEY, NOTHING, WALL, Core, resistance_force

TOL = 1e-9
DT = 1e-3


class Case(NamedTuple):
    """A body (mass m, damping b), a wall (k, d), and a tick dt from depth p and inward speed u under f."""

    m: float
    b: float
    k: float
    d: float
    dt: float
    p: float
    u: float
    f: float

    @property
    def w(self) -> float:
        return math.sqrt(self.k / self.m)


def ten_to(low: float, high: float) -> Any:
    """Positive numbers of every magnitude between 10^low and 10^high."""
    return st.floats(low, high).map(lambda e: 10.0**e)


def either_sign(magnitude: Any) -> Any:
    return st.just(0.0) | st.tuples(magnitude, st.sampled_from([-1.0, 1.0])).map(math.prod)


def core(kind: int = NOTHING, *, m: float = 1.0, b: float = 0.0, k: float = 0.0, d: float = 0.0, n: float = 1.5,
         lam: float = 0.0, fc: float = 0.0) -> Core:
    return kind, m, b, k, d, n, lam, fc


def run(plant: Any, x: float, v: float, forces: list[float]) -> tuple[list[tuple[float, float]], Effort]:
    """The states at the ticks, and the inner state at the end."""
    z, states = plant.start, [(x, v)]
    for f in forces:
        x, v, _, z = plant.move(plant.c, x, v, f, z)
        states.append((x, v))
    return states, Effort(*z)


def raw(c: Core, p: float, u: float) -> float:
    return 1.0 + c[6] * u if c[0] == HUNT_CROSSLEY else c[3] * p + c[4] * u


def reference(c: Core, p: float, u: float, f: float, s: float, dt: float) -> tuple[float, float]:  # noqa: PLR0912
    """The motion of `integrate` by DOP853 from event to event, each mode with its own smooth equation."""
    kind, m, b, k, d, n, lam, fc = c
    for _ in range(100):
        if kind in (NOTHING, BOND):
            touch = int(kind == BOND)
        elif p < 0.0 or (p == 0.0 and u < 0.0):
            touch = 0
        else:
            touch = 1 if raw(c, p, u) > 0.0 or p == 0.0 else 2

        def g(p: float, u: float, touch: int = touch) -> float:
            if touch != 1:
                return 0.0
            return k * max(p, 0.0)**n * (1.0 + lam * u) if kind == HUNT_CROSSLEY else k * p + d * u

        push = f - b * u - g(p, u)
        way = math.copysign(1.0, u + s) if u + s != 0.0 else math.copysign(1.0, push) if abs(push) > fc else 0.0
        if fc == 0.0:
            way = 0.0
        if fc > 0.0 and way == 0.0:  # it sticks, and p runs straight on, until the force is too large
            def over(t: float, p: float = p, u: float = u) -> float:
                return abs(f - b * u - resistance_force(c, p + u * t, u)) - fc

            if s == 0.0 or over(dt) <= 0.0:
                return p + u * dt, u
            t = brentq(over, 0.0, dt, xtol=1e-16) + 1e-9 * dt
            p, dt = p + u * t, dt - t
            continue

        def rate(_: float, y: Any, way: float = way, g: Any = g) -> list[float]:
            return [y[1], (f - b * y[1] - g(y[0], y[1]) - way * fc) / m]

        stops = []
        if kind in (WALL, HUNT_CROSSLEY):
            stops.append(at_zero(lambda y: y[0], 1.0 if touch == 0 else -1.0))
        if touch in (1, 2) and kind != BOND:
            stops.append(at_zero(lambda y: raw(c, y[0], y[1]), -1.0 if touch == 1 else 1.0))
        if way != 0.0:
            stops.append(at_zero(lambda y: y[1] + s, -way))
        scale = abs(p) + abs(u) * dt + abs(f) / m * dt * dt
        done = solve_ivp(rate, (0.0, dt), (p, u), "DOP853", rtol=1e-12, atol=[1e-14 * scale, 1e-13 * scale / dt],
                         events=stops, max_step=dt / 25)
        p, u = (float(value) for value in done.y[:, -1])
        if done.status == 0:
            return p, u
        dt -= float(done.t[-1])
        which = next(i for i, found in enumerate(done.t_events) if len(found))
        if way != 0.0 and which == len(stops) - 1:
            u = -s
        elif which == 0:
            p = 0.0
        elif touch == 1:  # it lets go: the force is 0 and stays so for the moment
            u -= 1e-14 * (1.0 + abs(u))
        else:
            u += 1e-14 * (1.0 + abs(u))
    raise AssertionError("the reference does not end")


def at_zero(of: Any, direction: float) -> Any:
    def event(_t: float, y: Any) -> float:
        return float(of(y))

    event.terminal, event.direction = True, direction  # type: ignore[attr-defined]
    return event


def struck(dice: random.Random) -> tuple[Core, float, float, float, float]:
    """A body near a wall: (core, p, u, f, dt), up to some three radians within a tick."""
    m, k = 10 ** dice.uniform(-2, 0.5), 10 ** dice.uniform(3, 7)
    w = math.sqrt(k / m)
    u = dice.choice([-1.0, 1.0]) * 10 ** dice.uniform(-2, 0)
    p = dice.choice([-1.0, 1.0, 1.0]) * abs(u) / w * 10 ** dice.uniform(-2, 0.5)
    f = dice.choice([-1.0, 1.0, 0.0]) * m * w * abs(u) * 10 ** dice.uniform(-1, 0.5)
    b = dice.choice([0.0, m * w * 10 ** dice.uniform(-3, -1)])
    d = dice.choice([0.0, 2 * m * w * 10 ** dice.uniform(-3, 0.7)])
    return core(WALL, m=m, b=b, k=k, d=d), p, u, f, 10 ** dice.uniform(-1.5, 0.5) / w
