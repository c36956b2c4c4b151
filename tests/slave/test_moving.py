"""An environment that moves, as a scene names it."""

import math
from dataclasses import dataclass
from typing import Any

import pytest

from slave.moving import Moving
from slave.standard_linear_solid import StandardLinearSolid
from slave.tissue import Tissue
from slave.wall import Wall
from teleop.errors import Refused
from teleop.laws.wave import Wave
from teleop.physics.plant import MassDamper, Plant
from teleop.scene.scene import Scene
from teleop.simulation.bodies import slave_plants

BODY = MassDamper(mass=0.5, damping=1.0)
DT = 1e-3


@dataclass(frozen=True)
class Swing:
    """5 mm up and down in a second."""

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[list[float], ...]:
        assert (axes, dt_ns) == (1, 1_000_000)
        return ([0.005 * math.sin(2 * math.pi * k * dt_ns / 1e9) for k in range(count)],)


def plant_of(moving: Moving, ticks: int) -> Plant:
    """As a run makes it: the slave in this environment."""
    return slave_plants(Scene(law=Wave(), master=BODY, slave=BODY, environment=moving, dt=DT, duration=ticks * DT))[0]


def test_body_bonded_to_what_moves_slowly_goes_along() -> None:
    plant = plant_of(Moving(environment=Tissue(k=1e6, d=500.0, at=0.02), path=Swing()), 1000)
    x, v, z = 0.02, 0.0, plant.start
    for k in range(1, 1001):
        x, v, _, z = plant.move(plant.c, x, v, 0.0, z)
        assert x == pytest.approx(0.02 + 0.005 * math.sin(2 * math.pi * k * DT), abs=2e-5)


def test_wall_that_comes_is_met_where_it_comes_to() -> None:
    plant = plant_of(Moving(environment=Wall(k=5000.0, at=0.004, side=-1), path=Swing()), 1000)
    for k in (0, 40, 250):  # the surface is 4 mm beyond the path
        place = 0.004 + 0.005 * math.sin(2 * math.pi * k * DT)
        assert plant.force(plant.c, place + 1e-6, 0.0, (k,)) == 0.0
        assert plant.force(plant.c, place - 1e-3, 0.0, (k,)) == pytest.approx(-5.0)


def test_inner_state_of_what_moves_is_kept() -> None:
    moving = Moving(environment=StandardLinearSolid(k=300.0, k1=700.0, tau=0.1), path=Swing())
    plant = plant_of(moving, 10)
    assert moving.inner
    assert plant.start == (0, 0.0)
    _, _, _, z = plant.move(plant.c, 0.0, 0.0, 0.0, plant.start)
    assert z[0] == 1
    assert z[1] < 0.0  # drawn along upward


@pytest.mark.parametrize(("parts", "says"), [
    ({"environment": Wall, "path": Swing()}, "environment must be something with plant, not the class Wall"),
    ({"environment": 3, "path": Swing()}, "not 3; write for example environment=Wall"),
    ({"environment": Wall(k=1.0), "path": 0.1}, r"path must be something with samples, not 0\.1"),
    ({"environment": Wall(k=1.0), "path": Swing}, "not the class Swing"),
    ({"environment": Moving(environment=Wall(k=1.0), path=Swing()), "path": Swing()}, "moves already"),
])
def test_what_cannot_move_is_refused(parts: dict[str, Any], says: str) -> None:
    with pytest.raises(Refused, match=says):
        Moving(**parts)
