"""Tissue: bonded, so it pulls as well as it pushes."""

import math

import pytest

from slave.tissue import Tissue
from teleop.errors import Refused
from teleop.physics.plant import MassDamper


def test_tissue_pushes_and_pulls() -> None:
    plant = Tissue(k=300.0, d=2.0, at=0.02).plant(MassDamper(mass=0.5), 1e-3)
    assert plant.force(plant.c, 0.03, 0.1) == pytest.approx(300.0 * 0.01 + 0.2)
    assert plant.force(plant.c, 0.01, 0.0) == pytest.approx(-3.0)


def test_undamped_tissue_swings_at_its_own_frequency() -> None:
    m, k, at, dt = 0.5, 300.0, 0.02, 1e-3
    plant = Tissue(k=k, d=0.0, at=at).plant(MassDamper(mass=m), dt)
    x, v = at + 0.01, 0.0
    for _ in range(1000):
        x, v, _ = plant.move(plant.c, x, v, 0.0)
    assert x - at == pytest.approx(0.01 * math.cos(math.sqrt(k / m)), abs=1e-13)
    assert v == pytest.approx(-0.01 * math.sqrt(k / m) * math.sin(math.sqrt(k / m)), abs=1e-12)


@pytest.mark.parametrize(("knobs", "says"), [
    ({"k": -1.0, "d": 0.0}, "k must be at least 0"),
    ({"k": 1.0, "d": True}, "d must be a number"),
    ({"k": 1.0, "d": 1.0, "at": -math.inf}, "at must be finite"),
])
def test_impossible_tissue_is_refused(knobs: dict[str, float], says: str) -> None:
    with pytest.raises(Refused, match=says):
        Tissue(**knobs)
