"""Report of a comparison's folder: the table and rankings of `teleop compare`, and how every case ended."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from teleop.errors import Refused, number_of
from teleop.report.figures import embed, figures
from teleop.report.markup import Markup, element, facts, table
from teleop.report.page import FolderReport, Section, heading, made_by
from teleop.scene.axes import SHAPES
from teleop.storage import strict_json as stored
from teleop.storage.files import read_bytes
from teleop.storage.strict_json import Misshapen, parse
from teleop.studies.compare.figures import (
    BAD,
    COLUMNS,
    LawVerdict,
    cells,
    columns_to_show,
    group_text,
    judge_laws,
    legend,
    rankings,
    text,
)
from teleop.studies.compare.plot import status_map, tracking_plot
from teleop.sweeps.store import Store, is_growing
from teleop.terminal.answer import Answer

ENDED = ("ok", *BAD, "diverged", "refused")
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
    broken = [f"{one['law']} over {one['link']}: {one['sentences'][0]}" for one in document.get("conditions", ())
              if one["sentences"]]
    notes = list(dict.fromkeys([*document.get("notes", ()), *broken]))
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
              *figures(lambda: _figures(rows, verdicts)),
              *([heading("Best first, = where they tie"), facts(ranked)] if ranked else []),
              *([heading("Notes"), facts([*[("", note) for note in notes[:NOTES]], *omitted])] if notes else []),
              *made_by(document)]
    return Section(title="Comparison of laws", under=f"folder {name}", status=str(document.get("status", "")),
                   sentence=words, blocks=blocks)


def _figures(rows: Sequence[Mapping[str, Any]], verdicts: Sequence[LawVerdict]) -> Iterator[Markup]:
    """Map of where each law came to an end, and tracking error over felt drag, as `teleop compare` plots them."""
    links, places = (list(dict.fromkeys(str(row[name]) for row in rows)) for name in ("link", "environment"))
    counts = "; ".join(f"{one.law}: " + ", ".join(f"{n} {status}" for status, n in sorted(one.ended.items()))
                       for one in verdicts)
    yield heading("How the cases ended, the worst of the seeds")
    yield embed(status_map(rows, verdicts, links, places), "How the cases ended", f"Cases of each law. {counts}.")
    scatter = tracking_plot(verdicts)
    if scatter is not None:
        title = "Tracking against felt drag"
        yield heading(title)
        yield embed(scatter, title, "Median tracking error of each law over what it holds the hand back with in free "
                                    "space, as the table has them.")
