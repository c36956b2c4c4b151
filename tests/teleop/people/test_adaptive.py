"""Staircases against their exact chain, and QUEST+ against the stimuli of a published implementation."""

from __future__ import annotations

from itertools import pairwise
from math import sqrt
from typing import NamedTuple

import numpy as np
import pytest

from teleop.people.adaptive import phi, quest_index, staircase_index


class StaircaseChain(NamedTuple):
    """Long run of a staircase; levels in standard deviations of the observer."""

    turning: float  # mean level of the trials at which it turns
    trial: float  # mean level of all trials
    correct: float  # share of correct answers


def chain(step: float, down: int = 2, easiest: float = 8.0) -> StaircaseChain:
    """The long run of an n-down-1-up staircase over the levels 0, step, 2 step, ..., exact: a Markov chain.

    Its states are the level, the correct answers in a row and the direction of the last step.
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
    return StaircaseChain(turning=float(turning @ at / turning.sum()), trial=float(long_run @ at),
                 correct=float(long_run @ np.repeat(share, down * 2)))


def test_the_long_run_of_two_down_one_up_is_the_exact_one() -> None:
    """70.7 % for steps towards 0 alone; at .25 standard deviations a bias of a percent, at 1 of 6.5."""
    shares = [phi(chain(step).turning) for step in (0.05, 0.25, 0.5, 1.0)]
    assert shares == pytest.approx([0.7074, 0.7174, 0.7367, 0.7727], abs=5e-5)
    quarter = chain(0.25)
    assert (quarter.turning, quarter.trial, quarter.correct) == pytest.approx((0.57506, 0.59999, 0.71411), abs=5e-6)


def test_a_staircase_that_is_replayed_walks_as_its_chain_says() -> None:
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
    assert np.mean(means) == pytest.approx(chain(0.25).trial, abs=4.0 * np.std(means, ddof=1) / sqrt(60))


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
