"""The figures of runs over time: a quantity each, a panel for each run, all on one scale of values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.report import svg
from teleop.report.extremes import Line, line_of
from teleop.report.markup import Markup
from teleop.report.scales import Axis, around, thousands
from teleop.terminal.plotting import BLUE, DARK, GREEN, RED
from teleop.terminal.run_plot import AXES, PANELS, TracePanel
from teleop.terminal.units import PREFIX, si

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from teleop.report.svg import Box

STYLE = {BLUE: "m", RED: "s", DARK: "e", GREEN: "g"}
DASH = ("", " y", " z")  # of the axes
HEIGHT, LOW = 96.0, 78.0  # of a panel: of one run alone, of several
MOST_MARKS = 40  # of events in a panel
HEAD = 17.0  # the line with the quantity and the legend


class Strip(NamedTuple):
    """A run as it is drawn: what stands over its panels, its trace, its tick (s), and its events with their times."""

    title: str
    trace: Mapping[str, Any]
    dt: float
    events: Sequence[tuple[float, str]]


class Drawn(NamedTuple):
    """A curve of a panel: its name, its style and its points."""

    name: str
    style: str
    line: Line


def strips(runs: Sequence[Strip], most_rows: int = 12) -> list[Markup]:
    """A figure for each quantity that a run has; of many runs as many figures as have so many rows of panels."""
    runs = [run for run in runs if len(run.trace["t"])]
    found = [panel for panel in PANELS if any(_has(panel, run) for run in runs)]
    across = 2 if len(runs) in (2, 4) else 3
    rows = max(1, -(-len(runs) // across))
    return [_figure(panel, runs, across) for panel in found[:max(2, most_rows // rows)]]


def _has(panel: TracePanel, run: Strip) -> bool:
    return any(curve.name in run.trace for curve in panel.curves)


def _figure(panel: TracePanel, runs: Sequence[Strip], across: int) -> Markup:
    named = len(runs) > 1
    top = HEAD + (svg.TITLE if named else 2.0)
    times = [Axis(float(run.trace["t"][0]), float(run.trace["t"][-1]) + run.dt) for run in runs]
    same = len(set(times)) == 1
    boxes, height = svg.grid_of(len(runs), across, LOW if named else HEIGHT, top=top,
                                apart=svg.TITLE * named + (4.0 if same else 16.0))
    drawn = [[*_curves(panel, run, time, box)] for run, time, box in zip(runs, times, boxes, strict=True)]
    every = [curve.line.range() for curves in drawn for curve in curves]
    low, high = min((a for a, _ in every), default=0.0), max((b for _, b in every), default=0.0)
    power = thousands(max(abs(low), abs(high)) if low <= high else 0.0)
    y = around(low * 1e3**-power, high * 1e3**-power)
    scaled = around(low, high)
    parts = [svg.label(svg.LEFT, 11, f"{panel.quantity} ({PREFIX[power]}{panel.unit})", style="b"),
             svg.legend(_legend(panel, runs), svg.WIDTH - svg.RIGHT, 11)]
    for i, (run, time, box, curves) in enumerate(zip(runs, times, boxes, drawn, strict=True)):
        last = i + min(across, len(runs)) >= len(runs)
        parts += [svg.frame(box, time, y, title=run.title if named else "", x_labels=last or not same,
                            y_labels=i % across == 0),
                  svg.marks([each for each in run.events if time.low < each[0] < time.high][:MOST_MARKS], box, time),
                  *[svg.curve(curve.line, box, scaled, f"l {curve.style}", curve.name) for curve in curves]]
    parts.append(svg.label(svg.LEFT - 8.0, height - 5.0, "time (s)", anchor="end"))
    return svg.figure(panel.quantity, _description(panel, runs, drawn), height, *parts)


def _curves(panel: TracePanel, run: Strip, time: Axis, box: Box) -> Iterator[Drawn]:
    """The last curve is narrow, and lies over the others, which are wide: where they coincide both are seen."""
    has = [curve for curve in panel.curves if curve.name in run.trace]
    t = run.trace["t"]
    for curve in has:
        wide = "" if curve is has[-1] else " w"
        for dash, (name, values) in zip(DASH, _axes_of(run.trace[curve.name]), strict=False):
            line = line_of(t, values, time.low, time.high, max(2, round(box.width)))
            yield Drawn(f"{plain(curve.label)} {name}".rstrip(), f"{STYLE[curve.colour]}{wide}{dash}", line)


def _axes_of(column: NDArray[Any]) -> list[tuple[str, NDArray[Any]]]:
    if column.ndim == 1:
        return [("", column)]
    return [(name, values) for (name, _), values in zip(AXES, column.T, strict=False)]


def _legend(panel: TracePanel, runs: Sequence[Strip]) -> list[tuple[str, str]]:
    has = [curve for curve in panel.curves if any(curve.name in run.trace for run in runs)]
    told = [(f"l {STYLE[curve.colour]}{'' if curve is has[-1] else ' w'}", plain(curve.label)) for curve in
            reversed(has)]
    axes = max((run.trace[curve.name].shape[1] if run.trace[curve.name].ndim > 1 else 1
                for run in runs for curve in has if curve.name in run.trace), default=1)
    return told + [(f"l e{dash}", name) for dash, (name, _) in zip(DASH, AXES, strict=False)][:axes] * (axes > 1)


def plain(label: str) -> str:
    """The label of a curve without the signs of a formula.

    >>> plain("$f_{env}$ on the environment")
    'f_env on the environment'
    """
    return re.sub(r"[${}]", "", label)


def _description(panel: TracePanel, runs: Sequence[Strip], drawn: Sequence[Sequence[Drawn]]) -> str:
    """The figure in words, for who does not see it: each curve with its least and its greatest value."""
    told = []
    for run, curves in zip(runs, drawn, strict=True):
        ranges = [(curve.name, *curve.line.range()) for curve in curves]
        words = "; ".join(f"{name} from {si(low, panel.unit)} to {si(high, panel.unit)}" if low <= high else
                          f"{name} has no value" for name, low, high in ranges)
        told.append(f"{run.title}: {words or 'it has none'}" if len(runs) > 1 else words)
    return f"{panel.quantity.capitalize()} over time. {'. '.join(told)}."
