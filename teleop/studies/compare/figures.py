"""The figures of a comparison: columns, what each law comes to in them, rankings with their ties, and the table.

A *case* is one law over one link in one environment. Of each figure a law has one value a seed: the median over the
cases in which the figure counts. A run that did not end `ok` counts as worse than any that did: a law does not better
its figures by failing where it is hard. The value of a law is the mean over the seeds, and the *spread* their
range: two laws tie where their difference is no more than the greater of the two spreads, or than one percent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import exp, inf, isfinite, isnan, log, nan
from statistics import fmean
from textwrap import wrap
from typing import Any, NamedTuple

from teleop.errors import enumerated, number_of
from teleop.scene.axes import TURNING, AxisLabels
from teleop.studies.compare.cases import Case
from teleop.terminal.answer import WithUnit
from teleop.terminal.table import columns, printable

LOW, ONE, MORE, NEITHER = "low", "one", "more", ""  # the value that is best: the least, 1, the greatest, none
FREE, TOUCHED, ANY = "free", "touched", "any"  # the environments whose rows count
LEAST = 0.01  # a difference of at most this part of the value is none
TINY = 1e-9
FAILED = inf  # the value of a run that did not end ok, where less is better or 1 is best
UNSETTLED = "unsettled"  # a run that ended ok by its status, and swings or grows, see `compare/command.py`
BAD = (UNSETTLED, "limit cycle", "unstable")

Row = Mapping[str, Any]
ENDED = (("ok", ("ok",)), ("osc", BAD), ("div", ("diverged", "refused")))  # heads, and the endings behind them
NARROW = 60  # columns of a terminal below which nothing is wrapped
HALF_FAILED = "fail"
USUAL = {"sent": 1.0, "seed_energy": 0.0}  # what is not worth a column where all laws have it


class FigureColumn(NamedTuple):
    """Figure of the rows with one value for each law."""

    key: str  # the figure, by its name in the rows
    head: str  # over the column
    unit: str  # as it is printed, of axes along lines
    factor: float  # from the figure's SI unit to that one
    better: str  # LOW, ONE, MORE or NEITHER, which is not ranked
    where: str
    question: str  # that it answers, in rankings and over figures
    meaning: str


COLUMNS = (
    FigureColumn("gain_margin", "gain", "", 1.0, MORE, ANY, "gain margin",
                 "factor on the gain of the linear loop that makes it unstable, over links of constant delay; below 1 "
                 "it is"),
    FigureColumn("x_err_rms", "track", "mm", 1e3, LOW, ANY, "tracking error",
                 "slave against the master of one delay ago, rms"),
    FigureColumn("f_err_rms", "force", "N", 1.0, LOW, ANY, "force error", "felt force against touched force, rms"),
    FigureColumn("felt_drag", "drag", "N s/m", 1.0, LOW, FREE, "free-space drag",
                 "drag that the stack adds to the master where nothing is touched"),
    FigureColumn("felt_mass", "mass", "kg", 1.0, NEITHER, FREE, "free-space mass",
                 "mass that it adds there; below zero where it feels like a spring"),
    FigureColumn("wall_late", "wall", "%", 1e2, ONE, TOUCHED, "force on the wall",
                 "force on what is touched over the second half of the run, mean, in percent of a rigid rod's"),
    FigureColumn("wall_peak", "peak", "%", 1e2, ONE, TOUCHED, "peak force on the wall",
                 "largest force on what is touched, in percent of a rigid rod's"),
    FigureColumn("felt_share", "stiff", "%", 1e2, ONE, TOUCHED, "contact stiffness",
                 "stiffness felt at the end, where the hand rests in contact, in percent of the environment's"),
    FigureColumn("jerk_rms", "jerk", "N/s", 1.0, LOW, ANY, "smoothness, rms",
                 "rate of change of the reflected force, rms"),
    FigureColumn("jerk_999", "j99.9", "N/s", 1.0, LOW, ANY, "smoothness, 99.9 %",
                 "the rate of change that one tick in a thousand exceeds"),
    FigureColumn("drift_end", "drift", "mm", 1e3, LOW, FREE, "drift",
                 "slave against master at the end, nothing touched"),
    FigureColumn("energy_out", "out", "mJ", 1e3, LOW, ANY, "energy given out",
                 "most energy that law and link had given out at the ports beyond what they took up"),
    FigureColumn("seed_energy", "seed", "mJ", 1e3, NEITHER, ANY, "seed energy",
                 "energy that the law is given to begin with"),
    FigureColumn("sent", "sent", "%", 1e2, NEITHER, ANY, "packets", "packets sent, in percent of the ticks"),
)
BY_KEY = {column.key: column for column in COLUMNS}


def columns_in(units: Iterable[str]) -> dict[str, FigureColumn]:
    """The columns by their keys, in the units of axes in m or rad; in no unit where there are both.

    >>> [columns_in(units)["x_err_rms"].unit for units in (["m"], ["rad"], ["m", "rad"])]
    ['mm', 'mrad', '']
    """
    labels = AxisLabels(units=tuple(units))
    return {column.key: _in_units(column, labels) for column in COLUMNS}


def axis_title(column: FigureColumn) -> str:
    """The question that a column answers, with its unit if it has one."""
    return f"{column.question} ({column.unit})" if column.unit else column.question


def _in_units(column: FigureColumn, labels: AxisLabels) -> FigureColumn:
    prefix, base = ("m", "m") if column.unit == "mm" else ("", column.unit)
    if base not in TURNING:
        return column
    if unit := labels.unit(base):
        return column._replace(unit=prefix + unit)
    return column._replace(unit="", factor=1.0, meaning=f"{column.meaning}, over axes in m and in rad")


class LawFigure(NamedTuple):
    """Figure of a law: its mean over the seeds, its distance from the best value, and the range over the seeds."""

    value: float  # in the figure's own unit; NaN: no run has it, or half of them failed
    distance: float = nan  # see `distance`; inf: half of its runs failed
    spread: float = nan  # of the distance

    @property
    def failed(self) -> bool:
        """True if half of the runs in which it counts failed."""
        return self.distance == inf


@dataclass(frozen=True, kw_only=True)
class LawVerdict:
    """Figures of one law, and how its cases ended."""

    law: str
    cases: int  # with at least one row
    ended: Mapping[str, int]  # cases by how they ended; a case counts as the worst of its seeds
    figures: Mapping[str, LawFigure]  # by the column's key
    columns: Mapping[str, FigureColumn]  # in the units of the axes


@dataclass(frozen=True, kw_only=True)
class Ranking:
    """The laws in the order of one column, the best first; those within one group tie."""

    column: FigureColumn
    groups: tuple[tuple[tuple[str, float], ...], ...]  # law and value
    failed: tuple[str, ...]  # laws with half or more of their runs failed, where the figure counts


def judge_laws(rows: Sequence[Row], laws: Iterable[str], units: Iterable[str] = ("m",)) -> list[LawVerdict]:
    """Verdicts on the laws that have rows, in the order of `laws`; `units` of the axes, m or rad."""
    in_units = columns_in(units)
    free = free_environments(rows)
    by_law: dict[str, list[Row]] = {law: [] for law in laws}
    for row in rows:
        by_law[row["law"]].append(row)
    counting = {column.key: _environments(column, rows, free) for column in COLUMNS}
    return [LawVerdict(law=law, cases=len(endings(law_rows)), ended=Counter(endings(law_rows).values()),
                       figures={column.key: _law_figure(column, law_rows, counting[column.key]) for column in COLUMNS},
                       columns=in_units)
            for law, law_rows in by_law.items() if law_rows]


def endings(rows: Iterable[Row]) -> dict[tuple[str, str], str]:
    """Ending of each case of a law, by (environment, link): the worst of its seeds."""
    order = ("ok", *BAD, "diverged", "refused")
    worst: dict[tuple[str, str], str] = {}
    for row in rows:
        case = row["environment"], row["link"]
        worst[case] = max(worst.get(case, "ok"), row["ended"], key=order.index)
    return worst


def free_environments(rows: Iterable[Row]) -> set[str]:
    """The environments in which nothing is touched: no row has a force relative to a rigid rod's."""
    every, touched = set[str](), set[str]()
    for row in rows:
        if row["ended"] == "ok":
            every.add(row["environment"])
            if "wall_late" in row:
                touched.add(row["environment"])
    return every - touched


def _environments(column: FigureColumn, rows: Iterable[Row], free: set[str]) -> set[str]:
    """The environments in which a column counts: of its kind, with the figure from some law."""
    has = {row["environment"] for row in rows if row["ended"] == "ok" and column.key in row}
    if column.where == ANY or (column.where == FREE and not has & free):
        return has
    return has & free if column.where == FREE else has - free


def _law_figure(column: FigureColumn, rows: Iterable[Row], environments: set[str]) -> LawFigure:
    """The figure of one law in a column."""
    by_seed: dict[int, dict[tuple[str, str], float]] = {}
    once: dict[tuple[str, str], list[tuple[int, float]]] = {}
    for row in rows:
        if row["environment"] in environments:
            once.setdefault((row["environment"], row["link"]), []).append((row["seed"], value_of(column, row)))
    seeds = sorted({seed for values in once.values() for seed, _ in values})
    for seed in seeds:
        for case, values in once.items():
            # A link without dice has one row, which counts for every seed.
            value = dict(values).get(seed, values[0][1] if len(values) == 1 else nan)
            by_seed.setdefault(seed, {})[case] = value
    medians = [_median(column, [value for value in each.values() if not isnan(value)]) for each in by_seed.values()]
    medians = [each for each in medians if not isnan(each[1])]
    if not medians:
        return LawFigure(nan)
    away = [each[1] for each in medians]
    if inf in away:
        return LawFigure(nan, inf)
    return LawFigure(fmean(value for value, _ in medians), fmean(away), max(away) - min(away))


def case_values(column: FigureColumn, rows: Sequence[Row], laws: Iterable[str]) -> dict[str, list[float]]:
    """Values of a column by law, one a case: the mean over the seeds, inf where one failed."""
    environments = _environments(column, rows, free_environments(rows))
    by_law: dict[str, dict[tuple[str, str], list[float]]] = {law: {} for law in laws}
    for row in rows:
        value = value_of(column, row)
        if row["environment"] in environments and row["law"] in by_law and not isnan(value):
            by_law[row["law"]].setdefault((row["environment"], row["link"]), []).append(value)
    return {law: [fmean(values) for values in cases.values()] for law, cases in by_law.items()}


def value_of(column: FigureColumn, row: Row) -> float:
    """Figure of one row: `FAILED` if its run failed and it is a figure of runs, NaN if it has none."""
    if row["ended"] != "ok" and column.better in (LOW, ONE):
        return FAILED
    value = float(row.get(column.key, nan))
    return abs(value) if column.key == "felt_drag" else value


def distance(column: FigureColumn, value: float) -> float:
    """Distance of a value from the best one. If that is 1, half is as far as double; if it is inf, 1/value."""
    if column.better == ONE:
        return abs(log(max(value, TINY))) if value < FAILED else inf
    return 1.0 / max(value, TINY) if column.better == MORE else value


def _median(column: FigureColumn, values: list[float]) -> tuple[float, float]:
    """The median distance, of an even number of values the greater of the two in the middle, and the value that it is
    at; where 1 is the best, below it where most of the values are. NaN of none."""
    away = sorted(distance(column, value) for value in values)
    if not away:
        return nan, nan
    middle = away[len(away) // 2]
    if column.better == ONE and middle < inf:
        return exp(middle if sorted(values)[len(values) // 2] >= 1.0 else -middle), middle
    return (1.0 / middle if middle > 0.0 else inf) if column.better == MORE else middle, middle


def ranking(column: FigureColumn, verdicts: Sequence[LawVerdict]) -> Ranking:
    """The laws in the order of a column.

    A group begins with the best law that is left, and takes those that tie with it.
    """
    by_law = {each.law: each.figures[column.key] for each in verdicts}
    sound = {law: each for law, each in by_law.items() if isfinite(each.distance)}
    order = sorted(sound, key=lambda law: sound[law].distance)
    groups: list[list[str]] = []
    for law in order:
        if groups and ties(column, sound[groups[-1][0]], sound[law]):
            groups[-1].append(law)
        else:
            groups.append([law])
    return Ranking(column=column, failed=tuple(law for law, each in by_law.items() if each.failed),
                   groups=tuple(tuple((law, sound[law].value) for law in group) for group in groups))


def ties(column: FigureColumn, a: LawFigure, b: LawFigure) -> bool:
    """True if two figures are as far from the best, but for the greater spread or one percent."""
    least = LEAST if column.better == ONE else LEAST * max(a.distance, b.distance)  # a logarithm is a share
    return abs(a.distance - b.distance) <= max(a.spread, b.spread, least)


def rankings(verdicts: Sequence[LawVerdict]) -> list[Ranking]:
    """Rankings by the columns that have a better way and values of at least two laws."""
    ranked = [ranking(column, verdicts) for column in columns_of(verdicts).values() if column.better != NEITHER]
    return [each for each in ranked if sum(map(len, each.groups)) > 1]


def columns_of(verdicts: Sequence[LawVerdict]) -> Mapping[str, FigureColumn]:
    """The columns by their keys, as the verdicts have them."""
    return verdicts[0].columns if verdicts else BY_KEY


def held_back_laws(verdicts: Sequence[LawVerdict]) -> list[LawVerdict]:
    """The laws whose low tracking error says little: they hold the hand back.

    They track better than the median law, and press less than half as much as the rigid baseline.
    """
    errors = sorted(each.figures["x_err_rms"].value for each in verdicts if isfinite(each.figures["x_err_rms"].value))
    return [each for each in verdicts if errors and each.figures["x_err_rms"].value <= errors[(len(errors) - 1) // 2]
            and each.figures["wall_late"].value < 0.5]


def table(verdicts: Sequence[LawVerdict], width: int = 120) -> str:
    """The laws as rows; in a narrower terminal in several parts, each with the laws at its left.

    A figure that no law has, and packets that all laws send at every tick, have no column.
    """
    shown = columns_to_show(verdicts)
    lines = [["", *[head for head, _ in ENDED], *[column.head for column in shown]],
             ["law", *["" for _ in ENDED], *[column.unit for column in shown]]]
    lines += [cells(each, shown) for each in verdicts]
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


def cells(verdict: LawVerdict, shown: Sequence[FigureColumn]) -> list[str]:
    """The row of a law: its name, the number of cases by how they ended, and its figures."""
    return [verdict.law, *[str(sum(verdict.ended.get(status, 0) for status in some)) for _, some in ENDED],
            *[cell(column, verdict.figures[column.key]) for column in shown]]


def columns_to_show(verdicts: Sequence[LawVerdict]) -> list[FigureColumn]:
    """The columns that say anything."""
    figures = {column: [each.figures[column.key] for each in verdicts] for column in columns_of(verdicts).values()}
    return [column for column, some in figures.items() if any(each.failed or not isnan(each.value) for each in some)
            and not (column.better == NEITHER and {each.value for each in some} <= {USUAL.get(column.key)})]


def cell(column: FigureColumn, figure: LawFigure) -> str:
    """A figure as the table has it; a dash where there is none, `HALF_FAILED` where half of the runs failed."""
    return HALF_FAILED if figure.failed else "-" if isnan(figure.value) else digits(column.factor * figure.value)


def digits(value: float) -> str:
    """Three digits, below 1 two, without an exponent where that is possible in five characters and a sign."""
    size = abs(value)
    if size >= 99999.5:
        return f"{value:.0e}".replace("e+0", "e")
    if size < 5e-4:
        return "0"
    return f"{value:.{0 if size >= 99.95 else 1 if size >= 9.995 else 2 if size >= 0.0995 else 3}f}"


def text(verdicts: Sequence[LawVerdict], ranked: Sequence[Ranking], cases: Sequence[Case], heading: str,
         notes: Sequence[str] = (), width: int = 120) -> str:
    """The page of a comparison: heading, table, legend, rankings and notes."""
    parts = [heading, table(verdicts, width), legend(verdicts, width), "\n".join(_ranking_lines(ranked, width))]
    every_note = [*_held_back_notes(verdicts), *notes, *condition_notes(cases)]
    parts.append("\n".join(line for note in every_note for line in _wrap(f"note  {note}", width, 6)))
    return "\n\n".join(part for part in parts if part)


def legend(verdicts: Sequence[LawVerdict], width: int) -> str:
    """Meanings of the columns that are shown, in short."""
    shown = columns_to_show(verdicts)
    kinds = {FREE: " (free)", TOUCHED: " (in contact)"}
    meanings = "; ".join(f"{column.head}: {column.meaning}{kinds.get(column.where, '')}" for column in shown)
    return "\n".join(_wrap("Each figure is the median over the cases, in which a run that did not end ok is worse "
                           f"than any other; {HALF_FAILED}: half of them. {meanings}.", width, 0))


def _ranking_lines(ranked: Sequence[Ranking], width: int) -> list[str]:
    """A line for each question, the best first, = between laws that tie."""
    wide = max((len(each.column.question) for each in ranked), default=0)
    lines = ["best first; = where the difference is within the spread over seeds, or one percent"] if ranked else []
    for each in ranked:
        best = ", ".join(group_text(group, each.column) for group in each.groups)
        failed = f"; half of the runs failed: {', '.join(each.failed)}" if each.failed else ""
        lines += _wrap(f"{each.column.question:<{wide}}  {best} {each.column.unit}".rstrip() + failed, width, wide + 2)
    return lines


def group_text(group: Sequence[tuple[str, float]], column: FigureColumn) -> str:
    """Laws that tie, and the value of the first; the value of each where some are below the best and some above."""
    if column.better == ONE and len({value < 1.0 for _, value in group}) > 1:
        return " = ".join(f"{law} {digits(column.factor * value)}" for law, value in group)
    return " = ".join(law for law, _ in group) + f" {digits(column.factor * group[0][1])}"


def _held_back_notes(verdicts: Sequence[LawVerdict]) -> list[str]:
    return [f"{each.law} tracks well because the hand goes less far: its wall feels "
            f"{100.0 * each.figures['wall_late'].value:.0f} % of a rigid rod's force{_drag(each)}"
            for each in held_back_laws(verdicts)]


def _drag(verdict: LawVerdict) -> str:
    drag, unit = verdict.figures["felt_drag"].value, verdict.columns["felt_drag"].unit
    return f", its drag is {digits(drag)} {unit}".rstrip() if isfinite(drag) else ""


def condition_notes(cases: Sequence[Case]) -> list[str]:
    """Sentences on the laws that break a condition: over which links, and the condition in the first case."""
    by_law: dict[str, list[Case]] = {}
    for case in cases:
        if case.conditions:
            by_law.setdefault(case.law, []).append(case)
    notes = []
    for law, broken in by_law.items():
        links = list(dict.fromkeys(case.link for case in broken))
        notes.append(f"{law} breaks a condition in {number_of(len(broken), 'case')}, over {enumerated(links)}; in "
                     f"{broken[0].environment} over {broken[0].link}: {broken[0].conditions[0]}")
    return notes


def _wrap(line: str, width: int, indent: int) -> list[str]:
    return wrap(printable(line), max(width, NARROW), subsequent_indent=" " * indent, break_on_hyphens=False)


def document(verdicts: Sequence[LawVerdict], ranked: Sequence[Ranking], units: Mapping[str, str]) -> dict[str, object]:
    """The verdicts and rankings as JSON; a figure that no run has is null, one with half of its runs failed "failed".

    `units`: SI units of the figures by key.
    A spread is the range of the distance from the best value, see `distance`.
    """
    return {
        "laws": [{"law": each.law, "cases": each.cases, "ended": dict(each.ended),
                  "figures": {key: _figure_document(figure, units[key]) for key, figure in each.figures.items()}}
                 for each in verdicts],
        "columns": {column.key: {"unit": column.unit, "factor": column.factor, "better": column.better,
                                 "meaning": column.meaning} for column in columns_of(verdicts).values()},
        "rankings": {each.column.key: {"groups": [[law for law, _ in group] for group in each.groups],
                                       "failed": list(each.failed)} for each in ranked},
        "held_back": [each.law for each in held_back_laws(verdicts)],
    }


def _figure_document(figure: LawFigure, unit: str) -> Mapping[str, object]:
    if figure.failed or isnan(figure.value):
        return {"value": WithUnit("failed" if figure.failed else None, unit), "spread": None}
    return {"value": WithUnit(figure.value if isfinite(figure.value) else str(figure.value), unit),
            "spread": figure.spread}
