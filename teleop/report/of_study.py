"""Report of the folder of a study: precision, tune, advise, stability, passivity, zwidth, reproduce, replay.

Such a folder has a summary.json; whatever it holds in numbers and texts is shown as it is called there, with its units.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

from teleop.errors import Refused
from teleop.report.figures import UNIT, WIDTH, embed, figures
from teleop.report.markup import Markup, element, pairs, table
from teleop.report.page import FolderReport, Section, cell, heading, made_by, parameters, sentence_of, with_unit
from teleop.report.scatter import Mark, Plane, Series, scatter
from teleop.storage import strict_json as stored
from teleop.storage.archive import read_arrays
from teleop.storage.files import read_bytes
from teleop.storage.strict_json import Misshapen, parse
from teleop.terminal.answer import Answer
from teleop.terminal.plotting import BLUE, DARK, FAILS, GREEN, ORANGE, PINK, PURPLE, RED, new_figure
from teleop.terminal.run_plot import LINES
from teleop.terminal.table import columns, facts, printable

SUMMARY, CURVES = "summary.json", "curves.npz"
MODES = ("precision", "tune", "advise", "stability", "passivity", "zwidth", "reproduce", "replay")
HEAD = {"status", "sentence", "scene", "mode", "parameters", "seed", "versions", "command", "dt", "units", "path",
        "notes", "meaning"}
COLOURS = (BLUE, RED, DARK, GREEN, PINK, ORANGE, PURPLE)
ROWS, COLUMNS, WIDE = 60, 9, 44  # of a table, and characters of a cell of it
ETA, AT_REST = 3.0, 1e-6  # greatest drawn of Llewellyn's parameter; from |z| = 1
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
                section=lambda: _section(folder, document, texts))


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
        elif isinstance(value, list) and value and all(isinstance(each, str) and len(each) > LONG for each in value):
            alone += [(name, value[0]), *[("", each) for each in value[1:ROWS]]]
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


def _section(folder: Path, document: Mapping[str, Any], texts: Sequence[StudyBlock]) -> Section:
    mode = str(document["mode"])
    drawn: list[Markup] = []
    try:
        if mode in FIGURES:
            drawn = figures(lambda: FIGURES[mode](document))
        elif mode in OF_CURVES:
            drawn = figures(lambda: OF_CURVES[mode](document, read_arrays(folder / CURVES, None)))
    except FileNotFoundError:
        cure = "a run in time has none" if document.get("method") == "run" else "type its command again with --plot"
        drawn = [element("p", {"class": "sub"}, f"No figure: the folder has no {CURVES}; {cure}.")]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, OSError, BadZipFile):
        drawn = [element("p", {"class": "sub"}, "No figure: the numbers for it are not there.")]  # others wrote them
    parts: list[Markup] = []
    for block in texts:
        short = [(row[0], row[1]) for row in block.rows if not block.head and len(row[1]) <= LONG]
        rows = block.rows if block.head else [row for row in block.rows if len(row[1]) > LONG]
        parts += [heading(block.title), *[pairs(short)] * bool(short),
                  *[table(block.head, rows[:ON_PAGE], numbers=bool(block.head))] * bool(rows)]
        if len(rows) > ON_PAGE:
            parts.append(element("p", {"class": "sub"}, f"and {len(rows) - ON_PAGE} more, which {SUMMARY} has"))
    return Section(
        title=f"{document.get('scene') or mode}: {mode}", under=f"folder {folder.resolve().name}",
        status=str(document["status"]), sentence=str(document["sentence"]), blocks=[
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


def _advise(document: Mapping[str, Any]) -> Iterator[Markup]:
    """The laws, each with what it is judged by, as `teleop advise --plot` draws them."""
    from teleop.studies.advise.report import draw_laws

    searched = [each for each in document["laws"] if "terms" in each]
    if not searched:
        return
    figure = new_figure((WIDTH / UNIT, 1.4 + 0.45 * len(searched)))
    advised = searched[0]["law"] if document["status"] == "done" else None
    draw_laws(figure.subplots(), searched, advised)
    title = "Laws over this link"
    values = [f"{each['law']}: {each['broken'] or format(float(each['value']), '.3f')}" for each in searched]
    yield heading(title)
    yield embed(figure, title, f"{title}, 0 as a rigid rod, 1 as a law that does nothing. {'; '.join(values)}.")


def _curve(name: str, colour: str, x: Any, y: Any, line: str = "-") -> Series:
    return Series(name, colour, [Mark(float(a), float(b), "") for a, b in zip(x, y, strict=True)], line)


def _level(x: Any) -> Series:
    """A line at 1, which a criterion compares with."""
    return _curve("1", DARK, (x[0], x[-1]), (1.0, 1.0), "--")


def _passivity(document: Mapping[str, Any], curves: Mapping[str, Any]) -> Iterator[Markup]:
    """Impedances and Llewellyn's parameter of two ports over frequency; of one port the damping that its hold needs."""
    import numpy as np

    along, unit = "frequency (Hz)", (document.get("units") or {}).get("damping", "N s/m")
    if document["ports"] == 1:
        f = curves["frequency"]
        lines = [_curve("needed", BLUE, f, curves["needed_damping"]),
                 _curve("of the device", GREEN, (f[0], f[-1]), [document["damping"]] * 2, "--")]
        if "damping_with_shunt" in curves:
            lines.append(_curve("with the shunt of its motor", ORANGE, f, curves["damping_with_shunt"]))
        yield from scatter("Damping that the held force needs", [Plane(along, f"damping ({unit})", lines)])
        return
    name = next(name for name in ("sampled", "continuous") if f"{name}_h" in curves)
    f, h = curves[f"{name}_frequency"], curves[f"{name}_h"]
    unit = (document.get("units") or {}).get("free_impedance", "N s/m")
    planes = [Plane(along, f"impedance ({unit})", [
        _curve("free motion", BLUE, f, np.abs(h[:, 0, 0])), _curve("master held", RED, f, 1.0 / np.abs(h[:, 1, 1]))])]
    if f"{name}_felt" in curves:
        planes.append(Plane(along, f"impedance ({unit})", [
            _curve("felt by the hand", GREEN, f, np.abs(curves[f"{name}_felt"])),
            _curve("touched by the slave", PURPLE, f, np.abs(curves[f"{name}_touched"]))]))
    yield from scatter(f"Impedances, {name}", planes)
    eta = np.clip(curves[f"{name}_eta"], -1.2, ETA)
    yield from scatter(f"Llewellyn's parameter, {name}: absolutely stable where it is 1 and more", [
        Plane(along, f"parameter, drawn up to {ETA:g}", [_curve("", BLUE, f, eta), _level(f)], decades="x")])


def _stability(document: Mapping[str, Any], curves: Mapping[str, Any]) -> Iterator[Markup]:
    """Roots and open loop, and margins over a knob."""
    import numpy as np

    z = curves["roots"]
    around = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 181))
    planes = [Plane("Re z", "Im z", [
        _curve("", DARK, around.real, around.imag),
        *[Series(name, colour, [Mark(float(one.real), float(one.imag), f"|z| = {abs(one):.6f}") for one in some])
          for name, colour, some in (("grows", FAILS, z[np.abs(z) > 1.0 + AT_REST]),
                                     ("does not grow", BLUE, z[np.abs(z) <= 1.0 + AT_REST]))]], decades="", round=True)]
    if "L" in curves:
        f, sizes = curves["frequency"], np.abs(curves["L"])
        branches = [_curve("|L|", COLOURS[j % len(COLOURS)], f, sizes[:, j]) for j in range(sizes.shape[1])
                    if sizes[:, j].max() > 0.0]
        if branches:
            planes.append(Plane("frequency (Hz)", "open loop |L|", [*branches, _level(f)]))
    yield from scatter("Roots z of the sampled loop" + ", and open loop" * (len(planes) > 1), planes)
    if "swept_values" in curves:
        knob, values = document["critical"]["knob"], curves["swept_values"]
        units = document.get("units") or {}
        unit = units.get("critical.value", units.get("value", ""))
        over = {"growth rate (1/s)": curves["swept_growth"],
                "gain margin (dB)": 20.0 * np.log10(curves["swept_gain_margin"]),
                "phase margin (deg)": np.degrees(curves["swept_phase_margin"])}
        yield from scatter(f"Margins over {knob}; critical where the growth rate passes 0", [
            Plane(f"{knob} ({unit})" if unit else knob, name, [_curve("", BLUE, values, each)], decades="x")
            for name, each in over.items()])


FIGURES = {"precision": _precision, "tune": _tune, "zwidth": _zwidth, "advise": _advise}
OF_CURVES = {"passivity": _passivity, "stability": _stability}
