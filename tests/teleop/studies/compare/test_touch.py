"""Force on what is touched: the rigid rod against closed form and scipy, and the figures of forces."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from teleop.scene.loading import load_scene
from teleop.studies.compare.touch import touch_of, touch_of_rod


def test_pressed_to_rest_it_is_hand_and_wall_in_series() -> None:
    touch = touch_of_rod(load_scene("hard_wall", duration=6.0))
    assert touch is not None
    assert touch.late == pytest.approx(200.0 * 2e4 / (200.0 + 2e4) * (0.06 - 0.03), rel=1e-6)  # k_h, k_e, to - wall


def test_a_swing_against_tissue_is_that_of_one_body_of_all_masses() -> None:
    scene = load_scene("soft_tissue", duration=2.0)
    mass, damping = 0.4 + 0.1 + 0.5, 0.5 + 1.0
    w = np.pi

    def slope(t: float, y: list[float]) -> list[float]:
        hand = 200.0 * (0.05 * np.sin(w * t) - y[0]) + 5.0 * (0.05 * w * np.cos(w * t) - y[1])
        return [y[1], (hand - 200.0 * y[0] - (2.0 + damping) * y[1]) / mass]

    t = np.arange(2000) * 1e-3
    exact = solve_ivp(slope, (0.0, 2.0), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-12).y
    expected = touch_of(200.0 * exact[0] + 2.0 * exact[1])
    touch = touch_of_rod(scene)
    assert touch is not None
    assert touch.late == pytest.approx(expected.late, rel=2e-3)  # the hold of one tick
    assert touch.peak == pytest.approx(expected.peak, rel=2e-3)


def test_nothing_to_touch_has_no_touch_of_rod() -> None:
    assert touch_of_rod(load_scene("free_motion", duration=0.1)) is None


def test_the_force_of_several_axes_is_their_magnitude() -> None:
    assert touch_of(np.array([[3.0, 4.0], [0.0, 5.0]])) == (5.0, 5.0)
