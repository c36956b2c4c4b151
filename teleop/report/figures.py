"""Figures of a page: matplotlib's SVG, kept to paths and texts, in the colours of the page's style.

Every figure has a title and a description in words. Lengths are units of the drawing, about pixels. Nothing in a figure
has an id, so several stand in one page; nothing is clipped, so what is drawn lies inside its axes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple
from warnings import catch_warnings, simplefilter
from xml.etree import ElementTree

from teleop.report.markup import Markup, element, path_data
from teleop.terminal.plotting import FRAME, GRID, NAME, NEXT, can_draw, new_figure, render

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

UNIT = 72.0  # to an inch
WIDTH = 720  # of a figure over the whole page
LEFT, RIGHT, BETWEEN, TOP, BOTTOM = 52, 12, 20, 6, 17  # around and between panels
TITLE = 15  # height of the line over a panel
TEXT = 10.0  # size of texts
SVG, LINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"
KEPT = {"fill", "stroke", "stroke-width", "stroke-dasharray", "opacity", "fill-opacity", "stroke-opacity",
        "text-anchor", "font-size", "font-weight", "font-style"}  # of a style, which the page's policy does not allow
USUAL = {("font-size", f"{TEXT:g}px"), ("font-weight", "400"), ("text-anchor", "start")}
NO_FIGURE = element("p", {"class": "sub"}, "Figures need matplotlib, which is not installed; type "
                                           "pip install 'bilateral-teleop[plot]', and ask for the report again.")


class Box(NamedTuple):
    """Place of a panel in its figure."""

    left: float
    top: float
    width: float
    height: float


def figures(draw: Callable[[], Iterable[Markup]]) -> list[Markup]:
    """The figures that `draw` makes; without matplotlib a sentence."""
    if not can_draw():
        return [NO_FIGURE]
    with catch_warnings():
        simplefilter("ignore", UserWarning)  # of a letter that matplotlib's font has not, and a browser's has
        return [*draw()]


def grid_of(count: int, across: int, height: float, *, apart: float = TITLE, below: float = BOTTOM,
            top: float = TOP + TITLE, between: float = BETWEEN) -> tuple[list[Box], float]:
    """The boxes of `count` panels, `across` of them in a row, and the height of their figure."""
    across = min(across, count)
    wide = (WIDTH - LEFT - RIGHT - between * (across - 1)) / across
    boxes = [Box(LEFT + (i % across) * (wide + between), top + (i // across) * (height + apart), wide, height)
             for i in range(count)]
    return boxes, boxes[-1].top + height + below


def page_figure(height: float) -> Figure:
    """A figure as wide as the page, without a layout of its own."""
    return new_figure((WIDTH / UNIT, height / UNIT), layout=None)


def panel(figure: Figure, box: Box, title: str = "", *, beside: Axes | None = None) -> Axes:
    """Axes in a box, with a frame, grid lines and few ticks at round numbers. `beside`: axes that share its values."""
    from matplotlib.ticker import MaxNLocator

    wide, high = UNIT * figure.get_size_inches()
    axes = figure.add_axes((box.left / wide, 1.0 - (box.top + box.height) / high, box.width / wide, box.height / high),
                           sharey=beside)
    axes.spines[:].set(color=FRAME, linewidth=1.0)
    axes.grid(visible=True, color=GRID, linewidth=1.0)
    axes.set_axisbelow(True)
    axes.tick_params(which="both", length=0.0, left=False, bottom=False, labelsize=TEXT, pad=3.0)
    for axis, room, apart in ((axes.xaxis, box.width, 70.0), (axes.yaxis, box.height, 24.0)):
        axis.set_major_locator(MaxNLocator(max(2, int(room / apart)), steps=[1, 2, 5, 10]))
        axis.set_major_formatter("{x:.6g}")
    axes.set_title(title, fontsize=TEXT, fontweight="bold", loc="left", y=1.0, pad=4.0)  # y: it is not searched for
    return axes


def embed(figure: Figure, title: str, description: str) -> Markup:
    """The figure as an image of the page, whose title and description are read to who does not see it."""
    for patch in (figure.patch, *(axes.patch for axes in figure.axes)):
        patch.set_visible(False)  # the page's own ground, light or dark
    for cells in (cells for axes in figure.axes for cells in axes.collections):
        cells.set_rasterized(False)  # the page's policy allows no image
    root = ElementTree.fromstring(render(figure, "svg", **{"svg.fonttype": "none"}))
    shapes = {shape.get("id"): shape for shape in root.iter(f"{SVG}path")}
    wide = float(UNIT * figure.get_size_inches()[0])
    return element("figure", None, element(
        "svg", {"viewBox": root.get("viewBox"), "width": None if wide == WIDTH else f"{1.1 * wide:.0f}", "role": "img",
                "xmlns": SVG.strip("{}")},
        element("title", None, title), element("desc", None, description), *_parts(root, shapes)))


def _parts(group: ElementTree.Element, shapes: dict[str | None, ElementTree.Element],
           names: Iterable[str] = ()) -> Iterator[Markup]:
    """Visible parts of a group of matplotlib's SVG: paths, texts, and groups that are moved or named.

    `names` are those of its marks, in their order.
    """
    names = iter(names)
    for part in group:
        tag, identifier = part.tag.removeprefix(SVG), part.get("id", "")
        if identifier.startswith("QuadMesh"):
            yield from _cells(part)
        elif identifier.startswith(NAME):
            first, *others = identifier.removeprefix(NAME).split(NEXT)
            if others:
                yield from _parts(part, shapes, (first, *others))
            else:
                yield element("g", None, *_title(first), *_parts(part, shapes))
        elif tag == "g":
            inside, move = _parts(part, shapes, names), part.get("transform")
            yield from inside if move is None else [element("g", {"transform": move}, *inside)]
        elif tag == "path":
            yield element("path", {"d": _data(str(part.get("d"))), **_style(part)})
        elif tag == "use":
            shape = shapes[part.get(LINK, "").removeprefix("#")]
            move = f"translate({float(part.get('x', 0)):.1f} {float(part.get('y', 0)):.1f})"
            yield element("path", {"d": _data(str(shape.get("d"))), **_style(shape), **_style(part), "transform": move},
                          *_title(next(names, "")))
        elif tag in ("text", "tspan"):
            places = {name: " ".join(f"{float(each):.1f}" for each in part.get(name, "").split()) for name in "xy"}
            turn = re.sub(r"(\.\d)\d+", r"\1", part.get("transform", ""))
            yield element(tag, {**{name: at for name, at in places.items() if at}, **_style(part),
                                "transform": None if turn.startswith("rotate(-0") else turn or None},
                          "" if len(part) else part.text or "", *_parts(part, shapes))


def _title(name: str) -> list[Markup]:
    return [element("title", None, name)] * bool(name)


def _cells(mesh: ElementTree.Element) -> Iterator[Markup]:
    """The cells of a map, those of one colour as one path."""
    by_style: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for cell in mesh.iter(f"{SVG}path"):
        by_style.setdefault((*_style(cell).items(),), []).append(_data(str(cell.get("d"))))
    for style, cells in by_style.items():
        yield element("path", {"d": path_data("".join(cells)), **dict(style), "shape-rendering": "crispEdges"})


def _style(part: ElementTree.Element) -> dict[str, str]:
    """The properties of a style that make it what it looks like.

    >>> _style(ElementTree.Element("text", style="font: 700 12px 'DejaVu Sans'; text-anchor: start"))
    {'font-size': '12px', 'font-weight': '700'}
    """
    pairs = (each.partition(":") for each in part.get("style", "").split(";"))
    style = {name.strip(): value.strip() for name, _, value in pairs}
    if "font" in style:  # all in one: an older matplotlib
        *words, style["font-size"] = style["font"].partition("'")[0].split()
        style |= {"font-weight" if word.isdigit() else "font-style": word for word in words}
    return {name: value for name, value in style.items() if name in KEPT and (name, value) not in USUAL}


def _data(path: str) -> Markup:
    """The commands of a path, with points from one to the next in tenths of a unit."""
    parts: list[str] = []
    before, at = "", (0, 0)
    for command, numbers in re.findall(r"([MLQCz])([^MLQCz]*)", path):
        values = [round(10.0 * float(number)) for number in numbers.split()]
        points = [*zip(values[::2], values[1::2], strict=True)]
        if command == "M":
            at = (0, 0)
        letter = command if command == "M" else command.lower()
        parts.append(letter if letter != before or letter == "M" else " ")
        parts.append(" ".join(f"{(x - at[0]) / 10:g} {(y - at[1]) / 10:g}" for x, y in points))
        before, at = letter, points[-1] if points else at
    return path_data(re.sub(r" (?=-)|\b0(?=\.\d)", "", "".join(parts)))
