"""A comparison as a person reads it: one table with the laws as rows, rankings with their ties, notes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite, isnan
from textwrap import wrap

from teleop.errors import enumerated, number_of
from teleop.studies.compare.cases import Case
from teleop.studies.compare.columns import COLUMNS, FREE, TOUCHED, Column
from teleop.studies.compare.judge import BAD, LawVerdict, Ranking, held_back
from teleop.terminal.printable import printable
from teleop.terminal.table import columns

ENDED = (("ok", ("ok",)), ("swing", BAD), ("div", ("diverged", "refused")))  # heads, and the statuses behind them
NARROW = 60  # columns of a terminal below which nothing is wrapped


def table(found: Sequence[LawVerdict], width: int = 120) -> str:
    """The laws as rows; in a terminal of less than its width in several parts, each with the laws at its left."""
    lines = [["", *[head for head, _ in ENDED], *[column.head for column in COLUMNS]],
             ["law", *["cases" for _ in ENDED], *[column.unit for column in COLUMNS]]]
    lines += [[one.law, *[str(sum(one.ended.get(status, 0) for status in some)) for _, some in ENDED],
               *[cell(column, one.figures[column.key].value) for column in COLUMNS]] for one in found]
    several = [line for line in zip(*lines, strict=True) if any(text not in ("", "-") for text in line[2:])]
    parts: list[list[tuple[str, ...]]] = []
    first, room = several[0], 0
    for column in several[1:]:
        wide = 2 + max(map(len, column))
        if not parts or room < wide:
            parts.append([first])
            room = max(width, NARROW) - max(map(len, first))
        parts[-1].append(column)
        room -= wide
    return "\n\n".join(columns(zip(*part, strict=True)) for part in parts)


def cell(column: Column, value: float) -> str:
    """A figure as the table has it; a dash where there is none, or where half of the runs failed."""
    return digits(column.factor * value) if isfinite(value) else "-" if isnan(value) else "failed"


def digits(value: float) -> str:
    """Three digits without an exponent where that is possible in six characters."""
    size = abs(value)
    if size >= 99999.5:
        return f"{value:.0e}".replace("e+0", "e")
    if size < 5e-4:
        return "0"
    return f"{value:.{0 if size >= 99.95 else 1 if size >= 9.995 else 2 if size >= 0.9995 else 3}f}"


def text(found: Sequence[LawVerdict], ranked: Sequence[Ranking], cases: Sequence[Case], heading: str,
         width: int = 120) -> str:
    """All that is said of a comparison."""
    parts = [heading, table(found, width), legend(found, width), "\n".join(_ranked(ranked, width))]
    told = [*_held_back(found), *conditions(cases)]
    parts.append("\n".join(line for note in told for line in _wrapped(f"note  {note}", width, 6)))
    return "\n\n".join(part for part in parts if part)


def legend(found: Sequence[LawVerdict], width: int) -> str:
    """What the columns that are shown mean, in short."""
    shown = [column for column in COLUMNS if any(not isnan(one.figures[column.key].value) for one in found)]
    kinds = {FREE: " (free)", TOUCHED: " (in contact)"}
    told = "; ".join(f"{column.head}: {column.meaning}{kinds.get(column.where, '')}" for column in shown)
    return "\n".join(_wrapped("Each figure is the median over the cases, in which a run that did not end ok is worse "
                              f"than any other. {told}.", width, 0))


def _ranked(ranked: Sequence[Ranking], width: int) -> list[str]:
    """A line for each question, the best first, = between laws that tie."""
    wide = max((len(one.column.question) for one in ranked), default=0)
    lines = ["best first; = where the difference is within the spread over seeds, or one percent"] if ranked else []
    for one in ranked:
        best = ", ".join(" = ".join(law for law, _ in group) + f" {cell(one.column, group[0][1])}"
                         for group in one.groups)
        failed = f"; half of the runs failed: {', '.join(one.failed)}" if one.failed else ""
        lines += _wrapped(f"{one.column.question:<{wide}}  {best} {one.column.unit}{failed}", width, wide + 2)
    return lines


def _held_back(found: Sequence[LawVerdict]) -> list[str]:
    held = held_back(found)
    return [f"{one.law} tracks well because the hand goes less far: its wall feels "
            f"{100.0 * one.figures['wall_late'].value:.0f} % of a rigid rod's force, its drag is "
            f"{digits(one.figures['felt_drag'].value)} N s/m" for one in held]


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
    """The same as JSON can hold it; a figure that no run has is null, one that half of the runs failed at the text
    "failed"."""
    return {
        "laws": [{"law": one.law, "cases": one.cases, "ended": dict(one.ended),
                  "figures": {key: _figure(told.value, told.spread) for key, told in one.figures.items()}}
                 for one in found],
        "columns": {column.key: {"unit": column.unit, "factor": column.factor, "better": column.better,
                                 "meaning": column.meaning} for column in COLUMNS},
        "rankings": {one.column.key: {"groups": [[law for law, _ in group] for group in one.groups],
                                      "failed": list(one.failed)} for one in ranked},
        "held_back": [one.law for one in held_back(found)],
    }


def _figure(value: float, spread: float) -> Mapping[str, object]:
    if isnan(value):
        return {"value": None, "spread": None}
    return {"value": value, "spread": spread} if isfinite(value) else {"value": "failed", "spread": None}
