"""The schedule: which condition each person meets at which place, and which step of the session comes next.

A condition goes by a letter here. Which letter is which condition is in the study's key alone, so nothing of an order
tells a condition. Neither orders nor staircases keep a state: each step follows from the plan and the lines of the
person's journal.

A Williams square (E. J. Williams, "Experimental designs balanced for the estimation of residual effects of treatments",
Aust. J. Sci. Res. A 2, 1949) has each condition at each place equally often, and behind each other condition equally
often. For an even number n of conditions it has n rows; for an odd number it has 2n, the second n the first backwards.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Any

import numpy as np

from teleop.people.adaptive import next_level
from teleop.people.plan import After, Design, LevelMethod, Order, QuestionKind, StudyPlan, StudyQuestion, TaskKind

Row = Mapping[str, Any]  # a line of a journal
LETTERS = "ABCDEFGHIJKL"
TRAINING = 1 << 20  # trials of training have dice of their own


class StepKind(StrEnum):
    """Kind of a step of a session; also the kind of the line that it leaves in the journal."""

    TRIAL = "trial"
    BREAK = "break"
    QUESTION = "question"
    END = "end"


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """A trial as it is to be run; the condition goes by its letter."""

    number: int  # of the participant, from 1, training included
    letter: str
    place: int  # of the condition in the person's order, from 1
    training: bool
    level: float  # stiffness, distance or force
    width: float  # of a reach's target
    second: bool  # the level is in the second of two intervals, the standard in the first


@dataclass(frozen=True, kw_only=True, slots=True)
class Step:
    """The next step of a session."""

    kind: StepKind
    trial: Trial | None = None
    question: int = 0  # its number among the plan's
    letter: str = ""  # of the condition that a question is about; empty: of the session
    place: int = 0
    seconds: float = 0.0  # of a break


def williams(n: int) -> list[list[int]]:
    """The rows of a Williams square of n conditions.

    >>> williams(4)
    [[0, 3, 1, 2], [1, 0, 2, 3], [2, 1, 3, 0], [3, 2, 0, 1]]
    """
    first = [0]
    for i in range(1, n):
        first.append((n - (i + 1) // 2) if i % 2 else i // 2)
    rows = [[(each + shift) % n for each in first] for shift in range(n)]
    return rows if n % 2 == 0 or n == 1 else rows + [row[::-1] for row in rows]


def dice(*key: int) -> np.random.Generator:
    """Random numbers that these numbers key: the same wherever a run begins again."""
    words = np.zeros(4, np.uint64)
    words[:len(key) - 1] = key[1:]
    return np.random.Generator(np.random.Philox(key=np.array([key[0], 0x70656F706C65], np.uint64), counter=words))


@lru_cache(maxsize=4096)
def permutation(n: int, *key: int) -> tuple[int, ...]:
    """The numbers below n in a random order."""
    return tuple(int(each) for each in dice(*key).random(n).argsort(kind="stable"))


def order_of(plan: StudyPlan, participant: int) -> list[str]:
    """The letters of the conditions that a person meets, in order; `participant` counts from 1."""
    n = len(plan.conditions)
    if plan.design is Design.BETWEEN:
        block, at = divmod(participant - 1, n)
        return [LETTERS[permutation(n, plan.seed, 1, block)[at]]]
    if plan.order is Order.WILLIAMS:
        rows = williams(n)
        block, at = divmod(participant - 1, len(rows))
        return [LETTERS[each] for each in rows[permutation(len(rows), plan.seed, 2, block)[at]]]
    return [LETTERS[each] for each in permutation(n, plan.seed, 3, participant)]


def next_step(plan: StudyPlan, felt: Mapping[str, Mapping[float, float]], participant: int,
              rows: Sequence[Row]) -> Step:
    """The step that comes after the lines of a person's journal.

    `felt` has the felt stiffness of each level by letter (`StudyKey.felt`), which QUEST+ needs.
    """
    done = [row for row in rows if row["kind"] != "session"]
    at = 0
    trial = 0
    for place, letter in enumerate(order_of(plan, participant), 1):
        of_condition: list[Row] = []
        for i in range(plan.training + plan.task.per_condition):
            training = i < plan.training
            if plan.break_every and i > plan.training and (i - plan.training) % plan.break_every == 0:
                if at == len(done):
                    return Step(kind=StepKind.BREAK, place=place, letter=letter, seconds=plan.break_seconds)
                at += 1
            trial += 1
            if at == len(done):
                return Step(kind=StepKind.TRIAL, letter=letter, place=place, trial=_trial(
                    plan, felt.get(letter, {}), participant, trial, letter, place, i, of_condition))
            of_condition += [] if training else [done[at]]
            at += 1
        for number, question in enumerate(plan.questions):
            if question.after is After.CONDITION:
                if at == len(done):
                    return Step(kind=StepKind.QUESTION, question=number, letter=letter, place=place)
                at += 1
    for number, question in enumerate(plan.questions):
        if question.after is After.SESSION:
            if at == len(done):
                return Step(kind=StepKind.QUESTION, question=number)
            at += 1
    return Step(kind=StepKind.END)


def _trial(plan: StudyPlan, felt: Mapping[float, float], participant: int, number: int, letter: str, place: int, i: int,
           before: Sequence[Row]) -> Trial:
    """Trial `i` of a person in a condition, training included."""
    task, training = plan.task, i < plan.training
    index = i if training else i - plan.training
    key = (plan.seed, participant, place)
    adaptive = task.kind is TaskKind.COMPARE and task.method is not LevelMethod.CONSTANT and not training
    targets = task.targets or ((0.0, 0.0),)
    count = plan.training if training else task.per_condition
    if adaptive:
        level, width = next_level(task, felt, before), 0.0
        second = bool(dice(*key, number).random() < 0.5)
    else:
        # Each level as often first as second where there are two intervals: levels twice, then in a random order.
        cells = [(target, is_second) for is_second in (False, True) for target in targets]
        cells = cells if task.intervals == 2 else [(target, False) for target in targets]
        each = [cells[k % len(cells)] for k in range(count)]
        (level, width), second = each[permutation(count, *key, TRAINING * training)[index]]
    return Trial(number=number, letter=letter, place=place, training=training, level=level, width=width, second=second)


def seconds_of(plan: StudyPlan) -> float:
    """Length of a session: trials, turns, answers, breaks, questions; s, training included."""
    task = plan.task
    trial = task.intervals * (task.seconds + plan.turn) + ANSWER
    breaks = (task.per_condition - 1) // plan.break_every * plan.break_seconds if plan.break_every else 0.0
    behind = {after: sum(_answer_seconds(each) for each in plan.questions if each.after is after) for after in After}
    return (plan.conditions_each * ((plan.training + task.per_condition) * trial + breaks + behind[After.CONDITION])
            + behind[After.SESSION] + WELCOME)


BYTES_PER_SECOND = 280e3 / 2.6  # of a trial's record while the hand moves: hand, inputs and record, compressed
AT_REST = 25e3  # likewise, of the turn before it


def disk_of(plan: StudyPlan) -> float:
    """Size of the records of a person, bytes."""
    of_interval = plan.task.seconds * BYTES_PER_SECOND + plan.turn * AT_REST
    return trials_of(plan) * plan.task.intervals * of_interval


ANSWER, WELCOME = 2.0, 180.0  # s, that a person takes for an answer; for consent and instructions


def _answer_seconds(question: StudyQuestion) -> float:
    if question.kind is QuestionKind.TLX:
        return 150.0 if question.weighted else 60.0
    return (10.0 if question.kind is QuestionKind.LIKERT else 45.0) * len(question.items)


def trials_of(plan: StudyPlan) -> int:
    """Trials of a person, training included."""
    return plan.conditions_each * (plan.training + plan.task.per_condition)
