"""A session: its steps and their balance, and a journal that goes on to the same bytes however it was cut."""

from __future__ import annotations

import os
import signal
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from teleop.errors import Refused
from teleop.people.felt import in_series
from teleop.people.journal import NAME, Journal, read_journal
from teleop.people.plan import Design, LevelMethod, Order, StudyPlan
from teleop.people.schedule import StepKind, next_step, order_of, trials_of, williams
from teleop.people.simulated import Person, simulate_session
from teleop.storage.strict_json import json_text
from tests.teleop.people.plans import comparison


def person(plan: StudyPlan, number: int = 3) -> Person:
    """A simulated person, behind a compliance of 0.002 m/N."""
    felt = {level: in_series(0.002, level) for level in (plan.task.standard, *plan.task.levels)}
    return Person(plan, number, dict.fromkeys("AB", felt), dict(zip("AB", plan.conditions, strict=True)))


def carried_on(plan: StudyPlan, path: Path) -> bytes:
    """The bytes of the journal after the session has been carried on to its end."""
    with Journal(path, sync=False) as journal:
        simulate_session(person(plan), journal)
    return path.read_bytes()


class DyingJournal(Journal):
    """A journal whose process is killed as soon as so many bytes are in the file."""

    die_at = 0

    def append(self, row: Mapping[str, Any]) -> None:
        """Write a line, or the part of it that makes the file long enough, and die."""
        line = json_text(row).encode() + b"\n"
        room = self.die_at - self.path.stat().st_size
        if room < len(line):
            os.write(self._file.fileno(), line[:room])
            os.kill(os.getpid(), signal.SIGKILL)
        super().append(row)


@pytest.mark.parametrize("method", LevelMethod)
def test_a_journal_that_is_cut_at_any_byte_goes_on_to_the_same_bytes(tmp_path: Path, method: LevelMethod) -> None:
    """Every fifth line is cut at each of its bytes' tenths, the whole journal at its ends."""
    plan = comparison(method=method)
    whole = carried_on(plan, tmp_path / "whole")
    path = tmp_path / NAME
    lines = whole.split(b"\n")
    places = {0, 1, len(whole) - 1, len(whole)}
    at = 0
    for i, line in enumerate(lines):
        places |= {at + len(line) * part // 10 for part in range(11)} if i % 10 == 3 else {at}
        at += len(line) + 1
    for cut in sorted(place for place in places if place <= len(whole)):
        path.write_bytes(whole[:cut])
        assert carried_on(plan, path) == whole, cut


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_session_killed_while_it_writes_goes_on_to_the_same_bytes_at_fifty_places(tmp_path: Path) -> None:
    """SIGKILL with a part of a line on the disk, each time a little further on."""
    plan = comparison()
    whole = carried_on(plan, tmp_path / "whole")
    path = tmp_path / NAME
    for place in range(50):
        child = os.fork()
        if child == 0:
            with DyingJournal(path, sync=False) as journal:
                journal.die_at = len(whole) * (place + 1) // 51
                simulate_session(person(plan), journal)
            os._exit(1)
        assert os.WIFSIGNALED(os.waitpid(child, 0)[1])
        assert path.stat().st_size == len(whole) * (place + 1) // 51
    assert carried_on(plan, path) == whole


def test_each_line_is_on_the_disk_before_the_next_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, synced = tmp_path / NAME, []
    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.append(os.fstat(descriptor).st_size))
    with Journal(path) as journal:
        synced.clear()
        for i in range(3):
            journal.append({"kind": "trial", "number": i})
            assert synced[-1] == path.stat().st_size
    assert len(synced) == 3


def test_two_processes_cannot_run_one_person_and_a_damaged_line_is_named(tmp_path: Path) -> None:
    path = tmp_path / "sub-01" / NAME
    path.parent.mkdir()
    with Journal(path, sync=False) as journal:
        journal.append({"kind": "session"})
        with pytest.raises(Refused, match="sub-01 is being run by another process; end that one first"):
            Journal(path)
    path.write_bytes(b'{"kind": "session"}\n{"kind" "trial"}\n')
    with pytest.raises(Refused, match=r"line 2 of .* is damaged \(it is no JSON"):
        Journal(path)
    path.write_bytes(b'[1]\n')
    with pytest.raises(Refused, match=r"line 1 of .* is no line of a journal"):
        read_journal(path)
    assert read_journal(tmp_path / "none") == []


def session(plan: StudyPlan, participant: int) -> list[Any]:
    """Return the steps of a whole session, in which each answer is correct."""
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
