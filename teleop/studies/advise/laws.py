"""The laws of an advice, each tuned for the link by a process, in a folder that the same command goes on with.

The folder's `sweep.json` says what was asked for and `rows.jsonl` has each point that was run, with its score, as
`teleop.sweeps.store` keeps them: a kill by any signal costs the points in flight. A search is the same to the bit
whenever it is run, so one that goes on is done again with the scores that are there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from math import sqrt
from os import getloadavg
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.knob import Declared, knobs_of_fields
from teleop.law.offers import claims_of, seed_energy
from teleop.scene.loading import load_scene
from teleop.simulation.facts import unmet
from teleop.studies.advise.links import OneWay, playouts_for
from teleop.studies.parallel import streamed
from teleop.studies.tune.objective import Score
from teleop.studies.tune.search import Scored, Tuned, tune_law
from teleop.sweeps.engine import PLAIN
from teleop.sweeps.grid import plain
from teleop.sweeps.kernels.digest import digest
from teleop.sweeps.runner import cores, plan_sweep
from teleop.sweeps.store import Store

MARGIN = 2.0  # by which the wall may be stiffer in the search
SETTLED = 20.0  # s after which the time that is left is told
COMPILES = 12.0  # s that a law's kernels take to compile, on the machine of `teleop/studies/README.md`
FASTER = 60.0  # times, compiled


class LawMargins(NamedTuple):
    """The most of what was tried that the gains stand, in a row; what comes next breaks a constraint, or is none."""

    wall: float  # N/m
    delay: float  # s, further, each way
    wall_end: str  # what the next stiffer wall breaks; empty: none stiffer was tried
    delay_end: str


@dataclass(frozen=True, kw_only=True)
class LawAdvice:
    """Result for one law."""

    law: str
    tuned: Tuned | None
    refused: str = ""  # why it was not tuned
    knobs: Mapping[str, Declared]  # of the law
    claims: Mapping[str, str]
    seed_energy: float = 0.0
    broken: tuple[str, ...] = ()  # conditions of the law that link and bodies break, with the best gains
    margins: LawMargins | None = None

    @property
    def value(self) -> float:
        """Value of the objective; inf of a law that keeps the constraints nowhere."""
        return self.tuned.score.value if self.tuned is not None and self.tuned.feasible else float("inf")

    @property
    def spread(self) -> float:
        """Standard deviation of the value from seed to seed; 0.0 where the link draws nothing."""
        values = () if self.tuned is None else self.tuned.score.values
        if len(values) < 2:
            return 0.0
        mean = sum(values) / len(values)
        return sqrt(sum([(each - mean) ** 2 for each in values]) / (len(values) - 1))

    @property
    def deviation(self) -> float:
        """Standard error of the value over the seeds; 0.0 where the link draws nothing."""
        return 0.0 if self.tuned is None else self.spread / sqrt(max(1, len(self.tuned.score.values)))

    def keeps_energy(self) -> bool:
        """True if it claims a ledger, and no condition of it is broken."""
        return bool(self.claims) and not self.broken


class LawJob(NamedTuple):
    """The search of one law."""

    scene: str
    law: str
    budget: int
    fixed: Mapping[str, object]
    ways: tuple[OneWay, OneWay]
    objective: str
    seed: int
    engine: str | None
    known: tuple[Scored, ...]  # points that are there


class Outlook:
    """The time that searches of so many rows each will still take, by several workers. Times in s, of any clock.

    A law's time is one to begin with, in which its kernels are compiled, and one for each row. Both are the means of
    the laws so far; rows that were there before take none. Until rows have come they are `start` and `each`.
    """

    def __init__(self, laws: int, rows: int, workers: int, start: float, each: float) -> None:
        self._waiting, self._rows, self._workers = laws, rows, workers
        self._start, self._each = start, each
        self._begun: dict[int, tuple[float, int]] = {}  # by the number of a law, when it began, and with which rows
        self._first: dict[int, tuple[float, int]] = {}  # when its first rows came, and how many were there then
        self._last: dict[int, tuple[float, int]] = {}
        self._done: set[int] = set()

    def begin(self, law: int, now: float, known: int = 0) -> None:
        """A law begins with so many `known` rows."""
        self._waiting -= 1
        self._begun[law] = now, known

    def rows(self, law: int, rows: int, now: float) -> None:
        """So many rows of a law are there."""
        if rows > self._begun[law][1]:
            self._first.setdefault(law, (now, rows))
            self._last[law] = now, rows

    def end(self, law: int) -> None:
        """A law is searched."""
        self._done.add(law)

    def time_left(self, now: float, busy: float = 1.0) -> float:
        """The time that is left, s; `busy`: processes that want to run for each core, until rows have come."""
        spent = sum(self._last[law][0] - at for law, (at, _) in self._first.items())
        rows_run = sum(self._last[law][1] - rows for law, (_, rows) in self._first.items())
        each = spent / rows_run if rows_run else self._each * busy
        starts = [max(0.0, at - self._begun[law][0] - each * (rows - self._begun[law][1]))
                  for law, (at, rows) in self._first.items()]
        start = sum(starts) / len(starts) if starts else max(
            [self._start * busy, *(now - at for law, (at, _) in self._begun.items() if law not in self._done)])
        work = [start + each * self._rows] * self._waiting
        for law, (at, known) in self._begun.items():
            if law not in self._done:
                rows = self._last[law][1] if law in self._last else known
                work.append(each * max(0, self._rows - rows) + (
                    0.0 if law in self._last else max(0.0, start - (now - at))))
        return max(sum(work) / self._workers, max(work, default=0.0))


def searched(jobs: Sequence[LawJob], out: Path | None, workers: int, clock: Callable[[], float],
             show: Callable[[float, str], None]) -> Iterator[tuple[LawAdvice, float | None]]:
    """Search each law; yield its result as it comes, with the time in all (s) that was told after `SETTLED`.

    `out`: the folder, made or gone on with; None: none. Raises `Refused`.
    """
    store = None if out is None else Store.open(out, definition(jobs))
    try:
        if store is not None:
            jobs = [job._replace(known=tuple(points)) for job, points in zip(jobs, _points(store, jobs), strict=True)]
        yield from _Searches(jobs, store, workers, clock, show).run()
    finally:
        if store is not None:
            store.close()


class _Searches:
    def __init__(self, jobs: Sequence[LawJob], store: Store | None, workers: int, clock: Callable[[], float],
                 show: Callable[[float, str], None]) -> None:
        self.jobs, self.store, self.workers, self.clock, self.show = jobs, store, workers, clock, show
        first = jobs[0]
        each = PLAIN * load_scene(first.scene, **first.fixed).ticks
        compiled = find_spec("numba") is not None and first.engine != "plain"
        self.outlook = Outlook(len(jobs), first.budget, min(workers, len(jobs)), COMPILES if compiled else 0.0,
                               each / FASTER if compiled else each)
        self.points = [len(job.known) for job in jobs]
        self.current, self.ended = "", 0
        self.told: float | None = None

    def run(self) -> Iterator[tuple[LawAdvice, float | None]]:
        self.began = self.clock()
        for number, advice in streamed(search_law, self.jobs, self.workers, self.begin, self.take, self.poll):
            self.outlook.end(number)
            self.ended += 1
            self.poll()
            yield advice, self.told

    def begin(self, number: int) -> None:
        self.current = self.jobs[number].law
        self.outlook.begin(number, self.clock(), sum(
            (each.stop - each.first) * len(each.score.figures) for each in self.jobs[number].known))
        self.poll()

    def take(self, number: int, part: int | list[Scored]) -> None:
        if isinstance(part, int):
            self.outlook.rows(number, part, self.clock())
        elif self.store is not None:
            first, job = self.points[number], self.jobs[number]
            self.store.append([_cells(number * job.budget + first + i, job.law, each) for i, each in enumerate(part)])
            self.points[number] += len(part)
        self.poll()

    def poll(self) -> None:
        """Show how far the searches have come."""
        now = self.clock()
        busy = max(1.0, getloadavg()[0] / cores())
        left, spent = self.outlook.time_left(now, busy), now - self.began
        if spent >= SETTLED and self.told is None:
            self.told = spent + left
        part = spent / (spent + left) if spent >= SETTLED else 0.0
        self.show(part, f"{self.ended} of {len(self.jobs)} laws, {self.current}")


def search_law(job: LawJob, send: Callable[[int | list[Scored]], None]) -> LawAdvice:
    """Tune one law, with the conditions that its best gains break; rows and points are sent as they come."""
    fixed = dict(job.fixed)
    try:
        scene = load_scene(job.scene, **{**fixed, "law": job.law})
        playouts = () if "playout" in fixed else playouts_for(scene, job.ways)
        margin = MARGIN if "k_e" in scene.knobs else 1.0
        tuned = tune_law(job.scene, job.law, job.budget, job.seed, fixed=fixed, objective=job.objective, margin=margin,
                         playouts=playouts, tell=lambda rows, _: send(rows), workers=1, engine=job.engine,
                         keep=lambda points: send([*points]), known=job.known)
        best = load_scene(job.scene, **tuned.knobs)
        conditions = tuple(unmet(best, job.seed))
    except Refused as refused:
        return LawAdvice(law=job.law, tuned=None, refused=str(refused), knobs={}, claims={})
    return LawAdvice(law=job.law, tuned=tuned, knobs=knobs_of_fields(type(best.law)), claims=claims_of(best.law),
                     seed_energy=seed_energy(best.law, best.dt), broken=conditions)


def definition(jobs: Sequence[LawJob]) -> dict[str, Any]:
    """Definition that the folder of an advice is held to."""
    from teleop.version import __version__

    first, sources = jobs[0], []
    for job in jobs:
        try:
            sources.append(plan_sweep(job.scene, fixed={**job.fixed, "law": job.law}).sources)
        except Refused as refused:  # as its search will be
            sources.append(str(refused))
    axes = [{"knobs": ["law"], "values": [job.law for job in jobs]},
            {"knobs": ["point"], "values": {"count": first.budget}}]
    return {"scene": "advise", "of": first.scene, "fixed": {key: plain(each) for key, each in first.fixed.items()},
            "objective": first.objective, "budget": first.budget, "grid": {"axes": axes, "seeds": [first.seed]},
            "metrics": [], "sources": digest(sources), "version": __version__}


def _points(store: Store, jobs: Sequence[LawJob]) -> list[list[Scored]]:
    """The points of each law that are there, in the order in which its search asked for them."""
    by_law: list[dict[int, Scored]] = [{} for _ in jobs]
    for row in store.rows():
        law, number = divmod(row["row"], jobs[0].budget)
        by_law[law][number] = Scored(tuple(row["point"]), row["seed"], row["seed"] + row["seeds"], _score(row["score"]))
    return [[points[i] for i in range(len(points)) if i in points] for points in by_law]


def _cells(number: int, law: str, one: Scored) -> dict[str, Any]:
    """A point as a row of the store."""
    own = one.score
    score = [own.value, own.broken, own.amount, _pairs(own.terms),
             [[task, _pairs(figures)] for task, figures in own.figures.items()], [*own.values], own.unmet]
    return {"row": number, "law": law, "seed": one.first, "seeds": one.stop - one.first, "point": [*one.point],
            "score": score}


def _score(cells: Sequence[Any]) -> Score:
    value, broken, amount, terms, figures, values, conditions = cells
    return Score(float(value), broken, float(amount), _numbers(terms),
                 {task: _numbers(pairs) for task, pairs in figures}, tuple(map(float, values)), int(conditions))


def _pairs(numbers: Mapping[str, float]) -> list[list[Any]]:
    return [[name, value] for name, value in numbers.items()]


def _numbers(pairs: Sequence[Sequence[Any]]) -> dict[str, float]:
    return {name: float(value) for name, value in pairs}
