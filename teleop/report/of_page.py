"""Report of a page's folder: its parts, between the switches, in order."""

from __future__ import annotations

import re
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from teleop.errors import Refused, number_of
from teleop.live.records.merge import load_result
from teleop.report.of_runs import RunView, of_parts
from teleop.report.page import FolderReport
from teleop.simulation.metrics import resolved
from teleop.simulation.result import RUNNING, stored_summary
from teleop.storage import strict_json as stored
from teleop.storage.files import read_bytes
from teleop.storage.folder import is_being_written
from teleop.storage.strict_json import Misshapen, parse
from teleop.terminal.answer import Answer
from teleop.terminal.run import PLOT
from teleop.terminal.run_table import heading
from teleop.terminal.table import columns, facts, si

INDEX = "page.json"
MOST = 500  # parts
Begun = tuple[int, str]  # the first tick of a part, and why it began
WHY = {"start": "start", "turn": "switched", "again": "started again", "lost": "a process had ended"}
_SHAPE = stored.record({
    "version": stored.whole(low=1, high=1), "scene": stored.text,
    "parts": stored.list_of(stored.record({"folder": stored.text, "k": stored.whole(low=-1), "why": stored.text}),
                         most=MOST)}, {"command": stored.list_of(stored.text)})


def page_report(folder: Path, args: Namespace, formats: Sequence[str]) -> FolderReport:
    """A page's folder, its parts drawn in `formats`. Raises `Refused`."""
    if args.picture or args.metric or args.rows is not None:
        raise Refused(f"{folder} holds the runs of a page, which have no rows and one plot each; leave --picture, "
                      "--metric and --rows out")
    document = _index(folder)
    running = is_being_written(folder)
    parts, left = _parts(folder, document, args.trust)
    running = running or any(run.result.status == RUNNING for _, run in parts)
    lines = [("part", "began by", "scene and law", "for", "status", "tracking error", "at most felt")]
    for i, ((_, why), run) in enumerate(parts):
        got, unit = resolved(run.result.metrics), run.result.labels.unit
        lines.append((str(i + 1), why, heading(run.result), f"{run.result.ticks * run.result.dt:.1f} s",
                      run.result.status, si(got["x_err_rms"], unit("m")) if "x_err_rms" in got else "-",
                      si(got["f_m_max"], unit("N")) if "f_m_max" in got else "-"))
    rows = [("page", f"{document['scene']}, {number_of(len(parts), 'part')}"), *[("left out", why) for why in left]]
    answer = Answer(f"{facts(rows)}\n{columns(lines, left=(0, 1, 2, 4))}\nwritten to {folder}", {
        **document, "path": str(folder), "parts": [
            {"folder": run.name, "k": k, "why": why, **run.document} for (k, why), run in parts]})
    for _, run in parts if formats else ():
        from teleop.terminal.run_plot import draw

        at = folder / run.name
        answer = answer.with_plots(at, draw(run.result, at / PLOT, formats))
    return FolderReport(folder, answer, running=running, section=lambda: of_parts(
        folder.resolve().name, [run for _, run in parts], [begun for begun, _ in parts], document))


def _index(folder: Path) -> dict[str, Any]:
    try:
        document: dict[str, Any] = parse(read_bytes(folder / INDEX, links=False))
        _SHAPE(document, INDEX)
        if not document["parts"]:
            raise Misshapen(f"{INDEX} names no part")
        wrong = next((one["folder"] for one in document["parts"] if not re.fullmatch(r"\d{1,4}", one["folder"])), None)
        if wrong is not None:
            raise Misshapen(f"{INDEX} names the part {wrong[:40]!r}, and a part is a number")
    except (OSError, Misshapen) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise Refused(f"{folder} holds no page that can be read ({why}); give the folder that teleop demo --page "
                      "printed") from error
    return document


def _parts(folder: Path, document: dict[str, Any], trust: bool) -> tuple[list[tuple[Begun, RunView]], list[str]]:
    """Each part that can be read, with its first tick and why it began; and why the others cannot."""
    parts: list[tuple[Begun, RunView]] = []
    left: list[str] = []
    for entry in document["parts"]:
        at = folder / entry["folder"]
        try:
            if at.is_symlink():
                raise Refused(f"{at} is a link, and what a folder links to is not opened")
            result = load_result(at, trust=trust)
            run_summary = result.summary() if result.status == RUNNING else stored_summary(at)
            if not run_summary.get("command"):
                run_summary = {**run_summary, "command": document.get("command") or []}
            parts.append(((entry["k"], WHY.get(entry["why"], entry["why"])),
                          RunView(entry["folder"], result, run_summary)))
        except Refused as refused:
            left.append(str(refused))
    if not parts:
        raise Refused(left[0])
    return parts, left
