"""What `teleop compare` does: read the file, run the rows, tell and draw what came of them."""

from __future__ import annotations

import csv
import sys
from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from shutil import get_terminal_size
from typing import Any, TextIO

from teleop.errors import enumerated, number_of
from teleop.scene.axis_labels import AxisLabels
from teleop.simulation.metrics import METRICS, UNITS
from teleop.simulation.result import versions
from teleop.storage.files import replacing_text
from teleop.storage.strict_json import write_document
from teleop.studies.compare.cases import Case, cases_of, shown_path
from teleop.studies.compare.file import BUILT_IN, Comparison, read_comparison
from teleop.studies.compare.judge import rankings, verdicts
from teleop.studies.compare.report import document, text
from teleop.studies.compare.tuned import tune_all
from teleop.studies.compare.work import OWN, carry_out, numbered
from teleop.sweeps.runner import cores
from teleop.sweeps.store import Store
from teleop.sweeps.typed import listed
from teleop.terminal.answer import Answer
from teleop.terminal.options import DONE, INTERRUPTED
from teleop.terminal.plotting import asked_formats
from teleop.terminal.progress import RowsProgress, shown_on
from teleop.terminal.units import duration

WIDE = 120  # columns of what is no terminal
CSV, SUMMARY = "rows.csv", "summary.json"


def command(args: Namespace) -> Answer:
    """Run a comparison, or go on with it, and tell what came of it. Raises `Refused`, before anything is written."""
    formats = asked_formats(args)
    began = args.seconds()
    path = args.file or BUILT_IN
    where = shown_path(path)
    laws = None if args.laws is None else listed(args.laws)
    asked = read_comparison(path, laws)
    stream = None if args.json else sys.stderr
    workers = args.workers or cores()
    cases, notes = cases_of(asked, where), list[str]()
    if args.tuned is not None:
        cases, notes = _tuned(asked, where, args.tuned, workers, stream, args.seconds)
    total = sum(len(case.seeds) for case in cases)
    folder = Path(args.out) if args.out is not None else Path("runs") / asked.name
    line = None if stream is None else RowsProgress(stream)
    interrupted = False
    try:
        carry_out(cases, folder, workers=workers,
                  show=lambda done, of: None if line is None else line.show(done, of, args.seconds()))
    except KeyboardInterrupt:
        if not (folder / "sweep.json").is_file():
            raise  # nothing was begun
        interrupted = True
    finally:
        if line is not None:
            line.end()
    rows = sorted(Store.look(folder).rows(), key=lambda row: row["row"])
    seconds = args.seconds() - began
    units = list(dict.fromkeys(unit for case in cases for unit in case.units))
    found = verdicts(rows, [law.name for law in asked.laws], units)
    ranked = rankings(found)
    heading = (f"compare   {where}: {number_of(len(asked.laws), 'law')}, {number_of(len(asked.links), 'link')}, "
               f"{number_of(len(asked.environments), 'environment')}, {number_of(len(asked.seeds), 'seed')} for links "
               f"with dice; {len(rows)} of {total} rows in {duration(seconds)}")
    told = {
        "status": "interrupted" if interrupted else "done", "sentence": f"{len(rows)} of {total} rows", "scene": None,
        "mode": "compare", "versions": versions(), "command": list(args.typed), "seconds": seconds, "file": str(path),
        "rows": total, "done": len(rows), "seeds": list(asked.seeds), "path": str(folder),
        "conditions": [{"law": case.law, "link": case.link, "environment": case.environment,
                        "sentences": list(case.conditions)} for case in cases if case.conditions],
        "axis_units": units, "tuned": args.tuned, "notes": notes, **document(found, ranked),
    }
    write_csv(folder / CSV, rows, cases, AxisLabels(units=tuple(units)))
    write_document(folder / SUMMARY, told)
    answer = Answer(text(found, ranked, cases, heading, notes, _width()), told, INTERRUPTED if interrupted else DONE)
    if formats:
        from teleop.studies.compare.figures import draw

        answer = answer.with_plots(folder, draw(rows, found, asked, folder, formats))
    if interrupted:
        answer = answer._replace(text=f"{answer.text}\ninterrupted: the same command goes on from here")
    return answer._replace(text=f"{answer.text}\nevery row, with the command that runs it again: {folder / CSV}\n"
                                f"written to {folder}")


def _tuned(asked: Comparison, where: str, budget: int, workers: int, stream: TextIO | None,
           clock: Callable[[], float]) -> tuple[list[Case], list[str]]:
    """The cases with the parameters that searches of so many rows found, and a note on those that found nothing."""
    count = len(asked.laws) * len(asked.links)
    with shown_on(stream, clock, float(count)) as show:
        found = tune_all(asked, budget, workers=workers, show=lambda done, of: show(
            float(done), f"{done} of {number_of(of, 'search', 'searches')} of {number_of(budget, 'row')}"))
    cases = cases_of(asked, where, {key: one.knobs for key, one in found.items()})
    notes = []
    for law in asked.laws:
        broken = {link.name: found[law.name, link.name].broken for link in asked.links}
        links = [name for name, why in broken.items() if why]
        if links:
            notes.append(f"no parameters of {law.name} keep the constraints of tune in {asked.tune} over "
                         f"{enumerated(links)}, so it runs with the nearest ({links[0]}: {broken[links[0]]})")
    return cases, notes


def _width() -> int:
    """The terminal's width; `WIDE` where the answer goes elsewhere."""
    return get_terminal_size().columns if sys.stdout.isatty() else WIDE


def write_csv(path: Path, rows: Sequence[dict[str, Any]], cases: Sequence[Case], labels: AxisLabels) -> None:
    """Every row: its names, seed, how it ended, its figures in SI units, and the command that runs it again.

    A figure over axes in m and in rad has no unit.
    """
    commands = {number: case.command(seed) for number, case, seed in numbered(cases)}
    some = [name for name in (*METRICS, *OWN) if any(name in row for row in rows)]
    units = {name: labels.unit(unit) for name, unit in [*UNITS.items(), *((key, own) for key, (own, _) in OWN.items())]}
    with replacing_text(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["law", "link", "environment", "seed", "status", "ticks",
                         *[f"{name} ({units[name]})" if units[name] else name for name in some], "sentence", "command"])
        for row in rows:
            writer.writerow([row["law"], row["link"], row["environment"], row["seed"], row["status"], row["ticks"],
                             *[row.get(name, "") for name in some], row.get("sentence", ""), commands[row["row"]]])
