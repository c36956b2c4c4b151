"""Figures as SVG: panels with axes, light grid lines, curves, cells and points, in the colours of the page's style.

Every figure has a title and a description in words. Lengths are those of the drawing, about pixels; a path is in tenths
of them, as whole numbers, which keeps it short.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isnan
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.report.markup import Markup, element, empty, joined, path_data
from teleop.report.scales import GREATEST
from teleop.simulation.trace import blocks

if TYPE_CHECKING:
    from teleop.report.scales import PlotAxis

WIDTH = 720  # of a figure
LEFT, RIGHT, BETWEEN, TOP, BOTTOM = 52, 12, 20, 6, 17  # around and between panels
TITLE = 15  # height of the line over a panel
CHARACTER = 5.9  # width of a letter of a label, about
ONE = 4  # tenths: a column of pixels whose values differ by no more is drawn as one point


class Box(NamedTuple):
    """Place of a panel in its figure."""

    left: float
    top: float
    width: float
    height: float


def figure(title: str, description: str, height: float, *inside: Markup, width: float = WIDTH) -> Markup:
    """An image, whose title and description are read to who does not see it."""
    head = element("title", None, title), element("desc", None, description)
    return element("figure", None, element(
        "svg", {"viewBox": f"0 0 {width:g} {height:g}", "role": "img", "xmlns": "http://www.w3.org/2000/svg"},
        *head, *inside))


def label(x: float, y: float, words: str, *, anchor: str | None = None, style: str | None = None, up: bool = False
          ) -> Markup:
    """A text that stands at x, y; `up`: written upwards."""
    turned = f"rotate(-90 {x:g} {y:g})" if up else None
    return element("text", {"x": f"{x:.4g}", "y": f"{y:.4g}", "text-anchor": anchor, "class": style,
                            "transform": turned}, words)


def frame(box: Box, x: PlotAxis, y: PlotAxis, *, title: str = "", x_labels: bool = True, y_labels: bool = True,
          x_texts: Sequence[str] | None = None, y_texts: Sequence[str] | None = None) -> Markup:
    """Grid lines and ticks of a panel. `x_texts`, `y_texts`: what stands at 0, 1, 2, ... in place of numbers."""
    lines, labels = [], []
    bottom = box.top + box.height
    for value, words in ticks_of(x, max(2, int(box.width / 70.0)), x_texts):
        at = box.left + x.at(value) * box.width
        lines.append(f"M{at:.1f} {box.top:g}v{box.height:g}")
        labels += [label(at, bottom + 12, words, anchor="middle")] * x_labels
    for value, words in ticks_of(y, max(2, int(box.height / 24.0)), y_texts):
        at = bottom - y.at(value) * box.height
        lines.append(f"M{box.left:g} {at:.1f}h{box.width:g}")
        labels += [label(box.left - 4, at + 3.5, words, anchor="end")] * y_labels
    head = [label(box.left, box.top - 4, title, style="b")] * bool(title)
    outline = empty("rect", {"x": f"{box.left:g}", "y": f"{box.top:g}", "width": f"{box.width:g}",
                             "height": f"{box.height:g}", "class": "f"})
    return joined([empty("path", {"d": path_data("".join(lines)), "class": "grid"}), outline, *labels, *head])


def ticks_of(axis: PlotAxis, most: int, texts: Sequence[str] | None) -> list[tuple[float, str]]:
    """The ticks of an axis of numbers; with `texts` those, at 0, 1, 2, ..."""
    return axis.ticks(most) if texts is None else [(float(i), words) for i, words in enumerate(texts)]


def curve(line: Line, box: Box, y: PlotAxis, style: str, name: str) -> Markup:
    """A curve in a panel, called `name`: the least and the greatest value of each column of pixels, joined up."""
    scale, foot = 10.0 * box.height, 10.0 * (box.top + box.height)
    wide, left = 10.0 * box.width, 10.0 * box.left
    names: list[str] = []
    before: tuple[int, int] | None = None
    for x, least, greatest in zip(line.x.tolist(), line.least.tolist(), line.greatest.tolist(), strict=True):
        if isnan(least):  # a gap
            before = None
            continue
        at = round(left + wide * x)
        low, high = round(foot - scale * y.at(least)), round(foot - scale * y.at(greatest))
        points = [low] if low - high <= ONE else [low, high]
        if before is None:
            names.append(f"M{at} {points[0]}l")
            before = (at, points.pop(0))
            names += ["0 0 "] * (not points)  # a point by itself is seen by its round end
        elif len(points) > 1 and abs(points[1] - before[1]) < abs(points[0] - before[1]):
            points.reverse()
        for point in points:
            names.append(f"{at - before[0]} {point - before[1]} ")
            before = (at, point)
    return element("path", {"d": path_data(_tight("".join(names))), "class": style, "transform": "scale(.1)"},
                   element("title", None, name))


def _tight(path: str) -> str:
    """A path without the spaces that it needs not, and without the points that carry on straight."""
    return path.replace(" -", "-").replace(" M", "M").rstrip()


def marks(at: Iterable[tuple[float, str]], box: Box, x: PlotAxis) -> Markup:
    """Dashed lines from top to bottom at places on the x axis, each with a name."""
    down = f"{box.top:g}v{box.height:g}"
    return joined(element("path", {"d": path_data(f"M{box.left + x.at(value) * box.width:.1f} {down}"), "class": "e"},
                          element("title", None, name)) for value, name in at)


def legend(entries: Sequence[tuple[str, str]], right: float, y: float) -> Markup:
    """Names of curves or areas, each behind a sample in its style, in one line that ends at `right`."""
    parts: list[Markup] = []
    x = right - sum(26.0 + CHARACTER * len(name) for _, name in entries)
    for style, name in entries:
        area = style.startswith("a")
        sample = empty("rect", {"x": f"{x:.1f}", "y": f"{y - 8:g}", "width": 10, "height": 8, "class": style}) if area \
            else empty("path", {"d": f"M{10 * x:.0f} {10 * y - 35:.0f}h120", "class": style, "transform": "scale(.1)"})
        parts += [sample, label(x + 16.0, y, name)]
        x += 26.0 + CHARACTER * len(name)
    return joined(parts)


def cells(places: Iterable[tuple[float, float, float, float]], box: Box, style: str) -> Markup:
    """Cells of one colour, each (left, right, low, high) from 0 to 1 along the axes."""
    wide, high = 10.0 * box.width, 10.0 * box.height
    left, foot = 10.0 * box.left, 10.0 * (box.top + box.height)
    names = []
    for a, b, low, top in places:
        x, end, y, to = (round(left + wide * a), round(left + wide * b), round(foot - high * top),
                         round(foot - high * low))
        names.append(f"M{x} {y}h{end - x}v{to - y}h{x - end}z")
    return empty("path", {"d": path_data("".join(names)), "class": style, "transform": "scale(.1)"})


def segments(places: Iterable[tuple[float, float, float, float]], box: Box, style: str) -> Markup:
    """Lines, each from (x, y) to (x, y), from 0 to 1 along the axes."""
    foot = box.top + box.height
    names = "".join(f"M{10 * (box.left + a * box.width):.0f} {10 * (foot - b * box.height):.0f}"
                   f"L{10 * (box.left + c * box.width):.0f} {10 * (foot - d * box.height):.0f}"
                   for a, b, c, d in places)
    return empty("path", {"d": path_data(names), "class": style, "transform": "scale(.1)"})


def dots(points: Iterable[tuple[float, float, str]], box: Box, style: str, radius: float = 3.0) -> Markup:
    """Points from 0 to 1 along the axes, each with a name."""
    foot = box.top + box.height
    return joined(element("circle", {"cx": f"{box.left + x * box.width:.1f}", "cy": f"{foot - y * box.height:.1f}",
                                     "r": f"{radius:g}", "class": style}, *[element("title", None, name)] * bool(name))
                  for x, y, name in points)


def grid_of(count: int, across: int, height: float, *, apart: float = TITLE, below: float = BOTTOM,
            left: float = LEFT, top: float = TOP + TITLE, between: float = BETWEEN) -> tuple[list[Box], float]:
    """The boxes of `count` panels, `across` of them in a row, and the height of their figure."""
    across = min(across, count)
    wide = (WIDTH - left - RIGHT - between * (across - 1)) / across
    boxes = [Box(round(left + (i % across) * (wide + between), 1), top + (i // across) * (height + apart),
                 round(wide, 1), height) for i in range(count)]
    return boxes, boxes[-1].top + height + below


def crosses(points: Iterable[tuple[float, float]], box: Box, size: float = 3.0) -> Markup:
    """Crosses at points from 0 to 1 along the axes."""
    foot = 10.0 * (box.top + box.height)
    names = "".join(f"M{10 * (box.left + x * box.width - size):.0f} {foot - 10 * (y * box.height + size):.0f}"
                   f"l{20 * size:.0f} {20 * size:.0f}m{-20 * size:.0f} 0l{20 * size:.0f} {-20 * size:.0f}"
                   for x, y in points)
    return empty("path", {"d": path_data(names), "class": "cross", "transform": "scale(.1)"}) if names else joined([])


if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


class Line(NamedTuple):
    """Points of a curve: arrays of shape (points,); where `least` is NaN, there is a gap."""

    x: NDArray[Any]  # from 0 to 1 along the axis
    least: NDArray[Any]
    greatest: NDArray[Any]

    def range(self) -> tuple[float, float]:
        """The least and the greatest value of all, (inf, -inf) of none."""
        import numpy as np

        known = np.isfinite(self.least)
        return (float(self.least[known].min(initial=np.inf)), float(self.greatest[known].max(initial=-np.inf)))


def line_of(t: NDArray[Any], values: NDArray[Any], low: float, high: float, columns: int) -> Line:
    """The curve of `values` (rows,) at times `t` (rows,), which grow, over `low` .. `high` in `columns` of pixels.

    With fewer than two rows a column each row is a point. A value that is not finite, or beyond `GREATEST`, is a gap.
    """
    import numpy as np

    if len(t) < 2 * columns:
        sound = _sound(np.asarray(values, dtype=float))
        return Line((np.asarray(t, dtype=float) - low) / (high - low), sound, sound)
    least, greatest = np.full(columns, np.inf), np.full(columns, -np.inf)
    for place, begin, part in _parts(t, values, low, high, columns):
        least[place] = np.fmin(least[place], np.fmin.reduceat(part, begin))
        greatest[place] = np.fmax(greatest[place], np.fmax.reduceat(part, begin))
    nothing = ~np.isfinite(least)
    least[nothing] = greatest[nothing] = np.nan
    return Line((np.arange(columns) + 0.5) / columns, least, greatest)


def _parts(t: NDArray[Any], values: NDArray[Any], low: float, high: float, columns: int
           ) -> Iterator[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]]:
    """Iterate over blocks of rows: the columns that have rows in them, where their rows begin, and the values."""
    import numpy as np

    for block in blocks(len(t)):
        at = (np.asarray(t[block], dtype=float) - low) * (columns / (high - low))
        place = np.clip(at.astype(np.int64), 0, columns - 1)
        begin = np.flatnonzero(np.diff(place, prepend=-1))
        yield place[begin], begin, _sound(np.asarray(values[block], dtype=float))


def _sound(values: NDArray[Any]) -> NDArray[Any]:
    import numpy as np

    return np.where(np.abs(values) <= GREATEST, values, np.nan)
