"""Points over two quantities, each with a name: linear axes, or by decades where the values ask for it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import NamedTuple

from teleop.report.figures import BOTTOM, LEFT, RIGHT, TEXT, TITLE, WIDTH, Box, embed, page_figure, panel
from teleop.report.markup import Markup
from teleop.report.page import heading
from teleop.terminal.plotting import literal, names_id, scale_by_decades, write_names
from teleop.terminal.run_plot import GREATEST

HEIGHT = 250.0
MOST_DOTS = 60  # on a line: of more the line alone is drawn
ACROSS = 6  # names of a legend in a line


class Mark(NamedTuple):
    """A point: its values, its name, and whether that is written beside it."""

    x: float
    y: float
    name: str
    written: bool = False


class Series(NamedTuple):
    """Points of one colour; `line`: how they are joined up in their order, if they are."""

    name: str
    colour: str
    points: Sequence[Mark]
    line: str = "none"


class Plane(NamedTuple):
    """A panel of points: what its axes are called, with units."""

    x: str
    y: str
    groups: Sequence[Series]


def scatter(title: str, planes: Sequence[Plane]) -> Iterator[Markup]:
    """A figure with a panel for each plane that has points."""
    some = [plane._replace(groups=[group._replace(points=[p for p in group.points if _finite(p)])
                                   for group in plane.groups]) for plane in planes]
    some = [plane for plane in some if any(group.points for group in plane.groups)]
    if not some:
        return
    entries = len({group.name for plane in some for group in plane.groups})
    top = 14.0 * -(-entries // ACROSS) + TITLE + 6.0
    height = top + HEIGHT + BOTTOM + 13.0
    figure = page_figure(height)
    wide = (WIDTH - RIGHT) / len(some) - LEFT
    words, lines = [], {}
    for i, plane in enumerate(some):
        axes = panel(figure, Box(LEFT + i * (wide + LEFT), top, wide, HEIGHT), literal(plane.y))
        axes.set_xlabel(literal(plane.x), fontsize=TEXT, loc="right")
        points = [point for group in plane.groups for point in group.points]
        for group in plane.groups:
            marker = "o" if group.line == "none" or len(group.points) <= MOST_DOTS else ""
            x, y = [point.x for point in group.points], [point.y for point in group.points]
            lines[literal(group.name)], = axes.plot(x, y, marker=marker, color=group.colour, linestyle=group.line,
                                                    markersize=6.0, gid=names_id(point.name for point in group.points))
        scale_by_decades(axes, "x", [point.x for point in points])
        scale_by_decades(axes, "y", [point.y for point in points])
        write_names(axes, figure, [(point.name, point.x, point.y) for point in points if point.written])
        words.append(f"{plane.y} from {min(p.y for p in points):.3g} to {max(p.y for p in points):.3g} over {plane.x} "
                     f"from {min(p.x for p in points):.3g} to {max(p.x for p in points):.3g}")
    lines.pop("", None)
    if lines:
        figure.legend([*lines.values()], [*lines], loc="upper right", ncols=ACROSS, frameon=False, fontsize=TEXT,
                      borderaxespad=0.0, bbox_to_anchor=(1.0 - RIGHT / WIDTH, 1.0))
    yield heading(title)
    yield embed(figure, title, f"{title}: {'; '.join(words)}.")


def _finite(point: Mark) -> bool:
    return all(isfinite(value) and abs(value) <= GREATEST for value in (point.x, point.y))
