"""What a slave stands in, as a scene names it: walls, tissue, solids that yield, contacts, and these in motion."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from scipy.optimize import brentq

from master import Sine
from slave import HuntCrossley, Moving, StandardLinearSolid, Tissue, Wall
from teleop import MassDamper, Plant, Refused, Resistance, Scene, Wave
from teleop.physics.implicit import implicit_plant
from teleop.physics.plant import move_free
from teleop.physics.sdirk import HUNT_CROSSLEY
from teleop.simulation.bodies import slave_plants
from tests.teleop.physics.motions import run

BODY = MassDamper(mass=0.5, damping=1.0)
DT = 1e-3

# Walls and tissue


def test_canonical_wall_stops_a_body_at_its_surface_and_neither_stiff_nor_damped_is_no_wall() -> None:
    plant = Wall(k=5000.0, d=5.0, at=0.03).plant(BODY, 1e-3)
    assert plant.force(plant.c, 0.0299, 1.0) == 0.0
    assert plant.force(plant.c, 0.031, 0.1) == pytest.approx(5000.0 * 0.001 + 5.0 * 0.1)
    x, v = 0.0, 0.0
    for _ in range(5000):
        x, v, _ = plant.move(plant.c, x, v, 2.0)
    assert x == pytest.approx(0.03 + 2.0 / 5000.0, abs=1e-12)
    assert Wall(k=0.0).plant(BODY, 1e-3).move is move_free
    assert Wall(k=5000, at=0, side=-1) == Wall(k=5000.0, at=0.0, side=-1.0)
    assert all(isinstance(c, float) for c in Wall(k=5000).plant(MassDamper(mass=1), 1e-3).c)


def test_wall_on_the_other_side_is_its_mirror_image() -> None:
    right, left = (Wall(k=5000.0, d=5.0, at=s * 0.03, side=s).plant(BODY, 1e-3) for s in (1, -1))
    x, v, y, w, deepest = 0.0, 0.4, 0.0, -0.4, 0.0
    for k in range(1000):
        f = math.sin(0.1 * k)
        x, v, _ = right.move(right.c, x, v, f)
        y, w, _ = left.move(left.c, y, w, -f)
        deepest = max(deepest, x)
        assert (y, w) == (-x, -v)
        assert left.force(left.c, y, w) == -right.force(right.c, x, v)
    assert deepest > 0.031


def test_tissue_pushes_and_pulls_and_undamped_swings_at_its_own_frequency_and_a_solid_starts_relaxed() -> None:
    m, k, at, dt = 0.5, 300.0, 0.02, 1e-3
    plant = Tissue(k=k, d=2.0, at=at).plant(MassDamper(mass=m), dt)
    assert plant.force(plant.c, 0.03, 0.1) == pytest.approx(300.0 * 0.01 + 0.2)
    assert plant.force(plant.c, 0.01, 0.0) == pytest.approx(-3.0)
    plant = Tissue(k=k, d=0.0, at=at).plant(MassDamper(mass=m), dt)
    x, v = at + 0.01, 0.0
    for _ in range(1000):
        x, v, _ = plant.move(plant.c, x, v, 0.0)
    assert x - at == pytest.approx(0.01 * math.cos(math.sqrt(k / m)), abs=1e-13)
    assert v == pytest.approx(-0.01 * math.sqrt(k / m) * math.sin(math.sqrt(k / m)), abs=1e-12)
    plant = StandardLinearSolid(k=300.0, k1=700.0, tau=0.1, at=0.02).plant(MassDamper(mass=0.5), 1e-3)
    assert StandardLinearSolid.inner
    assert plant.start == (0.0,)
    assert plant.force(plant.c, 0.03, 0.1, plant.start) == pytest.approx(3.0)
    assert plant.force(plant.c, 0.01, 0.0, (1.0,)) == pytest.approx(-2.0)


def test_quick_pushes_meet_both_springs_and_slow_ones_the_lasting_one() -> None:
    solid, body = StandardLinearSolid(k=300.0, k1=700.0, tau=0.1), MassDamper(mass=1e25)
    for dt, stiffness in ((1e-6, 1000.0), (1e5, 300.0)):
        plant = solid.plant(body, dt)
        x, _, _, z = plant.move(plant.c, 0.0, 0.01 / dt, 0.0, plant.start)
        assert plant.force(plant.c, x, 0.0, z) == pytest.approx(stiffness * 0.01, rel=1e-4)


# In motion

SWING = Sine(amplitude=0.005, frequency=1.0)


def plant_of(moving: Moving, ticks: int) -> Plant:
    """As a run makes it: the slave in this environment."""
    return slave_plants(Scene(law=Wave(), master=BODY, slave=BODY, environment=moving, dt=DT, duration=ticks * DT))[0]


def test_body_bonded_to_what_moves_slowly_goes_along_and_a_wall_that_comes_is_met_where_it_comes_to() -> None:
    plant = plant_of(Moving(environment=Tissue(k=1e6, d=500.0, at=0.02), path=SWING), 1000)
    x, v, z = 0.02, 0.0, plant.start
    for k in range(1, 1001):
        x, v, _, z = plant.move(plant.c, x, v, 0.0, z)
        assert x == pytest.approx(0.02 + 0.005 * math.sin(2 * math.pi * k * DT), abs=2e-5)
    plant = plant_of(Moving(environment=Wall(k=5000.0, at=0.004, side=-1), path=SWING), 1000)
    for k in (0, 40, 250):  # the surface is 4 mm beyond the path
        place = 0.004 + 0.005 * math.sin(2 * math.pi * k * DT)
        assert plant.force(plant.c, place + 1e-6, 0.0, (k,)) == 0.0
        assert plant.force(plant.c, place - 1e-3, 0.0, (k,)) == pytest.approx(-5.0)


def test_inner_state_of_what_moves_is_kept() -> None:
    moving = Moving(environment=StandardLinearSolid(k=300.0, k1=700.0, tau=0.1), path=SWING)
    plant = plant_of(moving, 10)
    assert moving.inner
    with pytest.raises(Refused, match="moves already"):
        Moving(environment=moving, path=SWING)
    assert plant.start == (0, 0.0)
    _, _, _, z = plant.move(plant.c, 0.0, 0.0, 0.0, plant.start)
    assert z[0] == 1
    assert z[1] < 0.0  # drawn along upward


# Hunt-Crossley contact: Hertz's closed forms and the first integral of its rebound


def beside(mass: float, dt: float, tol: float = 1e-9, **knobs: float) -> Plant:
    return implicit_plant(MassDamper(mass=mass), dt, resistance=HuntCrossley(**knobs).resistance(), tol=tol)


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


def test_a_ball_dropped_on_an_undamped_spring_comes_back_as_high_for_long() -> None:
    m, k, f, h = 0.1, 1e6, 1.0, 2e-3
    plant = beside(m, DT, 1e-11, k=k)
    states, z = run(plant, -h, 0.0, [f] * 600)
    energy = [0.5 * m * v * v - f * x + 0.4 * k * max(x, 0.0)**2.5 for x, v in states]
    fast = math.sqrt(2.0 * f * h / m)
    assert max(abs(e - energy[0]) for e in energy) <= 3.0 * z.total * (m * fast / DT + 50.0)
    assert sum(a[1] > 0.0 > b[1] for a, b in pairwise(states)) > 8


def test_it_resists_with_the_numbers_it_was_given() -> None:
    assert HuntCrossley.inner is True
    contact = HuntCrossley(k=2e5, n=2, lam=0.5, at=0.03, side=-1)
    assert contact.resistance() == Resistance(HUNT_CROSSLEY, 2e5, 0.0, 0.03, -1.0, 2.0, 0.5)
    plant = implicit_plant(MassDamper(mass=0.5), DT, resistance=contact.resistance())
    assert plant.force(plant.c, 0.029, -0.2, plant.start) == pytest.approx(-2e5 * 1e-6 * 1.1)
    assert plant.force(plant.c, 0.031, -0.2, plant.start) == 0.0
    assert plant.force(plant.c, 0.029, 2.1, plant.start) == 0.0  # drawn out faster than 1/lam: it cannot pull
