"""Points over two quantities, each with a name: linear axes, or by decades where the values ask for it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite, nan
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
    """A panel of points: what its axes are called, with units.

    `decades`: axes that are scaled by decades where their values ask for it; `round`: both axes have the same scale.
    """

    x: str
    y: str
    groups: Sequence[Series]
    decades: str = "xy"
    round: bool = False


def scatter(title: str, planes: Sequence[Plane]) -> Iterator[Markup]:
    """A figure with a panel for each plane that has points."""
    some = [plane._replace(groups=[group for group in plane.groups if any(map(_finite, group.points))])
            for plane in planes]
    some = [plane for plane in some if plane.groups]
    if not some:
        return
    entries = len({group.name for plane in some for group in plane.groups} - {""})
    top = 14.0 * -(-entries // ACROSS) + TITLE + 6.0
    height = top + HEIGHT + BOTTOM + 13.0
    figure = page_figure(height)
    wide = (WIDTH - RIGHT) / len(some) - LEFT
    words, lines = [], {}
    for i, plane in enumerate(some):
        axes = panel(figure, Box(LEFT + i * (wide + LEFT), top, wide, HEIGHT), literal(plane.y))
        axes.set_xlabel(literal(plane.x), fontsize=TEXT, loc="right")
        points = [point for group in plane.groups for point in group.points if _finite(point)]
        for group in plane.groups:
            drawn = [point if _finite(point) else Mark(nan, nan, point.name) for point in group.points]
            named = any(point.name for point in drawn)
            level = not named and len(drawn) == 2
            marker = "o" if group.line == "none" or (len(drawn) <= MOST_DOTS and not level) else ""
            lines[literal(group.name)], = axes.plot(
                [point.x for point in drawn], [point.y for point in drawn], marker=marker, color=group.colour,
                linestyle=group.line, markersize=6.0, gid=names_id(point.name for point in drawn) if named else None)
        for name, values in (("x", [point.x for point in points]), ("y", [point.y for point in points])):
            if name in plane.decades:
                scale_by_decades(axes, name, values)
        if plane.round:
            axes.set_aspect("equal", adjustable="datalim")
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
