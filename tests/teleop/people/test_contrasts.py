"""From answers to contrasts: exclusion, studies of every kind, power, least squares, and false alarms."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
import pytest
import scipy.special
import scipy.stats

from teleop.people.analysis import broken_rule
from teleop.people.contrasts import (
    Value,
    between,
    holm,
    noncentrality,
    paired_power,
    people_needed,
    small_sample,
    unpaired_power,
    within,
)
from teleop.people.felt import felt_stiffness
from teleop.people.plan import Exclusion, StudyPlan
from teleop.people.recovery import study_of
from teleop.people.schedule import williams
from tests.teleop.people.plans import REACH, TEXT, plan_of


def study(people: int, conditions: int, dice: np.random.Generator, *, effect: float = 0.0, learning: float = 0.0,
          fixed: bool = False) -> list[Value]:
    """A number for each person and condition, in the orders of a Williams square, or all in one order."""
    rows = williams(conditions)
    values = []
    for person in range(people):
        of_person = dice.normal(0.0, 1.0)
        for place, condition in enumerate(rows[0 if fixed else person % len(rows)], 1):
            value = of_person + effect * (condition == 0) + learning * place + dice.normal(0.0, 0.5)
            values.append(Value(person, "ABCDEF"[condition], place, value))
    return values


def test_power_and_the_interval_of_an_effect_size_are_those_of_the_noncentral_t() -> None:
    for d, n, power in ((0.5, 34, 0.807778), (0.8, 15, 0.821311), (1.0, 10, 0.803097)):
        assert paired_power(d, n) == pytest.approx(power, abs=5e-7)
        assert people_needed(paired_power, d, 0.8) == n
        assert paired_power(d, n - 1) < 0.8
    assert unpaired_power(0.5, 64) == pytest.approx(0.801460, abs=5e-6)  # Cohen's table: 64 in each group

    for t, df in ((2.9, 10), (-4.413, 8), (0.3, 33), (12.0, 5)):
        low, high = noncentrality(t, df, 0.05)
        assert scipy.stats.nct.cdf(t, df, low) == pytest.approx(0.975, abs=1e-6)
        assert scipy.stats.nct.cdf(t, df, high) == pytest.approx(0.025, abs=1e-6)
    assert small_sample(9) == pytest.approx(1.0 - 3.0 / (4 * 9 - 1), rel=1e-3)


def test_the_contrast_is_that_of_least_squares_by_person_condition_and_place() -> None:
    values = study(12, 2, np.random.default_rng(3), effect=0.4, learning=-0.3)
    contrast = within(values, "A", "B")
    design = np.zeros((len(values), 12 + 2))
    for row, each in zip(design, values, strict=True):
        row[each.person] = 1.0
        row[12], row[13] = float(each.condition == "A"), float(each.place == 2)
    y = np.array([each.value for each in values])
    solution, rest, rank, _ = np.linalg.lstsq(design, y, rcond=None)
    df = len(y) - rank
    error = sqrt(float(rest[0]) / df * np.linalg.pinv(design.T @ design)[12, 12])
    assert (contrast.df, contrast.people) == (df, 12)
    assert contrast.estimate == pytest.approx(solution[12], rel=1e-9)
    assert contrast.t == pytest.approx(solution[12] / error, rel=1e-9)
    assert contrast.p == pytest.approx(2.0 * scipy.stats.t.sf(abs(contrast.t), df), rel=1e-9)
    assert contrast.effect == pytest.approx(contrast.t / sqrt(12), rel=1e-9)  # balanced
    assert contrast.low < contrast.estimate < contrast.high
    low, high = contrast.effect_interval()
    ends = noncentrality(contrast.t, df, 0.05)
    assert [low, high] == pytest.approx([each / sqrt(12) * small_sample(df) for each in ends])
    assert contrast.corrected == pytest.approx(small_sample(df) * contrast.effect, rel=1e-12)


def test_between_people_it_is_the_t_test_of_two_groups() -> None:
    dice = np.random.default_rng(4)
    groups = {"A": dice.normal(0.5, 1.0, 9), "B": dice.normal(0.0, 1.0, 11)}
    values = [Value(i, name, 1, float(each)) for name, group in groups.items() for i, each in enumerate(group)]
    contrast = between(values, "A", "B")
    reference = scipy.stats.ttest_ind(groups["A"], groups["B"])
    assert (contrast.t, contrast.p, contrast.df) == pytest.approx((reference.statistic, reference.pvalue, reference.df))
    pooled = sqrt((8 * groups["A"].var(ddof=1) + 10 * groups["B"].var(ddof=1)) / 18)
    assert contrast.effect == pytest.approx((groups["A"].mean() - groups["B"].mean()) / pooled, rel=1e-9)


def test_false_alarms_are_five_in_a_hundred_where_others_are_too_few_or_far_too_many() -> None:
    """Two conditions, learning from place to place, no effect: 1500 studies of 12 people with 10 trials each.

    A paired t of numbers that learning has moved up in one half of the people and down in the other has a noncentral
    chi2 below it: exactly a mixture of t by Poisson's weights. A fixed order has the learning as its effect.
    """
    dice = np.random.default_rng(5)
    alarms = dict.fromkeys(("model", "paired t", "trials together", "fixed order"), 0)

    def p_of(difference: np.ndarray) -> float:
        t = difference.mean() / (difference.std(ddof=1) / sqrt(len(difference)))
        return float(2.0 * scipy.special.stdtr(len(difference) - 1, -abs(t)))

    for _ in range(1500):
        values = study(12, 2, dice, learning=-0.4)
        contrast = within(values, "A", "B")
        a, b = (np.array([each.value for each in values if each.condition == name]) for name in "AB")
        trials = [np.repeat(group, 10) + dice.normal(0.0, 0.5, 120) for group in (a, b)]
        alarms["model"] += contrast.p < 0.05
        alarms["paired t"] += p_of(a - b) < 0.05
        alarms["trials together"] += abs(np.diff([each.mean() for each in trials])[0]) > 1.97 * sqrt(
            sum(each.var(ddof=1) for each in trials) / 120)
        fixed = study(12, 2, dice, learning=-0.4, fixed=True)
        assert within(fixed, "A", "B") is None  # a fixed order tells no condition from its place
        c, d = (np.array([each.value for each in fixed if each.condition == name]) for name in "AB")
        alarms["fixed order"] += p_of(c - d) < 0.05
    shares = {name: count / 1500 for name, count in alarms.items()}
    assert shares["model"] == pytest.approx(0.05, abs=0.015)
    assert shares["paired t"] < 0.035
    poisson = scipy.stats.poisson.pmf(np.arange(100), 0.5 * 12 * 0.4**2 / 0.5)
    df = 11 + 2 * np.arange(100)
    mixed = 2.0 * float(poisson @ scipy.stats.t.sf(scipy.stats.t.ppf(0.975, 11) * np.sqrt(df / 11.0), df))
    for name, exact in (("paired t", mixed), ("fixed order", paired_power(0.4 / sqrt(0.5), 12))):
        assert shares[name] == pytest.approx(exact, abs=4.0 * sqrt(exact * (1.0 - exact) / 1500)), name
    assert shares["trials together"] > 0.1
    assert shares["fixed order"] > 0.24


def test_holm_corrects_in_steps_and_never_falls() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == [1.0, 1.0]
    p = list(np.random.default_rng(6).random(7) ** 3)
    corrected = holm(p)
    order = np.argsort(p)
    assert all(a <= b for a, b in zip(np.array(corrected)[order], np.array(corrected)[order][1:], strict=False))
    assert min(corrected) == pytest.approx(min(1.0, 7 * min(p)))
    assert all(a >= b for a, b in zip(corrected, p, strict=True))


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
