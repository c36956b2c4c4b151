"""Friction and nonlinear contact at their extremes: it ends, never raises, and makes no energy."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.physics.implicit import Resistance, implicit_master, implicit_plant
from teleop.physics.plant import MassDamper
from teleop.physics.sdirk import BOND, HUNT_CROSSLEY, MOST_SUBSTEPS, NOTHING, WALL
from tests.teleop.physics.motions import DT, TOL, run


def ten_to(low: float, high: float) -> Any:
    return st.floats(low, high).map(lambda e: 10.0**e)


def either_sign(magnitude: Any) -> Any:
    return st.just(0.0) | st.tuples(magnitude, st.sampled_from([-1.0, 1.0])).map(math.prod)


any_resistance = st.builds(
    Resistance, kind=st.sampled_from([NOTHING, WALL, BOND, HUNT_CROSSLEY]), k=st.just(0.0) | ten_to(0, 9),
    d=st.just(0.0) | ten_to(-3, 3), at=st.just(0.0), side=st.just(1.0), n=st.sampled_from([1.0, 1.5, 2.0, 10.0]),
    lam=st.just(0.0) | ten_to(-3, 2))


@settings(max_examples=150)
@given(any_resistance, ten_to(-4, 3), st.just(0.0) | ten_to(-3, 2), st.just(0.0) | ten_to(-3, 3), ten_to(-5, -1),
       either_sign(ten_to(-7, -1)), either_sign(ten_to(-5, 0.5)), either_sign(ten_to(-3, 2)))
def test_extremes_end_and_stay_finite(resistance: Resistance, m: float, b: float, fc: float, dt: float, x: float,
                                      v: float, f: float) -> None:
    plant = implicit_plant(MassDamper(mass=m, damping=b), dt, resistance=resistance, friction=fc)
    states, z = run(plant, x, v, [f, f, -f])
    assert all(math.isfinite(number) for state in (*states, z) for number in state)
    assert z.most <= MOST_SUBSTEPS
    assert math.isfinite(plant.force(plant.c, *states[-1], z))


def test_extremes_of_a_master_end_and_stay_finite() -> None:
    dice = random.Random(6)
    for _ in range(100):
        m, hand, fc, dt = (10 ** dice.uniform(*span) for span in ((-4, 3), (-4, 1), (-3, 3), (-5, -1)))
        k, d = dice.choice([0.0, 10 ** dice.uniform(0, 9)]), dice.choice([0.0, 10 ** dice.uniform(-3, 3)])
        master = implicit_master(MassDamper(mass=m), hand, k, d, dt, friction=fc)
        x, v, z = 0.0, dice.choice([0.0, 0.3]), master.start
        for _ in range(3):
            r, r1 = dice.uniform(-0.01, 0.01), dice.uniform(-0.01, 0.01)
            x, v, z = master.move(master.c, x, v, dice.uniform(-10, 10), r, r1, z)
            assert all(map(math.isfinite, (x, v, *z, master.force(master.c, x, v, 1.0, r1, 0.1, z))))
        assert z[3] <= MOST_SUBSTEPS


@pytest.mark.parametrize("kind", [NOTHING, WALL, BOND, HUNT_CROSSLEY])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("fc", "n"), [(0.0, 1.5), (1.0, 1.5), (0.0, 3.0)])
def test_what_is_not_finite_comes_back_as_not_finite(kind: int, bad: float, fc: float, n: float) -> None:
    plant = implicit_plant(MassDamper(mass=1.0), DT, resistance=Resistance(kind, 1e4, 1.0, n=n), friction=fc)
    master = implicit_master(MassDamper(mass=1.0), 0.1, 100.0, 1.0, DT, friction=fc)
    for numbers in ((bad, 0.1, 1.0), (1e-3, bad, 1.0), (1e-3, 0.1, bad), (0.0, 0.0, bad)):
        assert not all(map(math.isfinite, plant.move(plant.c, *numbers, plant.start)[:2]))
        plant.force(plant.c, *numbers[:2], plant.start)
        assert not all(map(math.isfinite, master.move(master.c, *numbers, 0.0, 0.0, master.start)[:2]))
        master.force(master.c, *numbers, 0.0, 0.0, master.start)
    for numbers in ((1e200, 1e200, 1e200), (1e308, -1e308, 1e308)):
        plant.move(plant.c, *numbers, plant.start)
        plant.force(plant.c, *numbers[:2], plant.start)
        master.move(master.c, *numbers, 0.0, 0.0, master.start)


@pytest.mark.parametrize("kind", [WALL, BOND, HUNT_CROSSLEY])
@pytest.mark.parametrize("k", [3e3, 1e9])
@pytest.mark.parametrize("fc", [0.0, 0.05])
def test_energy_is_never_made_beyond_the_error(kind: int, k: float, fc: float) -> None:
    m, n, dice = 0.2, 1.5, random.Random(9)
    plant = implicit_plant(MassDamper(mass=m), DT, resistance=Resistance(kind, k, 0.5, lam=0.1), friction=fc)

    def stored(x: float, v: float) -> float:
        spring = {WALL: 0.5 * k * max(x, 0.0)**2, BOND: 0.5 * k * x * x,
                  HUNT_CROSSLEY: k * max(x, 0.0)**(n + 1) / (n + 1)}[kind]
        return 0.5 * m * v * v + spring

    x, v, z, turns = -1e-3, 0.3, plant.start, 0
    for _ in range(400):
        f = dice.uniform(-0.5, 2.0)
        y, w, _, after = plant.move(plant.c, x, v, f, z)
        error = after[2] - z[2]
        fast, push = max(abs(v), abs(w)), max(abs(plant.force(plant.c, *at, z)) for at in ((x, v), (y, w)))
        made = stored(y, w) - stored(x, v) - f * (y - x)
        slack = 3.0 * error * (m * fast / DT + push + abs(f)) + m * (3.0 * error / DT)**2
        assert made <= slack + 1e-13 * (stored(x, v) + abs(f * y) + abs(f * x))
        turns += v > 0.0 > w
        x, v, z = y, w, after
    assert turns > 1


def test_a_tick_that_would_need_more_substeps_says_so() -> None:
    plant = implicit_plant(MassDamper(mass=1e-4), 0.1, resistance=Resistance(HUNT_CROSSLEY, 1e9))
    _, z = run(plant, 1e-5, 0.5, [5.0] * 3)
    assert (z.over > 0, z.most) == (True, MOST_SUBSTEPS)
    assert z.worst > TOL
    assert math.frexp(z.first)[0] == 0.5  # so that the next tick is not passed over its end
