"""From the rows of a comparison to what is said of each law: figures over all cases, and rankings with their ties.

A *case* is one law over one link in one environment. Of each figure a law has one value a seed: the median over the
cases in which the figure counts. A run that did not end `ok` counts as worse than any that did, so that a law cannot
better its figures by failing where it is hard. What is told is the mean over the seeds, and the *spread* their range:
two laws tie where their difference is no more than the greater of the two spreads, or than one percent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import exp, inf, isfinite, isnan, log, nan
from statistics import fmean
from typing import Any, NamedTuple

from teleop.studies.compare.columns import ANY, BY_KEY, COLUMNS, FREE, LOW, MORE, NEITHER, ONE, Column, columns_in

LEAST = 0.01  # a difference of at most this part of the value is none
TINY = 1e-9
FAILED = inf  # the value of a run that did not end ok, where less is better or 1 is best
UNSETTLED = "unsettled"  # a run that ended ok by its status, and swings or grows, see `teleop.studies.compare.work`
BAD = (UNSETTLED, "limit cycle", "unstable")

Row = Mapping[str, Any]


class Told(NamedTuple):
    """A figure of a law: its mean over the seeds, and how far from the best that is, with the range over the seeds."""

    value: float  # in the figure's own unit; NaN: no run has it, or half of them failed
    distance: float = nan  # see `distance`; inf: half of its runs failed
    spread: float = nan  # of the distance

    @property
    def failed(self) -> bool:
        """True if half of the runs in which it counts failed."""
        return self.distance == inf


@dataclass(frozen=True, kw_only=True)
class LawVerdict:
    """What is said of one law."""

    law: str
    cases: int  # with at least one row
    ended: Mapping[str, int]  # how many cases ended how; one counts as the worst of its seeds
    figures: Mapping[str, Told]  # by the column's key
    columns: Mapping[str, Column]  # in the units of the axes


@dataclass(frozen=True, kw_only=True)
class Ranking:
    """The laws in the order of one column, the best first; those within one group tie."""

    column: Column
    groups: tuple[tuple[tuple[str, float], ...], ...]  # law and value
    failed: tuple[str, ...]  # laws of whose runs, where the figure counts, half or more failed


def verdicts(rows: Sequence[Row], laws: Iterable[str], units: Iterable[str] = ("m",)) -> list[LawVerdict]:
    """One for each law that has rows, in the order of `laws`; `units`: those of the axes, m or rad."""
    columns = columns_in(units)
    free = free_environments(rows)
    by_law: dict[str, list[Row]] = {law: [] for law in laws}
    for row in rows:
        by_law[row["law"]].append(row)
    counting = {column.key: _environments(column, rows, free) for column in COLUMNS}
    return [LawVerdict(law=law, cases=len(endings(own)), ended=Counter(endings(own).values()),
                       figures={column.key: _told(column, own, counting[column.key]) for column in COLUMNS},
                       columns=columns)
            for law, own in by_law.items() if own]


def endings(rows: Iterable[Row]) -> dict[tuple[str, str], str]:
    """How each case of a law ended, by (environment, link): the worst of its seeds."""
    order = ("ok", *BAD, "diverged", "refused")
    found: dict[tuple[str, str], str] = {}
    for row in rows:
        case = row["environment"], row["link"]
        found[case] = max(found.get(case, "ok"), row["ended"], key=order.index)
    return found


def free_environments(rows: Iterable[Row]) -> set[str]:
    """The environments in which nothing is touched: no row has a force relative to a rigid rod's."""
    every, touched = set[str](), set[str]()
    for row in rows:
        if row["ended"] == "ok":
            every.add(row["environment"])
            if "wall_late" in row:
                touched.add(row["environment"])
    return every - touched


def _environments(column: Column, rows: Iterable[Row], free: set[str]) -> set[str]:
    """The environments in which a column counts: those of its kind in which some law has the figure."""
    has = {row["environment"] for row in rows if row["ended"] == "ok" and column.key in row}
    if column.where == ANY or (column.where == FREE and not has & free):
        return has
    return has & free if column.where == FREE else has - free


def _told(column: Column, rows: Iterable[Row], environments: set[str]) -> Told:
    """A column of one law."""
    by_seed: dict[int, dict[tuple[str, str], float]] = {}
    once: dict[tuple[str, str], list[tuple[int, float]]] = {}
    for row in rows:
        if row["environment"] in environments:
            once.setdefault((row["environment"], row["link"]), []).append((row["seed"], value_of(column, row)))
    seeds = sorted({seed for values in once.values() for seed, _ in values})
    for seed in seeds:
        for case, values in once.items():
            # A link without dice has one row, which is that of every seed.
            own = dict(values).get(seed, values[0][1] if len(values) == 1 else nan)
            by_seed.setdefault(seed, {})[case] = own
    told = [_median(column, [value for value in each.values() if not isnan(value)]) for each in by_seed.values()]
    told = [one for one in told if not isnan(one[1])]
    if not told:
        return Told(nan)
    away = [one[1] for one in told]
    if inf in away:
        return Told(nan, inf)
    return Told(fmean(value for value, _ in told), fmean(away), max(away) - min(away))


def case_values(column: Column, rows: Sequence[Row], laws: Iterable[str]) -> dict[str, list[float]]:
    """Of each law the values of a column, one a case: the mean over the seeds, inf where one failed."""
    environments = _environments(column, rows, free_environments(rows))
    found: dict[str, dict[tuple[str, str], list[float]]] = {law: {} for law in laws}
    for row in rows:
        value = value_of(column, row)
        if row["environment"] in environments and row["law"] in found and not isnan(value):
            found[row["law"]].setdefault((row["environment"], row["link"]), []).append(value)
    return {law: [fmean(values) for values in cases.values()] for law, cases in found.items()}


def value_of(column: Column, row: Row) -> float:
    """The figure of one row: `FAILED` if its run failed and the figure is that of a run, NaN if it has none."""
    if row["ended"] != "ok" and column.better in (LOW, ONE):
        return FAILED
    value = float(row.get(column.key, nan))
    return abs(value) if column.key == "felt_drag" else value


def distance(column: Column, value: float) -> float:
    """How far a value is from the best one. Where that is 1, half is as far as double; where it is inf, 1/value."""
    if column.better == ONE:
        return abs(log(max(value, TINY))) if value < FAILED else inf
    return 1.0 / max(value, TINY) if column.better == MORE else value


def _median(column: Column, values: list[float]) -> tuple[float, float]:
    """The median distance, of an even number of values the greater of the two in the middle, and the value that it is
    at; where 1 is the best, below it where most of the values are. NaN of none."""
    away = sorted(distance(column, value) for value in values)
    if not away:
        return nan, nan
    middle = away[len(away) // 2]
    if column.better == ONE and middle < inf:
        return exp(middle if sorted(values)[len(values) // 2] >= 1.0 else -middle), middle
    return (1.0 / middle if middle > 0.0 else inf) if column.better == MORE else middle, middle


def ranking(column: Column, found: Sequence[LawVerdict]) -> Ranking:
    """The laws in the order of a column.

    A group begins with the best law that is left, and takes those that tie with it.
    """
    told = {one.law: one.figures[column.key] for one in found}
    sound = {law: one for law, one in told.items() if isfinite(one.distance)}
    order = sorted(sound, key=lambda law: sound[law].distance)
    groups: list[list[str]] = []
    for law in order:
        if groups and ties(column, sound[groups[-1][0]], sound[law]):
            groups[-1].append(law)
        else:
            groups.append([law])
    return Ranking(column=column, failed=tuple(law for law, one in told.items() if one.failed),
                   groups=tuple(tuple((law, sound[law].value) for law in group) for group in groups))


def ties(column: Column, one: Told, other: Told) -> bool:
    """True if two figures are as far from the best, but for the greater spread or one percent."""
    least = LEAST if column.better == ONE else LEAST * max(one.distance, other.distance)  # a logarithm is a share
    return abs(one.distance - other.distance) <= max(one.spread, other.spread, least)


def rankings(found: Sequence[LawVerdict]) -> list[Ranking]:
    """One for each column that has a better way and a value of at least two laws."""
    made = [ranking(column, found) for column in columns_of(found).values() if column.better != NEITHER]
    return [one for one in made if sum(map(len, one.groups)) > 1]


def columns_of(found: Sequence[LawVerdict]) -> Mapping[str, Column]:
    """The columns by their keys, as the verdicts have them."""
    return found[0].columns if found else BY_KEY


def held_back(found: Sequence[LawVerdict]) -> list[LawVerdict]:
    """The laws whose low tracking error says little: they track better than the median law, and press less than half
    as much as a rigid rod would."""
    errors = sorted(one.figures["x_err_rms"].value for one in found if isfinite(one.figures["x_err_rms"].value))
    return [one for one in found if errors and one.figures["x_err_rms"].value <= errors[(len(errors) - 1) // 2]
            and one.figures["wall_late"].value < 0.5]
