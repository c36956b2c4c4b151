"""Plans, each refusal by its whole sentence; what is felt of levels; steps of a session, and a journal that is cut."""

from __future__ import annotations

import os
import signal
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from math import log, sqrt
from pathlib import Path
from statistics import mean
from typing import Any

import pytest
import scipy.stats

from teleop.errors import Refused
from teleop.people.adaptive import phi
from teleop.people.felt import check_levels, felt_stiffness, hardest, in_series, limen
from teleop.people.journal import NAME, Journal, read_journal
from teleop.people.plan import Design, LevelMethod, Measure, Order, StudyCondition, StudyPlan
from teleop.people.plan_file import read_plan
from teleop.people.recovery import recovered, study_of, true_log_w
from teleop.people.schedule import StepKind, next_step, order_of, seconds_of, trials_of, williams
from teleop.people.simulated import Person, simulate_session
from teleop.storage.strict_json import json_text
from tests.teleop.people.plans import REACH, TEXT, comparison, plan_of

EXAMPLES = Path(__file__).parents[3] / "scenarios" / "examples" / "people"
WRONG = {  # what is written in place of what, and the sentence
    ('name = "small"', 'name = "my study"'):
        "plan.toml: name has at most 24 letters and digits, for it names the files, not 'my study'; write for "
        'example name = "feltstiffness"',
    ("seed = 5", "sed = 5"):
        "plan.toml has no key 'sed'; did you mean seed or set?; knobs go into set = {...}",
    ('scene = "hard_wall"', ""):
        'plan.toml has no scene; write scene = "hard_wall"',
    ("seed = 5", 'design = "mixed"'):
        "plan.toml: design is within or between, not 'mixed'; write design = \"within\"",
    ("least = 4", "least = 5"):
        "plan.toml [participants]: least is 5, which is no multiple of 2; write least = 6",
    ("least = 4\nmost = 8\nmultiple_of = 2", "least = 3\nmost = 9"):
        "plan.toml [participants]: least 3 and most 9 are not both multiples of the 2 orders, so some would stand"
        " more often; write multiple_of = 2, and numbers to suit",
    ("most = 8", "most = 2"):
        "plan.toml [participants]: most is 2, fewer than least, 4; write most = 4",
    ('name = "stiff"', 'name = "smooth"'):
        "plan.toml has two conditions called 'smooth'; give one of them another name",
    ('kind = "compare"', 'kind = "compares"'):
        "plan.toml [task]: kind is reach, press, compare or free, not 'compares'; write kind = \"reach\"",
    ("levels = [350.0,", "levels = [350.0, 350.0,"):
        "plan.toml [task]: levels has 350 twice; leave one of them out",
    ("levels = [350.0,", "levels = [500.0,"):
        "plan.toml [task]: levels have the standard itself, 500, where no answer is correct; leave it out",
    ("repeats = 4", "repeats = 5"):
        "plan.toml [task]: repeats is 5, an odd number, with which a level cannot stand first as often as second;"
        " write repeats = 6",
    ("repeats = 4", "trials = 40"):
        'plan.toml [task]: trials belongs to staircase and quest; write repeats, or method = "staircase"',
    ("repeats = 4", 'method = "staircase"'):
        "plan.toml [task]: the levels of a staircase lie on one side of its standard, 500; leave out those of the"
        " other side",
    ("repeats = 4", "distances = [0.1]"):
        "plan.toml [task] has no key 'distances'; there are: down, kind, knob, levels, method, repeats, seconds, "
        "show, standard, text, trials",
    ('items = ["Anything else?"]', ""):
        '[[question]] 2 of plan.toml has no items; write for example items = ["How hard was it to feel the '
        'wall?"]',
    ("weighted = true", 'items = ["a"]'):
        "[[question]] 1 of plan.toml: NASA-TLX has items of its own; leave items out",
    ('primary = "w"', 'primary = "throughput"'):
        "plan.toml [analysis]: a task compare has no throughput; there are: w, bias, correct, time, peak_force, "
        "tlx",
    ('["smooth", "stiff"]', '["smooth", "stif"]'):
        "plan.toml [analysis]: contrasts name the condition 'stif'; did you mean stiff?",
    ('["smooth", "stiff"]', '["smooth", "smooth"]'):
        "plan.toml [analysis]: a contrast is between two conditions, not of one with itself; leave it out",
    ("least_correct = 0.5", "least_right = 0.5"):
        "plan.toml [exclusion] has no key 'least_right'; did you mean least_trials or least_correct?",
    ("w = 0.15", "w = 0.0"):
        "plan.toml [simulated]: w must be above 0, not 0; write for example w=1",
    ("w = 0.15", "effects = {smoth = 0.1}"):
        "plan.toml [simulated] effects has no key 'smoth'; did you mean smooth?",
}


def test_a_wrong_plan_is_refused_in_one_sentence() -> None:
    for (before, after), sentence in WRONG.items():
        assert before in TEXT, before
        text = TEXT.replace(before, after, 1)
        with pytest.raises(Refused) as refused:
            plan_of(text)
        assert str(refused.value) == sentence


def test_a_session_is_as_long_as_its_trials_turns_breaks_and_questions() -> None:
    plan = plan_of(TEXT)
    assert trials_of(plan) == 2 * (2 + 12)
    assert seconds_of(plan) == pytest.approx(2 * (14 * (2 * (2.6 + 1.5) + 2.0) + 30.0 + 150.0) + 45.0 + 180.0)
    assert trials_of(plan_of(REACH)) == 2 * 2 * 3


@pytest.mark.parametrize("name", ["discrimination", "laws"])
def test_the_examples_are_simulated_and_analysed(name: str) -> None:
    """Six people: every condition has a measure, and the contrasts of the plan are there."""
    plan = read_plan(EXAMPLES / f"{name}.toml")
    felt = felt_stiffness(plan)
    check_levels(plan, felt)
    found = study_of(plan, felt, 6)
    assert not found.excluded.fits
    assert [each.people for each in found.after.summaries] == [found.after.people] * len(plan.conditions)
    assert len(found.after.contrasts) == len(plan.analysis.contrasts)
    assert all(each.p <= each.p_corrected <= 1.0 for each in found.after.contrasts)
    weighted = replace(plan, analysis=replace(plan.analysis, primary=Measure.TLX))
    assert all(0.0 <= each.mean <= 100.0 for each in study_of(weighted, felt, 4).after.summaries)


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_over_200_studies_w_is_recovered_and_contrasts_alarm_as_often_as_they_say() -> None:
    """The first example, from its answers to its contrast: each count within what 200 studies leave to chance."""
    plan = read_plan(EXAMPLES / "discrimination.toml")
    counts = recovered(plan, plan.participants.least, 200)
    low, high = scipy.stats.binom.interval(0.99, 200, 0.95)
    assert all(low <= covered <= high for covered in counts.covered.values()), counts
    false, = counts.false.values()
    assert scipy.stats.binom.interval(0.99, 200, 0.05)[0] <= false <= scipy.stats.binom.interval(0.99, 200, 0.05)[1]
    assert all(mean([*logs]) == pytest.approx(true_log_w(plan, name), abs=0.06)
               for name, logs in counts.estimates.items()), counts


def test_the_difference_limen_is_asymmetric_behind_a_compliance_and_ends() -> None:
    for c, up, down in ((0.002, 0.618867, -0.320939), (0.0025, 0.754601, -0.347131)):
        walls = [limen(c, 500.0, 0.15, z) for z in (1.0, -1.0)]
        assert [wall / 500.0 - 1.0 for wall in walls if wall] == pytest.approx([up, down], abs=5e-7)
        for wall in walls:
            assert wall is not None
            ratio = log(in_series(c, wall) / in_series(c, 500.0))
            assert phi(abs(ratio) / (sqrt(2.0) * 0.15)) == pytest.approx(0.841345, abs=5e-7)
    assert hardest(0.002, 0.15) == pytest.approx(2116.0, abs=0.5)
    assert limen(0.002, 2115.0, 0.15) is not None
    assert limen(0.002, 2117.0, 0.15) is None
    assert hardest(0.0, 0.15) == float("inf")


def test_the_measured_compliance_is_the_laws_closed_form() -> None:
    """Waves: 1/K and the round trip over 2 b, less half a tick; position-position: 1/K."""
    felt = felt_stiffness(plan_of(TEXT))
    assert felt["smooth"] == pytest.approx({level: in_series(1e-3 + 0.04 / 40.0, level) for level in felt["smooth"]},
                                           rel=1e-3)
    assert felt["stiff"] == pytest.approx({level: in_series(1e-3, level) for level in felt["stiff"]}, rel=1e-6)


def test_a_law_that_passes_no_stiffness_on_is_measured_at_each_level_and_feels_the_same_everywhere() -> None:
    plan = plan_of(TEXT)
    drifting = replace(plan, conditions=(StudyCondition(name="lost", knobs={"law": "pfra"}),))
    values = list(felt_stiffness(drifting)["lost"].values())
    assert max(values) / min(values) == pytest.approx(1.0, abs=1e-6)
    assert max(values) < 100.0


def person(plan: StudyPlan, number: int = 3) -> Person:
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
