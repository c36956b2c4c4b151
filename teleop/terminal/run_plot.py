"""The plot of a run: positions, forces, queues of waves, stored energy over one time axis. Needs the extra `plot`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.scene.axes import AxisLabels, unit_on
from teleop.simulation.result import Result
from teleop.simulation.trace import blocks
from teleop.terminal.options import APART, TOGETHER, axes_of, by_unit, left_out, most_worked
from teleop.terminal.plotting import BLUE, DARK, GREEN, PNG, RED, UNDER, grid_lines, literal, new_figure, save
from teleop.terminal.run_table import heading, verdict
from teleop.terminal.table import PREFIX

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BINS = 400  # at most, of equal length, along the time axis: each is about two pixels wide
# A curve that goes up and down within its bins so often that its path is this many times their ranges would be drawn as
# a filled area. Measured of the forces of built-in scenes: 1.0 to 1.6 without loss and jitter, 1.9 to 9 with them.
JUMPS = 1.75
LINES = ("-", "--", ":")  # of the axes that share a panel
GREATEST = 1e30  # a value beyond is a gap of a curve: nothing that is measured is as large


class TraceCurve(NamedTuple):
    """Curve of a column of the trace."""

    name: str
    label: str
    colour: str


class TracePanel(NamedTuple):
    """Panel of a plot: its quantity, its SI unit and its curves. The last curve is narrow and lies over the others."""

    quantity: str
    unit: str
    curves: tuple[TraceCurve, ...]


PANELS = (  # blue is the master's end, red the slave's; grey what a person or an environment does there
    TracePanel("position", "m", (TraceCurve("x_s", "$x_s$ slave", RED), TraceCurve("x_m", "$x_m$ master", BLUE))),
    TracePanel("master's force", "N", (
        TraceCurve("f_h", "$f_h$ of the hand", DARK), TraceCurve("f_m", "$f_m$ against the hand", BLUE),
    )),
    TracePanel("slave's force", "N", (
        TraceCurve("f_env", "$f_{env}$ on the environment", DARK), TraceCurve("f_s", "$f_s$ on the slave", RED),
    )),
    TracePanel("queue of waves", "s", (
        TraceCurve("queue_s", "forward", RED), TraceCurve("queue_m", "backward", BLUE),
    )),
    TracePanel("energy", "J", (
        TraceCurve("E_port", "$E_{port}$ two-port", DARK), TraceCurve("E_link", "$E_{link}$ link", GREEN),
    )),
)


def draw(result: Result, path: Path, formats: Sequence[str] = PNG) -> list[Path]:
    """Draw `result` into `path` with the suffix of each format, as `save` does; returns the files.

    A panel is there if the trace has one of its columns. A column that jumps is drawn as its mean and its range in each
    bin, see `binned`. Up to `TOGETHER` axes lie over each other in a panel for each unit; of more, each has a column of
    panels, see `teleop.terminal.options`. Raises `Refused` if the extra is missing or the file cannot be written.
    """
    panels = [panel for panel in PANELS if any(curve.name in result.trace for curve in panel.curves)]
    apart = axes_of(result.trace) > TOGETHER
    shown = most_worked(result.trace, APART if apart else TOGETHER)
    heads = [heading(result), verdict(result), left_out(result.trace, shown, result.labels)]
    title = "\n".join(fill(literal(text), 115) for text in heads if text)
    figure = (_apart if apart else _together)(result, panels, shown, title)
    return save(figure, path, formats)


def _together(result: Result, panels: Sequence[TracePanel], shown: Sequence[int], title: str) -> Figure:
    """A panel for each quantity and unit, with all axes."""
    count = axes_of(result.trace)
    rows = [(panel._replace(unit=unit), axes) for panel in panels
            for unit, axes in by_unit(panel.unit, shown, result.labels, count).items()]
    figure = new_figure((9.5, 2.0 * len(rows) + 0.9), title)
    every = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (panel, drawn) in zip(every, rows, strict=True):
        handles = _fill(axes, panel, result, drawn)
        axes.legend(*zip(*handles, strict=True), loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False,
                    fontsize=9)
    _time(every[-1], result)
    figure.align_ylabels()
    return figure


def _apart(result: Result, panels: Sequence[TracePanel], shown: Sequence[int], title: str) -> Figure:
    """A column of panels for each axis, each panel on its own scale; what is of all axes together is as wide as all."""
    count = axes_of(result.trace)
    names, units = result.labels.names_for(count), result.labels.units_for(count)
    figure = new_figure((2.6 * len(shown) + 2.2, 1.7 * len(panels) + 1.2), title)
    grid = figure.add_gridspec(len(panels), len(shown))
    for row, panel in enumerate(panels):
        of_axes = any(result.trace[curve.name].ndim > 1 for curve in panel.curves if curve.name in result.trace)
        for column, i in enumerate(shown if of_axes else shown[:1]):
            axes = figure.add_subplot(grid[row, column] if of_axes else grid[row, :])
            drawn = panel._replace(unit=unit_on(panel.unit, units[i]))
            handles = _fill(axes, drawn, result, [i], named=False)
            axes.tick_params(labelsize=8)
            if row == 0:
                axes.set_title(names[i], fontsize=10)
            if of_axes and column:
                axes.set_ylabel(axes.get_ylabel().partition(" (")[2].rstrip(")"), fontsize=8)
            if column == len(shown) - 1 or not of_axes:
                axes.legend(*zip(*handles, strict=True), loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False,
                            fontsize=8)
            if row == len(panels) - 1:
                _time(axes, result)
            elif len(result.trace["t"]):
                axes.set_xlim(0.0, result.trace["t"][-1] + result.dt)
    return figure


def _time(axes: Axes, result: Result) -> None:
    if len(result.trace["t"]):
        axes.set_xlim(0.0, result.trace["t"][-1] + result.dt)
    axes.set_xlabel("time (s)")


def _fill(axes: Axes, panel: TracePanel, result: Result, shown: Sequence[int], *, named: bool = True
          ) -> list[tuple[Any, str]]:
    """Draw the curves of a panel; what its legend says, a curve above those that it lies over."""
    trace, dt = result.trace, result.dt
    has = [curve for curve in panel.curves if curve.name in trace]
    drawn = {curve.name: [*axis_curves(trace[curve.name], shown, result.labels)] for curve in has}
    thousands = power_of_thousand([values for several in drawn.values() for _, _, values in several])
    handles: list[tuple[Any, str]] = []
    for curve in has:
        lines: list[tuple[Any, str]] = []
        under = UNDER if curve is not has[-1] else {"linewidth": 1.2}
        for name, i, exact in drawn[curve.name]:
            values = exact * 10.0 ** (-3 * thousands)
            label = f"{curve.label}, {name}" if name and named else curve.label
            style = LINES[i] if named else "-"
            shape: dict[str, Any] = {"color": curve.colour, "linestyle": style, **under}
            bins = binned(trace["t"], values)
            if bins is None:
                (line,) = axes.plot(trace["t"], values, **shape)
                lines.append((line, label))
            else:
                (mean,) = axes.plot(bins.t, bins.mean, **shape)
                band = axes.fill_between(bins.t, bins.least, bins.greatest, color=curve.colour, alpha=0.22, linewidth=0)
                lines.append(((band, mean), f"{label}:\nmean and range over {1e3 * dt * bins.ticks:g} ms"))
        handles = [*lines, *handles]
    axes.set_ylabel(f"{panel.quantity} ({PREFIX[thousands]}{panel.unit})")
    grid_lines(axes)
    return handles


def axis_curves(column: NDArray[Any], shown: Sequence[int], labels: AxisLabels
                ) -> Iterator[tuple[str, int, NDArray[Any]]]:
    """Name, index and values of each axis that is shown; that of a scene with a single one has no name."""
    if column.ndim == 1:
        yield "", 0, column
    else:
        names = labels.names_for(column.shape[1])
        yield from ((names[i], i, column[:, i]) for i in shown)


class Bins(NamedTuple):
    """A column summed up over bins of equal length (the last may be shorter): arrays of one number for each bin."""

    ticks: int  # in a bin
    t: NDArray[Any]  # s, of its middle
    mean: NDArray[Any]
    least: NDArray[Any]
    greatest: NDArray[Any]


def binned(t: NDArray[Any], values: NDArray[Any]) -> Bins | None:
    """A column (ticks,) that jumps, summed up over at most `BINS` bins; None if it can be drawn tick by tick.

    It jumps if its path, the sum of the sizes of its steps, is more than `JUMPS` times the sum of its ranges in the
    bins: a column that only rises or falls in each bin has a path as long as its ranges.
    """
    ticks = -(-len(values) // BINS)
    if ticks < 3 or not np.isfinite(values).all():
        return None
    begin = np.arange(0, len(values), ticks)
    count = np.diff(begin, append=len(values))
    least, greatest = np.minimum.reduceat(values, begin), np.maximum.reduceat(values, begin)
    with np.errstate(over="ignore"):  # of a run that diverged
        if not np.abs(np.diff(values)).sum() > JUMPS * (greatest - least).sum():
            return None
        mean = np.add.reduceat(values, begin) / count
    return Bins(ticks, np.add.reduceat(t, begin) / count, mean, least, greatest)


def extremes(t: NDArray[Any], values: NDArray[Any], low: float, high: float, columns: int
             ) -> tuple[NDArray[Any], NDArray[Any]]:
    """The curve of `values` (ticks,) at rising times `t` over `low` .. `high`: two points in each of `columns`.

    They are the least and the greatest value there. With fewer than two ticks a column each tick has both of its points
    at its value. A value that is not finite, or beyond `GREATEST`, is a gap.
    """
    def sound(some: NDArray[Any]) -> NDArray[Any]:
        exact = np.asarray(some, dtype=float)
        return np.where(np.abs(exact) <= GREATEST, exact, np.nan)

    if len(t) < 2 * columns:
        return np.repeat(np.asarray(t, dtype=float), 2), np.repeat(sound(values), 2)
    least, greatest = np.full(columns, np.inf), np.full(columns, -np.inf)
    for block in blocks(len(t)):
        at = (np.asarray(t[block], dtype=float) - low) * (columns / (high - low))
        place = np.clip(at.astype(np.int64), 0, columns - 1)
        begin = np.flatnonzero(np.diff(place, prepend=-1))
        drawn, part = place[begin], sound(values[block])
        least[drawn] = np.fmin(least[drawn], np.fmin.reduceat(part, begin))
        greatest[drawn] = np.fmax(greatest[drawn], np.fmax.reduceat(part, begin))
    nothing = ~np.isfinite(least)
    least[nothing] = greatest[nothing] = np.nan
    rises = np.diff(least / 2.0 + greatest / 2.0, prepend=least[0]) >= 0.0
    middle = low + (np.arange(columns) + 0.5) * ((high - low) / columns)
    return np.repeat(middle, 2), np.where(rises, (least, greatest), (greatest, least)).T.ravel()


def power_of_thousand(columns: list[Any]) -> int:
    """The power of a thousand whose SI prefix suits the greatest magnitude in `columns`."""
    peak = max((np.abs(column[np.isfinite(column)]).max(initial=0.0) for column in columns), default=0.0)
    return int(np.clip(np.floor(np.log10(peak) / 3.0), min(PREFIX), max(PREFIX))) if peak > 0.0 else 0
