"""Recovery: many simulated studies of a plan, and what its analysis makes of them: bias, coverage, false alarms, power.

Each study has other people and another seed. The numbers that they were made of are known, so it is counted how often
an interval covers them, how often a contrast is found that the plan's effects make, and how often one is found where
there is no effect: the same studies with all effects at nothing.
"""

from __future__ import annotations

from argparse import Namespace
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import exp, log, sqrt
from typing import Any

from teleop.people.analysis import Analysed, Felt, analyse
from teleop.people.felt import felt_stiffness
from teleop.people.plan import Measure, StudyPlan
from teleop.people.schedule import LETTERS
from teleop.people.simulated import Person, simulate_session
from teleop.terminal.answer import Answer
from teleop.terminal.table import columns, facts

_STUDY = 1_000_003  # between the seeds of studies


@dataclass(slots=True)
class MemoryJournal:
    """A journal in memory."""

    rows: list[dict[str, Any]] = field(default_factory=list)

    def append(self, row: Mapping[str, Any]) -> None:
        """Keep a line."""
        self.rows.append(dict(row))


@dataclass(slots=True)
class Recovered:
    """Counts over the studies; by condition (estimates) and by contrast (p values)."""

    studies: int = 0
    estimates: dict[str, list[float]] = field(default_factory=dict)  # of ln w
    covered: Counter[str] = field(default_factory=Counter)  # by the interval over people
    pooled: Counter[str] = field(default_factory=Counter)  # by the profile likelihood of all as one
    contrasts: Counter[str] = field(default_factory=Counter)  # found
    false: Counter[str] = field(default_factory=Counter)


def study_of(plan: StudyPlan, felt: Felt, people: int, *, pooled: bool = False) -> Analysed:
    """Simulate a study in memory, and analyse it; `felt` by the names of conditions."""
    letters = dict(zip(LETTERS, plan.conditions, strict=False))
    by_letter = {letter: felt[condition.name] for letter, condition in letters.items()}
    journals = []
    for number in range(1, people + 1):
        lines = MemoryJournal()
        simulate_session(Person(plan, number, by_letter, letters), lines)
        journals.append((number, lines.rows))
    of = {condition.name: letter for letter, condition in letters.items()}
    pairs = [(of[first], of[second]) for first, second in plan.analysis.contrasts]
    return analyse(plan, by_letter, journals, pairs, pooled=pooled)


def true_log_w(plan: StudyPlan, name: str) -> float:
    """The mean of ln w over people in a condition, by which places it has on average."""
    simulated = plan.simulated
    return log(simulated.w) + simulated.effects.get(name, 0.0) + simulated.learning * 0.5 * (plan.conditions_each - 1)


def recovered(plan: StudyPlan, people: int, studies: int, show: Callable[[int], None] = lambda _: None) -> Recovered:
    """Simulate and analyse so many studies, with and without effects."""
    felt, counts = felt_stiffness(plan), Recovered()
    names = {letter: condition.name for letter, condition in zip(LETTERS, plan.conditions, strict=False)}
    for i in range(studies):
        show(i)
        each = replace(plan, seed=plan.seed + _STUDY * (i + 1))
        counts.studies += 1
        findings = study_of(each, felt, people, pooled=plan.analysis.primary is Measure.W).after
        for contrast in findings.contrasts:
            counts.contrasts[f"{names[contrast.first]} - {names[contrast.second]}"] += (
                contrast.p_corrected < plan.analysis.alpha)
        without = replace(each, simulated=replace(plan.simulated, effects={}))
        null = study_of(without, felt, people).after if plan.simulated.effects else findings
        for contrast in null.contrasts:
            counts.false[f"{names[contrast.first]} - {names[contrast.second]}"] += contrast.p < plan.analysis.alpha
        if plan.analysis.primary is Measure.W:
            for summary in findings.summaries:
                name = names[summary.letter]
                true, one = exp(true_log_w(plan, name)), findings.pooled[summary.letter]
                counts.estimates.setdefault(name, []).append(log(summary.mean))
                counts.covered[name] += summary.low <= true <= summary.high
                counts.pooled[name] += one.low <= true <= one.high
    return counts


def recover(args: Namespace, plan: StudyPlan, people: int, show: Callable[[int], None],
            head: Mapping[str, Any]) -> Answer:
    """Answer `teleop study simulate --recover N`."""
    counts = recovered(plan, people, args.recover, show)
    n = counts.studies
    error = sqrt(0.95 * 0.05 / n)
    parts = [facts([("study", f"{plan.name}: {n} simulated studies of {people} people"),
                    ("chance", f"a share of 0.95, or 0.05, over {n} studies has a standard error of {error:.3f}")])]
    if counts.estimates:
        lines = [["condition", "true w", "mean w", "bias", "covered", "as one"]]
        for name, estimates in counts.estimates.items():
            true, mean = exp(true_log_w(plan, name)), exp(sum(estimates) / len(estimates))
            lines.append([name, f"{true:.4f}", f"{mean:.4f}", f"{mean / true - 1.0:+.1%}",
                          f"{counts.covered[name] / n:.3f}", f"{counts.pooled[name] / n:.3f}"])
        parts.append(columns(lines))
    if counts.contrasts:
        lines = [["contrast", "found", "without effect"]]
        lines += [[name, f"{count / n:.3f}", f"{counts.false[name] / n:.3f}"]
                  for name, count in counts.contrasts.items()]
        parts.append(columns(lines))
    document = {**head, "participants": people, "studies": n, "found": {k: v / n for k, v in counts.contrasts.items()},
                "false_alarms": {k: v / n for k, v in counts.false.items()},
                "coverage": {k: v / n for k, v in counts.covered.items()},
                "coverage_as_one": {k: v / n for k, v in counts.pooled.items()},
                "w": {k: exp(sum(v) / len(v)) for k, v in counts.estimates.items()}}
    return Answer("\n\n".join(parts), document)
