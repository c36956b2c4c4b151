"""Plots: one palette, a new figure, and its files, each written whole or not at all. Needs the extra `plot`.

One rule for all commands: a plot is drawn only where --plot, or an option that says how it is to look, asks for it; the
answer names its files; and no file is overwritten.
"""

from __future__ import annotations

from importlib.util import find_spec
from io import BytesIO
from itertools import count
from os.path import lexists
from typing import TYPE_CHECKING, Any

from teleop.errors import Refused
from teleop.storage.files import read_bytes, replacing
from teleop.terminal.table import printable

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The colours of Okabe and Ito, which colour-blind eyes tell apart.
BLUE, SKY, GREEN, ORANGE, RED, PINK = "#0072B2", "#56B4E9", "#009E73", "#E69F00", "#D55E00", "#CC79A7"
YELLOW = "#F0E442"  # theirs too; for areas alone, on white a line of it is not seen
BROWN, PURPLE, OLIVE, WINE = "#8C564B", "#5D3A9B", "#999933", "#882255"  # where these are too few
BLACK, DARK, GREY, PALE = "#000000", "#666666", "#999999", "#BDBDBD"
FAILS = "#CC0000"  # a criterion that fails, a run that diverged
UNDER: dict[str, Any] = {"linewidth": 2.6, "alpha": 0.5}  # beneath a narrow curve: where they coincide both are seen

PNG = ("png",)  # in which a plot is drawn unless it is asked for in another format
# What each file would hold besides: the version of matplotlib, or the time. The same figure gives the same bytes.
WITHOUT: dict[str, dict[str, Any]] = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
WRITTEN: dict[Any, Any] = {"svg.hashsalt": "teleop",  # in place of random names of the parts of an SVG file
                           "pdf.fonttype": 42}  # letters stay letters, as publishers ask


def asked_formats(args: Namespace, *, wanted: bool = False) -> tuple[str, ...]:
    """The formats in which a command is to draw, from --plot and --format; empty: it is to draw nothing.

    `wanted`: another of its options asks for a plot. Raises `Refused` without the extra, before anything is computed.
    """
    if not (wanted or any(vars(args).get(name) for name in ("plot", "format"))):
        return ()
    need_plot()
    return args.format or PNG


def need_plot() -> None:
    """Refuse where nothing can be drawn."""
    if find_spec("matplotlib") is None:
        raise Refused("a plot needs matplotlib: pip install 'bilateral-teleop[plot]', or ask for no plot")


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


def save(figure: Figure, path: Path, formats: Sequence[str] = PNG) -> list[Path]:
    """Write `figure` as `path` with the suffix of each format, each file whole or not at all; returns the files.

    No file is overwritten: of NAME, NAME-2, NAME-3, ... the first is taken where each of the files is not there yet, or
    is this very figure, to the byte. Raises `Refused` if a file cannot be written.
    """
    drawn = {each: _draw(figure, each) for each in formats}
    for number in count(1):
        stem = path.name if number == 1 else f"{path.name}-{number}"
        files = {path.with_name(f"{stem}.{each}"): data for each, data in drawn.items()}
        if all(not lexists(file) or _holds(file, data) for file, data in files.items()):
            break
    for file, data in files.items():
        if not lexists(file):
            _write(file, data)
    return [*files]


def _draw(figure: Figure, kind: str) -> bytes:
    """The file in memory: the same figure gives the same bytes."""
    from matplotlib import rc_context

    with rc_context(WRITTEN), BytesIO() as file:
        figure.savefig(file, format=kind, metadata=WITHOUT[kind])
        return file.getvalue()


def _write(path: Path, data: bytes) -> None:
    try:
        with replacing(path) as file:
            file.write(data)
    except OSError as error:
        why = error.strerror or error
        raise Refused(f"could not write {path} ({why}); make room there, or make it writable") from error


def _holds(path: Path, data: bytes) -> bool:
    try:
        return read_bytes(path, most=len(data), links=False) == data
    except OSError:  # larger, a link, a folder, not to be read: something else
        return False
