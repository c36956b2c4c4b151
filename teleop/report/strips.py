"""The figures of runs over time: a quantity each, a panel for each run, all on one scale of values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.report import svg
from teleop.report.markup import Markup, element
from teleop.report.scales import PlotAxis, around, thousands
from teleop.report.svg import Line, line_of
from teleop.scene.axes import AxisLabels
from teleop.terminal.options import APART, TOGETHER, axes_of, by_unit, left_out, most_worked
from teleop.terminal.plotting import BLUE, DARK, GREEN, RED
from teleop.terminal.run_plot import PANELS, TracePanel, axis_curves
from teleop.terminal.table import PREFIX, si

if TYPE_CHECKING:
    from collections.abc import Iterator

    from teleop.report.svg import Box

STYLE = {BLUE: "m", RED: "s", DARK: "e", GREEN: "g"}
DASH = ("", " y", " z")  # of the axes
HEIGHT, LOW = 96.0, 78.0  # of a panel: of one run alone, of several
MOST_MARKS = 40  # of events in a panel
OWN = 42.0  # between panels that have a scale each
HEAD = 17.0  # the line with the quantity and the legend


class Strip(NamedTuple):
    """A run as it is drawn: what stands over its panels, its trace, its tick (s), its events, and labels."""

    title: str
    trace: Mapping[str, Any]
    dt: float
    events: Sequence[tuple[float, str]]
    labels: AxisLabels = AxisLabels()


class Drawn(NamedTuple):
    """A curve of a panel: its name, its style and its points."""

    name: str
    style: str
    line: Line


class Panels(NamedTuple):
    """The panels of one figure: a run each, or one run's axes, each with the axes that it shows.

    `apart`: each on its own scale of values; else all are on one.
    """

    panel: TracePanel
    runs: list[Strip]
    shown: list[list[int]]
    apart: bool = False


def strips(runs: Sequence[Strip], most_rows: int = 12) -> list[Markup]:
    """A figure for each quantity and unit that a run has; of many runs as many figures as have so many rows of panels.

    Up to `TOGETHER` axes share a panel. Of one run with more, each has a panel of its own; of several runs those are
    drawn over which most work was done. A sentence names what is left out.
    """
    runs = [run for run in runs if len(run.trace["t"])]
    panels_drawn = [panel for panel in PANELS if any(_has(panel, run) for run in runs)]
    apart = len(runs) == 1 and axes_of(runs[0].trace) > TOGETHER
    shown = [most_worked(run.trace, APART if apart else TOGETHER) for run in runs]
    every = [each for panel in panels_drawn for each in (
        _of_axes(panel, runs[0], shown[0]) if apart else _of_runs(panel, runs, shown))]
    across = 2 if len(runs) in (2, 4) else 3
    rows = max(1, -(-len(every[0].runs if every else runs) // across))
    legend_names = dict.fromkeys(left_out(run.trace, axes, run.labels) for run, axes in zip(runs, shown, strict=True))
    notes = [element("p", {"class": "sub"}, f"{text}.") for text in legend_names if text]
    return [*notes, *[_figure(each, across) for each in every[:max(2, most_rows // rows)]]]


def _of_runs(panel: TracePanel, runs: Sequence[Strip], shown: Sequence[list[int]]) -> Iterator[Panels]:
    """The figures of a quantity, one for each unit: a panel for each run."""
    units = [by_unit(panel.unit, axes, run.labels, axes_of(run.trace)) for run, axes in zip(runs, shown, strict=True)]
    for unit in dict.fromkeys(unit for each in units for unit in each):
        yield Panels(panel._replace(unit=unit), list(runs), [each.get(unit, []) for each in units])


def _of_axes(panel: TracePanel, run: Strip, shown: Sequence[int]) -> Iterator[Panels]:
    """The figures of a quantity of one run, one for each unit: a panel for each axis."""
    count = axes_of(run.trace)
    if all(run.trace[curve.name].ndim == 1 for curve in panel.curves if curve.name in run.trace):
        yield Panels(panel, [run], [[0]])
        return
    names = run.labels.names_for(count)
    for unit, axes in by_unit(panel.unit, shown, run.labels, count).items():
        yield Panels(panel._replace(unit=unit), [_along(run, panel, names[i], i) for i in axes],
                     [[0]] * len(axes), apart=True)


def _along(run: Strip, panel: TracePanel, name: str, i: int) -> Strip:
    """A run along one of its axes, as if it had no other."""
    rows_of = {curve.name: run.trace[curve.name] for curve in panel.curves if curve.name in run.trace}
    return run._replace(title=name, trace={"t": run.trace["t"], **{
        key: column if column.ndim == 1 else column[:, i] for key, column in rows_of.items()}})


def _has(panel: TracePanel, run: Strip) -> bool:
    return any(curve.name in run.trace for curve in panel.curves)


def _figure(panels: Panels, across: int) -> Markup:
    panel, runs, shown, apart = panels
    named = len(runs) > 1 or apart
    top = HEAD + (svg.TITLE if named else 2.0)
    times = [PlotAxis(float(run.trace["t"][0]), float(run.trace["t"][-1]) + run.dt) for run in runs]
    same = len(set(times)) == 1
    boxes, height = svg.grid_of(len(runs), across, LOW if named else HEIGHT, top=top,
                                apart=svg.TITLE * named + (4.0 if same else 16.0),
                                between=OWN if apart else svg.BETWEEN)
    drawn = [[*_curves(panel, run, axes, time, box)]
             for run, axes, time, box in zip(runs, shown, times, boxes, strict=True)]
    ranges = [_range(curves) for curves in drawn]
    if not apart:
        ranges = [_range([curve for curves in drawn for curve in curves])] * len(drawn)
    low, high = min(a for a, _ in ranges), max(b for _, b in ranges)
    power = thousands(max(abs(low), abs(high)) if low <= high else 0.0)
    parts = [svg.label(svg.LEFT, 11, f"{panel.quantity} ({PREFIX[power]}{panel.unit})", style="b"),
             svg.legend(_legend(panels), svg.WIDTH - svg.RIGHT, 11)]
    for i, (run, time, box, curves) in enumerate(zip(runs, times, boxes, drawn, strict=True)):
        last = i + min(across, len(runs)) >= len(runs)
        y, scaled = (around(ranges[i][0] * of, ranges[i][1] * of) for of in (1e3**-power, 1.0))
        parts += [svg.frame(box, time, y, title=run.title if named else "", x_labels=last or not same,
                            y_labels=apart or i % across == 0),
                  svg.marks([each for each in run.events if time.low < each[0] < time.high][:MOST_MARKS], box, time),
                  *[svg.curve(curve.line, box, scaled, f"l {curve.style}", curve.name) for curve in curves]]
    parts.append(svg.label(svg.LEFT - 8.0, height - 5.0, "time (s)", anchor="end"))
    return svg.figure(panel.quantity, _description(panel, runs, drawn), height, *parts)


def _range(curves: Sequence[Drawn]) -> tuple[float, float]:
    every = [curve.line.range() for curve in curves]
    return min((a for a, _ in every), default=0.0), max((b for _, b in every), default=0.0)


def _curves(panel: TracePanel, run: Strip, shown: Sequence[int], time: PlotAxis, box: Box) -> Iterator[Drawn]:
    """The last curve is narrow, and lies over the others, which are wide: where they coincide both are seen."""
    has = [curve for curve in panel.curves if curve.name in run.trace]
    t = run.trace["t"]
    for curve in has:
        wide = "" if curve is has[-1] else " w"
        dashes = _dashes(run)
        for name, i, values in axis_curves(column := run.trace[curve.name], shown, run.labels):
            line = line_of(t, values, time.low, time.high, max(2, round(box.width)))
            dash = dashes[i] if column.ndim > 1 else ""  # what is of all axes together is of none that is drawn
            yield Drawn(f"{plain_number(curve.label)} {name}".rstrip(), f"{STYLE[curve.colour]}{wide}{dash}", line)


def _dashes(run: Strip) -> dict[int, str]:
    """The style of the line of each axis of a run that shares a panel."""
    return dict(zip(most_worked(run.trace, TOGETHER), DASH, strict=False))


def _legend(panels: Panels) -> list[tuple[str, str]]:
    panel, runs = panels.panel, panels.runs
    has = [curve for curve in panel.curves if any(curve.name in run.trace for run in runs)]
    legend_names = [(f"l {STYLE[curve.colour]}{'' if curve is has[-1] else ' w'}", plain_number(curve.label))
                    for curve in reversed(has)]
    several = [(run, shown) for run, shown in zip(runs, panels.shown, strict=True) if any(
        run.trace[curve.name].ndim > 1 for curve in has if curve.name in run.trace)]
    axes = {f"l e{_dashes(run)[i]}": run.labels.names_for(axes_of(run.trace))[i]
            for run, shown in several for i in shown}
    return [*legend_names, *axes.items()]


def plain_number(label: str) -> str:
    """The label of a curve without the signs of a formula.

    >>> plain_number("$f_{env}$ on the environment")
    'f_env on the environment'
    """
    return re.sub(r"[${}]", "", label)


def _description(panel: TracePanel, runs: Sequence[Strip], drawn: Sequence[Sequence[Drawn]]) -> str:
    """The figure in words, for who does not see it: each curve with its least and its greatest value."""
    legend_names = []
    for run, curves in zip(runs, drawn, strict=True):
        ranges = [(curve.name, *curve.line.range()) for curve in curves]
        words = "; ".join(f"{name} from {si(low, panel.unit)} to {si(high, panel.unit)}" if low <= high else
                          f"{name} has no value" for name, low, high in ranges)
        legend_names.append(f"{run.title}: {words or 'it has none'}" if len(runs) > 1 else words)
    return f"{panel.quantity.capitalize()} over time. {'. '.join(legend_names)}."
