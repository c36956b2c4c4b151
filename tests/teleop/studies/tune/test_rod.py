"""The rigid rod that laws are compared with."""

from __future__ import annotations

import pytest

from teleop import load_scene
from teleop.errors import Refused
from teleop.studies.tune.rod import rod


@pytest.mark.parametrize("k_e", [100.0, 2000.0])
def test_the_rod_presses_as_two_springs_in_series(k_e: float) -> None:
    """A hand of 200 N/m that reaches 0.03 m beyond the surface: F = k_h k_e/(k_h + k_e) 0.03."""
    assert rod(load_scene("hard_wall", k_e=k_e)).steady == pytest.approx(200.0 * k_e / (200.0 + k_e) * 0.03, rel=1e-6)


def test_in_free_space_the_rod_moves_as_the_hand_and_presses_nothing() -> None:
    found = rod(load_scene("free_motion", amplitude=0.04, frequency=0.05, duration=20.0))
    assert found.moved == pytest.approx(0.04 / 2.0**0.5, rel=0.01)  # slow: the grip's spring takes it along
    assert found.pressed == 0.0
    assert found.steady is None
    assert found.scale == pytest.approx(200.0 * found.moved)


def test_a_hand_that_keeps_moving_has_no_steady_force() -> None:
    found = rod(load_scene("canonical", duration=2.0))
    assert found.steady is None
    assert found.scale == found.pressed > 0.0


@pytest.mark.parametrize(("scene", "knobs", "why"), [
    ("virtual_wall", {}, "no hand that moves a slave"),
    ("hard_wall", {"to": 0.0}, "moves nothing"),
    ("hard_wall", {"scale_x": 0.5}, "scales"),
])
def test_a_scene_that_no_law_can_be_tuned_in_is_refused(scene: str, knobs: dict[str, float], why: str) -> None:
    with pytest.raises(Refused, match=why):
        rod(load_scene(scene, duration=1.0, **knobs))
