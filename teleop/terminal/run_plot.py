"""The plot of a run: positions, forces and stored energy over one time axis. Needs the extra `plot`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.terminal.plotting import BLUE, DARK, GREEN, ORANGE, PNG, RED, SKY, grid_lines, literal, new_figure, save
from teleop.terminal.run_table import heading, verdict
from teleop.terminal.units import PREFIX

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from teleop.simulation.result import Result


class TraceCurve(NamedTuple):
    """How a column of the trace is drawn. The later ones of a panel lie on top."""

    name: str
    label: str
    colour: str


class TracePanel(NamedTuple):
    """One pair of axes: its quantity, its SI unit and its curves."""

    quantity: str
    unit: str
    curves: tuple[TraceCurve, ...]


PANELS = (  # blue at the master's end, red at the slave's
    TracePanel("position", "m", (TraceCurve("x_s", "$x_s$ slave", RED), TraceCurve("x_m", "$x_m$ master", BLUE))),
    TracePanel("force", "N", (
        TraceCurve("f_s", "$f_s$ on the slave", ORANGE), TraceCurve("f_env", "$f_{env}$ on the environment", RED),
        TraceCurve("f_h", "$f_h$ of the hand", SKY), TraceCurve("f_m", "$f_m$ against the hand", BLUE),
    )),
    TracePanel("energy", "J", (
        TraceCurve("E_port", "$E_{port}$ two-port", DARK), TraceCurve("E_link", "$E_{link}$ link", GREEN),
    )),
)


def draw(result: Result, path: Path, formats: Sequence[str] = PNG) -> list[Path]:
    """Draw `result` into `path` with the suffix of each format, as `save` does; returns the files.

    The energy panel is there if the scene summed any. Several axes share a panel: the first is drawn as for
    one, the others thin. Raises `Refused` if the extra is missing or the file cannot be written.
    """
    panels = [panel for panel in PANELS if any(curve.name in result.trace for curve in panel.curves)]
    figure = new_figure((9.5, 2.3 * len(panels) + 0.9), f"{literal(heading(result))}\n{literal(verdict(result))}")
    every = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(every, panels, strict=True):
        _fill(axes, panel, result.trace)
    if len(result.trace["t"]):
        every[-1].set_xlim(0.0, result.trace["t"][-1] + result.dt)
    every[-1].set_xlabel("time (s)")
    figure.align_ylabels()
    return save(figure, path, formats)


def _fill(axes: Axes, panel: TracePanel, trace: Mapping[str, Any]) -> None:
    has = [curve for curve in panel.curves if curve.name in trace]
    thousands = _thousands([trace[curve.name] for curve in has])
    for curve in has:
        column = trace[curve.name] * 10.0 ** (-3 * thousands)
        for axis, values in enumerate([column] if column.ndim == 1 else column.T):
            first = axis == 0
            axes.plot(trace["t"], values, color=curve.colour, linewidth=1.2 if first else 0.5,
                      label=curve.label if first else None)
    axes.set_ylabel(f"{panel.quantity} ({PREFIX[thousands]}{panel.unit})")
    grid_lines(axes)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9, reverse=True)


def _thousands(columns: list[Any]) -> int:
    """The power of a thousand whose SI prefix suits the greatest magnitude in `columns`."""
    import numpy as np

    peak = max((np.abs(column[np.isfinite(column)]).max(initial=0.0) for column in columns), default=0.0)
    return int(np.clip(np.floor(np.log10(peak) / 3.0), min(PREFIX), max(PREFIX))) if peak > 0.0 else 0
