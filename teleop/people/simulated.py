"""Simulated people: each step of a session answered by an observer with stated numbers, for `teleop study simulate`.

In a comparison each interval gives a felt stiffness with an error of w in its logarithm, and the larger one is the
answer; a lapse is an answer by chance. A reach takes Fitts' time and ends within the target as its width asks, an
effective width of 4.133 standard deviations. What a person does depends on the plan's seed, the person and the number
of the trial alone, so a session that is gone on with has the same answers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, log, log2
from typing import Any, Protocol

import numpy as np

from teleop.people.plan import QuestionKind, StudyCondition, StudyPlan, StudyQuestion, TaskKind
from teleop.people.schedule import Step, StepKind, Trial, dice, next_step
from teleop.people.scores import EFFECTIVE, PAIRS, TLX_ITEMS
from teleop.people.session import TrialOutcome, answer_row, break_row, session_row, trial_row

_PERSON, _TRIAL, _QUESTION = 1 << 30, 1 << 31, 1 << 32  # dice of their own


class JournalLines(Protocol):
    """A journal, on disk or in memory."""

    rows: list[dict[str, Any]]

    def append(self, row: Mapping[str, Any], /) -> None:
        """Keep a line."""


@dataclass(frozen=True, slots=True)
class Person:
    """A simulated person: what is added to ln w and to ln of times in all conditions."""

    plan: StudyPlan
    number: int
    felt: Mapping[str, Mapping[float, float]]  # by letter
    conditions: Mapping[str, StudyCondition]  # by letter

    def shift(self, letter: str, place: int) -> float:
        """Sum of what person, condition and place add to ln w and to ln of times."""
        simulated, (of_person, *of_conditions) = self.plan.simulated, dice(
            self.plan.seed, self.number, _PERSON).standard_normal(1 + len(self.plan.conditions))
        condition = self.conditions[letter]
        index = self.plan.conditions.index(condition)
        return float(simulated.spread * of_person + simulated.within * of_conditions[index]
                     + simulated.effects.get(condition.name, 0.0) + simulated.learning * (place - 1))

    def outcome(self, trial: Trial) -> TrialOutcome:
        """Carry out a trial."""
        draws = dice(self.plan.seed, self.number, _TRIAL, trial.number)
        shift = self.shift(trial.letter, trial.place)
        task, simulated = self.plan.task, self.plan.simulated
        pace = exp(shift + 0.1 * draws.standard_normal())
        if task.kind is TaskKind.COMPARE:
            return TrialOutcome(answer=self._compared(trial, shift, draws), time=1.5 * pace)
        if task.kind is TaskKind.REACH:
            time = (simulated.pause + simulated.slope * log2(trial.level / trial.width + 1.0)) * pace
            end = trial.level + trial.width / EFFECTIVE * draws.standard_normal()
            return TrialOutcome(time=float(time), end=float(end), overshoot=float(max(end - trial.level, 0.0)))
        if task.kind is TaskKind.PRESS:
            peak = trial.level * exp(abs(0.1 * exp(shift) * draws.standard_normal()))
            return TrialOutcome(time=1.5 * pace, peak_force=float(peak), overshoot=float(peak - trial.level))
        return TrialOutcome(time=task.seconds)

    def _compared(self, trial: Trial, shift: float, draws: np.random.Generator) -> int:
        felt, simulated = self.felt[trial.letter], self.plan.simulated
        w = simulated.w * exp(shift)
        walls = [self.plan.task.standard, trial.level]
        first, second = (log(felt[wall]) for wall in (walls if trial.second else walls[::-1]))
        errors = w * draws.standard_normal(2)
        if draws.random() < simulated.lapse:
            return 1 + int(draws.random() < 0.5)
        return 2 if second + errors[1] + simulated.bias > first + errors[0] else 1

    def answers(self, question: StudyQuestion, step: Step) -> dict[str, Any]:
        """Answer a question."""
        draws = dice(self.plan.seed, self.number, _QUESTION, step.place * 64 + step.question)
        load = 50.0 + 40.0 * (self.shift(step.letter, step.place) if step.letter else 0.0)
        if question.kind is QuestionKind.TEXT:
            return {"texts": ["" for _ in question.items]}
        if question.kind is QuestionKind.LIKERT:
            middle = 1.0 + (question.points - 1.0) * min(max(load / 100.0, 0.0), 1.0)
            return {"points": [int(min(max(round(middle + draws.standard_normal()), 1), question.points))
                               for _ in question.items]}
        ratings = [int(min(max(5 * round((load + 15.0 * draws.standard_normal()) / 5.0), 0), 100)) for _ in TLX_ITEMS]
        return {"ratings": ratings, **({"chosen": [int(pair[int(draws.random() < 0.5)]) for pair in PAIRS]}
                                       if question.weighted else {})}


def simulate_session(person: Person, journal: JournalLines) -> None:
    """Carry a session on to its end."""
    plan = person.plan
    if not journal.rows:
        journal.append(session_row(plan, person.number, f"simulated-{person.number}", simulated=True))
    while (step := next_step(plan, person.felt, person.number, journal.rows)).kind is not StepKind.END:
        if step.trial is not None:
            outcome = person.outcome(step.trial)
            journal.append(trial_row(plan, step.trial, outcome))
        elif step.kind is StepKind.BREAK:
            journal.append(break_row(step, step.seconds))
        else:
            journal.append(answer_row(plan, step, person.answers(plan.questions[step.question], step)))
