"""What is asked next and what is fitted to the answers: against published numbers and independent optimisers."""

from __future__ import annotations

from itertools import combinations, pairwise
from math import exp, isnan, log, log2, sqrt

import numpy as np
import pytest
import scipy.optimize
import scipy.special
import scipy.stats

from teleop.people.adaptive import phi, quest_index, staircase_index
from teleop.people.fit import Answers, climb, deviance, fit, grouped, likeliest_lapse, with_interval
from teleop.people.scores import PAIRS, throughput, tlx_raw, tlx_weighted, tlx_weights

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


def test_folding_answers_to_correct_and_wrong_would_widen_w_by_a_bias() -> None:
    shown = 100_000
    p = scipy.stats.norm.cdf((SIGNED + 0.15) / (sqrt(2.0) * 0.15))
    signed = Answers(SIGNED[None], np.full((1, 12), float(shown)), (shown * p)[None])
    correct = np.where(SIGNED > 0.0, p, 1.0 - p)
    folded = Answers(np.abs(SIGNED)[None], np.full((1, 12), float(shown)), (shown * correct)[None])
    assert fit(signed)[0].w == pytest.approx(0.15, rel=1e-3)
    assert fit(signed)[0].bias == pytest.approx(0.15, rel=1e-3)
    assert fit(folded)[0].w > 0.17


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
