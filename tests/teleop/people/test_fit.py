"""The psychometric fit: against an optimiser that knows nothing of it, and by what it covers."""

from __future__ import annotations

from math import exp, log, sqrt

import numpy as np
import pytest
import scipy.optimize
import scipy.special
import scipy.stats

from teleop.people.fit import Answers, climb, deviance, fit, grouped, likeliest_lapse, with_interval

WALLS = np.array([230.0, 320.0, 400.0, 640.0, 850.0, 1500.0])
X = np.log(1.0 / (0.002 + 1.0 / WALLS) / 250.0)  # felt through a compliance of 0.002 m/N, beside 500 N/m
SIGNED = np.concatenate([X, -X])


def drawn(rows: int, shown: int, *, w: float = 0.15, bias: float = 0.03, lapse: float = 0.02, seed: int = 1) -> Answers:
    """Answers of observers, each x shown so often."""
    p = 0.5 * lapse + (1.0 - lapse) * scipy.stats.norm.cdf((SIGNED + bias) / (sqrt(2.0) * w))
    second = np.random.default_rng(seed).binomial(shown, np.tile(p, (rows, 1))).astype(float)
    return Answers(np.tile(SIGNED, (rows, 1)), np.full_like(second, shown), second)


def one(answers: Answers, row: int) -> Answers:
    """A row by itself."""
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
