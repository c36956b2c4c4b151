"""Layout of a sweep's picture of a table: the knobs that vary, the panels, the scales, the colours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from teleop.errors import Refused
from teleop.simulation.metrics import UNITS
from teleop.sweeps.table import Table
from teleop.terminal.plotting import BLACK, BLUE, BROWN, GREEN, ORANGE, PALE, PINK, PURPLE, RED, SKY, YELLOW, literal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WAYS = 1_000_000  # to choose the values that are shown
PANELS = 6  # at most, in one picture
WITHOUT = ("refused", "none ended ok", "no such metric")  # what a point without a median may be
# Told apart by who does not see red, green or blue too.
STATUS = {"ok": SKY, "limit cycle": YELLOW, "unstable": PURPLE, "diverged": RED, "none ended ok": RED, "refused": PALE}
OTHER = BROWN  # whatever else: stopped
TEXTS = (BLUE, RED, GREEN, ORANGE, PINK, SKY, BLACK)
DECADES = 100.0  # a metric whose values are this far apart gets a log scale


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlottedKnob:
    """A knob that varies: its values in order, and for each row the place of its value there."""

    name: str
    unit: str
    values: tuple[Any, ...]
    place: NDArray[Any]
    numeric: bool

    @property
    def label(self) -> str:
        return literal(f"{self.name} ({self.unit})" if self.unit else self.name, most=80)


@dataclass(frozen=True, kw_only=True, slots=True)
class Panel:
    """A pair of axes: its title and its rows."""

    title: str
    rows: NDArray[Any]


def varying(table: Table, units: Mapping[str, str]) -> tuple[list[PlottedKnob], list[str]]:
    """The knobs with several values; of those that go in step, as zipped ones do, the first, and what follows it."""
    candidates: list[PlottedKnob] = []
    for name in table.knobs:
        column = table[name]
        numeric = column.dtype.kind in "fiu" and bool(np.isfinite(column).all())
        if numeric:
            values, place = np.unique(column, return_inverse=True)
            ordered: list[Any] = values.tolist()
        else:
            order: dict[str, int] = {}
            place = np.array([order.setdefault(str(value), len(order)) for value in column.tolist()], dtype=np.int64)
            ordered = [*order]
        if len(ordered) > 1:
            unit = units.get(name, "")
            candidates.append(PlottedKnob(name=name, unit=unit, values=tuple(ordered), place=place, numeric=numeric))
    kept_knobs: list[PlottedKnob] = []
    notes: list[str] = []
    for knob in candidates:
        leader = next((earlier for earlier in kept_knobs if _in_step(knob, earlier)), None)
        if leader is None:
            kept_knobs.append(knob)
        else:
            notes.append(f"{knob.name} goes with {leader.name}")
    return kept_knobs, notes


def pairs_of(a: PlottedKnob, b: PlottedKnob) -> NDArray[Any] | None:
    """The places of both for each value of `a`, if each value of one comes with a single one of the other."""
    if len(a.values) != len(b.values):
        return None
    pairs = np.unique(a.place * len(b.values) + b.place)
    return np.stack(np.divmod(pairs, len(b.values)), axis=1) if len(pairs) == len(a.values) else None


def _in_step(a: PlottedKnob, b: PlottedKnob) -> bool:
    """True if one follows from the other. Numbers must also rise or fall together: those of a sample do not."""
    pairs = pairs_of(a, b)
    if pairs is None:
        return False
    steps = np.diff(pairs[:, 1])
    return not (a.numeric and b.numeric) or bool((steps > 0).all() or (steps < 0).all())


def axes_knobs_of(knobs: list[PlottedKnob], kind: str) -> list[PlottedKnob]:
    """The knobs on the axes: x and y of a map; x and, if there is one, the lines of curves."""
    most = sorted((knob for knob in knobs if knob.numeric), key=lambda knob: -len(knob.values))
    if kind != "curves":
        chosen = most[:2]
        return sorted(chosen, key=knobs.index)
    x = most[0] if most else knobs[0]
    rest = [knob for knob in knobs if knob is not x and pairs_of(knob, x) is None]
    texts = [knob for knob in rest if not knob.numeric]
    return [x, *(texts or rest)[:1]]


def panels_of(table: Table, knobs: list[PlottedKnob]) -> tuple[list[Panel], str]:
    """A panel for each combination of values that has rows, up to `PANELS`, and what was left out."""
    code, keep = np.zeros(len(table), np.int64), np.ones(len(table), bool)
    counts = thinned([len(knob.values) for knob in knobs], PANELS, [knob.numeric for knob in knobs])
    left = []
    for knob, count in zip(knobs, counts, strict=True):
        code = code * len(knob.values) + knob.place
        if count < len(knob.values):
            shown = spread(len(knob.values), count)
            keep &= np.isin(knob.place, shown)
            left.append(f"{count} of {len(knob.values)} values of {knob.name}" if count > 1 else
                        f"{knob.name} {text_of(knob.values[shown[0]])} alone, of {len(knob.values)} values")
    panels = []
    for key in np.unique(code[keep]).tolist():
        words: list[str] = []
        rest = key
        for knob in reversed(knobs):
            rest, place = divmod(rest, len(knob.values))
            words.insert(0, literal(f"{knob.name} {text_of(knob.values[place])} {knob.unit}".rstrip(), most=80))
        narrow = sum(map(len, words)) > 30  # more would run into the next panel's
        panels.append(Panel(title=("\n" if narrow else ", ").join(words), rows=np.flatnonzero(code == key)))
    return panels, ", ".join(left)


def thinned(counts: list[int], most: int, numeric: list[bool]) -> list[int]:
    """Choose the number of values of each knob to show, so that their combinations are at most `most`.

    As few knobs as possible lose any, rather numbers than texts, as few as possible are down to one, and then as many
    combinations as possible are shown.

    >>> thinned([3, 4], 6, [True, True]), thinned([3, 3], 6, [False, True]), thinned([2, 2, 4], 6, [True, True, False])
    ([3, 2], [3, 2], [2, 2, 1])
    """
    def lost(way: tuple[int, ...]) -> tuple[int, ...]:
        less = [n < count for n, count in zip(way, counts, strict=True)]
        texts = sum(gone and not number for gone, number in zip(less, numeric, strict=True))
        return sum(less), texts, sum(n == 1 for n in way), -prod(way)

    if prod(min(count, most) for count in counts) > _WAYS:
        raise Refused(f"{len(counts)} knobs vary beside those on the axes, too many for the panels of one picture; "
                      "sweep fewer of them at once")
    ways = product(*(range(1, min(count, most) + 1) for count in counts))
    best = min((way for way in ways if prod(way) <= most), key=lost)
    return [*best]


def spread(count: int, most: int) -> list[int]:
    """At most `most` of `count` places, both ends among them; one is that in the middle."""
    if most == 1:
        return [count // 2] if count > 1 else [0]
    return [*range(count)] if count <= most else [round(i * (count - 1) / (most - 1)) for i in range(most)]


def text_of(value: Any) -> str:
    """A knob's value as a label."""
    text = f"{value:.5g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def scale(axes: Axes, which: str, values: tuple[Any, ...]) -> None:
    """A log axis where the values are spaced so; with a zero among them, linear up to the least above it."""
    kind, linear = spaced(values)
    if kind == "log":
        getattr(axes, f"set_{which}scale")("log")
    elif kind == "symlog":
        getattr(axes, f"set_{which}scale")("symlog", linthresh=linear, linscale=0.5)


def spaced(values: tuple[Any, ...]) -> tuple[str, float]:
    """The scale on which values that rise are spaced evenly: linear, log or symlog, and up to where that is linear."""
    above = np.array([value for value in values if value > 0.0])
    if min(values) < 0.0 or len(above) < 2:
        return "linear", 0.0
    ratios, steps = np.diff(np.log(above)), np.diff(np.array(values))
    log = above[-1] / above[0] >= 10.0 if len(above) == 2 else (
        ratios.std() / ratios.mean() < steps.std() / steps.mean() and above[-1] / above[0] > 4.0)
    if not log:
        return "linear", 0.0
    return ("log", 0.0) if len(above) == len(values) else ("symlog", float(above[0]))


def spacing(values: NDArray[Any]) -> tuple[str, float]:
    """The scale on which all of these finite values can be told apart: linear, log or symlog, and up to where linear.

    One run that grows until it is stopped would leave all others in a flat line at the bottom.
    """
    sizes = np.abs(values[values != 0.0])
    if not len(sizes):
        return "linear", 0.0
    if values.min() > 0.0:
        return ("log" if DECADES * sizes.min() < sizes.max() else "linear"), 0.0
    usual = float(np.median(sizes))
    return ("symlog", 10.0 ** np.floor(np.log10(usual))) if DECADES * usual < sizes.max() else ("linear", 0.0)


def groups_of(values: NDArray[Any], where: NDArray[Any], ok: NDArray[Any], count: int) -> list[NDArray[Any]]:
    """The values at each of `count` places, of the rows that ended ok and have one."""
    keep = ok & np.isfinite(values)
    order = np.argsort(where[keep], kind="stable")
    ends = np.cumsum(np.bincount(where[keep], minlength=count))
    return np.split(values[keep][order], ends[:-1])


def with_unit(metric: str, units: Mapping[str, str]) -> str:
    """A metric with its unit in brackets, if it has a known one: that of `units`, else along lines."""
    unit = units.get(metric, UNITS.get(metric, ""))
    return f"{metric} ({unit})" if unit else metric


def gradient_map() -> Any:
    """The colours of a map of numbers."""
    from matplotlib import colormaps

    return colormaps["viridis"]


