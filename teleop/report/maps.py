"""Maps of a sweep over two knobs: cells, or points of a sample, by how rows ended or by a metric."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import isnan
from typing import TYPE_CHECKING, NamedTuple

from teleop.report import svg
from teleop.report.knobs import axis_of, plain
from teleop.report.markup import Markup, joined
from teleop.report.scales import Axis, along
from teleop.report.style import LEVELS, OTHER, STATUS
from teleop.sweeps.pictures.layout import PlottedKnob, spacing, spread, text_of
from teleop.sweeps.pictures.picture import MapPoints, map_points

if TYPE_CHECKING:
    from collections.abc import Iterator

    from teleop.sweeps.pictures.layout import Panel
    from teleop.sweeps.table import Table

ALONG = 96  # cells along an axis, at most


class _Area(NamedTuple):
    """A kind of cells: its class, its name in the legend."""

    style: str
    name: str


def maps(rows: Table, panels: Sequence[Panel], knobs: Sequence[PlottedKnob], metric: str | None,
          words: Mapping[str, str], measured: str) -> tuple[Markup, str]:
    """Cells by status, by the share of runs that end ok, or by a metric; black between ok and not."""
    import numpy as np

    x, y = knobs
    found = [map_points(rows, panel.rows, x, y, metric) for panel in panels]
    by_status = metric is None and all((one.status != "").all() for one in found)
    values = np.concatenate([one.value for one in found])
    values = values[np.isfinite(values)]
    scaled = spacing(values) if metric is not None and len(values) else ("linear", 0.0)
    span = Axis(0.0, 1.0) if metric is None else along(
        [float(values.min()), float(values.max())] if len(values) else [0.0, 1.0], *scaled)
    across, up = _places(x), _places(y)
    height = 250.0 if len(panels) == 1 else 150.0
    top = svg.TITLE * 2 + 14.0
    columns = min(2 if len(panels) in (1, 2, 4) else 3, len(panels))
    boxes, total = svg.grid_of(len(panels), columns, height, top=top, apart=svg.TITLE + 8.0,
                               below=30.0 + 22.0 * (not by_status))
    parts: list[Markup] = []
    names: dict[str, _Area] = {}
    cells = len(x.values) * len(y.values)
    sampled = all(len(one.x) <= 2 * max(len(x.values), len(y.values)) < cells for one in found)
    for i, (box, panel, one) in enumerate(zip(boxes, panels, found, strict=True)):
        ended = float((rows["status"][panel.rows] == "ok").mean())
        title = f"{plain(panel.title)}: {100.0 * ended:.3g} % ok".removeprefix(": ")
        styles = _styles(one, by_status, span, words, names)
        low = i + columns >= len(panels)
        inside = [_sample(styles, one, x, y, box)] if sampled else [
            *_cells(styles, one, box, across, up), svg.segments(_edges(one, across, up), box, "edge")]
        parts += [*inside, svg.frame(box, axis_of(x), axis_of(y), title=title, x_labels=low, y_labels=i % columns == 0)]
    foot = boxes[-1].top + height
    label = f"{y.name} ({y.unit})" if y.unit else y.name
    below = f"{x.name} ({x.unit})" if x.unit else x.name
    parts += [svg.label(12.0, boxes[0].top - svg.TITLE - 6.0, f"{label} over {below}", style="b"),
              svg.legend([(area.style, area.name) for area in names.values()], svg.WIDTH - svg.RIGHT, 11.0),
              svg.label(svg.WIDTH - svg.RIGHT, foot + 25.0, below, anchor="end")]
    if not by_status:
        what = f"{measured}, median of the runs ok" if metric else "share of the runs that end ok"
        parts.append(_bar(span, what, total - 16.0))
    counts = ", ".join(f"{count} {status}" for status, count in rows.counts().items())
    return svg.figure(f"{'How rows ended' if metric is None else metric} over {x.name} and {y.name}",
                      f"Maps of {len(rows)} rows ({counts}), {x.name} from {text_of(x.values[0])} to "
                      f"{text_of(x.values[-1])} across, {y.name} from {text_of(y.values[0])} to "
                      f"{text_of(y.values[-1])} upwards.", total, *parts), "" if sampled else _thinned(x) + _thinned(y)


def _thinned(knob: PlottedKnob) -> str:
    return f"{ALONG} of {len(knob.values)} values of {knob.name} " if len(knob.values) > ALONG else ""


def _places(knob: PlottedKnob) -> dict[int, tuple[float, float]]:
    """For each place of a knob's value that is shown, where its cell begins and ends, from 0 to 1.

    The edges lie midway between neighbours; the outer cells end at the outer values, beyond which nothing was run.
    """
    axis = axis_of(knob)
    shown = spread(len(knob.values), ALONG)
    at = [axis.at(float(knob.values[place])) for place in shown]
    edges = [0.0, *[(a + b) / 2.0 for a, b in pairwise(at)], 1.0]
    return {place: (edges[i], edges[i + 1]) for i, place in enumerate(shown)}


def _styles(one: MapPoints, by_status: bool, span: Axis, words: Mapping[str, str], names: dict[str, _Area]
            ) -> list[str]:
    """The class of each point; `names` is given the kinds of the legend."""
    told = []
    for status, share, value in zip(one.status.tolist(), one.share.tolist(), one.value.tolist(), strict=True):
        word = str(status) if by_status else "" if not isnan(value) else "refused" if isnan(share) else \
            "none ended ok" if share == 0.0 else "no such metric"
        if word:
            style = STATUS.get(word, OTHER)
            names.setdefault(word, _Area(style, words.get(word, word)))
            told.append(style)
        else:
            told.append(f"a{min(LEVELS - 1, max(0, int(span.at(value) * LEVELS)))}")
    return told


def _sample(styles: Sequence[str], one: MapPoints, x: PlottedKnob, y: PlottedKnob, box: svg.Box) -> Markup:
    """The points of a sample, which has no grid."""
    across, up = axis_of(x), axis_of(y)
    return joined(svg.dots([(across.at(float(x.values[i])), up.at(float(y.values[j])), "")], box, style)
                  for style, i, j in zip(styles, one.x.tolist(), one.y.tolist(), strict=True))


def _cells(styles: Sequence[str], one: MapPoints, box: svg.Box, across: Mapping[int, tuple[float, float]],
           up: Mapping[int, tuple[float, float]]) -> Iterator[Markup]:
    """The cells, those of one colour as one path, those beside each other as one cell."""
    by_style: dict[str, list[tuple[float, float, float, float]]] = {}
    order = sorted(range(len(styles)), key=lambda i: (one.y[i], one.x[i]))
    for i in order:
        x, y = int(one.x[i]), int(one.y[i])
        if x in across and y in up:
            places = by_style.setdefault(styles[i], [])
            cell = (*across[x], *up[y])
            if places and places[-1][1] == cell[0] and places[-1][2:] == cell[2:]:
                cell = (places.pop()[0], *cell[1:])
            places.append(cell)
    return (svg.cells(places, box, style) for style, places in by_style.items())


def _edges(one: MapPoints, across: Mapping[int, tuple[float, float]], up: Mapping[int, tuple[float, float]]
           ) -> list[tuple[float, float, float, float]]:
    """The boundary between cells of which half of the runs end ok and those of which fewer do."""
    good = {(int(x), int(y)): share >= 0.5 for x, y, share in zip(one.x, one.y, one.share.tolist(), strict=True)
            if not isnan(share)}
    xs, ys = [*across], [*up]
    found = []
    for i, x in enumerate(xs):
        for j, y in enumerate(ys):
            if (x, y) not in good:
                continue
            right, above = (xs[i + 1], y) if i + 1 < len(xs) else None, (x, ys[j + 1]) if j + 1 < len(ys) else None
            if right in good and good[right] != good[x, y]:
                found.append((across[x][1], up[y][0], across[x][1], up[y][1]))
            if above in good and good[above] != good[x, y]:
                found.append((across[x][0], up[y][1], across[x][1], up[y][1]))
    return found


def _bar(span: Axis, what: str, y: float) -> Markup:
    """The colours of a map of numbers, from the least to the greatest."""
    box = svg.Box(svg.LEFT, y - 8.0, 260.0, 9.0)
    cells = [svg.cells([(i / LEVELS, (i + 1) / LEVELS, 0.0, 1.0)], box, f"a{i}") for i in range(LEVELS)]
    return joined([*cells, svg.label(svg.LEFT - 4.0, y, text_of(span.low), anchor="end"),
                       svg.label(svg.LEFT + 264.0, y, f"{text_of(span.high)}   {what}")])
