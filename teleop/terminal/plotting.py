"""Plots: one palette, a new figure, and its PNG file, which is written whole or not at all. Needs the extra `plot`."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

from teleop.errors import Refused
from teleop.storage.files import replacing
from teleop.terminal.printable import printable

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The colours of Okabe and Ito, which colour-blind eyes tell apart.
BLUE, SKY, GREEN, ORANGE, RED, PINK = "#0072B2", "#56B4E9", "#009E73", "#E69F00", "#D55E00", "#CC79A7"
BROWN, PURPLE = "#8C564B", "#5D3A9B"  # where these are too few
BLACK, DARK, GREY, PALE = "#000000", "#666666", "#999999", "#D9D9D9"
FAILS = "#CC0000"  # a criterion that fails, a run that diverged


def drawable() -> bool:
    """True if the extra `plot` is installed."""
    return find_spec("matplotlib") is not None


def need_plot() -> None:
    """Refuse where nothing can be drawn, before anything is computed."""
    if not drawable():
        raise Refused("a plot needs matplotlib: pip install 'bilateral-teleop[plot]', or leave --plot out")


def new_figure(size: tuple[float, float], title: str = "") -> Figure:
    """An empty figure of `size` (width and height in inches) under `title`. Raises `Refused` without the extra."""
    need_plot()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def grid_lines(axes: Axes) -> None:
    """Thin grid lines at the major ticks."""
    axes.grid(visible=True, linewidth=0.4, alpha=0.5)


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
