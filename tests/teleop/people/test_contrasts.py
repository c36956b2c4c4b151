"""From answers to contrasts: staircases, fits, exclusion, power and false alarms, against independent optimisers."""

from __future__ import annotations

from itertools import combinations, pairwise
from math import exp, isnan, log, log2, sqrt
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import scipy.special
import scipy.stats

from teleop.people.adaptive import phi, quest_index, staircase_index
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
from teleop.people.fit import Answers, climb, deviance, fit, grouped, likeliest_lapse, with_interval
from teleop.people.plan import Exclusion, StudyPlan
from teleop.people.recovery import study_of
from teleop.people.schedule import williams
from teleop.people.scores import PAIRS, throughput, tlx_raw, tlx_weighted, tlx_weights
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


WALLS = np.array([230.0, 320.0, 400.0, 640.0, 850.0, 1500.0])
X = np.log(1.0 / (0.002 + 1.0 / WALLS) / 250.0)  # felt through a compliance of 0.002 m/N, beside 500 N/m
SIGNED = np.concatenate([X, -X])


def drawn(rows: int, shown: int, *, w: float = 0.15, bias: float = 0.03, lapse: float = 0.02, seed: int = 1) -> Answers:
    """Answers of observers, each x shown so often."""
    p = 0.5 * lapse + (1.0 - lapse) * scipy.stats.norm.cdf((SIGNED + bias) / (sqrt(2.0) * w))
    second = np.random.default_rng(seed).binomial(shown, np.tile(p, (rows, 1))).astype(float)
    return Answers(np.tile(SIGNED, (rows, 1)), np.full_like(second, shown), second)


def one(answers: Answers, row: int) -> Answers:
    return Answers(*(part[row:row + 1] for part in answers))


def likelihood(answers: Answers, w: float, bias: float, lapse: float) -> float:
    """The logarithm of the likelihood of one row, as the textbook has it."""
    p = 0.5 * lapse + (1.0 - lapse) * scipy.special.ndtr((answers.x[0] + bias) / (sqrt(2.0) * w))
    return float((scipy.special.xlogy(answers.second[0], p) + scipy.special.xlogy(
        answers.shown[0] - answers.second[0], 1.0 - p)).sum())


def test_the_fit_and_its_interval_are_those_of_an_optimiser_that_knows_only_the_likelihood() -> None:
    answers = drawn(2, 60)
    for row, fitted in enumerate(fit(answers)):
        mine = one(answers, row)

        def lost(values: np.ndarray, mine: Answers = mine, w: float | None = None) -> float:
            log_w, bias, lapse = values if w is None else (log(w), *values)
            return -likelihood(mine, exp(log_w), bias, min(max(lapse, 0.0), 0.1)) + 1e3 * max(0.0, -lapse, lapse - 0.1)

        best = scipy.optimize.minimize(lost, [log(0.2), 0.0, 0.03], method="Nelder-Mead",
                                       options={"xatol": 1e-7, "fatol": 1e-10, "maxiter": 4000})
        assert log(fitted.w) == pytest.approx(best.x[0], abs=3e-3)
        assert fitted.bias == pytest.approx(best.x[1], abs=2e-3)
        assert fitted.lapse == pytest.approx(best.x[2], abs=3e-3)
        interval = with_interval(mine, fitted, 0.95)
        half = 0.5 * scipy.stats.chi2.ppf(0.95, 1)
        for end in (interval.low, interval.high):
            profile = min(scipy.optimize.minimize(lost, [0.0, start], args=(mine, end), method="Nelder-Mead",
                                                   options={"xatol": 1e-7, "fatol": 1e-10}).fun
                           for start in (0.001, 0.05, 0.099))
            assert profile - best.fun == pytest.approx(half, rel=0.01)


def test_the_profile_interval_covers_w_in_95_of_a_hundred_studies() -> None:
    """200 studies of 768 trials; how many of 200 chance leaves of 95 % is binomial."""
    answers = drawn(200, 64)
    fits = fit(answers)
    best = np.array([each.likelihood for each in fits])
    covered = deviance(answers, best, np.full(200, log(0.15))) <= scipy.stats.chi2.ppf(0.95, 1)
    low, high = scipy.stats.binom.interval(0.95, 200, 0.95)
    assert low <= covered.sum() <= high
    assert np.mean([log(each.w) for each in fits]) == pytest.approx(log(0.15), abs=0.03)


def test_a_persons_few_trials_have_their_bias_reduced() -> None:
    """48 trials: fewer than half of the bias of the likeliest w, and no w far out."""
    answers = drawn(400, 4, w=0.11)
    reduced = np.log([each.w for each in fit(answers, 0.02)])
    slopes = climb(answers, np.full(400, 0.02)).a
    likeliest = -np.log(slopes * sqrt(2.0))
    assert abs(reduced.mean() - log(0.11)) < 0.06
    assert abs(reduced.mean() - log(0.11)) < 0.5 * abs(likeliest.mean() - log(0.11))
    assert reduced.std() < 0.6 * likeliest.std()
    assert reduced.min() > log(0.04)


def test_the_reduced_fit_is_that_of_an_optimiser_with_jeffreys_prior_added() -> None:
    """The information is made of the textbook's sum, with its slopes by differences of the probability."""
    answers = drawn(5, 4, w=0.11)
    for row, fitted in enumerate(fit(answers, 0.02)):
        x, shown, _ = (part[0] for part in one(answers, row))

        def probability(a: float, m: float, x: np.ndarray = x) -> np.ndarray:
            return np.asarray(0.01 + 0.98 * scipy.special.ndtr(a * x + m))

        def lost(at: np.ndarray, row: int = row, shown: np.ndarray = shown) -> float:
            a, m = at
            p = probability(a, m)
            slopes = np.stack([probability(a + 1e-4, m) - probability(a - 1e-4, m),
                               probability(a, m + 1e-4) - probability(a, m - 1e-4)]) / 2e-4
            information = slopes * shown / (p * (1.0 - p)) @ slopes.T
            value = likelihood(one(answers, row), 1.0 / (sqrt(2.0) * a), m / a, 0.02)
            return -value - 0.5 * float(np.linalg.slogdet(information)[1])

        best = scipy.optimize.minimize(lost, [4.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9})
        assert fitted.w == pytest.approx(1.0 / (sqrt(2.0) * best.x[0]), rel=1e-3)
        assert fitted.bias == pytest.approx(best.x[1] / best.x[0], abs=1e-3)


def test_answers_that_tell_no_w_are_known_by_its_bounds() -> None:
    perfect = grouped([[(float(x), x > 0.0) for x in SIGNED for _ in range(4)]])
    guessed = grouped([[(float(x), bool(i % 2)) for x in SIGNED for i in range(8)]])
    assert fit(perfect)[0].is_at_bound
    assert fit(guessed)[0].is_at_bound
    assert with_interval(guessed, fit(guessed)[0], 0.95).high == float("inf")
    assert likeliest_lapse(lambda lapse: -(lapse - 0.037) ** 2, 1)[0] == pytest.approx(0.037, abs=1e-3)


def test_answers_are_counted_by_stimulus() -> None:
    answers = grouped([[(0.1, True), (-0.2, False), (0.1, False)], [(0.3, True)]])
    assert answers.x.tolist() == [[-0.2, 0.1], [0.3, 0.0]]
    assert answers.shown.tolist() == [[1.0, 2.0], [1.0, 0.0]]
    assert answers.second.tolist() == [[0.0, 1.0], [1.0, 0.0]]


def chain(step: float, down: int = 2, easiest: float = 8.0) -> tuple[float, float]:
    """Mean level of the turns, and of all trials, of an n-down-1-up staircase in the long run, in deviations.

    A Markov chain over the levels 0, step, 2 step..., the correct answers in a row and the direction of the last step.
    """
    levels = np.arange(0.0, easiest, step)
    n = len(levels)
    share = np.array([phi(float(level)) for level in levels])
    place = np.arange(n * down * 2).reshape(n, down, 2)  # last: 0 went down, 1 went up
    moves = np.zeros((place.size, place.size))
    turns = np.zeros(place.size)
    for i, p in enumerate(share):
        for streak in range(down):
            for up in (0, 1):
                here = place[i, streak, up]
                moves[here, place[min(i + 1, n - 1), 0, 1]] += 1.0 - p
                turns[here] += (1.0 - p) * (not up)
                if streak < down - 1:
                    moves[here, place[i, streak + 1, up]] += p
                else:
                    moves[here, place[max(i - 1, 0), 0, 0]] += p
                    turns[here] += p * up
    equations = moves.T - np.eye(place.size)
    equations[-1] = 1.0
    long_run = np.linalg.solve(equations, np.eye(place.size)[-1])
    at = np.repeat(levels, down * 2)
    turning = long_run * turns
    return float(turning @ at / turning.sum()), float(long_run @ at)


def test_a_staircase_that_is_replayed_walks_as_its_chain_whose_long_run_is_the_published_one_says() -> None:
    """70.7 % for steps towards 0 alone; at .25 standard deviations a bias of a percent, at 1 of 6.5."""
    shares = [phi(chain(step)[0]) for step in (0.05, 0.25, 0.5, 1.0)]
    assert shares == pytest.approx([0.7074, 0.7174, 0.7367, 0.7727], abs=5e-5)
    levels = np.arange(0.0, 8.0, 0.25)[::-1]
    dice = np.random.default_rng(1)
    means = []
    for _ in range(60):
        answers: list[bool] = []
        path: list[float] = []
        for draw in dice.random(250):
            path.append(float(levels[staircase_index(len(levels), 2, answers)]))
            answers.append(bool(draw < phi(path[-1])))
        means.append(np.mean(path[100:]))
    assert np.mean(means) == pytest.approx(chain(0.25)[1], abs=4.0 * np.std(means, ddof=1) / sqrt(60))


def test_a_staircase_begins_at_the_easiest_level_and_moves_by_one() -> None:
    dice = np.random.default_rng(2)
    for down in (1, 2, 3):
        answers = [bool(each) for each in dice.random(60) < 0.7]
        path = [staircase_index(5, down, answers[:i]) for i in range(len(answers) + 1)]
        assert path[0] == 0
        assert all(abs(b - a) <= 1 for a, b in pairwise(path))
        assert all(b <= a for a, b, right in zip(path, path[1:], answers, strict=False) if not right)


def test_quest_shows_the_stimuli_of_a_reference_forty_of_forty_times() -> None:
    """The printed stimuli of questplus 2023.1: norm_cdf, 25 levels, 13 means, 12 deviations, min_entropy."""
    x, mean = np.round(np.linspace(-0.5, 0.7, 25), 10), np.round(np.linspace(-0.3, 0.3, 13), 10)
    deviation = np.round(np.geomspace(0.05, 1.0, 12), 10)
    table = np.array([[0.01 + 0.98 * phi((each - m) / s) for m in mean for s in deviation] for each in x])
    printed = [10, 12, 11, 13, 9, 5, 5, 0, 20, 1, 20, 19, 2, 18, 3, 17, 4, 17, 5, 16, 4, 5, 19, 6, 19, 19, 3, 18, 17, 4,
               17, 4, 16, 5, 15, 6, 15, 15, 6, 14]
    answers = [each == "1" for each in "0001101010110101010000111101101010101101"]
    shown = [quest_index(table, list(zip(printed[:i], answers[:i], strict=True))) for i in range(40)]
    assert shown == printed


def test_tlx_is_the_printed_one() -> None:
    ratings = (55, 10, 40, 25, 60, 35)
    assert tlx_raw(ratings) == 37.5
    weights = (5, 0, 3, 1, 4, 2)
    assert tlx_weighted(ratings, weights) == pytest.approx(48.6667, abs=5e-5)
    wins = [max(pair, key=lambda item: weights[item]) for pair in combinations(range(6), 2)]
    assert tlx_weights(wins) == weights
    assert sum(weights) == len(PAIRS) == 15


def test_throughput_goes_by_where_reaches_end() -> None:
    """Two targets with ends of a known mean and deviation: log2(D/(4.133 s) + 1) over the mean time, then the mean."""
    ends = np.array([-1.0, 1.0, -1.0, 1.0])
    reaches, expected = [], []
    for distance, width, deviation, time in ((0.1, 0.02, 0.004, 0.8), (0.05, 0.02, 0.002, 0.5)):
        spread = deviation * ends / np.sqrt(4.0 / 3.0)
        reaches += [(distance, width, distance - 0.001 + float(each), time) for each in spread]
        expected.append(log2((distance - 0.001) / (4.133 * deviation) + 1.0) / time)
    assert throughput(reaches) == pytest.approx(sum(expected) / 2.0, rel=1e-12)
    assert isnan(throughput(reaches[:1]))
