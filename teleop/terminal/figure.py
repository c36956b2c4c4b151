"""The figure of a run: positions, forces and stored energy over one time axis. Needs the extra `plot`."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.errors import Refused
from teleop.storage.files import replacing
from teleop.terminal.printable import printable
from teleop.terminal.run_table import PREFIX, heading, verdict

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from teleop.simulation.result import Result


class Curve(NamedTuple):
    """How a column of the trace is drawn. The later ones of a panel lie on top."""

    name: str
    label: str
    colour: str


class Panel(NamedTuple):
    """One pair of axes: its quantity, its SI unit and its curves."""

    quantity: str
    unit: str
    curves: tuple[Curve, ...]


# Okabe and Ito's colours, which colour-blind eyes tell apart: blues at the master's end, reds at the slave's.
_BLUE, _SKY, _RED, _YELLOW = "#0072B2", "#56B4E9", "#D55E00", "#E69F00"
_GREEN, _GREY = "#009E73", "#666666"
PANELS = (
    Panel("position", "m", (Curve("x_s", "$x_s$ slave", _RED), Curve("x_m", "$x_m$ master", _BLUE))),
    Panel("force", "N", (
        Curve("f_s", "$f_s$ on the slave", _YELLOW), Curve("f_env", "$f_{env}$ on the environment", _RED),
        Curve("f_h", "$f_h$ of the hand", _SKY), Curve("f_m", "$f_m$ against the hand", _BLUE),
    )),
    Panel("energy", "J", (
        Curve("E_port", "$E_{port}$ two-port", _GREY), Curve("E_link", "$E_{link}$ link", _GREEN),
    )),
)


def drawable() -> bool:
    """Is the extra `plot` installed?"""
    return find_spec("matplotlib") is not None


def need_plot() -> None:
    """Refuse where nothing can be drawn, before anything is computed."""
    if not drawable():
        raise Refused("a figure needs matplotlib: pip install 'bilateral-teleop[plot]', or leave --plot out")


def draw(result: Result, path: Path) -> None:
    """Draw `result` into the PNG file `path`, whole or not at all.

    The energy panel is there if the scene summed any. Several axes share a panel: the first is drawn as for
    one, the others thin. Raises `Refused` if the extra is missing or the file cannot be written.
    """
    need_plot()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = [panel for panel in PANELS if any(curve.name in result.trace for curve in panel.curves)]
    figure = Figure(figsize=(9.5, 2.3 * len(panels) + 0.9), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{literal(heading(result))}\n{literal(verdict(result))}", fontsize=11)
    every = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(every, panels, strict=True):
        _fill(axes, panel, result.trace)
    if len(result.trace["t"]):
        every[-1].set_xlim(0.0, result.trace["t"][-1] + result.dt)
    every[-1].set_xlabel("time (s)")
    figure.align_ylabels()
    save(figure, path)


def literal(text: str, *, most: int = 300) -> str:
    r"""`text` as a label shows it, letter for letter: a dollar sign begins no formula, and it is not too long to place.

    >>> print(literal("5 $ a$"))
    5 \$ a\$
    """
    return printable(text, most=most).replace("$", r"\$")


def save(figure: Figure, path: Path) -> None:
    """Write `figure` as the PNG file `path`, whole or not at all. Raises `Refused` if it cannot be written."""
    try:
        with replacing(path) as file:
            figure.savefig(file, format="png", metadata={"Software": None})  # the same run gives the same bytes
    except OSError as error:
        why = error.strerror or error
        raise Refused(f"could not write {path} ({why}); make room there, or make it writable") from error


def _fill(axes: Axes, panel: Panel, trace: Mapping[str, Any]) -> None:
    has = [curve for curve in panel.curves if curve.name in trace]
    thousands = _thousands([trace[curve.name] for curve in has])
    for curve in has:
        column = trace[curve.name] * 10.0 ** (-3 * thousands)
        for axis, values in enumerate([column] if column.ndim == 1 else column.T):
            first = axis == 0
            axes.plot(trace["t"], values, color=curve.colour, linewidth=1.2 if first else 0.5,
                      label=curve.label if first else None)
    axes.set_ylabel(f"{panel.quantity} ({PREFIX[thousands]}{panel.unit})")
    axes.grid(visible=True, linewidth=0.4, alpha=0.5)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9, reverse=True)


def _thousands(columns: list[Any]) -> int:
    """The power of a thousand whose SI prefix suits the greatest magnitude in `columns`."""
    import numpy as np

    peak = max((np.abs(column[np.isfinite(column)]).max(initial=0.0) for column in columns), default=0.0)
    return int(np.clip(np.floor(np.log10(peak) / 3.0), min(PREFIX), max(PREFIX))) if peak > 0.0 else 0
