"""Terms and constraints of a point, by rows that are written down here."""

from __future__ import annotations

from math import sqrt
from typing import Any

import pytest

from teleop import Scene, load_scene
from teleop.studies.baseline import Baseline
from teleop.studies.tune.objective import FREE, OBJECTIVES, SCENE, Score, score

ROD = Baseline(moved=0.02, pressed=4.0, steady=5.0, scale=5.0, fastest=0.1)
RODS = {SCENE: ROD, FREE: ROD._replace(moved=0.04, pressed=0.0, steady=None)}
GOOD: dict[str, Any] = {"status": "ok", "ticks": 100, "x_err_rms": 0.002, "f_m_max": 6.0, "f_env_end": 4.0,
                        "f_m_end": 3.0, "f_env_max": 7.0, "swing_end": 0.0, "E_link_min": 0.0}
LIGHT = {**GOOD, "x_err_rms": 0.004, "f_m_max": 1.0, "f_env_end": 0.0, "f_m_end": 0.0, "f_env_max": 0.0}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("hard_wall", duration=0.1)


def judged(scene: Scene, *rows: tuple[str, dict[str, Any]], objective: str = "balanced") -> Score:
    return score(OBJECTIVES[objective], RODS, scene, rows)


def test_each_term_is_relative_to_the_rod_and_objectives_look_at_their_own(scene: Scene) -> None:
    rows = (SCENE, GOOD), (FREE, LIGHT)
    found = judged(scene, *rows)
    assert found.terms == pytest.approx({"tracking": 0.1, "drag": 0.2, "touch": 0.2, "feel": 0.4})
    assert found.value == pytest.approx(sqrt((0.01 + 0.04 + 0.04 + 0.16) / 4.0))
    assert found.order == (0.0, 0.0, found.value)
    for objective, value in (("tracking", 0.1), ("drag", 0.2), ("force", sqrt((0.04 + 0.16) / 2.0))):
        assert judged(scene, *rows, objective=objective).value == pytest.approx(value), objective


def test_the_rod_itself_is_worth_nothing_and_a_law_that_does_nothing_one(scene: Scene) -> None:
    rod = {**GOOD, "x_err_rms": 0.0, "f_env_end": 5.0, "f_m_end": 5.0}
    assert judged(scene, (SCENE, rod), (FREE, {**LIGHT, "x_err_rms": 0.0, "f_m_max": 0.0})).value == 0.0
    idle = {**GOOD, "x_err_rms": 0.02, "f_env_end": 0.0, "f_m_end": 0.0}
    found = judged(scene, (SCENE, idle), (FREE, {**LIGHT, "x_err_rms": 0.04, "f_m_max": 0.0}))
    assert found.value == pytest.approx(sqrt(3.0 / 4.0))


def test_a_small_error_that_keeps_the_hand_off_the_wall_is_worse_than_a_large_one_that_is_felt(scene: Scene) -> None:
    drags = judged(scene, (SCENE, {**GOOD, "x_err_rms": 0.0005, "f_env_end": 0.0}), (FREE, {**LIGHT, "f_m_max": 5.0}))
    follows = judged(scene, (SCENE, {**GOOD, "x_err_rms": 0.006}), (FREE, LIGHT))
    assert drags.value > follows.value


def test_a_row_that_breaks_a_constraint_says_which_and_is_no_feasible_point(scene: Scene) -> None:
    for row, sentence in (
            ({"status": "refused", "ticks": 0, "sentence": "b must be above 0"}, "refused: b must be above 0"),
            ({**GOOD, "status": "diverged", "ticks": 50}, "diverged at 0.05 s"),
            ({**GOOD, "status": "limit cycle"}, "limit cycle"),
            ({**GOOD, "swing_end": 0.01}, "a swing of 10.0 mm is left at the end"),
            ({**GOOD, "E_link_min": -0.02}, "E_link falls to -20.0 mJ"),
            ({**GOOD, "E_link_min": float("nan")}, "E_link"), ({**GOOD, "x_err_rms": float("nan")}, "")):
        found = judged(scene, (SCENE, row), (FREE, LIGHT))
        assert found.broken
        assert sentence in found.broken
        assert found.order > judged(scene, (SCENE, {**GOOD, "x_err_rms": 10.0}), (FREE, LIGHT)).order, sentence
        assert sentence in judged(scene, (SCENE, GOOD), (FREE, row)).broken
    early, late = (judged(scene, (SCENE, {**GOOD, "status": "diverged", "ticks": ticks})) for ticks in (10, 90))
    assert late.order < early.order  # of two that diverge the later comes nearer


def test_a_force_that_chatters_is_no_steady_force(scene: Scene) -> None:
    """200 N/s rms is 2 N in 10 ms, of the rod's 5 N."""
    found = judged(scene, (SCENE, {**GOOD, "jerk_rms": 200.0}), (FREE, LIGHT))
    assert found.terms["rough"] == pytest.approx(0.4)
    assert found.value > judged(scene, (SCENE, {**GOOD, "jerk_rms": 5.0}), (FREE, LIGHT)).value
