"""Report of a comparison's folder: the table and rankings of `teleop compare`, and how every case ended."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from teleop.errors import Refused, number_of
from teleop.report import svg
from teleop.report.markup import STATUS, Markup, element, facts, table
from teleop.report.page import FolderReport, Section, heading, made_by
from teleop.report.scatter import Mark, Plane, Series, scatter
from teleop.scene.axes import SHAPES
from teleop.storage import strict_json as stored
from teleop.storage.files import read_bytes
from teleop.storage.strict_json import Misshapen, parse
from teleop.studies.compare.figures import (
    BAD,
    COLUMNS,
    LawVerdict,
    axis_title,
    cells,
    columns_of,
    columns_to_show,
    endings,
    group_text,
    judge_laws,
    legend,
    rankings,
    text,
)
from teleop.sweeps.store import Store, is_growing
from teleop.terminal.answer import Answer

ENDED = ("ok", *BAD, "diverged", "refused")
MOST_ACROSS = 3  # environments in a row
CELL, WIDEST = 13.0, 26.0  # of a case: height, and width at most
NOTES = 8
_ROW = stored.record(
    {"law": stored.text, "link": stored.text, "environment": stored.text, "ended": stored.one_of(*ENDED),
     "seed": stored.whole(low=0), "row": stored.whole(low=0)},
    dict.fromkeys((column.key for column in COLUMNS), stored.either(stored.real, stored.one_of("inf", "-inf", "nan"))))
_SUMMARY = stored.record({}, {
    "status": stored.text, "sentence": stored.text, "file": stored.text, "notes": stored.list_of(stored.text),
    "command": stored.list_of(stored.text), "axis_units": SHAPES["axis_units"],
    "versions": stored.dict_of(stored.text),
    "conditions": stored.list_of(stored.record({"law": stored.text, "link": stored.text,
                                                "sentences": stored.list_of(stored.text)}))})


def comparison_report(folder: Path, args: Namespace) -> FolderReport:
    """A comparison. Raises `Refused`."""
    request = [name for name, value in (("--plot", args.plot or args.format), ("--picture", args.picture),
                                      ("--metric", args.metric), ("--rows", args.rows)) if value]
    if request:
        raise Refused(f"{folder} holds a comparison; for {request[0]} type the teleop compare that wrote it again with "
                      f"--plot, which runs no row twice, or read {folder / 'rows.csv'}")
    rows = sorted(Store.look(folder).rows(), key=lambda row: row["row"])
    document = _summary(folder)
    try:
        for row in rows:
            _ROW(row, f"row {row['row']}")
    except Misshapen as error:
        raise Refused(f"{folder} holds a comparison of another version, or rows that are none of it ({error}); type "
                      "the teleop compare that wrote it again with another --out") from error
    if not rows:
        raise Refused(f"{folder} holds a comparison without a row yet; type the teleop compare that wrote it again")
    verdicts = judge_laws(rows, dict.fromkeys(row["law"] for row in rows), document.get("axis_units") or ("m",))
    links, places = (list(dict.fromkeys(row[name] for row in rows)) for name in ("link", "environment"))
    words = (f"{number_of(len(verdicts), 'law')}, {number_of(len(links), 'link')}, "
            f"{number_of(len(places), 'environment')}; {number_of(len(rows), 'row')}")
    notes = [*document.get("notes", ()), *[f"{one['law']} over {one['link']}: {one['sentences'][0]}" for one in
                                           document.get("conditions", ()) if one["sentences"]]]
    heading_ = f"compare   {document.get('file', folder)}: {words}"
    answer = Answer(text(verdicts, rankings(verdicts), (), heading_, notes) + f"\nwritten to {folder}",
                    {**document, "done": len(rows), "path": str(folder)})
    return FolderReport(folder, answer, running=is_growing(folder), section=lambda: _section(
        folder.resolve().name, document, rows, verdicts, words, notes))


def _summary(folder: Path) -> dict[str, Any]:
    """The summary of the last call; nothing where a kill has left none."""
    try:
        document: dict[str, Any] = parse(read_bytes(folder / "summary.json", links=False))
        _SUMMARY(document, "summary.json")
    except (OSError, Misshapen):
        return {}
    return document


def _section(name: str, document: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], verdicts: Sequence[LawVerdict],
             words: str, notes: Sequence[str]) -> Section:
    columns = columns_to_show(verdicts)
    head = ["law", "ok", "osc", "div", *[f"{one.head} ({one.unit})" if one.unit else one.head for one in columns]]
    ranked = [(one.column.question, " | ".join(group_text(group, one.column) for group in one.groups)
               + (f"; half of the runs failed: {', '.join(one.failed)}" if one.failed else ""))
              for one in rankings(verdicts)]
    omitted = [("", f"and {len(notes) - NOTES} more, which summary.json has")] * (len(notes) > NOTES)
    blocks = [table(head, [cells(one, columns) for one in verdicts]),
              element("p", {"class": "sub small"}, legend(verdicts, 10**6)),
              *_status(rows, verdicts), *_tracking(verdicts),
              *([heading("Best first, = where they tie"), facts(ranked)] if ranked else []),
              *([heading("Notes"), facts([*[("", note) for note in notes[:NOTES]], *omitted])] if notes else []),
              *made_by(document)]
    return Section(title="Comparison of laws", under=f"folder {name}", status=str(document.get("status", "")),
                   sentence=words, blocks=blocks)


def _status(rows: Sequence[Mapping[str, Any]], verdicts: Sequence[LawVerdict]) -> list[Markup]:
    """A map: laws down, links across, a block for each environment; the worst of a case's seeds."""
    laws = [one.law for one in verdicts]
    links, places = (list(dict.fromkeys(str(row[name]) for row in rows)) for name in ("link", "environment"))
    ended = {law: endings(row for row in rows if row["law"] == law) for law in laws}
    left = 10.0 + svg.CHARACTER * min(24, max(map(len, laws)))
    below = 8.0 + svg.CHARACTER * min(20, max(map(len, links)))
    wide = max(CELL * len(links), 60.0)
    across = max(1, min(MOST_ACROSS, len(places), int((svg.WIDTH - left) / (wide + 16.0))))
    size = min(WIDEST, (svg.WIDTH - left - 16.0 * across) / across / len(links))
    tall = CELL * len(laws)
    parts = [svg.label(4.0, 11.0, "how the cases ended, the worst of the seeds", style="b")]
    kinds: dict[str, list[str]] = {}
    for i, place in enumerate(places):
        x, y = left + (i % across) * (size * len(links) + 16.0), 36.0 + (i // across) * (tall + 20.0)
        parts.append(svg.label(x, y - 5.0, place[:40], style="b"))
        by_style: dict[str, list[tuple[float, float, float, float]]] = {}
        for row, law in enumerate(laws):
            if i % across == 0:
                parts.append(svg.label(left - 4.0, y + CELL * (row + 0.78), law[:24], anchor="end"))
            for column, link in enumerate(links):
                status = ended[law].get((place, link))
                if status is not None:
                    style = STATUS[status]
                    if status not in kinds.setdefault(style, []):
                        kinds[style].append(status)
                    high = 1.0 - (row + 0.06) / len(laws)
                    by_style.setdefault(style, []).append(((column + 0.06) / len(links), (column + 0.94) / len(links),
                                                           high - 0.88 / len(laws), high))
        box = svg.Box(x, y, size * len(links), tall)
        parts += [svg.cells(some, box, style) for style, some in by_style.items()]
        if i + across >= len(places):
            parts += [svg.label(x + size * (column + 0.7), y + tall + 6.0, link[:20], anchor="end", up=True)
                      for column, link in enumerate(links)]
    lines = -(-len(places) // across)
    parts.append(svg.legend([(style, ", ".join(names)) for style, names in kinds.items()], svg.WIDTH - svg.RIGHT, 11.0))
    counts = "; ".join(f"{one.law}: " + ", ".join(f"{n} {status}" for status, n in sorted(one.ended.items()))
                       for one in verdicts)
    return [svg.figure("How the cases ended", f"Cases of each law. {counts}.",
                       36.0 + lines * (tall + 20.0) + below, *parts)]


def _tracking(verdicts: Sequence[LawVerdict]) -> list[Markup]:
    """Tracking error over felt drag: a law far to the right tracks because it holds the hand."""
    columns = columns_of(verdicts)
    error, drag = columns["x_err_rms"], columns["felt_drag"]
    points = [Mark(drag.factor * one.figures["felt_drag"].value, error.factor * one.figures["x_err_rms"].value,
                    one.law[:24], True) for one in verdicts
              if isfinite(one.figures["felt_drag"].value) and isfinite(one.figures["x_err_rms"].value)]
    if len(points) < 2:
        return []
    return scatter("Tracking against felt drag", [
        Plane(axis_title(drag), axis_title(error), [Series("", "m", points)])])
