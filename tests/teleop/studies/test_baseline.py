"""The rigid baseline against closed form and scipy, its figures, and the scenes that have none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from teleop.scene.loading import load_scene
from teleop.studies.baseline import baseline_contact, contact_force, rigid_baseline


def test_pressed_to_rest_it_is_hand_and_wall_in_series() -> None:
    contact = baseline_contact(load_scene("hard_wall", duration=6.0))
    assert contact.late == pytest.approx(200.0 * 2e4 / (200.0 + 2e4) * (0.06 - 0.03), rel=1e-6)  # k_h, k_e, to - wall


def test_a_swing_against_tissue_is_that_of_one_body_of_all_masses() -> None:
    scene = load_scene("soft_tissue", duration=2.0)
    mass, damping = 0.4 + 0.1 + 0.5, 0.5 + 1.0
    w = np.pi

    def slope(t: float, y: list[float]) -> list[float]:
        hand = 200.0 * (0.05 * np.sin(w * t) - y[0]) + 5.0 * (0.05 * w * np.cos(w * t) - y[1])
        return [y[1], (hand - 200.0 * y[0] - (2.0 + damping) * y[1]) / mass]

    t = np.arange(2000) * 1e-3
    exact = solve_ivp(slope, (0.0, 2.0), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-12).y
    expected = contact_force(200.0 * exact[0] + 2.0 * exact[1])
    contact = baseline_contact(scene)
    assert contact.late == pytest.approx(expected.late, rel=2e-3)  # the hold of one tick
    assert contact.peak == pytest.approx(expected.peak, rel=2e-3)


def test_the_force_of_several_axes_is_their_magnitude_and_nothing_to_touch_has_none() -> None:
    assert contact_force(np.array([[3.0, 4.0], [0.0, 5.0]])) == (5.0, 5.0)
    assert baseline_contact(load_scene("free_motion", duration=0.1)) is None


def test_the_rod_presses_as_two_springs_in_series() -> None:
    """A hand of 200 N/m that reaches 0.03 m beyond the surface: F = k_h k_e/(k_h + k_e) 0.03."""
    for k_e in (100.0, 2000.0):
        steady = rigid_baseline(load_scene("hard_wall", k_e=k_e)).steady
        assert steady == pytest.approx(200.0 * k_e / (200.0 + k_e) * 0.03, rel=1e-6), k_e


def test_in_free_space_the_rod_moves_as_the_hand_and_presses_nothing() -> None:
    baseline = rigid_baseline(load_scene("free_motion", amplitude=0.04, frequency=0.05, duration=20.0))
    assert baseline.moved == pytest.approx(0.04 / 2.0**0.5, rel=0.01)  # slow: the grip's spring takes it along
    assert baseline.pressed == 0.0
    assert baseline.steady is None
    assert baseline.scale == pytest.approx(200.0 * baseline.moved)


def test_a_hand_that_keeps_moving_has_no_steady_force() -> None:
    baseline = rigid_baseline(load_scene("canonical", duration=2.0))
    assert baseline.steady is None
    assert baseline.scale == baseline.pressed > 0.0
