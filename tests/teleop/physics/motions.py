"""Motions with friction and contact as the tests draw them, and an independent solution of each."""

from __future__ import annotations

import math
import random
from typing import Any, NamedTuple

from hypothesis import strategies as st

from teleop.analysis.precision.reference.reference import settle
from teleop.physics.implicit import Effort
from teleop.physics.sdirk import NOTHING, WALL, Core

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


def reference(c: Core, p: float, u: float, f: float, s: float, dt: float) -> tuple[float, float]:
    """The motion of `integrate` by DOP853 from event to event."""
    return settle(c, p, u, f, s, dt, "DOP853")[:2]


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
