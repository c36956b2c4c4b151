"""Report of a sweep's folder: its summary over all the calls that ran rows, its refusals, its picture."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple

import numpy as np

from teleop.errors import Refused, plural
from teleop.scene.axes import labels_of
from teleop.scene.catalogue import units_of
from teleop.scene.library import known_scenes
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.metrics import UNITS
from teleop.simulation.result import has_record
from teleop.storage import strict_json as stored
from teleop.storage.files import read_bytes
from teleop.storage.folder import is_being_written
from teleop.storage.strict_json import Misshapen, parse, write_document
from teleop.sweeps.pictures.picture import draw
from teleop.sweeps.store import Store
from teleop.sweeps.table import Table
from teleop.terminal.answer import Answer
from teleop.terminal.plotting import PNG
from teleop.terminal.table import facts, grouped

SUMMARY = "summary.json"
OF_A_CALL = ("command", "engine", "why", "workers", "engines", "ran", "seconds", "interrupted", "cluster", "versions")
SENTENCES = 3  # that are shown
_SHAPE = stored.record({}, {
    "scene": stored.text, "rows": stored.whole(low=0), "engine": stored.text, "why": stored.optional(stored.text),
    "runs": stored.list_of(stored.record({})), "limits": stored.dict_of(stored.real),
})


class PictureRequest(NamedTuple):
    """The picture asked for: a kind of `teleop.sweeps.pictures.picture.KINDS` and a metric; none: what suits."""

    kind: str | None = None
    metric: str | None = None


def summary_of(folder: Path) -> dict[str, Any]:
    """Content of summary.json of a sweep's folder; empty if there is none that can be read."""
    try:
        got: dict[str, Any] = parse(read_bytes(folder / SUMMARY, links=False))
        _SHAPE(got, SUMMARY)
    except (OSError, Misshapen):
        return {}
    return got


def joined(summary: Mapping[str, Any], before: Mapping[str, Any]) -> dict[str, Any]:
    """A call's summary after that of earlier calls: `runs` has an entry for each that ran rows, the last also on top.

    A call that found every row there changes nothing of how they were made.
    """
    runs: list[dict[str, Any]] = before["runs"] if isinstance(before.get("runs"), list) else []
    if summary["ran"]:
        runs = [*runs, {key: summary[key] for key in OF_A_CALL if key in summary}]
    last = runs[-1] if runs and not summary["ran"] else {}
    return {**summary, **{key: last[key] for key in OF_A_CALL if key in last}, "runs": runs}


def write(summary: Mapping[str, Any], folder: Path) -> None:
    """Write summary.json, whole or not at all. Raises `Refused` if that cannot be."""
    try:
        write_document(folder / SUMMARY, summary)
    except OSError as error:
        raise Refused(f"cannot write to {folder} ({error.strerror or error}); the rows are kept, and the same "
                      "command goes on") from error


def sentences(table: Table) -> dict[str, int]:
    """Why rows were refused, and how many for each reason; the most frequent first."""
    refusals = table["sentence"][table["status"] == "refused"]
    texts, counts = np.unique([str(text) for text in refusals.tolist() if text is not None], return_counts=True)
    return dict(sorted(zip(texts.tolist(), counts.tolist(), strict=True), key=lambda pair: -pair[1]))


def status_rows(table: Table) -> list[tuple[str, str]]:
    """Rows of the report: the number of rows for each status, and the reasons of those refused."""
    counts = ", ".join(f"{grouped(count)} {status}" for status, count in table.counts().items())
    rows = [("status", f"{grouped(len(table))} done: {counts or 'none'}")]
    every = [*sentences(table).items()]
    for i, (sentence, count) in enumerate(every[:SENTENCES]):
        rows.append(("" if i else "refused", f"{grouped(count)} {plural(count, 'row')}: {sentence}"))
    if len(every) > SENTENCES:
        rest = every[SENTENCES:]
        count = sum(count for _, count in rest)
        rows.append(("", f"and {grouped(len(rest))} more {plural(len(rest), 'sentence')} in {grouped(count)} "
                         f"{plural(count, 'row')}, which rows.jsonl has"))
    return rows


def sentence_of(table: Table, rows: int | None) -> str:
    """Sentence with the number of rows done, and for each status."""
    counts = ", ".join(f"{grouped(count)} {status}" for status, count in table.counts().items())
    of = "" if rows is None else f" of {grouped(rows)}"
    return f"{grouped(len(table))}{of} rows done: {counts or 'none'}"


def report_of(folder: Path, rows: int) -> str:
    """The command that shows so many rows of a sweep's folder."""
    return f"teleop report {quote(str(folder))} --rows {rows}"


def told_of(folder: Path, shown: int | None = None) -> tuple[dict[str, Any], str, Table]:
    """Content of a sweep's folder: as JSON can hold it, as text, and its rows. It may still be growing.

    `shown`: the rows that the text has; left out, the first few.
    """
    store = Store.look(folder)
    table = store.table()
    content = {**summary_of(folder), **store.definition, "done": len(table), "counts": table.counts(),
               "path": str(folder)}
    if "scene" not in content:
        raise Refused(f"{folder} holds a sweep of no scene; give the folder that `teleop sweep` printed")
    rows = f"{grouped(content['rows'])} {plural(content['rows'], 'row')}" if "rows" in content else "rows"
    lines = [("sweep", f"{content['scene']}, {rows} of {', '.join(table.knobs) or 'seeds'}"), *status_rows(table)]
    if "engine" in content:
        lines.append(("engine", f"{content['engine']}: {content.get('why')}"))
    calls = len(content.get("runs", ()))
    lines += [("", f"{calls} calls ran rows; {SUMMARY} has each")] if calls > 1 else []
    content["sentence"] = sentence_of(table, content.get("rows"))
    return content, f"{facts(lines)}\n{table.text(shown, all_by=report_of(folder, len(table)))}", table


def picture(table: Table, folder: Path, content: Mapping[str, Any], request: PictureRequest,
            formats: Sequence[str] = PNG, *, trust: bool) -> list[Path]:
    """Draw a sweep into its folder, as sweep.png or in other `formats`; the files. Raises `Refused` if that cannot be.

    `trust`: the scene's own file may be run, for the units of its knobs.
    """
    name = str(content["scene"])
    units = knob_units(content, table, trust=trust)
    return draw(table, folder / "sweep", request.kind, metric=request.metric, title=Path(name).stem,
                units=units, words=words_of(content, units),
                formats=formats)


def words_of(content: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, str]:
    """Words of a legend for each status, with the bounds that all rows had; `units` as `knob_units` gives them."""
    limits, unit = content.get("limits") or {}, units.get("x_limit", "m")
    words = {}
    bounded = limits.get("x_limit", Scene.x_limit) < Scene.x_limit  # a scene's own bounds nothing that moves
    if bounded:
        words["diverged"] = f"diverged: beyond x_limit = {limits['x_limit']:g} {unit}"
    if "duration" in limits:
        within = f"within {limits['x_limit']:g} {unit} for " if bounded else "ran "
        words["ok"] = f"ok: {within}{limits['duration']:g} s"
    return words


def knob_units(content: Mapping[str, Any], table: Table, *, trust: bool) -> dict[str, str]:
    """The units of knobs and metrics of a sweep; of the scene of a user's own, whose file is run for it, only with
    `trust`. A metric over axes in m and in rad has none."""
    name = str(content["scene"])
    if not trust and name not in known_scenes():
        return {}
    try:
        labels = labels_of(load_scene(name))
    except Refused:  # the scene's file is gone, or needs knobs
        return units_of(name, table.knobs)
    metrics = {metric: labels.unit(unit) for metric, unit in UNITS.items()}
    return {**metrics, **units_of(name, table.knobs), "x_limit": labels.unit("m") or "m or rad"}


def with_picture(answer: Answer, table: Table, folder: Path, content: Mapping[str, Any], request: PictureRequest,
                 formats: Sequence[str]) -> Answer:
    """Draw a sweep that was just run, and name the files; that it cannot be is no error, for its rows are there."""
    if not len(table):
        return answer.without_plot("no row is there yet")
    try:
        return answer.with_plots(folder, picture(table, folder, content, request, formats, trust=True))
    except Refused as refused:
        return answer.without_plot(refused)


def report(folder: Path, request: PictureRequest, formats: Sequence[str] = (), *, trust: bool = False,
           rows: int | None = None) -> Answer:
    """Answer of `teleop report` for a sweep, which is drawn in `formats`; none: not at all. `trust`: see `picture`.

    `rows`: how many it shows; left out, the first few. Raises `Refused` if it cannot be drawn.
    """
    content, text, table = told_of(folder, rows)
    answer = Answer(text, content)
    if not formats:
        return answer
    return answer.with_plots(folder, picture(table, folder, content, request, formats, trust=trust))


def check_run(at: Path, request: PictureRequest) -> None:
    """Refuse what is no run's folder, in the words of what is there, and a request for another picture than its own."""
    if not at.is_dir():
        raise Refused(f"there is no folder {at}; give the one that `teleop run` or `teleop sweep` printed")
    if not (at / "trace.npz").is_file() and not has_record(at) and not is_being_written(at):
        inside = sorted(each.parent for each in [*at.glob("*/trace.npz"), *at.glob("*/sweep.json")])
        cure = f"one of the folders in it, such as {inside[-1]}" if inside else \
            "the folder that `teleop run` or `teleop sweep` printed"
        raise Refused(f"{at} holds no run and no sweep; give {cure}")
    if any(request):
        raise Refused(f"{at} holds a run, which has one plot; leave --picture and --metric out")


def limits_of(first: Scene, turned: Collection[str]) -> dict[str, float]:
    """Duration (s) and position limit (m) of every row of a sweep, as the first has them; without knobs of the grid."""
    return {key: getattr(first, key) for key in ("duration", "x_limit") if key not in turned}
