"""Report of a sweep: how the rows ended, a map or curves over its knobs, and the first rows."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.errors import Refused, number_of
from teleop.report import svg
from teleop.report.markup import LEVELS, LINES, OTHER, STATUS, Markup, element, facts, joined, table
from teleop.report.page import FolderReport, Section, cell, heading, made_by, parameters
from teleop.report.scales import PlotAxis, along, around, axis_of, plain_number
from teleop.sweeps.pictures.layout import (
    PlottedKnob,
    axes_knobs_of,
    groups_of,
    pairs_of,
    panels_of,
    spacing,
    spread,
    text_of,
    varying,
    with_unit,
)
from teleop.sweeps.pictures.picture import MapPoints, check, map_points
from teleop.sweeps.pictures.report import (
    PictureRequest,
    knob_units,
    picture,
    sentences,
    told_of,
    words_of,
)
from teleop.sweeps.store import is_growing
from teleop.terminal.answer import Answer

if TYPE_CHECKING:

    from teleop.sweeps.table import Table

ROWS = 12  # that the page shows
SENTENCES = 5


def sweep_report(folder: Path, args: Namespace, formats: Sequence[str]) -> FolderReport:
    """A sweep, drawn in `formats`. Raises `Refused`."""
    request = PictureRequest(args.picture, args.metric)
    document, text, rows = told_of(folder, args.rows)
    answer = Answer(text, document)
    if formats:
        answer = answer.with_plots(folder, picture(rows, folder, document, request, formats, trust=args.trust))
    return FolderReport(folder, answer, running=is_growing(folder), section=lambda: sweep_section(
        folder.resolve().name, document, rows, request, trust=args.trust, shown=args.rows or ROWS))


def sweep_section(
    name: str, document: Mapping[str, Any], rows: Table, request: PictureRequest, *, trust: bool, shown: int
) -> Section:
    """The section of a sweep called `name`."""
    fixed = document.get("fixed")
    reasons = [(f"{count} refused", sentence) for sentence, count in [*sentences(rows).items()][:SENTENCES]]
    title = f"{Path(str(document['scene'])).stem}: sweep of {', '.join(rows.knobs) or 'seeds'}"
    blocks = [*_figures(document, rows, request, trust), *_axes(rows), *([heading("Refused"), facts(reasons)] if reasons
              else []), *_rows(rows, shown), *(parameters(fixed, title="Set for all rows") if isinstance(fixed, dict)
                                               else []), *made_by(document)]
    return Section(title=title, under=f"folder {name}", sentence=str(document["sentence"]), blocks=blocks)


def _axes(rows: Table) -> list[Markup]:
    """Values of each knob."""
    knobs, _ = varying(rows, {}) if len(rows) else ([], [])
    lines = []
    for knob in knobs:
        some = knob.values if len(knob.values) <= 8 else (*knob.values[:3], "...", knob.values[-1])
        lines.append((knob.name, f"{number_of(len(knob.values), 'value')}: {', '.join(map(text_of, some))}"))
    return [heading("Knobs"), facts(lines)] if lines else []


def _rows(rows: Table, shown: int) -> list[Markup]:
    """The first rows."""
    names = ["row", "seed", *rows.knobs, "status", "ticks", *rows.metrics]
    lines = []
    for i, row in enumerate(rows):
        if i == shown:
            break
        lines.append([cell(row[name]) if name in row else "" for name in names])
    if not lines:
        return []
    remaining = f"The first {len(lines)} of {len(rows)} rows" if len(lines) < len(rows) else "Rows"
    return [heading(remaining), table(names, lines)]


def _figures(document: Mapping[str, Any], rows: Table, request: PictureRequest, trust: bool) -> list[Markup]:
    """The picture that `--plot` draws, as far as one can be drawn; else why not."""
    try:
        return _figure(document, rows, request, trust) if len(rows) else []
    except Refused as refused:
        if any(request):
            raise
        return [element("p", {"class": "sub"}, f"No figure: {refused}")]


def _figure(document: Mapping[str, Any], rows: Table, request: PictureRequest, trust: bool) -> list[Markup]:
    units = knob_units(document, rows, trust=trust)
    knobs, notes = varying(rows, units)
    numeric = [knob.name for knob in knobs if knob.numeric]
    kind, metric = request
    check([knob.name for knob in knobs], numeric, kind, metric, rows.metrics)
    if kind is None:
        by_ending = metric is None and ({*rows.counts()} != {"ok"} or not rows.metrics)
        kind = "curves" if len(numeric) < 2 else "stability" if by_ending else "metric"
    metric = metric or next(iter(rows.metrics), None)
    measured = "" if metric is None else with_unit(metric, units)
    shown = axes_knobs_of(knobs, kind)
    others = [knob for knob in knobs if knob not in shown and pairs_of(knob, shown[0]) is None]
    panels, note = panels_of(rows, others)
    if kind == "curves":
        drawn, left = curves(rows, panels, shown, str(metric), measured)
    else:
        drawn, left = maps(rows, panels, shown, metric if kind == "metric" else None, words_of(document, units),
                           measured)
    remarks = [*notes, note, left]
    below = "; ".join(part for part in remarks if part)
    return [drawn, *[element("p", {"class": "sub"}, f"Shown: {below}.")] * bool(below)]


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
    samples = [map_points(rows, panel.rows, x, y, metric) for panel in panels]
    by_status = metric is None and all((one.status != "").all() for one in samples)
    values = np.concatenate([one.value for one in samples])
    values = values[np.isfinite(values)]
    scaled = spacing(values) if metric is not None and len(values) else ("linear", 0.0)
    span = PlotAxis(0.0, 1.0) if metric is None else along(
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
    sampled = all(len(one.x) <= 2 * max(len(x.values), len(y.values)) < cells for one in samples)
    for i, (box, panel, one) in enumerate(zip(boxes, panels, samples, strict=True)):
        ended = float((rows["status"][panel.rows] == "ok").mean())
        title = f"{plain_number(panel.title)}: {100.0 * ended:.3g} % ok".removeprefix(": ")
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


def _styles(one: MapPoints, by_status: bool, span: PlotAxis, words: Mapping[str, str], names: dict[str, _Area]
            ) -> list[str]:
    """The class of each point; `names` is given the kinds of the legend."""
    styles = []
    for status, share, value in zip(one.status.tolist(), one.share.tolist(), one.value.tolist(), strict=True):
        word = str(status) if by_status else "" if not isnan(value) else "refused" if isnan(share) else \
            "none ended ok" if share == 0.0 else "no such metric"
        if word:
            style = STATUS.get(word, OTHER)
            names.setdefault(word, _Area(style, words.get(word, word)))
            styles.append(style)
        else:
            styles.append(f"a{min(LEVELS - 1, max(0, int(span.at(value) * LEVELS)))}")
    return styles


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
    samples = []
    for i, x in enumerate(xs):
        for j, y in enumerate(ys):
            if (x, y) not in good:
                continue
            right, above = (xs[i + 1], y) if i + 1 < len(xs) else None, (x, ys[j + 1]) if j + 1 < len(ys) else None
            if right in good and good[right] != good[x, y]:
                samples.append((across[x][1], up[y][0], across[x][1], up[y][1]))
            if above in good and good[above] != good[x, y]:
                samples.append((across[x][0], up[y][1], across[x][1], up[y][1]))
    return samples


def _bar(span: PlotAxis, what: str, y: float) -> Markup:
    """The colours of a map of numbers, from the least to the greatest."""
    box = svg.Box(svg.LEFT, y - 8.0, 260.0, 9.0)
    cells = [svg.cells([(i / LEVELS, (i + 1) / LEVELS, 0.0, 1.0)], box, f"a{i}") for i in range(LEVELS)]
    return joined([*cells, svg.label(svg.LEFT - 4.0, y, text_of(span.low), anchor="end"),
                       svg.label(svg.LEFT + 264.0, y, f"{text_of(span.high)}   {what}")])


if TYPE_CHECKING:
    from teleop.sweeps.pictures.layout import Panel
    from teleop.sweeps.table import Table

CURVES = 5  # lines in a panel


def curves(rows: Table, panels: Sequence[Panel], knobs: Sequence[PlottedKnob], metric: str, measured: str
           ) -> tuple[Markup, str]:
    """Medians of the runs that ended ok, over the seeds, with their quartiles; a cross where not every run did."""
    import numpy as np

    x, by = knobs[0], knobs[1] if len(knobs) > 1 else None
    shown = [0] if by is None else spread(len(by.values), CURVES)
    drawn_lines: list[list[tuple[str, str, list[float], Any, list[int]]]] = []
    for panel in panels:
        drawn_lines.append([])
        for i, place in enumerate(shown):
            knob_values = panel.rows if by is None else panel.rows[by.place[panel.rows] == place]
            if not len(knob_values):
                continue
            ok = rows["status"][knob_values] == "ok"
            groups = groups_of(rows[metric][knob_values], x.place[knob_values], ok, len(x.values))
            three = np.array([np.quantile(each, (0.25, 0.5, 0.75)) if len(each) else [np.nan] * 3 for each in groups])
            at = [float(value) for value in x.values] if x.numeric else [float(j) for j in range(len(x.values))]
            name = "" if by is None else f"{by.name} {text_of(by.values[place])}"
            bad_places = sorted({*x.place[knob_values][~ok].tolist()})
            drawn_lines[-1].append((LINES[i % len(LINES)], name, at, three, bad_places))
    every = np.concatenate([three.ravel() for lines in drawn_lines for *_, three, _ in lines] or [np.array([])])
    every = every[np.isfinite(every) & (np.abs(every) < 1e30)]
    kind, bend = spacing(every) if len(every) else ("linear", 0.0)
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)
    y = around(low, high) if kind == "linear" or not high > low else along([low, high], kind, bend)
    axis = axis_of(x) if x.numeric else PlotAxis(-0.5, len(x.values) - 0.5)
    texts = None if x.numeric else [text_of(value)[:16] for value in x.values]
    boxes, total = svg.grid_of(len(panels), 3, 180.0, top=2.0 * svg.TITLE + 12.0, apart=svg.TITLE + 8.0, below=32.0)
    parts = [svg.label(12.0, 11.0, measured, style="b"),
             svg.legend([*dict.fromkeys((f"l {style}", name) for lines in drawn_lines
                                          for style, name, *_ in lines if name)],
                        svg.WIDTH - svg.RIGHT, 11.0)]
    for i, (box, panel, lines) in enumerate(zip(boxes, panels, drawn_lines, strict=True)):
        parts.append(svg.frame(box, axis, y, title=plain_number(panel.title), x_texts=texts, y_labels=i % 3 == 0,
                               x_labels=i + 3 >= len(panels)))
        for style, name, at, three, bad in lines:
            points = [(axis.at(a), *[y.at(float(v)) for v in row]) for a, row in zip(at, three, strict=True)
                      if np.isfinite(row).all() and np.abs(row).max() < 1e30]
            if x.numeric:
                parts.append(svg.segments([(a[0], a[2], b[0], b[2]) for a, b in pairwise(points)],
                                          box, f"l {style}"))
            parts += [svg.segments([(a, low_, a, high_) for a, low_, _, high_ in points if high_ > low_], box,
                                   f"l w {style}"),
                      svg.dots([(a, v, f"{name} {m:.4g}".strip()) for (a, _, v, _), m in zip(
                          points, [float(row[1]) for row in three if np.isfinite(row).all()], strict=False)], box,
                          style, 2.4)]
            parts.append(svg.crosses([(axis.at(at[place]), 0.03) for place in bad], box))
    below = f"{x.name} ({x.unit})" if x.unit else x.name
    crossed = "; a cross: not every run ended ok" if any(bad for lines in drawn_lines for *_, bad in lines) else ""
    parts.append(svg.label(svg.WIDTH - svg.RIGHT, total - 5.0, below + crossed, anchor="end"))
    left = f"{len(shown)} of {len(by.values)} values of {by.name}" if by is not None and len(shown) < len(by.values) \
        else ""
    return svg.figure(f"{metric} over {x.name}", f"Medians of the runs that ended ok, from {low:.4g} to {high:.4g}.",
                      total, *parts), left
