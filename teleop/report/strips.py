"""The figures of runs over time: a quantity each, a panel for each run, all on one scale of values."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.report.figures import BETWEEN, LEFT, RIGHT, TEXT, TITLE, WIDTH, embed, grid_of, page_figure, panel
from teleop.report.markup import Markup, element
from teleop.scene.axes import AxisLabels
from teleop.simulation.metrics import ROUNDING
from teleop.terminal.options import APART, TOGETHER, axes_of, by_unit, left_out, most_worked
from teleop.terminal.plotting import DARK, UNDER, literal, names_id
from teleop.terminal.run_plot import LINES, PANELS, TracePanel, axis_curves, extremes, power_of_thousand
from teleop.terminal.table import PREFIX, si

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEIGHT, LOW = 96.0, 78.0  # of a panel: of one run alone, of several
MOST_MARKS = 40  # of events in a panel
OWN = 42.0  # between panels that have a scale each
NARROW: dict[str, Any] = {"linewidth": 1.2}
HEAD = 17.0  # the line with the quantity and the legend


class Strip(NamedTuple):
    """A run as it is drawn: what stands over its panels, its trace, its tick (s), its events, and labels."""

    title: str
    trace: Mapping[str, Any]
    dt: float
    events: Sequence[tuple[float, str]]
    labels: AxisLabels = AxisLabels()

    @property
    def span(self) -> tuple[float, float]:
        """Beginning and end of the time axis (s)."""
        return float(self.trace["t"][0]), float(self.trace["t"][-1]) + self.dt


class Drawn(NamedTuple):
    """A curve of a panel: its name, its points, and how it is drawn."""

    name: str
    t: Any
    values: Any
    look: dict[str, Any]

    def range(self) -> tuple[float, float]:
        """The least and the greatest value of all, (inf, -inf) of none."""
        import numpy as np

        known = self.values[np.isfinite(self.values)]
        return float(known.min(initial=np.inf)), float(known.max(initial=-np.inf))


class Panels(NamedTuple):
    """The panels of one figure: a run each, or one run's axes, each with the axes that it shows.

    `apart`: each on its own scale of values; else all are on one.
    """

    panel: TracePanel
    runs: list[Strip]
    shown: list[list[int]]
    apart: bool = False


def strips(runs: Sequence[Strip], most_rows: int = 12) -> Iterator[Markup]:
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
    yield from [element("p", {"class": "sub"}, f"{text}.") for text in legend_names if text]
    yield from [_figure(each, across) for each in every[:max(2, most_rows // rows)]]


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
    quantity, runs, shown, apart = panels
    named = len(runs) > 1 or apart
    same = len({run.span for run in runs}) == 1
    boxes, height = grid_of(len(runs), across, LOW if named else HEIGHT, top=HEAD + (TITLE if named else 2.0),
                            apart=TITLE * named + (4.0 if same else 16.0), between=OWN if apart else BETWEEN)
    drawn = [[*_curves(quantity, run, axes, round(boxes[0].width))] for run, axes in zip(runs, shown, strict=True)]
    power = power_of_thousand([curve.values for curves in drawn for curve in curves])
    figure = page_figure(height)
    first: Axes | None = None
    for i, (run, box, curves) in enumerate(zip(runs, boxes, drawn, strict=True)):
        axes = panel(figure, box, literal(run.title) if named else "", beside=None if apart else first)
        for curve in curves:
            axes.plot(curve.t, curve.values * 10.0 ** (-3 * power), gid=names_id([curve.name]), **curve.look)
        for t, words in [each for each in run.events if run.span[0] < each[0] < run.span[1]][:MOST_MARKS]:
            axes.axvline(t, color=DARK, linewidth=1.0, linestyle=(0, (3, 3)), gid=names_id([words]))
        axes.set_xlim(*run.span)
        axes.tick_params(labelleft=apart or i % across == 0,
                         labelbottom=not same or i + min(across, len(runs)) >= len(runs))
        first = first or axes
    _texts(figure, panels, f"{quantity.quantity} ({PREFIX[power]}{quantity.unit})", height)
    return embed(figure, quantity.quantity, _description(quantity, runs, drawn))


def _texts(figure: Any, panels: Panels, title: str, height: float) -> None:
    """The quantity and the legend in the line above the panels, and what runs along the lower axis."""
    figure.text(LEFT / WIDTH, 1.0 - 11.0 / height, literal(title), fontsize=TEXT + 0.5, fontweight="bold")
    figure.text((LEFT - 8.0) / WIDTH, 5.0 / height, "time (s)", fontsize=TEXT, ha="right")
    handles = _legend(panels)
    figure.legend(handles=handles, loc="upper right", ncols=len(handles), frameon=False, fontsize=TEXT, borderpad=0.0,
                  borderaxespad=0.0, handlelength=1.4, handletextpad=0.5, columnspacing=1.4,
                  bbox_to_anchor=(1.0 - RIGHT / WIDTH, 1.0 - 2.0 / height))


def _curves(panel: TracePanel, run: Strip, shown: Sequence[int], columns: int) -> Iterator[Drawn]:
    """The last curve is narrow, and lies over the others, which are wide: where they coincide both are seen."""
    has = [curve for curve in panel.curves if curve.name in run.trace]
    dashes = _dashes(run)
    for curve in has:
        for name, i, values in axis_curves(column := run.trace[curve.name], shown, run.labels):
            line = dashes[i] if column.ndim > 1 else "-"  # what is of all axes together is of none that is drawn
            yield Drawn(f"{plain_number(curve.label)} {name}".rstrip(),
                        *extremes(run.trace["t"], values, *run.span, columns),
                        {"color": curve.colour, "linestyle": line, **(UNDER if curve is not has[-1] else NARROW)})


def _dashes(run: Strip) -> dict[int, str]:
    """The style of the line of each axis of a run that shares a panel."""
    return dict(zip(most_worked(run.trace, TOGETHER), LINES, strict=False))


def _legend(panels: Panels) -> list[Any]:
    """A line for each curve, the uppermost first, and for each axis that shares a panel."""
    from matplotlib.lines import Line2D

    panel, runs = panels.panel, panels.runs
    has = [curve for curve in panel.curves if any(curve.name in run.trace for run in runs)]
    lines = [Line2D([], [], color=curve.colour, label=plain_number(curve.label),
                    **(UNDER if curve is not has[-1] else NARROW)) for curve in reversed(has)]
    several = [(run, shown) for run, shown in zip(runs, panels.shown, strict=True) if any(
        run.trace[curve.name].ndim > 1 for curve in has if curve.name in run.trace)]
    axes = {_dashes(run)[i]: run.labels.names_for(axes_of(run.trace))[i] for run, shown in several for i in shown}
    return [*lines, *[Line2D([], [], color=DARK, label=literal(name), **{**NARROW, "linestyle": dash})
                      for dash, name in axes.items()]]


def plain_number(label: str) -> str:
    """The label of a curve without the signs of a formula.

    >>> plain_number("$f_{env}$ on the environment")
    'f_env on the environment'
    """
    return re.sub(r"[${}]", "", label)


def _description(panel: TracePanel, runs: Sequence[Strip], drawn: Sequence[Sequence[Drawn]]) -> str:
    """The figure in words, for who does not see it: each curve with its least and its greatest value."""
    legend_names = []
    every = [[(curve.name, *curve.range()) for curve in curves] for curves in drawn]
    least = ROUNDING * max((max(-low, high) for ranges in every for _, low, high in ranges if low <= high), default=0.0)

    def size(value: float) -> str:
        return si(value if abs(value) >= least else 0.0, panel.unit)

    for run, ranges in zip(runs, every, strict=True):
        words = "; ".join(f"{name} from {size(low)} to {size(high)}" if low <= high else
                          f"{name} has no value" for name, low, high in ranges)
        legend_names.append(f"{run.title}: {words or 'it has none'}" if len(runs) > 1 else words)
    return f"{panel.quantity.capitalize()} over time. {'. '.join(legend_names)}."
