"""Plots: one palette, a new figure, and its files, each written whole or not at all. Needs the extra `plot`.

One rule for all commands: a plot is drawn only where --plot, or an option that says how it is to look, asks for it; the
answer names its files; and no file is overwritten.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable, Sequence
from functools import partial
from importlib.util import find_spec
from io import BytesIO
from itertools import count
from os.path import lexists
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from teleop.errors import Refused
from teleop.storage.files import read_bytes, replacing
from teleop.terminal.table import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The colours of Okabe and Ito, which colour-blind eyes tell apart.
BLUE, SKY, GREEN, ORANGE, RED, PINK = "#0072B2", "#56B4E9", "#009E73", "#E69F00", "#D55E00", "#CC79A7"
YELLOW = "#F0E442"  # theirs too; for areas alone, on white a line of it is not seen
BROWN, PURPLE, OLIVE, WINE = "#8C564B", "#5D3A9B", "#999933", "#882255"  # where these are too few
BLACK, DARK, GREY, PALE = "#000000", "#666666", "#999999", "#BDBDBD"
LOG_FROM = 50.0  # greatest to least value, from which on an axis goes by decades
NAME, NEXT = "name: ", "\u2028"  # before and between names in the id of what they are names of; no text has the latter
GRID, FRAME = "#E9E9E9", "#D9D9D9"  # of panels in a page
FAILS = "#CC0000"  # a criterion that fails, a run that diverged
UNDER: dict[str, Any] = {"linewidth": 2.6, "alpha": 0.5}  # beneath a narrow curve: where they coincide both are seen

Box = tuple[float, float, float, float]  # left, bottom, right and top, pixels

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


def can_draw() -> bool:
    """True if the extra `plot` is there."""
    return find_spec("matplotlib") is not None


def need_plot() -> None:
    """Refuse where nothing can be drawn."""
    if not can_draw():
        raise Refused("a plot needs matplotlib: pip install 'bilateral-teleop[plot]', or ask for no plot")


def new_figure(size: tuple[float, float], title: str = "", layout: Literal["constrained"] | None = "constrained"
               ) -> Figure:
    """An empty figure of `size` (width and height in inches) under `title`. Raises `Refused` without the extra."""
    need_plot()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=120, layout=layout)
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def grid_lines(axes: Axes) -> None:
    """Thin grid lines at the major ticks."""
    axes.grid(visible=True, linewidth=0.4, alpha=0.5)


def names_id(names: Iterable[str]) -> str:
    """The id of an artist in a page: the name of a curve, or of each of its marks, for a reader who points there."""
    return NAME + NEXT.join(map(printable, names))


def scale_by_decades(axes: Axes, name: str, values: Sequence[float]) -> None:
    """Scale an axis by decades where the values ask for it; where some are zero or below, linearly around zero."""
    sizes = sorted(abs(value) for value in values if value != 0.0)
    if not sizes or sizes[-1] < LOG_FROM * sizes[len(sizes) // 20]:
        return
    if min(values) > 0.0:
        getattr(axes, f"set_{name}scale")("log")
    else:
        near = max(sizes[len(sizes) // 4], sizes[-1] * 1e-4)
        getattr(axes, f"set_{name}scale")("symlog", linthresh=near)
        if min(values) >= 0.0:
            low, high = getattr(axes, f"get_{name}lim")()
            getattr(axes, f"set_{name}lim")(max(low, -0.4 * near), high)


def write_names(axes: Axes, figure: Figure, points: Sequence[tuple[str, float, float]]) -> None:
    """Write a name beside each point, at the first of eight places free of names and points, and inside the axes."""
    figure.draw_without_rendering()
    taken = [(x - 6.0, y - 6.0, x + 6.0, y + 6.0) for x, y in (axes.transData.transform(point[1:]) for point in points)]
    inside = axes.get_window_extent()
    for law, x, y in points:
        label = axes.annotate(literal(law), (x, y), xytext=(8, 0), textcoords="offset points", fontsize=8, va="center")
        size = label.get_window_extent()
        at_x, at_y = axes.transData.transform((x, y))
        free = None
        for step in (0, 1, -1, 2, -2, 3, -3, 4, -4):
            for left in (at_x + 12.0, at_x - 12.0 - size.width):
                low = at_y + step * 0.8 * size.height - 0.5 * size.height
                box = (left, low, left + size.width, low + size.height)
                fits = inside.x0 < box[0] and box[2] < inside.x1
                if free is None and fits and not any(map(partial(_overlap, box), taken)):
                    free = box
        if free is not None:
            points_a_pixel = 72.0 / figure.dpi
            label.set_position(((free[0] - at_x) * points_a_pixel, (0.5 * (free[1] + free[3]) - at_y) * points_a_pixel))
            taken.append(free)


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def literal(text: str, *, most: int = 300) -> str:
    r"""`text` as a label shows it, letter for letter: a dollar sign begins no formula, and it is not too long to place.

    A legend leaves out a name that begins with `_`, so a space stands before that.

    >>> print(literal("5 $ a$"), literal("_x"))
    5 \$ a\$  _x
    """
    return " " * text.startswith("_") + printable(text, most=most).replace("$", r"\$")


def save(figure: Figure, path: Path, formats: Sequence[str] = PNG) -> list[Path]:
    """Write `figure` as `path` with the suffix of each format, each file whole or not at all; returns the files.

    No file is overwritten: of NAME, NAME-2, NAME-3, ... the first is taken where each of the files is not there yet, or
    is this very figure, to the byte. Raises `Refused` if a file cannot be written.
    """
    drawn = {each: render(figure, each) for each in formats}
    for number in count(1):
        stem = path.name if number == 1 else f"{path.name}-{number}"
        files = {path.with_name(f"{stem}.{each}"): data for each, data in drawn.items()}
        if all(not lexists(file) or _holds(file, data) for file, data in files.items()):
            break
    for file, data in files.items():
        if not lexists(file):
            _write(file, data)
    return [*files]


def render(figure: Figure, kind: str, **settings: Any) -> bytes:
    """The file in memory, written with more `settings` of matplotlib: the same figure gives the same bytes."""
    from matplotlib import rc_context

    with rc_context(WRITTEN | settings), BytesIO() as file:
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
