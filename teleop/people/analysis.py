"""The analysis of a study: what is left out and why, each person's measures, and the contrasts, before and after.

A measure is one number of a person in a condition (`Measure`), so people are the sample and not trials. Weber fractions
and times are compared by their logarithms: a contrast of them is a ratio.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import exp, isfinite, log, nan
from typing import Any

from teleop.people.contrasts import Contrast, Value, between, holm, mean_interval, within
from teleop.people.fit import Answers, Fit, fit, grouped, with_interval
from teleop.people.journal import of_kind
from teleop.people.plan import ON_A_LOG_SCALE, Correction, Design, Exclusion, Measure, QuestionKind, StudyPlan
from teleop.people.scores import throughput, tlx_raw, tlx_weighted, tlx_weights

Row = Mapping[str, Any]
Felt = Mapping[str, Mapping[float, float]]  # by letter, of each level


@dataclass(slots=True)
class Excluded:
    """Exclusions: trials by reason, people with the reason, and fits that tell nothing."""

    trials: dict[str, int] = field(default_factory=dict)
    people: dict[int, str] = field(default_factory=dict)
    fits: list[tuple[int, str]] = field(default_factory=list)  # person and letter


@dataclass(frozen=True, slots=True)
class Summary:
    """A measure in a condition over the people: mean (geometric of a ratio), interval, and how many."""

    letter: str
    people: int
    mean: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Findings:
    """The findings of a study in one state, before or after exclusions."""

    people: int
    trials: int
    summaries: tuple[Summary, ...]
    contrasts: tuple[Contrast, ...]
    pooled: Mapping[str, Fit]  # of a comparison, by letter: all people as one observer
    answers: Mapping[str, Answers]  # likewise, what those were fitted to
    values: tuple[Value, ...]  # of each person


@dataclass(frozen=True, slots=True)
class Analysed:
    """The analysis of a study."""

    measure: Measure
    before: Findings
    after: Findings
    excluded: Excluded


def analyse(plan: StudyPlan, felt: Felt, people: Iterable[tuple[int, Sequence[Row]]], pairs: Sequence[tuple[str, str]],
            measure: Measure | None = None, *, pooled: bool = True) -> Analysed:
    """Analyse journals: `pairs` of letters are the contrasts. Raises `Refused` without scipy."""
    measure = measure or plan.analysis.primary
    journals = dict(people)
    everybody = {person: (_trials(rows), of_kind(rows, "question")) for person, rows in journals.items()}
    excluded = Excluded()
    journals_left = _within_rules(plan, everybody, excluded)
    after = _findings(plan, felt, journals_left, pairs, measure, excluded, pooled=pooled)
    untouched = not excluded.trials and not excluded.people
    before = after if untouched else _findings(plan, felt, everybody, pairs, measure, Excluded(), pooled=pooled)
    return Analysed(measure, before, after, excluded)


def every_pair(letters: Iterable[str]) -> list[tuple[str, str]]:
    """Pair each letter with each: the contrasts that are shown before a study is unblinded."""
    return list(combinations(sorted(letters), 2))


Journals = Mapping[int, tuple[Sequence[Row], Sequence[Row]]]  # trials and questionnaires of each person


def _trials(rows: Sequence[Row]) -> list[Row]:
    return [row for row in of_kind(rows, "trial") if not row["training"]]


def _within_rules(plan: StudyPlan, everybody: Journals, excluded: Excluded) -> Journals:
    journals_left = {}
    for person, (trials, questions) in everybody.items():
        left = []
        for row in trials:
            reason = broken_rule(plan.exclusion, row)
            if reason is None:
                left.append(row)
            else:
                excluded.trials[reason] = excluded.trials.get(reason, 0) + 1
        why = _person_rule(plan.exclusion, trials, left)
        if why is None:
            journals_left[person] = (left, questions)
        else:
            excluded.people[person] = why
    return journals_left


def broken_rule(rules: Exclusion, row: Row) -> str | None:
    """The rule that leaves a trial out; None if none does."""
    def beyond(name: str, bound: float | None, sign: float = 1.0) -> bool:
        value = row.get(name)
        return bound is not None and value is not None and sign * value > sign * bound

    if row["stopped"]:
        return "stopped"
    for is_broken, reason in (
            (beyond("time", rules.shortest, -1.0), "answered too soon"),
            (beyond("time", rules.longest), "took too long"),
            (beyond("skipped", rules.most_skipped), "skipped ticks"), (beyond("loss", rules.most_loss), "lost packets"),
            (rules.focus_lost and row["focus_lost"], "page not in front"), (rules.again and row["again"], "run again")):
        if is_broken:
            return reason
    return None


def _person_rule(rules: Exclusion, trials: Sequence[Row], left: Sequence[Row]) -> str | None:
    """The rule that leaves a person out, with the number; None if none does."""
    if rules.least_trials is not None and len(left) < rules.least_trials * len(trials):
        return f"{len(left)} of {len(trials)} trials are left, fewer than {rules.least_trials:.0%}"
    judged = [row["correct"] for row in left if row["correct"] is not None]
    if rules.least_correct is not None and judged and sum(judged) < rules.least_correct * len(judged):
        return f"{sum(judged) / len(judged):.0%} of the answers are correct, fewer than {rules.least_correct:.0%}"
    return None


def _findings(plan: StudyPlan, felt: Felt, journals: Journals, pairs: Sequence[tuple[str, str]], measure: Measure,
              excluded: Excluded, *, pooled: bool) -> Findings:
    cells = [(person, letter, [row for row in trials if row["letter"] == letter],
              [row for row in questions if row["letter"] == letter])
             for person, (trials, questions) in journals.items()
             for letter in dict.fromkeys(row["letter"] for row in (*trials, *questions) if row["letter"])]
    values: list[Value] = []
    for (person, letter, trials, questions), value in zip(cells, measured(plan, felt, measure, cells), strict=True):
        if isfinite(value):
            values.append(Value(person, letter, (*trials, *questions)[0]["place"], value))
        else:
            excluded.fits.append((person, letter))
    test = within if plan.design is Design.WITHIN else between
    alpha = plan.analysis.alpha
    contrasts = [each for pair in pairs if (each := test(values, *pair, alpha)) is not None]
    p = [each.p for each in contrasts]
    p = holm(p) if plan.analysis.correction is Correction.HOLM else p
    as_shown = exp if measure in ON_A_LOG_SCALE else float
    summaries = []
    for letter in sorted({each.condition for each in values}):
        of_letter = [each.value for each in values if each.condition == letter]
        mean, low, high = mean_interval(of_letter, alpha)
        summaries.append(Summary(letter, len(of_letter), as_shown(mean), as_shown(low), as_shown(high)))
    together: dict[str, Fit] = {}
    answers: dict[str, Answers] = {}
    if pooled and measure is Measure.W:
        for summary in summaries:
            of_all = answers[summary.letter] = grouped([signed_answers(plan, felt[summary.letter], [
                row for _, letter, trials, _ in cells if letter == summary.letter for row in trials])])
            together[summary.letter] = with_interval(of_all, fit(of_all)[0], 1.0 - alpha)
    return Findings(len(journals), sum(len(trials) for trials, _ in journals.values()), tuple(summaries),
                    tuple(replace(each, p_corrected=corrected) for each, corrected in zip(contrasts, p, strict=True)),
                    together, answers, tuple(values))


def signed_answers(plan: StudyPlan, felt: Mapping[float, float], rows: Sequence[Row]) -> list[tuple[float, bool]]:
    """Each trial's ln of felt stiffness, second over first, and whether the answer was the second."""
    standard = plan.task.standard
    return [((1.0 if row["second"] else -1.0) * log(felt[row["level"]] / felt[standard]), row["answer"] == 2)
            for row in rows if row["answer"] is not None]


Cell = tuple[int, str, Sequence[Row], Sequence[Row]]  # person, letter, and the trials and questionnaires of both


def measured(plan: StudyPlan, felt: Felt, measure: Measure, cells: Sequence[Cell]) -> list[float]:
    """A measure of each person in each condition, the logarithm of a ratio; NaN where there is none."""
    if measure not in (Measure.W, Measure.BIAS):
        return [_mean_of(plan, measure, trials, questions) for _, _, trials, questions in cells]
    pairs = [signed_answers(plan, felt[letter], trials) for _, letter, trials, _ in cells]
    values = [nan] * len(cells)
    some = [i for i, each in enumerate(pairs) if each]
    if some:
        answers = grouped([pairs[i] for i in some])
        for i, one in zip(some, fit(answers, plan.analysis.lapse), strict=True):
            values[i] = nan if one.is_at_bound else log(one.w) if measure is Measure.W else one.bias
    return values


def _mean_of(plan: StudyPlan, measure: Measure, trials: Sequence[Row], questions: Sequence[Row]) -> float:
    """A measure that needs no fit."""
    if measure is Measure.TLX:
        return _tlx(plan, questions)
    if measure is Measure.THROUGHPUT:
        return throughput([(row["level"], row["width"], row["end"], row["time"]) for row in trials
                           if row["end"] is not None and row["time"]])
    got = [row[measure.value] for row in trials if row[measure.value] is not None]
    got = [log(each) for each in got if each > 0.0] if measure is Measure.TIME else [float(each) for each in got]
    return sum(got) / len(got) if got else nan


def _tlx(plan: StudyPlan, questions: Sequence[Row]) -> float:
    scores = [tlx_weighted(row["ratings"], tlx_weights(row["chosen"])) if "chosen" in row else tlx_raw(row["ratings"])
              for row in questions if plan.questions[row["question"]].kind is QuestionKind.TLX]
    return sum(scores) / len(scores) if scores else nan
