"""Report of a sweep: how the rows ended, a map or curves over its knobs, and the first rows."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from teleop.errors import Refused, number_of
from teleop.report.figures import embed, figures
from teleop.report.markup import Markup, element, facts, table
from teleop.report.page import FolderReport, Section, cell, heading, made_by, parameters
from teleop.sweeps.pictures.layout import text_of, varying
from teleop.sweeps.pictures.picture import picture_of
from teleop.sweeps.pictures.report import PictureRequest, knob_units, picture, sentences, told_of, words_of
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
    blocks = [*figures(lambda: _figures(document, rows, request, trust)), *_axes(rows),
              *([heading("Refused"), facts(reasons)] if reasons else []), *_rows(rows, shown),
              *(parameters(fixed, title="Set for all rows") if isinstance(fixed, dict) else []), *made_by(document)]
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


def _figures(document: Mapping[str, Any], rows: Table, request: PictureRequest, trust: bool) -> Iterator[Markup]:
    """The picture that `--plot` draws, as far as one can be drawn; else why not."""
    if not len(rows):
        return
    units = knob_units(document, rows, trust=trust)
    try:
        figure, remarks = picture_of(rows, *request, units, words_of(document, units), page=True)
    except Refused as refused:
        if any(request):
            raise
        yield element("p", {"class": "sub"}, f"No figure: {refused}")
        return
    across, up = figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()
    counts = ", ".join(f"{count} {status}" for status, count in rows.counts().items())
    yield embed(figure, f"{up} over {across}", f"{up} over {across}: {len(rows)} rows ({counts}).")
    if remarks:
        yield element("p", {"class": "sub"}, f"Shown: {'; '.join(remarks)}.")
