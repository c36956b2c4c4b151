"""The command `teleop compare`: read the file, run its rows in several processes, and report their figures.

Every row is a run with its whole record, in plain Python: with a dozen rows to a kernel, compiling one for each law
and scene would take longer than the rows do. A row's figures depend on its own knobs and seed alone. Rows are kept in
a folder as they finish.

With --tuned each law runs with the parameters that one search of the same number of rows finds for it over each link.
A search is run in one environment, named by the file's key `tune`, and its parameters are taken in all of them: a
law that met free space with other parameters than the wall would not be one law. A law without a number to tune stays
as it is.
"""

from __future__ import annotations

import csv
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from math import isnan
from pathlib import Path
from shutil import get_terminal_size
from typing import Any, NamedTuple

from teleop.errors import Refused, enumerated, number_of
from teleop.law.offers import seed_energy
from teleop.scene.axes import AxisLabels
from teleop.scene.knobs import law_with_its_numbers
from teleop.scene.library import scene_function
from teleop.scene.loading import load_scene
from teleop.scene.parts import varies
from teleop.scene.scene import Scene
from teleop.simulation.ending import GrowthNote
from teleop.simulation.metrics import METRICS, UNITS
from teleop.simulation.result import Result, versions
from teleop.simulation.virtual import run
from teleop.storage.files import replacing_text
from teleop.storage.strict_json import write_document
from teleop.studies.baseline import ContactForce, baseline_contact, contact_force
from teleop.studies.compare.cases import BUILT_IN, Case, Comparison, cases_of, path_text, read_comparison
from teleop.studies.compare.figures import UNSETTLED, document, judge_laws, rankings, text
from teleop.studies.compare.plot import draw
from teleop.studies.margin import margin
from teleop.studies.parallel import in_parallel
from teleop.studies.tune.search import LawSearch, SearchJob
from teleop.studies.tune.strategy import NothingToTune
from teleop.sweeps.grid import json_value, split_list
from teleop.sweeps.runner import cores
from teleop.sweeps.store import DEFINITION, Store
from teleop.terminal.answer import Answer, WithUnit, with_units
from teleop.terminal.options import DONE, INTERRUPTED
from teleop.terminal.plotting import asked_formats
from teleop.terminal.progress import RowsProgress, shown_for
from teleop.terminal.table import duration
from teleop.version import __version__

WIDE = 120  # columns of what is no terminal
CSV, SUMMARY = "rows.csv", "summary.json"
Show = Callable[[int, int], None]
SWING = 1e-3  # m, at the end of a run that has settled
ROW_FIGURES = {  # of a row, beside the metrics of its run: unit and meaning
    "wall_late": ("1", "force of the slave on its environment over the second half of the run, mean, over that of a "
                  "rigid rod"),
    "wall_peak": ("1", "largest force of the slave on its environment, over that of a rigid rod"),
    "sent": ("1", "packets sent for each tick, both directions"),
    "seed_energy": ("J", "energy that the law is given to begin with"),
    "gain_margin": ("1", "factor on the loop's gain that makes it unstable, see `teleop.studies.margin`; of one axis "
                    "over a constant delay"),
    "delay_margin": ("s", "delay that may be added to the round trip, by the same analysis"),
}


def command(args: Namespace) -> Answer:
    """Run a comparison, or go on with it, and report its figures. Raises `Refused`, before anything is written."""
    formats = asked_formats(args)
    began = args.seconds()
    path = args.file or BUILT_IN
    where = path_text(path)
    laws = None if args.laws is None else split_list(args.laws)
    comparison = read_comparison(path, laws)
    stream = None if args.json else sys.stderr
    workers = args.workers or cores()
    cases, notes = cases_of(comparison, where), list[str]()
    if args.tuned is not None:
        cases, notes = _tuned_cases(comparison, where, args, workers)
    total = sum(len(case.seeds) for case in cases)
    folder = Path(args.out) if args.out is not None else Path("runs") / comparison.name
    line = None if stream is None else RowsProgress(stream)
    interrupted = False
    try:
        carry_out(cases, folder, workers=workers,
                  show=lambda done, of: None if line is None else line.show(done, of, args.seconds()))
    except KeyboardInterrupt:
        if not (folder / DEFINITION).is_file():
            raise  # nothing was begun
        interrupted = True
    finally:
        if line is not None:
            line.end()
    rows = sorted(Store.look(folder).rows(), key=lambda row: row["row"])
    seconds = args.seconds() - began
    axis_units = list(dict.fromkeys(unit for case in cases for unit in case.units))
    units = figure_units(AxisLabels(units=tuple(axis_units)))
    verdicts = judge_laws(rows, [law.name for law in comparison.laws], axis_units)
    ranked = rankings(verdicts)
    counts = (number_of(len(comparison.laws), "law"), number_of(len(comparison.links), "link"),
              number_of(len(comparison.environments), "environment"), number_of(len(comparison.seeds), "seed"))
    heading = (f"compare   {where}: {', '.join(counts)} for links with dice; {len(rows)} of {total} rows in "
               f"{duration(seconds)}")
    summary = {
        "status": "interrupted" if interrupted else "done", "sentence": f"{len(rows)} of {total} rows", "scene": None,
        "mode": "compare", "versions": versions(), "command": list(args.typed), "file": str(path),
        "rows": total, "done": len(rows), "seeds": list(comparison.seeds), "path": str(folder),
        "conditions": [{"law": case.law, "link": case.link, "environment": case.environment,
                        "sentences": list(case.conditions)} for case in cases if case.conditions],
        "axis_units": axis_units, "tuned": args.tuned, "notes": notes,
        **with_units({"seconds": WithUnit(seconds, "s"), **document(verdicts, ranked, units)}, head={}),
    }
    write_csv(folder / CSV, rows, cases, units)
    write_document(folder / SUMMARY, summary)
    answer = Answer(text(verdicts, ranked, cases, heading, notes, _width()), summary,
                    INTERRUPTED if interrupted else DONE)
    if formats:
        answer = answer.with_plots(folder, draw(rows, verdicts, comparison, folder, formats))
    if interrupted:
        answer = answer._replace(text=f"{answer.text}\ninterrupted: the same command goes on from here")
    return answer._replace(text=f"{answer.text}\nevery row, with the command that runs it again: {folder / CSV}\n"
                                f"written to {folder}")


def _tuned_cases(comparison: Comparison, where: str, args: Namespace, workers: int) -> tuple[list[Case], list[str]]:
    """The cases with the parameters of searches, and a note on the laws that kept no constraint."""
    with shown_for(args, float(len(comparison.laws) * len(comparison.links))) as show:
        parameters = tune_all(comparison, args.tuned, workers=workers, show=lambda done, of: show(
            float(done), f"{done} of {number_of(of, 'search', 'searches')} of {number_of(args.tuned, 'row')}"))
    cases = cases_of(comparison, where, {key: each.knobs for key, each in parameters.items()})
    notes = []
    for law in comparison.laws:
        broken = {link.name: parameters[law.name, link.name].broken for link in comparison.links}
        links = [name for name, why in broken.items() if why]
        if links:
            notes.append(f"no parameters of {law.name} keep the constraints of tune in {comparison.tune} over "
                         f"{enumerated(links)}, so it runs with the nearest ({links[0]}: {broken[links[0]]})")
    return cases, notes


def _width() -> int:
    """The terminal's width; `WIDE` where the answer goes elsewhere."""
    return get_terminal_size().columns if sys.stdout.isatty() else WIDE


def figure_units(labels: AxisLabels) -> dict[str, str]:
    """The SI units of the figures of rows; empty for a figure over axes in m and in rad."""
    return {name: labels.unit(unit) for name, unit in [
        *UNITS.items(), *((key, unit) for key, (unit, _) in ROW_FIGURES.items())]}


def write_csv(path: Path, rows: Sequence[dict[str, Any]], cases: Sequence[Case], units: Mapping[str, str]) -> None:
    """Write every row: its names, seed, ending, figures in SI units, and the command that runs it again."""
    commands = {number: case.command(seed) for number, case, seed in number_rows(cases)}
    some = [name for name in (*METRICS, *ROW_FIGURES) if any(name in row for row in rows)]
    with replacing_text(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["law", "link", "environment", "seed", "status", "ticks",
                         *[f"{name} ({units[name]})" if units[name] else name for name in some], "sentence", "command"])
        for row in rows:
            writer.writerow([row["law"], row["link"], row["environment"], row["seed"], row["status"], row["ticks"],
                             *[row.get(name, "") for name in some], row.get("sentence", ""), commands[row["row"]]])


class CaseBatch(NamedTuple):
    """Rows that one process runs: cases of one law in one environment, each with the numbers and seeds of its rows."""

    cases: tuple[tuple[Case, tuple[tuple[int, int], ...]], ...]


def number_rows(cases: Sequence[Case]) -> Iterator[tuple[int, Case, int]]:
    """Number, case and seed of every row."""
    return ((number, case, seed) for number, (case, seed) in enumerate(
        (case, seed) for case in cases for seed in case.seeds))


def definition(cases: Sequence[Case]) -> dict[str, Any]:
    """Definition by which the folder of a comparison is known again."""
    rows = [[case.environment, case.link, case.law, case.command(seed), case.source] for case in cases
            for seed in case.seeds]
    return {"scene": "compare", "fixed": {}, "metrics": [], "version": __version__,
            "grid": {"axes": [{"knobs": ["environment", "link", "law", "command", "source"], "values": rows}],
                     "seeds": [0]}}


def carry_out(cases: Sequence[Case], folder: Path, *, workers: int, show: Show) -> None:
    """Run the missing rows of a comparison in `folder`, which is made or gone on with. Raises `Refused`."""
    with Store.open(folder, definition(cases)) as store:
        total = sum(len(case.seeds) for case in cases)
        show(len(store.done), total)
        for rows in in_parallel(run_batch, _batches(cases, store), workers):
            store.append(rows)
            show(len(store.done), total)


def _batches(cases: Sequence[Case], store: Store) -> list[CaseBatch]:
    """The missing rows, grouped by law and environment."""
    waiting = [(number, case, seed) for number, case, seed in number_rows(cases) if number not in store.done]
    batches = []
    for _, group in groupby(waiting, key=lambda row: (row[1].law, row[1].environment)):
        by_case = groupby(group, key=lambda row: id(row[1]))
        several = [list(rows) for _, rows in by_case]
        batches.append(CaseBatch(tuple(
            (rows[0][1], tuple((number, seed) for number, _, seed in rows)) for rows in several)))
    return batches


def run_batch(batch: CaseBatch) -> list[dict[str, Any]]:
    """Run every row of a batch."""
    rows, contact, is_known = [], None, False
    for case, numbers in batch.cases:
        scene = load_scene(case.scene, **case.knobs)
        if not is_known:  # of one environment, so the same for all
            contact, is_known = baseline_contact(scene), True
        of_case = {"seed_energy": _seed_energy(scene), **margins(scene, numbers[0][1])}
        for number, seed in numbers:
            row: dict[str, Any] = {"row": number, "seed": seed, "environment": case.environment, "link": case.link,
                                   "law": case.law, "knobs": [[name, json_value(value)] for name, value in
                                                              case.knobs.items()]}
            try:
                result = run(scene, seed=seed)
            except Refused as refused:
                rows.append({**row, "status": "refused", "ended": "refused", "ticks": 0, "sentence": str(refused)})
                continue
            ended, sentence = ending_of(result)
            rows.append({**row, "status": result.status, "ended": ended, "ticks": result.ticks, "sentence": sentence,
                         **result.metrics, **row_figures(result, contact), **of_case})
    return rows


def _seed_energy(scene: Scene) -> float:
    """The energy that the laws of all axes are given before the first tick, J."""
    dt, laws = scene.dt_ns / 1e9, scene.laws
    if not isinstance(scene.law, tuple) or hasattr(laws[0], "master_sums"):
        return seed_energy(laws[0], dt, scene.axes)
    return sum(seed_energy(law, dt) for law in laws)


def ending_of(result: Result) -> tuple[str, str]:
    """The status of a run and its sentence; `UNSETTLED` if it ended ok and has not come to rest.

    The status is ok, too, where a swing of more than `SWING` is left and the time was too short for a verdict. So it is
    where the motion still grows under a hand that moves: law and link feed it.
    """
    if result.status == "ok":
        growth = next((note for note in result.notes if isinstance(note, GrowthNote)), None)
        if growth is not None or result.metrics.get("swing_end", 0.0) > SWING:
            return UNSETTLED, growth or result.sentence
    return result.status, "" if result.status == "ok" else result.sentence


def margins(scene: Scene, seed: int) -> dict[str, float]:
    """Gain and delay margin of the linear loop of one axis over a constant delay, where they are exact.

    With several axes they would take longer than the runs do.
    """
    if scene.axes > 1 or (scene.link is not None and varies(scene.link)):
        return {}
    linear = margin(scene, seed=seed)
    return {} if isnan(linear.gain) else {"gain_margin": linear.gain, "delay_margin": linear.delay}


def row_figures(result: Result, baseline: ContactForce | None) -> dict[str, float]:
    """The figures of `ROW_FIGURES` that a run has."""
    figures: dict[str, float] = {}
    if baseline is not None and result.status != "diverged":
        contact = contact_force(result.trace["f_env"])
        figures |= {"wall_late": contact.late / baseline.late, "wall_peak": contact.peak / baseline.peak}
    if result.packets:
        figures["sent"] = sum(way.sent for way in result.packets.values()) / (len(result.packets) * result.ticks)
    return figures


class TunedKnobs(NamedTuple):
    """Parameters of a law that a search has set, as knobs, and a sentence where it kept no constraint."""

    knobs: Mapping[str, object]
    broken: str = ""


def tune_all(comparison: Comparison, budget: int, *, workers: int, show: Show) -> dict[tuple[str, str], TunedKnobs]:
    """Tune each law over each link, by their names. Raises `Refused` for a budget that takes no search."""
    where = next(each for each in comparison.environments if each.name == comparison.tune)
    scene = scene_function(where.text)
    jobs = [((law.name, link.name), SearchJob(
                where.text, law_with_its_numbers(law.text, scene), budget, comparison.seeds[0],
                {**comparison.knobs, **where.knobs, **link.knobs, **law.knobs, "link": link.text}, engine="plain"))
            for law in comparison.laws for link in comparison.links]
    show(0, len(jobs))
    tuned: dict[tuple[str, str], TunedKnobs] = {}
    for key, knobs in in_parallel(run_search, jobs, workers):
        tuned[key] = knobs
        show(len(tuned), len(jobs))
    return tuned


def run_search(keyed: tuple[tuple[str, str], SearchJob]) -> tuple[tuple[str, str], TunedKnobs]:
    """Run the search of one law over one link, by their names."""
    key, job = keyed
    try:
        tuned = LawSearch(job, workers=1).run()
    except NothingToTune:
        return key, TunedKnobs({})
    except Refused as refused:
        raise Refused(f"{refused} (law {key[0]!r}, link {key[1]!r})") from None
    best: dict[str, Any] = dict(tuned.best)
    return key, TunedKnobs(best, "" if tuned.feasible else tuned.score.broken)
