"""The wall against two of scipy's integrators, with every change of mode located by events."""

import math
import random
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from teleop.physics.contact import wall
from teleop.physics.plant import MassDamper
from tests.teleop.physics.cases import Case


def integrated(method: str, case: Case) -> tuple[float, float, list[str]]:
    """Depth and speed after the tick, and the modes passed through, by integration from event to event.

    An event of scipy's is as exact as its interpolation: from there its instant is polished by Newton's
    method on integrations that end at it.
    """
    m, b, k, d, left, p, u, f = case
    soon = min(left, 1.0 / case.w)
    far = abs(p) + (abs(u) + abs(f) / m * left) * soon
    fast = abs(u) + case.w * max(p, 0.0) + abs(f) / m * soon
    limits = {"atol": [1e-15 * far, 1e-15 * fast], "rtol": 3e-14 if method == "DOP853" else 3e-13,
              "max_step": min(left / 10, 0.5 / case.w)}
    exits = {"free": [(-1.0, 0.0, "contact")], "contact": [(k, d, "detached")],
             "detached": [(1.0, 0.0, "free"), (-k, -d, "contact")]}

    def rate(_: float, y: Any, k: float, c: float) -> Any:
        return np.array([y[1], (f - c * y[1] - k * y[0]) / m])

    def run(span: float, start: Any, linear: tuple[float, float], events: Any = None) -> Any:
        jacobian = np.array([[0.0, 1.0], [-linear[0] / m, -linear[1] / m]])
        extra = {"jac": lambda *_: jacobian} if method == "Radau" else {}
        return solve_ivp(rate, (0.0, span), start, method, args=linear, events=events, **limits, **extra)

    modes = ["free" if p < 0 else "contact" if k * p + d * u > 0 else "detached"]
    y = np.array([p, u])
    while True:
        linear = (k, b + d) if modes[-1] == "contact" else (0.0, b)
        leave = [leaving(alpha, beta) for alpha, beta, _ in exits[modes[-1]]]
        done = run(left, y, linear, leave)
        if done.status == 0:
            return float(done.y[0, -1]), float(done.y[1, -1]), modes
        which = next(i for i, found in enumerate(done.t_events) if len(found))
        alpha, beta, mode = exits[modes[-1]][which]
        t = float(done.t_events[which][0])
        for _ in range(3):
            end = run(t, y, linear).y[:, -1]
            slope = rate(t, end, *linear)
            t -= (alpha * end[0] + beta * end[1]) / (alpha * slope[0] + beta * slope[1])
        y = run(t, y, linear).y[:, -1]
        if mode == "detached" and d == 0.0:
            mode = "free"
        if "free" in (mode, modes[-1]):
            y[0] = 0.0
        modes.append(mode)
        left -= t


def leaving(alpha: float, beta: float) -> Any:
    """The event that alpha p + beta p' falls through zero, as scipy asks for it."""

    def event(_t: float, y: Any, _k: float, _c: float) -> float:
        return float(alpha * y[0] + beta * y[1])

    event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
    return event


def stiff_case(dice: random.Random) -> Case:
    """A body near a stiff wall, with up to some five oscillations within a tick."""
    m, k = 10 ** dice.uniform(-2, 0.5), 10 ** dice.uniform(3, 8)
    w = math.sqrt(k / m)
    dt = 10 ** dice.uniform(-1, 1.5) / w
    b = dice.choice([0.0, m * w * 10 ** dice.uniform(-3, -1)])
    d = dice.choice([0.0, 2 * m * w * 10 ** dice.uniform(-3, 0.7)])
    u = dice.choice([-1.0, 1.0]) * 10 ** dice.uniform(-2, 0)
    p = dice.choice([-1.0, 1.0, 1.0]) * abs(u) / w * 10 ** dice.uniform(-2, 0.5)
    f = dice.choice([-1.0, 1.0, 0.0]) * m * w * abs(u) * 10 ** dice.uniform(-1, 0.5)
    if dice.random() < 0.2:  # drawn out of a wall that is too slow to follow, and pushed back in
        p, u, d, f = abs(p), -abs(u), 4 * k * abs(p / u), 2 * m * u * u / abs(p)
    return Case(m, b, k, d, dt, p, u, f)


@pytest.mark.parametrize(("method", "count"), [("DOP853", 60), ("Radau", 6)])
def test_stiff_walls_match_integrators_to_1e_10(method: str, count: int) -> None:
    dice = random.Random(7)
    passed: set[tuple[str, str]] = set()
    for _ in range(count):
        case = stiff_case(dice)
        p1, u1, modes = integrated(method, case)
        plant = wall(MassDamper(mass=case.m, damping=case.b), case.dt, k=case.k, d=case.d, at=0.0, side=1.0)
        got_p, got_u, capped = plant.move(plant.c, case.p, case.u, case.f)
        held = abs(case.f) / case.m * min(case.dt, 1 / case.w)
        fast = abs(case.u) + abs(u1) + case.w * max(case.p, 0.0) + held
        assert capped == 0
        assert abs(got_p - p1) <= 1e-10 * (abs(case.p) + abs(p1) + fast / case.w), case
        assert abs(got_u - u1) <= 1e-10 * fast, case
        passed |= set(pairwise(modes))
    if method == "DOP853":  # the cases drawn show every change of mode there is
        assert passed == {("free", "contact"), ("contact", "free"), ("contact", "detached"),
                          ("detached", "free"), ("detached", "contact")}
