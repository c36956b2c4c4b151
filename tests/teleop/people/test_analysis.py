"""The analysis: rules of exclusion one by one, and plans of every task, method and design from answers to contrast."""

from __future__ import annotations

from typing import Any

import pytest

from teleop.people.analysis import broken_rule
from teleop.people.felt import felt_stiffness
from teleop.people.plan import Exclusion, StudyPlan
from teleop.people.recovery import study_of
from tests.teleop.people.plans import REACH, TEXT, plan_of

ADAPTIVE = TEXT.replace("levels = [350.0, 700.0, 1000.0]\nrepeats = 4", "levels = [1000.0, 850.0, 700.0]\ntrials = 40")
TARGETS = 'kind = "reach"\ndistances = [0.02, 0.05]\nwidths = [0.004]'
PLANS = {
    "staircase": ADAPTIVE.replace("standard", 'method = "staircase"\nstandard'),
    "quest": ADAPTIVE.replace("standard", 'method = "quest"\nstandard'),
    "orders at random": 'order = "random"\n' + TEXT,
    "between": 'design = "between"\n' + REACH,
    "press": REACH.replace(TARGETS, 'kind = "press"\nforces = [2.0, 5.0]').replace('"time"', '"overshoot"'),
    "free": REACH.replace(TARGETS, 'kind = "free"').replace("[analysis]", '[[question]]\nkind = "tlx"\n[analysis]')
                 .replace('"time"', '"tlx"'),
}


def study_plan(text: str, correction: str = "holm") -> StudyPlan:
    """The plan with its contrast in both directions: two with the same p."""
    return plan_of(text.replace('contrasts = [["smooth", "stiff"]]', f'correction = "{correction}"\n'
                                'contrasts = [["smooth", "stiff"], ["stiff", "smooth"]]'))


def test_each_rule_leaves_out_what_is_beyond_it_and_nothing_at_it() -> None:
    row: dict[str, Any] = {"stopped": False, "time": 1.0, "skipped": 0.01, "loss": 0.1, "focus_lost": False, "again": 0}
    for rules, beyond, reason in (
            (Exclusion(shortest=1.0), {"time": 0.99}, "answered too soon"),
            (Exclusion(longest=1.0), {"time": 1.01}, "took too long"),
            (Exclusion(most_skipped=0.01), {"skipped": 0.02}, "skipped ticks"),
            (Exclusion(most_loss=0.1), {"loss": 0.11}, "lost packets"),
            (Exclusion(focus_lost=True), {"focus_lost": True}, "page not in front"),
            (Exclusion(again=True), {"again": 2}, "run again")):
        assert broken_rule(rules, row | beyond) == reason
        assert broken_rule(rules, row) is None
        assert broken_rule(rules, row | dict.fromkeys(("time", "skipped", "loss"))) is None, "nothing was measured"
        assert broken_rule(Exclusion(), row | beyond) is None
        assert broken_rule(rules, row | {"stopped": True}) == "stopped"


@pytest.mark.parametrize("name", PLANS)
def test_a_study_of_each_kind_is_simulated_and_analysed(name: str) -> None:
    plan = study_plan(PLANS[name])
    found = study_of(plan, felt_stiffness(plan), 8)
    people = 4 * plan.conditions_each
    assert [each.people for each in found.after.summaries] == [people, people]
    assert all(each.low < each.mean < each.high for each in found.after.summaries)
    assert found.after.trials == 2 * people * plan.task.per_condition
    first, second = found.after.contrasts
    assert (first.estimate, first.t) == pytest.approx((-second.estimate, -second.t))
    assert first.people == 8


def test_p_values_are_corrected_only_where_the_plan_says_so() -> None:
    for correction, times in (("holm", 2.0), ("none", 1.0)):
        plan = study_plan(TEXT, correction)
        found = study_of(plan, felt_stiffness(plan), 8).after.contrasts
        assert [each.p_corrected for each in found] == pytest.approx([min(1.0, times * each.p) for each in found])
        assert found[0].p < 0.5
