"""What a page says of a sweep: how the rows ended, a map or curves over its knobs, and the first rows."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from teleop.errors import Refused, number_of
from teleop.report.curves import curves
from teleop.report.maps import maps
from teleop.report.markup import Markup, element, facts, table
from teleop.report.page import Section, cell, heading, made_by, parameters
from teleop.report.told import Told
from teleop.sweeps.pictures.layout import (
    axes_knobs_of,
    pairs_of,
    panels_of,
    text_of,
    varying,
    with_unit,
)
from teleop.sweeps.pictures.picture import check
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


def sweep_told(folder: Path, args: Namespace, formats: Sequence[str]) -> Told:
    """A sweep, drawn in `formats`. Raises `Refused`."""
    request = PictureRequest(args.picture, args.metric)
    told, text, rows = told_of(folder, args.rows)
    answer = Answer(text, told)
    if formats:
        answer = answer.with_plots(folder, picture(rows, folder, told, request, formats, trust=args.trust))
    return Told(folder, answer, running=is_growing(folder), section=lambda: sweep_section(
        folder.resolve().name, told, rows, request, trust=args.trust, shown=args.rows or ROWS))


def sweep_section(name: str, told: Mapping[str, Any], rows: Table, request: PictureRequest, *, trust: bool, shown: int
                  ) -> Section:
    """The section of a sweep called `name`."""
    fixed = told.get("fixed")
    reasons = [(f"{count} refused", sentence) for sentence, count in [*sentences(rows).items()][:SENTENCES]]
    title = f"{Path(str(told['scene'])).stem}: sweep of {', '.join(rows.knobs) or 'seeds'}"
    blocks = [*_figures(told, rows, request, trust), *_axes(rows), *([heading("Refused"), facts(reasons)] if reasons
              else []), *_rows(rows, shown), *(parameters(fixed, title="Set for all rows") if isinstance(fixed, dict)
                                               else []), *made_by(told)]
    return Section(title=title, under=f"folder {name}", sentence=str(told["sentence"]), blocks=blocks)


def _axes(rows: Table) -> list[Markup]:
    """What each knob goes through."""
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
    more = f"The first {len(lines)} of {len(rows)} rows" if len(lines) < len(rows) else "Rows"
    return [heading(more), table(names, lines)]


def _figures(told: Mapping[str, Any], rows: Table, request: PictureRequest, trust: bool) -> list[Markup]:
    """The picture that `--plot` draws, as far as one can be drawn; else why not."""
    try:
        return _figure(told, rows, request, trust) if len(rows) else []
    except Refused as refused:
        if any(request):
            raise
        return [element("p", {"class": "sub"}, f"No figure: {refused}")]


def _figure(told: Mapping[str, Any], rows: Table, request: PictureRequest, trust: bool) -> list[Markup]:
    units = knob_units(told, rows, trust=trust)
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
        drawn, left = maps(rows, panels, shown, metric if kind == "metric" else None, words_of(told, units), measured)
    said_ = [*notes, note, left]
    below = "; ".join(part for part in said_ if part)
    return [drawn, *[element("p", {"class": "sub"}, f"Shown: {below}.")] * bool(below)]
