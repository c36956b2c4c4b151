"""Hunt-Crossley contact: Hertz's closed forms, the first integral of its rebound, and what a scene may write."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from slave.hunt_crossley import HuntCrossley
from teleop.errors import Refused
from teleop.physics.implicit import Effort, Resistance, implicit_plant
from teleop.physics.plant import MassDamper, Plant
from teleop.physics.sdirk import HUNT_CROSSLEY

DT = 1e-3


def beside(mass: float, dt: float, tol: float = 1e-9, **knobs: float) -> Plant:
    return implicit_plant(MassDamper(mass=mass), dt, resistance=HuntCrossley(**knobs).resistance(), tol=tol)


def run(plant: Plant, x: float, v: float, forces: list[float]) -> tuple[list[tuple[float, float]], Effort]:
    """The states at the ticks, and the inner state at the end."""
    z, states = plant.start, [(x, v)]
    for f in forces:
        x, v, _, z = plant.move(plant.c, x, v, f, z)
        states.append((x, v))
    return states, Effort(*z)


def test_a_hertz_impact_has_its_closed_depth_and_time() -> None:
    # m v^2/2 = (2/5) k depth^2.5; half the contact time is depth/v times the integral of 1/sqrt(1 - y^2.5).
    m, k, v = 0.1, 1e6, 0.5
    depth = (1.25 * m * v * v / k)**0.4
    half = depth / v * 0.4 * math.sqrt(math.pi) * math.gamma(0.4) / math.gamma(0.9)
    assert 2.0 * half == pytest.approx(2.943 * depth / v, rel=2e-4)
    for parts in (1, 7):
        plant = beside(m, half / parts, k=k)
        states, z = run(plant, 0.0, v, [0.0] * (2 * parts))
        x, u = states[parts]
        assert x == pytest.approx(depth, abs=3.0 * z.total)
        assert u == pytest.approx(0.0, abs=3.0 * z.total * parts / half)
        assert plant.force(plant.c, x, u, z) == pytest.approx(k * depth**1.5, rel=1e-4)
        assert states[-1][0] == pytest.approx(0.0, abs=3.0 * z.total)
        assert states[-1][1] == pytest.approx(-v, abs=3.0 * z.total * parts / half)
        assert z.total < 5e-9 * parts


@pytest.mark.parametrize(("n", "lam"), [(1.0, 0.3), (1.5, 0.02), (1.5, 0.3), (1.5, 4.0), (2.2, 0.3)])
def test_a_rebound_is_as_fast_as_the_first_integral_of_hunt_crossley_says(n: float, lam: float) -> None:
    # m u du = -k p^n (1 + lam u) dp, so lam u - ln(1 + lam u) is the same before and after, whatever k and n.
    m, k, v = 0.2, 2e5 * 100.0**(n - 1.0), 0.4

    def lost(e: float) -> float:
        return lam * v - math.log1p(lam * v) + lam * e * v + math.log1p(-lam * e * v)

    e = brentq(lost, 0.1, min(1.0, (1.0 - 1e-12) / (lam * v)), xtol=1e-15)
    plant = beside(m, DT, k=k, n=n, lam=lam)
    states, z = run(plant, -0.35 * DT * v, v, [0.0] * 100)
    assert states[-1][0] < 0.0 < max(x for x, _ in states)
    assert states[-1][1] == pytest.approx(-e * v, abs=3.0 * z.total / DT)
    assert z.total < 1e-7
    if lam * v < 0.01:
        assert e == pytest.approx(1.0 - 2.0 / 3.0 * lam * v, abs=(lam * v)**2)


@pytest.mark.parametrize("method", ["Radau", "DOP853"])
def test_the_peak_force_of_an_impact_is_that_of_an_independent_integration(method: str) -> None:
    m, k, lam, push, v, dt = 0.2, 1e6, 0.5, 1.0, 0.4, 1e-4
    plant = beside(m, dt, 1e-12, k=k, lam=lam)
    states, z = run(plant, 0.0, v, [push] * 100)
    felt = [plant.force(plant.c, x, u, z) for x, u in states]

    def rate(_: float, y: Any) -> list[float]:
        return [y[1], (push - k * max(y[0], 0.0)**1.5 * max(1.0 + lam * y[1], 0.0)) / m]

    def away(_: float, y: Any) -> float:
        return float(y[0])

    away.terminal, away.direction = True, -1.0  # type: ignore[attr-defined]
    tight = {"rtol": 1e-11, "atol": 1e-13, "max_step": dt}
    times = [dt * i for i in range(101)]
    touch = solve_ivp(rate, (0.0, times[-1]), (0.0, v), method, events=away, t_eval=times, **tight)
    meant = [k * max(x, 0.0)**1.5 * (1.0 + lam * u) for x, u in touch.y.T]
    assert 50 < len(meant) < 100
    assert felt[:len(meant)] == pytest.approx(meant, abs=1e-4 * max(meant))
    assert 1 < felt.index(max(felt)) < len(meant)
    left = float(touch.t_events[0][0])
    x, u = states[-1]
    out = float(touch.y_events[0][0][1])
    assert u == pytest.approx(out + push / m * (times[-1] - left), abs=1e-6)
    assert x == pytest.approx(out * (times[-1] - left) + 0.5 * push / m * (times[-1] - left)**2, abs=1e-8)


def test_a_ball_dropped_on_an_undamped_spring_comes_back_as_high_for_long() -> None:
    m, k, f, h = 0.1, 1e6, 1.0, 2e-3
    plant = beside(m, DT, 1e-11, k=k)
    states, z = run(plant, -h, 0.0, [f] * 2000)
    energy = [0.5 * m * v * v - f * x + 0.4 * k * max(x, 0.0)**2.5 for x, v in states]
    fast = math.sqrt(2.0 * f * h / m)
    assert max(abs(e - energy[0]) for e in energy) <= 3.0 * z.total * (m * fast / DT + 50.0)
    assert sum(a[1] > 0.0 > b[1] for a, b in pairwise(states)) > 30


# -- as a scene names it


def test_it_resists_with_the_numbers_it_was_given() -> None:
    assert HuntCrossley.inner is True
    contact = HuntCrossley(k=2e5, n=2, lam=0.5, at=0.03, side=-1)
    assert contact.resistance() == Resistance(HUNT_CROSSLEY, 2e5, 0.0, 0.03, -1.0, 2.0, 0.5)
    plant = implicit_plant(MassDamper(mass=0.5), DT, resistance=contact.resistance())
    assert plant.force(plant.c, 0.029, -0.2, plant.start) == pytest.approx(-2e5 * 1e-6 * 1.1)
    assert plant.force(plant.c, 0.031, -0.2, plant.start) == 0.0
    assert plant.force(plant.c, 0.029, 2.1, plant.start) == 0.0  # drawn out faster than 1/lam: it cannot pull


@pytest.mark.parametrize(("knobs", "says"), [
    ({"k": -1.0}, "k must be at least 0, not -1"),
    ({"k": "hard"}, "k must be a number, not 'hard'"),
    ({"k": 1.0, "n": 0.5}, "n must be at least 1, not 0.5"),
    ({"k": 1.0, "n": 11.0}, "n must be at most 10"),
    ({"k": 1.0, "lam": -0.5}, "lam must be at least 0"),
    ({"k": 1.0, "at": math.nan}, "at must be finite"),
    ({"k": 1.0, "side": 0}, "side must be 1 .* or -1 .*, not 0"),
])
def test_impossible_contacts_are_refused(knobs: dict[str, Any], says: str) -> None:
    with pytest.raises(Refused, match=says):
        HuntCrossley(**knobs)
