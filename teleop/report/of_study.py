"""Report of the folder of a study: precision, tune, advise, stability, passivity, zwidth, reproduce, replay.

Such a folder has a summary.json; whatever it holds in numbers and texts is shown as it is called there, with its units.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.report.figures import figures
from teleop.report.markup import Markup, element, pairs, table
from teleop.report.page import FolderReport, Section, cell, heading, made_by, parameters, sentence_of, with_unit
from teleop.report.scatter import Mark, Plane, Series, scatter
from teleop.storage import strict_json as stored
from teleop.storage.files import read_bytes
from teleop.storage.strict_json import Misshapen, parse
from teleop.terminal.answer import Answer
from teleop.terminal.plotting import BLUE, DARK, GREEN, ORANGE, PINK, PURPLE, RED
from teleop.terminal.run_plot import LINES
from teleop.terminal.table import columns, facts, printable

SUMMARY = "summary.json"
MODES = ("precision", "tune", "advise", "stability", "passivity", "zwidth", "reproduce", "replay")
HEAD = {"status", "sentence", "scene", "mode", "parameters", "seed", "versions", "command", "dt", "units", "path",
        "notes", "meaning"}
COLOURS = (BLUE, RED, DARK, GREEN, PINK, ORANGE, PURPLE)
ROWS, COLUMNS, WIDE = 60, 9, 44  # of a table, and characters of a cell of it
ON_PAGE, LONG = 24, 28  # rows of it on a page, and characters of what stands in a line of its own there
_SHAPE = stored.record(
    {"status": stored.text, "sentence": stored.text, "mode": stored.one_of(*MODES)},
    {"scene": stored.optional(stored.text), "parameters": stored.record({}), "versions": stored.dict_of(stored.text),
     "command": stored.list_of(stored.text), "units": stored.dict_of(stored.text),
     "notes": stored.list_of(stored.text)})


class StudyBlock(NamedTuple):
    """A table of the summary: its heading, its columns' names (none: facts), its rows."""

    title: str
    head: tuple[str, ...]
    rows: list[tuple[str, ...]]


def is_study(folder: Path) -> bool:
    """True if the folder holds a summary that names such a study; also of one that is cut short, see `study`."""
    return (folder / SUMMARY).is_file() and not (folder / "trace.npz").exists() and _mode(folder) in MODES


def _mode(folder: Path) -> object:
    try:
        return parse(read_bytes(folder / SUMMARY, links=False)).get("mode")
    except (OSError, Misshapen, AttributeError):
        return None


def study_report(folder: Path, args: Namespace) -> FolderReport:
    """A study. Raises `Refused`."""
    try:
        document: dict[str, Any] = parse(read_bytes(folder / SUMMARY, links=False))
        _SHAPE(document, SUMMARY)
    except (OSError, Misshapen) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise Refused(f"{folder} holds no complete study ({why}); type the command that wrote it again") from error
    modes = [name for name, value in (("--plot", args.plot or args.format), ("--picture", args.picture),
                                      ("--metric", args.metric), ("--rows", args.rows)) if value]
    if modes:
        raise Refused(f"{folder} holds what teleop {document['mode']} found, which has no {modes[0]} here; leave it "
                      f"out, or type teleop {document['mode']} with --plot again")
    texts = blocks_of(document)
    text = [facts([(document["mode"], str(document.get("scene") or "")), ("status", f"{document['status']}: "
                                                                         f"{document['sentence']}")])]
    for block in texts:
        text.append(columns([block.head, *block.rows], left=(0,)) if block.head else facts(
            [(row[0], row[1]) for row in block.rows]))
    return FolderReport(folder, Answer("\n\n".join(text), {**document, "path": str(folder)}),
                section=lambda: _section(folder.resolve().name, document, texts))


def blocks_of(document: Mapping[str, Any]) -> list[StudyBlock]:
    """The numbers and texts of a document as tables: one of all that stand alone, and one for each list of objects."""
    units = document.get("units") or {}
    alone: list[tuple[str, ...]] = []
    documents: list[StudyBlock] = []
    for name, value in document.items():
        if name in HEAD:
            continue
        if isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
            documents += _tables(name, [_shortened(each) for each in value], units)
        elif isinstance(value, dict):
            alone += [(path, with_unit(each, units.get(path, units.get(key, ""))))
                      for key, each in value.items() if _plain_values(each) for path in [f"{name}.{key}"]]
            documents += [block for key, each in value.items() if isinstance(each, list) and each and
                      all(isinstance(one, dict) for one in each) for block in _tables(f"{name}.{key}", each, units)]
        elif _plain_values(value):
            alone.append((name, with_unit(value, units.get(name, ""))))
    notes = [("note", note) for note in document.get("notes") or ()]
    return [*([StudyBlock("Results", (), [*alone, *notes])] if alone or notes else []), *documents]


def _shortened(entry: Mapping[str, Any]) -> dict[str, Any]:
    """An entry of a list; of a method of precision what it is compared by."""
    errors = entry.get("errors")
    if not isinstance(errors, dict):
        return dict(entry)
    sizes = {f"{name}, at most": error.get("max") for name, error in errors.items() if isinstance(error, dict)}
    return {"name": entry.get("name"), "ns_per_tick": entry.get("ns_per_tick"), **sizes, **{
        key: entry.get(key) for key in ("status", "missed_contacts", "beaten_by")}}


def _plain_values(value: object) -> bool:
    """Can it stand in one cell?"""
    if isinstance(value, list):
        return 0 < len(value) <= 8 and all(isinstance(each, str | int | float) for each in value)
    return value is not None and not isinstance(value, dict) and value != ""


def _tables(name: str, entries: Sequence[Mapping[str, Any]], units: Mapping[str, str]) -> list[StudyBlock]:
    """Plain values of an object; of lists of objects in it a table each."""
    names = [key for key in dict.fromkeys(key for each in entries for key in each)
             if any(_plain_values(each.get(key)) for each in entries)]
    short = [key for key in names if all(len(sentence_of(each.get(key, ""))) <= WIDE for each in entries)][:COLUMNS]
    documents = []
    if short:
        head = tuple(f"{key} ({units[key]})" if units.get(key, "1") != "1" else key for key in short)
        rows = [tuple(printable(cell(each[key])) if _plain_values(each.get(key)) else "" for key in short)
                for each in entries[:ROWS]]
        nested = f", the first {ROWS} of {len(entries)}" if len(entries) > ROWS else ""
        documents.append(StudyBlock(f"{name.replace('_', ' ').capitalize()}{nested}", head, rows))
    for each in entries[:ROWS]:
        for key, inner in each.items():
            tables = isinstance(inner, list) and inner and all(isinstance(one, dict) for one in inner)
            if tables and len(documents) < ROWS:
                documents += _tables(f"{each.get('name', name)} {key}", inner, units)
    return documents


def _section(name: str, document: Mapping[str, Any], texts: Sequence[StudyBlock]) -> Section:
    mode = str(document["mode"])
    drawn: list[Markup] = []
    if mode in FIGURES:
        try:
            drawn = figures(lambda: FIGURES[mode](document))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError):  # numbers that others wrote
            drawn = [element("p", {"class": "sub"}, "No figure: the numbers for it are not there.")]
    parts: list[Markup] = []
    for block in texts:
        short = [(row[0], row[1]) for row in block.rows if not block.head and len(row[1]) <= LONG]
        rows = block.rows if block.head else [row for row in block.rows if len(row[1]) > LONG]
        parts += [heading(block.title), *[pairs(short)] * bool(short),
                  *[table(block.head, rows[:ON_PAGE], numbers=bool(block.head))] * bool(rows)]
        if len(rows) > ON_PAGE:
            parts.append(element("p", {"class": "sub"}, f"and {len(rows) - ON_PAGE} more, which {SUMMARY} has"))
    return Section(
        title=f"{document.get('scene') or mode}: {mode}", under=f"folder {name}", status=str(document["status"]),
        sentence=str(document["sentence"]), blocks=[
            *drawn, *parts, *parameters(document.get("parameters") or {}), *made_by(document)])


def _precision(document: Mapping[str, Any]) -> Iterator[Markup]:
    """The largest error of each method over its run time."""
    methods, units = document["methods"], document.get("units") or {}
    kinds = list(dict.fromkeys(str(one["method"]) for one in methods))
    planes = []
    for series, what, unit in (("x_s", "largest error of the slave's position", "m"),
                               ("f_env", "largest error of the force on the environment", "N")):
        groups = []
        for i, kind in enumerate(kinds):
            points = [Mark(float(one["ns_per_tick"]) * 1e-3, float(one["errors"][series]["max"] or 0.0),
                            str(one["name"]), kind in ("exact", "default"))
                      for one in methods if one["method"] == kind and one["status"] != "diverged"
                      and one["errors"].get(series, {}).get("max")]
            line = LINES[i // len(COLOURS) % len(LINES)]
            groups.append(Series(kind, COLOURS[i % len(COLOURS)], sorted(points), line))
        planes.append(Plane("run time (us a tick)", f"{what} ({units.get(series, unit)})", groups))
    return scatter("Error over run time", planes)


def _tune(document: Mapping[str, Any]) -> Iterator[Markup]:
    """Tracking error over drag of the points of the front; the one that was taken has its name."""
    best = document["best"]
    points = []
    for one in document["front"]:
        drag = (one["figures"].get("free") or one["figures"]["scene"])["f_m_max"]
        taken = all(one.get(name) == value for name, value in best.items())
        points.append(Mark(float(drag), 1e3 * float(one["figures"]["scene"]["x_err_rms"]),
                            "taken" if taken else "", taken))
    points.sort()
    return scatter("The front of tracking error against drag", [Plane(
        "greatest force in free space (N)", "tracking error, rms (mm)", [Series("", BLUE, points, "-")])])


def _zwidth(document: Mapping[str, Any]) -> Iterator[Markup]:
    """The greatest and the least impedance that can be rendered, over frequency."""
    documents = document["impedance"]
    groups = []
    for key, name, colour in (("upper", "greatest", BLUE), ("lower", "least", RED)):
        some = [*zip(documents["frequency"], documents[key], strict=True)][::6]
        groups.append(Series(name, colour, [Mark(float(f), float(z), "") for f, z in some if z is not None], "-"))
    return scatter("Impedance that can be rendered", [Plane("frequency (Hz)", "impedance (N s/m)", groups)])


FIGURES = {"precision": _precision, "tune": _tune, "zwidth": _zwidth}
