"""The wall as a scene names it."""

import math

import pytest

from slave.wall import Wall
from teleop.errors import Refused
from teleop.physics.plant import MassDamper, move_free

BODY = MassDamper(mass=0.5, damping=1.0)


def test_canonical_wall_stops_a_body_at_its_surface() -> None:
    plant = Wall(k=5000.0, d=5.0, at=0.03).plant(BODY, 1e-3)
    assert plant.force(plant.c, 0.0299, 1.0) == 0.0
    assert plant.force(plant.c, 0.031, 0.1) == pytest.approx(5000.0 * 0.001 + 5.0 * 0.1)
    x, v = 0.0, 0.0
    for _ in range(5000):
        x, v, _ = plant.move(plant.c, x, v, 2.0)
    assert x == pytest.approx(0.03 + 2.0 / 5000.0, abs=1e-12)


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


def test_neither_stiff_nor_damped_is_no_wall() -> None:
    assert Wall(k=0.0).plant(BODY, 1e-3).move is move_free


def test_whole_numbers_are_numbers() -> None:
    assert Wall(k=5000, at=0, side=-1) == Wall(k=5000.0, at=0.0, side=-1.0)
    assert all(isinstance(c, float) for c in Wall(k=5000).plant(MassDamper(mass=1), 1e-3).c)


@pytest.mark.parametrize(("knobs", "says"), [
    ({"k": -1.0}, "k must be at least 0, not -1"),
    ({"k": math.inf}, "k must be finite"),
    ({"k": "hard"}, "k must be a number, not 'hard'"),
    ({"k": 1.0, "d": -0.5}, "d must be at least 0"),
    ({"k": 1.0, "at": math.nan}, "at must be finite"),
    ({"k": 1.0, "side": 0}, "side must be 1 .* or -1 .*, not 0"),
])
def test_impossible_walls_are_refused(knobs: dict[str, float], says: str) -> None:
    with pytest.raises(Refused, match=says):
        Wall(**knobs)
