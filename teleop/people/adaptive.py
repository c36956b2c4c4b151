"""The next level by the answers so far: n-down-1-up staircases and QUEST+. Neither keeps a state: both are replayed.

Staircase (H. Levitt, "Transformed up-down methods in psychoacoustics", J. Acoust. Soc. Am. 49, 1971): after `down`
correct answers at a level the next harder one, after each wrong answer the next easier one. Levitt's 70.7 % of
2-down-1-up is where a step down is as likely as a step up, and holds for steps towards 0 alone. With levels at 0, s,
2 s, ... standard deviations of the observer and its share of correct answers Phi(level), the trials at which the
staircase turns have a mean level of .5751 for s = .25, where .7174 are correct, and the trials together .7141; for
s = 1 it is .7727. So the answers are fitted, and a mean of reversals is never called 70.7 %.

QUEST+ (A. B. Watson, "QUEST+: a general multidimensional Bayesian adaptive psychometric method", J. Vision 17(3):10,
2017): of all levels the one after which the entropy of the posterior is expected to be least; the first of those alike.
Its observer is the one that the analysis fits: correct with

    p = lapse/2 + (1 - lapse) Phi(|ln(felt/felt standard)|/(sqrt 2 w)),

over a grid of w and lapse with an even prior. The level is felt through the condition's law, so the grid is one of felt
stiffness, and a law that hardly passes stiffness on gets levels farther apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from math import erf, log, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from teleop.people.plan import LevelMethod, TrialTask

Floats = NDArray[np.float64]
W_GRID = tuple(float(w) for w in np.geomspace(0.03, 1.0, 31))
LAPSE_GRID = (0.0, 0.02, 0.05, 0.1)


def phi(x: float) -> float:
    """The normal distribution's share below x.

    >>> round(phi(1.0), 6)
    0.841345
    """
    return 0.5 * (1.0 + erf(x / sqrt(2.0)))


def share_correct(x: float, w: float, lapse: float) -> float:
    """The share of answers for the interval that is stiffer by x in ln of felt stiffness; x has a bias in it."""
    return 0.5 * lapse + (1.0 - lapse) * phi(x / (sqrt(2.0) * w))


def next_level(task: TrialTask, felt: Mapping[float, float], before: Sequence[Mapping[str, Any]]) -> float:
    """The level of the next trial of a person in a condition, after the lines of its trials `before`.

    A trial that was stopped has no answer, and counts as none.
    """
    before = [row for row in before if row["correct"] is not None]
    if task.method is LevelMethod.STAIRCASE:
        easiest_first = sorted(task.levels, key=lambda level: -abs(log(level / task.standard)))
        return easiest_first[staircase_index(len(task.levels), task.down, [bool(row["correct"]) for row in before])]
    levels = tuple(task.levels)
    at = {level: i for i, level in enumerate(levels)}
    table = likelihoods(tuple(abs(log(felt[level] / felt[task.standard])) for level in levels))
    return levels[quest_index(table, [(at[row["level"]], bool(row["correct"])) for row in before])]


def staircase_index(levels: int, down: int, correct: Sequence[bool]) -> int:
    """Replay a staircase: the index of its level after these answers, 0 the easiest, at which it begins."""
    index = streak = 0
    for answer in correct:
        streak = streak + 1 if answer else 0
        if not answer:
            index = max(index - 1, 0)
        elif streak == down:
            index, streak = min(index + 1, levels - 1), 0
    return index


@lru_cache(maxsize=64)
def likelihoods(ratios: tuple[float, ...]) -> Floats:
    """The share of correct answers of each level (by |ln| of its felt stiffness ratio) for each point of the grid."""
    return np.array([[share_correct(ratio, w, lapse) for w in W_GRID for lapse in LAPSE_GRID] for ratio in ratios])


def quest_index(correct: Floats, answers: Sequence[tuple[int, bool]]) -> int:
    """The level that QUEST+ shows next; `correct[level, point of the grid]` is the share of correct answers."""
    posterior = np.ones(correct.shape[1]) / correct.shape[1]
    for level, is_correct in answers:
        posterior = posterior * (correct[level] if is_correct else 1.0 - correct[level])
        posterior /= posterior.sum()
    expected = np.zeros(correct.shape[0])
    for p in (correct, 1.0 - correct):
        joint = posterior * p
        share = joint.sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            after = joint / share[:, None]
            entropy = -np.where(after > 0.0, after * np.log(after), 0.0).sum(axis=1)
        expected += np.where(share > 0.0, share * entropy, 0.0)
    return int(np.argmin(expected))
