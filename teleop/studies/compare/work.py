"""The rows of a comparison run, by several processes, and kept in a folder as they finish.

Every row is a run with its whole record, in plain Python: with a dozen rows to a kernel, compiling one for each law
and scene would take longer than the rows do. A row's figures depend on its own knobs and seed alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from math import isnan
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.law.offers import seed_energy
from teleop.scene.loading import load_scene
from teleop.scene.parts import varies
from teleop.scene.scene import Scene
from teleop.simulation.result import Result
from teleop.simulation.virtual import run
from teleop.studies.compare.cases import Case
from teleop.studies.compare.judge import UNSETTLED
from teleop.studies.compare.touch import Touch, touch_of, touch_of_rod
from teleop.studies.margin import margin
from teleop.studies.parallel import in_parallel
from teleop.sweeps.grid import plain
from teleop.sweeps.store import Store

Show = Callable[[int, int], None]
SWING = 1e-3  # m
GROWS = "the motion still grows"  # begins the note of `teleop.simulation.ending.growth`
OWN = {  # of a row, beside the metrics of its run: unit and meaning
    "wall_late": ("1", "force of the slave on its environment over the second half of the run, mean, over that of a "
                  "rigid rod"),
    "wall_peak": ("1", "largest force of the slave on its environment, over that of a rigid rod"),
    "sent": ("1", "packets sent for each tick, both directions"),
    "seed_energy": ("J", "energy that the law is given to begin with"),
    "gain_margin": ("1", "factor on the loop's gain that makes it unstable, see `teleop.studies.margin`; of one axis "
                    "over a constant delay"),
    "delay_margin": ("s", "delay that may be added to the round trip, by the same analysis"),
}


class Job(NamedTuple):
    """Rows that one process runs: cases of one law in one environment, each with the numbers and seeds of its rows."""

    cases: tuple[tuple[Case, tuple[tuple[int, int], ...]], ...]


def numbered(cases: Sequence[Case]) -> Iterator[tuple[int, Case, int]]:
    """Number, case and seed of every row."""
    return ((number, case, seed) for number, (case, seed) in enumerate(
        (case, seed) for case in cases for seed in case.seeds))


def definition(cases: Sequence[Case]) -> dict[str, Any]:
    """What the folder of a comparison is held to."""
    from teleop.version import __version__

    rows = [[case.environment, case.link, case.law, case.command(seed), case.source] for case in cases
            for seed in case.seeds]
    return {"scene": "compare", "fixed": {}, "metrics": [], "version": __version__,
            "grid": {"axes": [{"knobs": ["environment", "link", "law", "command", "source"], "values": rows}],
                     "seeds": [0]}}


def carry_out(cases: Sequence[Case], folder: Path, *, workers: int, show: Show) -> None:
    """Run what is not done yet of a comparison in `folder`, which is made or gone on with. Raises `Refused`."""
    with Store.open(folder, definition(cases)) as store:
        total = sum(len(case.seeds) for case in cases)
        show(len(store.done), total)
        for rows in in_parallel(work, _jobs(cases, store), workers):
            store.append(rows)
            show(len(store.done), total)


def _jobs(cases: Sequence[Case], store: Store) -> list[Job]:
    """The rows that are missing, those of one law in one environment together."""
    waiting = [(number, case, seed) for number, case, seed in numbered(cases) if number not in store.done]
    jobs = []
    for _, group in groupby(waiting, key=lambda row: (row[1].law, row[1].environment)):
        by_case = groupby(group, key=lambda row: id(row[1]))
        several = [list(rows) for _, rows in by_case]
        jobs.append(Job(tuple((rows[0][1], tuple((number, seed) for number, _, seed in rows)) for rows in several)))
    return jobs


def work(job: Job) -> list[dict[str, Any]]:
    """Run every row of a job."""
    rows, touch, known = [], None, False
    for case, numbers in job.cases:
        scene = load_scene(case.scene, **case.knobs)
        if not known:  # of one environment, so the same for all
            touch, known = touch_of_rod(scene), True
        given = _seed_energy(scene)
        of_case = {"seed_energy": given, **margins(scene, numbers[0][1])}
        for number, seed in numbers:
            row: dict[str, Any] = {"row": number, "seed": seed, "environment": case.environment, "link": case.link,
                                   "law": case.law, "knobs": [[name, plain(value)] for name, value in
                                                              case.knobs.items()]}
            try:
                result = run(scene, seed=seed)
            except Refused as refused:
                rows.append({**row, "status": "refused", "ended": "refused", "ticks": 0, "sentence": str(refused)})
                continue
            ended, sentence = how_it_ended(result)
            rows.append({**row, "status": result.status, "ended": ended, "ticks": result.ticks, "sentence": sentence,
                         **result.metrics, **of_result(result, touch), **of_case})
    return rows


def _seed_energy(scene: Scene) -> float:
    """The energy that the laws of all axes are given before the first tick, J."""
    dt, laws = scene.dt_ns / 1e9, scene.laws
    if not isinstance(scene.law, tuple) or hasattr(laws[0], "master_sums"):
        return seed_energy(laws[0], dt, scene.axes)
    return sum(seed_energy(law, dt) for law in laws)


def how_it_ended(result: Result) -> tuple[str, str]:
    """The status of a run and its sentence; of one that ended ok and has not come to rest, `UNSETTLED`.

    That is one with a swing of more than `SWING` left where nothing moves the scene any more, which was too short a
    time for a verdict, and one whose motion still grows under a hand that moves: law and link feed it.
    """
    if result.status == "ok":
        grows = next((note for note in result.notes if note.startswith(GROWS)), None)
        if grows is not None or result.metrics.get("swing_end", 0.0) > SWING:
            return UNSETTLED, grows or result.sentence
    return result.status, "" if result.status == "ok" else result.sentence


def margins(scene: Scene, seed: int) -> dict[str, float]:
    """Gain and delay margin of the linear loop of one axis over a constant delay, of which they are exact.

    Those of several axes would take longer than the runs do.
    """
    if scene.axes > 1 or (scene.link is not None and varies(scene.link)):
        return {}
    found = margin(scene, seed=seed)
    return {} if isnan(found.gain) else {"gain_margin": found.gain, "delay_margin": found.delay}


def of_result(result: Result, touch: Touch | None) -> dict[str, float]:
    """The figures of `OWN` that a run has."""
    found: dict[str, float] = {}
    if touch is not None and result.status != "diverged":
        own = touch_of(result.trace["f_env"])
        found |= {"wall_late": own.late / touch.late, "wall_peak": own.peak / touch.peak}
    if result.packets:
        found["sent"] = sum(way.sent for way in result.packets.values()) / (len(result.packets) * result.ticks)
    return found

