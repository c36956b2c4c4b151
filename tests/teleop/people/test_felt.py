"""Felt stiffness: closed forms, what can be told of it, and levels that nobody could tell."""

from __future__ import annotations

from dataclasses import replace
from math import log, sqrt

import pytest

from teleop.errors import Refused
from teleop.people.adaptive import phi
from teleop.people.felt import check_levels, felt_stiffness, hardest, in_series, limen
from teleop.people.plan import StudyCondition
from tests.teleop.people.plans import TEXT, plan_of


def test_the_difference_limen_is_asymmetric_behind_a_compliance_and_ends() -> None:
    for c, up, down in ((0.002, 0.618867, -0.320939), (0.0025, 0.754601, -0.347131)):
        walls = [limen(c, 500.0, 0.15, z) for z in (1.0, -1.0)]
        assert [wall / 500.0 - 1.0 for wall in walls if wall] == pytest.approx([up, down], abs=5e-7)
        for wall in walls:
            assert wall is not None
            ratio = log(in_series(c, wall) / in_series(c, 500.0))
            assert phi(abs(ratio) / (sqrt(2.0) * 0.15)) == pytest.approx(0.841345, abs=5e-7)
    assert hardest(0.002, 0.15) == pytest.approx(2116.0, abs=0.5)
    assert limen(0.002, 2115.0, 0.15) is not None
    assert limen(0.002, 2117.0, 0.15) is None
    assert hardest(0.0, 0.15) == float("inf")


def test_the_measured_compliance_is_the_laws_closed_form() -> None:
    """Waves: 1/K and the round trip over 2 b, less half a tick; position-position: 1/K."""
    felt = felt_stiffness(plan_of(TEXT))
    assert felt["smooth"] == pytest.approx({level: in_series(1e-3 + 0.04 / 40.0, level) for level in felt["smooth"]},
                                           rel=1e-3)
    assert felt["stiff"] == pytest.approx({level: in_series(1e-3, level) for level in felt["stiff"]}, rel=1e-6)


def test_a_law_that_passes_no_stiffness_on_is_measured_at_each_level_and_feels_the_same_everywhere() -> None:
    plan = plan_of(TEXT)
    drifting = replace(plan, conditions=(StudyCondition(name="lost", knobs={"law": "pfra"}),))
    values = list(felt_stiffness(drifting)["lost"].values())
    assert max(values) / min(values) == pytest.approx(1.0, abs=1e-6)
    assert max(values) < 100.0


def test_levels_that_no_one_could_tell_are_refused_with_the_law_and_the_bound() -> None:
    plan = plan_of(TEXT)
    hard = replace(plan, task=replace(plan.task, standard=2200.0, levels=(3000.0, 1500.0)))
    with pytest.raises(Refused, match=r"under 'smooth' no wall is told from 2200 N/m, however hard: its compliance of "
                                      r"0.002 m/N hides differences from 211\d N/m on"):
        check_levels(hard, felt_stiffness(hard))
    check_levels(plan, felt_stiffness(plan))
