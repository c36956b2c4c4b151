"""Tissue that yields with time, as a scene names it."""

import math

import pytest

from slave.standard_linear_solid import StandardLinearSolid
from teleop.errors import Refused
from teleop.physics.plant import MassDamper


def test_it_pushes_and_pulls_and_starts_relaxed() -> None:
    plant = StandardLinearSolid(k=300.0, k1=700.0, tau=0.1, at=0.02).plant(MassDamper(mass=0.5), 1e-3)
    assert plant.start == (0.0,)
    assert plant.force(plant.c, 0.03, 0.1, plant.start) == pytest.approx(3.0)
    assert plant.force(plant.c, 0.01, 0.0, (1.0,)) == pytest.approx(-2.0)


def test_quick_pushes_meet_both_springs_and_slow_ones_the_lasting_one() -> None:
    solid, body = StandardLinearSolid(k=300.0, k1=700.0, tau=0.1), MassDamper(mass=1e25)
    for dt, stiffness in ((1e-6, 1000.0), (1e5, 300.0)):
        plant = solid.plant(body, dt)
        x, _, _, z = plant.move(plant.c, 0.0, 0.01 / dt, 0.0, plant.start)
        assert plant.force(plant.c, x, 0.0, z) == pytest.approx(stiffness * 0.01, rel=1e-4)


def test_its_plants_say_that_they_have_an_inner_state() -> None:
    assert StandardLinearSolid.inner
    assert StandardLinearSolid(k=300, k1=700, tau=1) == StandardLinearSolid(k=300.0, k1=700.0, tau=1.0)


@pytest.mark.parametrize(("knobs", "says"), [
    ({"k": -1.0, "k1": 1.0, "tau": 1.0}, "k must be at least 0"),
    ({"k": 1.0, "k1": math.inf, "tau": 1.0}, "k1 must be finite"),
    ({"k": 1.0, "k1": 1.0, "tau": 0.0}, "tau must be above 0"),
    ({"k": 1.0, "k1": 1.0, "tau": 1.0, "at": "here"}, "at must be a number"),
])
def test_impossible_solids_are_refused(knobs: dict[str, float], says: str) -> None:
    with pytest.raises(Refused, match=says):
        StandardLinearSolid(**knobs)
