"""The schedule: balance of orders and of intervals, and the steps of a session as the journal grows."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from teleop.people.plan import Design, LevelMethod, Order, StudyPlan
from teleop.people.schedule import StepKind, next_step, order_of, trials_of, williams
from tests.teleop.people.plans import comparison


def session(plan: StudyPlan, participant: int) -> list[Any]:
    """The steps of a whole session, in which each answer is correct."""
    rows: list[dict[str, Any]] = [{"kind": "session"}]
    steps = []
    while (step := next_step(plan, {}, participant, rows)).kind is not StepKind.END:
        steps.append(step)
        rows.append({"kind": step.kind.value, "correct": True, "level": step.trial and step.trial.level})
    return steps


@pytest.mark.parametrize("n", range(2, 13))
def test_a_williams_square_has_each_condition_at_each_place_and_behind_each_other_as_often(n: int) -> None:
    rows = williams(n)
    assert len(rows) == (n if n % 2 == 0 else 2 * n)
    assert all(sorted(row) == list(range(n)) for row in rows)
    for place in range(n):
        assert set(Counter(row[place] for row in rows).values()) == {len(rows) // n}
    behind = Counter(pair for row in rows for pair in pairwise(row))
    assert len(behind) == n * (n - 1)
    assert set(behind.values()) == {len(rows) // n}


def test_each_set_of_people_is_balanced_in_orders_or_in_conditions() -> None:
    for n in (2, 3, 4, 5):
        plan = comparison(conditions=n)
        for first in range(1, 5 * plan.rows, plan.rows):
            orders = {tuple(order_of(plan, first + i)) for i in range(plan.rows)}
            assert orders == {tuple("ABCDE"[i] for i in row) for row in williams(n)}
        groups = replace(plan, design=Design.BETWEEN)
        assert sorted(order_of(groups, 1 + i)[0] for i in range(n)) == list("ABCDE"[:n])
        at_random = [order_of(replace(plan, order=Order.RANDOM), i) for i in range(1, 40)]
        assert len({*map(tuple, at_random)}) > 1
        assert all(sorted(order) == list("ABCDE"[:n]) for order in at_random)


def test_every_level_stands_first_as_often_as_second_and_no_order_comes_back() -> None:
    plan = comparison()
    seen = set()
    for participant in (1, 2, 3, 4):
        trials = [step.trial for step in session(plan, participant) if step.kind is StepKind.TRIAL]
        assert len(trials) == trials_of(plan)
        assert [trial.number for trial in trials] == list(range(1, len(trials) + 1))
        for letter in "AB":
            of_letter = [trial for trial in trials if trial.letter == letter and not trial.training]
            counts = Counter((trial.level, trial.second) for trial in of_letter)
            assert set(counts.values()) == {plan.task.repeats // 2}
            assert len(counts) == 2 * len(plan.task.levels)
            seen.add(tuple((trial.level, trial.second) for trial in of_letter))
    assert len(seen) == 8


def test_training_breaks_and_questions_stand_where_the_plan_puts_them() -> None:
    plan = comparison()
    kinds = [step.kind.value[0] for step in session(plan, 1)]
    block = "t" * plan.training + "b".join(["t" * plan.break_every] * 2) + "q"
    assert "".join(kinds) == block + block + "q"
    assert [step.trial.training for step in session(plan, 1) if step.trial][:plan.training + 1] == [True, True, False]


def test_a_session_begins_again_where_its_lines_end() -> None:
    """Nothing but the lines is needed: each prefix of a journal leads to the step that followed it."""
    for method in LevelMethod:
        plan = comparison(method=method)
        felt = {letter: {level: level for level in (plan.task.standard, *plan.task.levels)} for letter in "AB"}
        rows: list[dict[str, Any]] = []
        steps = []
        while (step := next_step(plan, felt, 2, rows)).kind is not StepKind.END:
            steps.append(step)
            level = 0.0 if step.trial is None else step.trial.level
            rows.append({"kind": step.kind.value, "correct": len(rows) % 3 > 0, "level": level})
        assert [next_step(plan, felt, 2, rows[:i]) for i in range(len(rows))] == steps
