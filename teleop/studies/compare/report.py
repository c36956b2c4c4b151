"""A comparison as a person reads it: one table with the laws as rows, rankings with their ties, notes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite, isnan
from textwrap import wrap

from teleop.errors import enumerated, number_of
from teleop.studies.compare.cases import Case
from teleop.studies.compare.columns import FREE, NEITHER, ONE, TOUCHED, Column
from teleop.studies.compare.judge import BAD, LawVerdict, Ranking, Told, columns_of, held_back
from teleop.terminal.printable import printable
from teleop.terminal.table import columns

ENDED = (("ok", ("ok",)), ("osc", BAD), ("div", ("diverged", "refused")))  # heads, and the endings behind them
NARROW = 60  # columns of a terminal below which nothing is wrapped
FAILED = "fail"
USUAL = {"sent": 1.0, "seed_energy": 0.0}  # what is not worth a column where all laws have it


def table(found: Sequence[LawVerdict], width: int = 120) -> str:
    """The laws as rows; in a terminal of less than its width in several parts, each with the laws at its left.

    A figure that no law has, and packets that all laws send at every tick, have no column.
    """
    shown = shown_columns(found)
    lines = [["", *[head for head, _ in ENDED], *[column.head for column in shown]],
             ["law", *["" for _ in ENDED], *[column.unit for column in shown]]]
    lines += [cells(one, shown) for one in found]
    parts: list[list[tuple[str, ...]]] = []
    first, *others = zip(*lines, strict=True)
    room = 0
    for column in others:
        wide = 2 + max(map(len, column))
        if not parts or room < wide:
            parts.append([first])
            room = max(width, NARROW) - max(map(len, first))
        parts[-1].append(column)
        room -= wide
    return "\n\n".join(columns(zip(*part, strict=True)) for part in parts)


def cells(one: LawVerdict, shown: Sequence[Column]) -> list[str]:
    """The row of a law: its name, how many cases ended how, and its figures."""
    return [one.law, *[str(sum(one.ended.get(status, 0) for status in some)) for _, some in ENDED],
            *[cell(column, one.figures[column.key]) for column in shown]]


def shown_columns(found: Sequence[LawVerdict]) -> list[Column]:
    """The columns that say anything."""
    told = {column: [one.figures[column.key] for one in found] for column in columns_of(found).values()}
    return [column for column, some in told.items() if any(one.failed or not isnan(one.value) for one in some)
            and not (column.better == NEITHER and {one.value for one in some} <= {USUAL.get(column.key)})]


def cell(column: Column, told: Told) -> str:
    """A figure as the table has it; a dash where there is none, `FAILED` where half of the runs failed."""
    return FAILED if told.failed else "-" if isnan(told.value) else digits(column.factor * told.value)


def digits(value: float) -> str:
    """Three digits, below 1 two, without an exponent where that is possible in five characters and a sign."""
    size = abs(value)
    if size >= 99999.5:
        return f"{value:.0e}".replace("e+0", "e")
    if size < 5e-4:
        return "0"
    return f"{value:.{0 if size >= 99.95 else 1 if size >= 9.995 else 2 if size >= 0.0995 else 3}f}"


def text(found: Sequence[LawVerdict], ranked: Sequence[Ranking], cases: Sequence[Case], heading: str,
         notes: Sequence[str] = (), width: int = 120) -> str:
    """All that is said of a comparison."""
    parts = [heading, table(found, width), legend(found, width), "\n".join(_ranked(ranked, width))]
    told = [*_held_back(found), *notes, *conditions(cases)]
    parts.append("\n".join(line for note in told for line in _wrapped(f"note  {note}", width, 6)))
    return "\n\n".join(part for part in parts if part)


def legend(found: Sequence[LawVerdict], width: int) -> str:
    """What the columns that are shown mean, in short."""
    shown = shown_columns(found)
    kinds = {FREE: " (free)", TOUCHED: " (in contact)"}
    told = "; ".join(f"{column.head}: {column.meaning}{kinds.get(column.where, '')}" for column in shown)
    return "\n".join(_wrapped("Each figure is the median over the cases, in which a run that did not end ok is worse "
                              f"than any other; {FAILED}: half of them. {told}.", width, 0))


def _ranked(ranked: Sequence[Ranking], width: int) -> list[str]:
    """A line for each question, the best first, = between laws that tie."""
    wide = max((len(one.column.question) for one in ranked), default=0)
    lines = ["best first; = where the difference is within the spread over seeds, or one percent"] if ranked else []
    for one in ranked:
        best = ", ".join(group_text(group, one.column) for group in one.groups)
        failed = f"; half of the runs failed: {', '.join(one.failed)}" if one.failed else ""
        lines += _wrapped(f"{one.column.question:<{wide}}  {best} {one.column.unit}".rstrip() + failed, width, wide + 2)
    return lines


def group_text(group: Sequence[tuple[str, float]], column: Column) -> str:
    """Laws that tie, and the value of the first; that of each where some are below the best value and some above."""
    if column.better == ONE and len({value < 1.0 for _, value in group}) > 1:
        return " = ".join(f"{law} {digits(column.factor * value)}" for law, value in group)
    return " = ".join(law for law, _ in group) + f" {digits(column.factor * group[0][1])}"


def _held_back(found: Sequence[LawVerdict]) -> list[str]:
    held = held_back(found)
    return [f"{one.law} tracks well because the hand goes less far: its wall feels "
            f"{100.0 * one.figures['wall_late'].value:.0f} % of a rigid rod's force{_drag(one)}" for one in held]


def _drag(one: LawVerdict) -> str:
    drag, unit = one.figures["felt_drag"].value, one.columns["felt_drag"].unit
    return f", its drag is {digits(drag)} {unit}".rstrip() if isfinite(drag) else ""


def conditions(cases: Sequence[Case]) -> list[str]:
    """Of each law whose condition is broken somewhere: over which links, and the sentence for the first."""
    by_law: dict[str, list[Case]] = {}
    for case in cases:
        if case.conditions:
            by_law.setdefault(case.law, []).append(case)
    told = []
    for law, broken in by_law.items():
        links = list(dict.fromkeys(case.link for case in broken))
        more = number_of(len(broken), "case")
        told.append(f"{law} breaks a condition in {more}, over {enumerated(links)}; in {broken[0].environment} over "
                    f"{broken[0].link}: {broken[0].conditions[0]}")
    return told


def _wrapped(line: str, width: int, indent: int) -> list[str]:
    return wrap(printable(line), max(width, NARROW), subsequent_indent=" " * indent, break_on_hyphens=False)


def document(found: Sequence[LawVerdict], ranked: Sequence[Ranking]) -> dict[str, object]:
    """The same as JSON can hold it; a figure that no run has is null, one that half of the runs failed at "failed".

    A spread is that of the distance from the best value, see `teleop.studies.compare.judge.distance`.
    """
    return {
        "laws": [{"law": one.law, "cases": one.cases, "ended": dict(one.ended),
                  "figures": {key: _figure(told) for key, told in one.figures.items()}}
                 for one in found],
        "columns": {column.key: {"unit": column.unit, "factor": column.factor, "better": column.better,
                                 "meaning": column.meaning} for column in columns_of(found).values()},
        "rankings": {one.column.key: {"groups": [[law for law, _ in group] for group in one.groups],
                                      "failed": list(one.failed)} for one in ranked},
        "held_back": [one.law for one in held_back(found)],
    }


def _figure(told: Told) -> Mapping[str, object]:
    if told.failed or isnan(told.value):
        return {"value": "failed" if told.failed else None, "spread": None}
    return {"value": told.value if isfinite(told.value) else str(told.value), "spread": told.spread}
