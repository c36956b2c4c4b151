"""Points over two quantities, each with a name: linear axes, or by decades where the values ask for it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import isfinite
from typing import NamedTuple

from teleop.report import svg
from teleop.report.markup import Markup, joined
from teleop.report.page import heading
from teleop.report.scales import GREATEST, PlotAxis, around

LOG_FROM = 50.0  # greatest to least value, from which on an axis goes by decades
HEIGHT = 250.0
MOST_DOTS = 60  # on a line: of more the line alone is drawn


class Mark(NamedTuple):
    """A point: its values, its name, and whether that is written beside it."""

    x: float
    y: float
    name: str
    written: bool = False


class Series(NamedTuple):
    """Points of one colour; `lines`: joined up in their order."""

    name: str
    style: str
    points: Sequence[Mark]
    lines: bool = False


class Plane(NamedTuple):
    """A panel of points: what its axes are called, with units."""

    x: str
    y: str
    groups: Sequence[Series]


def scatter(title: str, planes: Sequence[Plane]) -> list[Markup]:
    """A figure with a panel for each plane that has points."""
    some = [plane._replace(groups=[group._replace(points=[p for p in group.points if _finite(p)])
                                   for group in plane.groups]) for plane in planes]
    some = [plane for plane in some if any(group.points for group in plane.groups)]
    if not some:
        return []
    entries = [*dict.fromkeys((f"l {group.style}", group.name) for plane in some for group in plane.groups
                              if group.name)]
    lines = _legend_lines(entries)
    boxes, height = svg.grid_of(len(some), 2, HEIGHT, top=14.0 * len(lines) + svg.TITLE + 6.0, below=30.0)
    if len(some) > 1:  # the second has numbers of its own at its left
        wide = (svg.WIDTH - 2.0 * svg.LEFT - svg.RIGHT) / 2.0
        boxes = [svg.Box(svg.LEFT + i * (wide + svg.LEFT), box.top, wide, box.height) for i, box in enumerate(boxes)]
    parts = [svg.legend(line, svg.WIDTH - svg.RIGHT, 11.0 + 14.0 * i) for i, line in enumerate(lines)]
    names = []
    for box, plane in zip(boxes, some, strict=True):
        points = [point for group in plane.groups for point in group.points]
        x, y = _axis([p.x for p in points]), _axis([p.y for p in points])
        parts += [svg.frame(box, x, y), svg.label(box.left, box.top - 5.0, plane.y, style="b"),
                  svg.label(box.left + box.width, box.top + box.height + 25.0, plane.x, anchor="end")]
        for group in plane.groups:
            at = [(x.at(p.x), y.at(p.y), p.name) for p in group.points]
            if group.lines:
                parts.append(svg.segments([(a[0], a[1], b[0], b[1]) for a, b in pairwise(at)], box,
                                          f"l {group.style}"))
            if not group.lines or len(at) <= MOST_DOTS:
                parts.append(svg.dots(at, box, group.style))
        parts.append(_names([(x.at(p.x), y.at(p.y), p.name) for p in points if p.written], box))
        names.append(f"{plane.y} from {min(p.y for p in points):.3g} to {max(p.y for p in points):.3g} over {plane.x} "
                    f"from {min(p.x for p in points):.3g} to {max(p.x for p in points):.3g}")
    return [heading(title), svg.figure(title, f"{title}: {'; '.join(names)}.", height, *parts)]


def _finite(point: Mark) -> bool:
    return all(isfinite(value) and abs(value) <= GREATEST for value in (point.x, point.y))


def _axis(values: Sequence[float]) -> PlotAxis:
    low, high = min(values), max(values)
    if low > 0.0 and high > LOG_FROM * low:
        return PlotAxis(low / 1.5, high * 1.5, log=True)
    return around(low, high)


def _legend_lines(entries: Sequence[tuple[str, str]]) -> list[list[tuple[str, str]]]:
    lines: list[list[tuple[str, str]]] = [[]]
    room = float(svg.WIDTH)
    for entry in entries:
        wide = 24.0 + svg.CHARACTER * len(entry[1])
        if room < wide + 40.0 and lines[-1]:
            lines.append([])
            room = float(svg.WIDTH)
        lines[-1].append(entry)
        room -= wide
    return [line for line in lines if line]


def _names(points: Sequence[tuple[float, float, str]], box: svg.Box) -> Markup:
    """A name beside each point, at the nearest height at which none is yet."""
    parts, taken = [], list[tuple[float, float, float, float]]()
    for px, py, name in sorted(points, key=lambda point: -point[1]):
        x, y = box.left + px * box.width, box.top + (1.0 - py) * box.height
        wide = svg.CHARACTER * len(name)
        left = x + 6.0 if x + 8.0 + wide < box.left + box.width else x - 6.0 - wide
        for step in (0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5):
            low = y + 3.5 + 11.0 * step
            place = (left, low - 9.0, left + wide, low)
            if box.top + 8.0 < low < box.top + box.height and not any(_meet(place, second) for second in taken):
                taken.append(place)
                parts.append(svg.label(left, low, name))
                break
    return joined(parts)


def _meet(one: tuple[float, float, float, float], second: tuple[float, float, float, float]) -> bool:
    return one[0] < second[2] and second[0] < one[2] and one[1] < second[3] and second[1] < one[3]
