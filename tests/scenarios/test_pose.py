"""The scene `pose`: a tool comes back from its tilt as the hand does, after more than a turn, and nothing unwinds."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from scenarios.pose import at_lever
from teleop import PositionPosition, TwoLayer, load_scene, run
from teleop.physics.rotation import exp, log, product
from teleop.simulation.metrics import angle_error, quaternions

FREE = {"k_e": 0.0, "d_e": 0.0, "k_t": 0.0, "d_t": 0.0}


@lru_cache
def ran(law: str, **knobs: Any) -> Any:
    return run(load_scene("pose", law=law, **knobs))


@pytest.mark.parametrize("law", ["pp", *(pytest.param(name, marks=pytest.mark.full)
                                        for name in ("four_channel", "tdpa"))])
def test_the_tool_ends_as_the_hand_does_which_its_angles_alone_do_not_tell(law: str) -> None:
    """All tilts undone, phi says one and a half turns about the tilted axis; the tool stands otherwise."""
    trace = ran(law, **FREE).trace
    m, s = quaternions(trace, "m")[0][:, -1], quaternions(trace, "s")[0][:, -1]
    assert angle_error(trace, np.arange(len(trace["t"])), 0)[-1] < 1e-2
    phi = trace["x_s"][-1, 3:]
    assert np.linalg.norm(phi) == pytest.approx(3.0 * np.pi, abs=0.02)
    by_phi = np.array(log(*product(*exp(*phi), s[0], *-s[1:])))
    assert np.linalg.norm(by_phi) > 0.5
    assert np.linalg.norm(log(*product(*m, s[0], *-s[1:]))) < 1e-2


@pytest.mark.parametrize("law", ["pp", pytest.param("wave", marks=pytest.mark.full)])
def test_it_turns_on_through_half_a_turn_and_a_whole_one(law: str) -> None:
    trace = ran(law).trace
    about = trace["x_s"][1500:4400, 3:] @ (np.sin(0.6), 0.0, np.cos(0.6))
    assert about.max() > 2.8 * np.pi
    assert np.diff(about).min() > -1e-4


def test_it_touches_a_wall_and_twists_a_spring_and_both_are_felt() -> None:
    result = ran("pp")
    felt, touched = result.trace["f_m"][-1], result.trace["f_env"][-1]
    assert touched[0] > 1.0
    assert np.linalg.norm(touched[3:]) > 0.05  # N m
    assert felt == pytest.approx(touched, rel=0.02, abs=1e-3)


def test_a_law_at_the_end_of_a_lever_has_its_numbers_in_the_units_of_a_rotation() -> None:
    law = at_lever(PositionPosition(K=400.0, B=4.0, rejoin=2.0), 0.05)
    assert (law.K, law.B, law.rejoin) == (pytest.approx(1.0), pytest.approx(0.01), 2.0)
    tanks = at_lever(TwoLayer(H_d=0.05, f_max=40.0, alpha=500.0), 0.1)
    assert (tanks.H_d, tanks.f_max, tanks.alpha) == (0.05, pytest.approx(4.0), pytest.approx(5.0))
