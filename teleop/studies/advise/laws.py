"""The laws of an advice: each tuned for the link by a process, in a folder that the same command goes on with.

A link is described by the delay, jitter and loss of each direction, which say what playouts are worth trying over it.
The folder's `sweep.json` holds the request and `rows.jsonl` each point that was run, with its score, as
`teleop.sweeps.store` keeps them: a kill by any signal costs the points in flight. A search is the same to the bit
whenever it is run, so one that goes on is done again with the scores of the folder.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, sqrt
from os import getloadavg
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from teleop.errors import Refused
from teleop.knob import Declared, knobs_of_fields
from teleop.law.offers import CONDITIONS, claims_of, seed_energy
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.notes import unmet
from teleop.studies.parallel import stream
from teleop.studies.tune.objective import Score
from teleop.studies.tune.search import LawSearch, Scored, SearchJob, Tuned
from teleop.sweeps.engine import PLAIN, compiles
from teleop.sweeps.grid import json_value
from teleop.sweeps.kernels.functions import digest
from teleop.sweeps.runner import cores, plan_sweep
from teleop.sweeps.store import Store
from teleop.terminal.table import si
from teleop.version import __version__

MARGIN = 2.0  # by which the wall may be stiffer in the search
SETTLED = 20.0  # s after which the time that is left is shown
COMPILES = {"plain": 0.0, "c": 2.0}  # s, a law's kernels, on the machine of `teleop/studies/README.md`
FASTER = 60.0  # times, compiled
LATE = 0.995  # of the packets that come, which a fixed playout delay is to play


class OneWay(NamedTuple):
    """Delay and loss of one direction, over the run of a scene. SI units."""

    least: float
    median: float
    late: float  # the delay that `LATE` of them keep to
    greatest: float
    lost: float  # share

    def text(self) -> str:
        """The direction in words."""
        if self.greatest - self.least < 1e-9:
            delay = si(self.median, "s")
        else:
            delay = (f"{si(self.median, 's')} median ({si(self.least, 's')} to {si(self.greatest, 's')}, "
                     f"{LATE:.1%} within {si(self.late, 's')})")
        return f"{delay}, {self.lost:.1%} of packets lost"


LONGEST_WAY = 10.0  # s: nobody holds a handle for longer; more is most likely a delay that was typed in ms


def one_way(scene: Scene, direction: int, seed: int) -> OneWay:
    """Delay and loss of direction 0 (forward) or 1 in a run of `scene`.

    Raises `Refused` if nothing arrives, or if it takes more than `LONGEST_WAY` in the median.
    """
    if scene.link is None:
        return OneWay(scene.dt, scene.dt, scene.dt, scene.dt, 0.0)
    arrivals = scene.link.arrivals(direction, scene.ticks, scene.dt_ns, seed, scene.wire_size)
    if not len(arrivals.packet):
        way = ("forward", "backward")[direction]
        raise Refused(f"nothing gets through the link {way} within {scene.duration:g} s, so no law can do anything; "
                      "give another part of the recording, or another --link")
    ages = (arrivals.time_ns - arrivals.packet * scene.dt_ns) / 1e9
    lost = 1.0 - len(np.unique(arrivals.packet)) / scene.ticks
    late, median = float(np.quantile(ages, LATE, method="higher")), float(np.median(ages))
    if median > LONGEST_WAY:
        raise Refused(f"the link takes {median:g} s one way, and laws are compared up to {LONGEST_WAY:g} s; its delays "
                      "are in s, so write for example delay(0.08) for 80 ms")
    return OneWay(float(ages.min()), median, late, float(ages.max()), lost)


def link_text(ways: tuple[OneWay, OneWay]) -> str:
    """Both directions in words."""
    near = all(abs(a - b) <= 0.02 * max(abs(a), abs(b)) + 5e-3 for a, b in zip(*ways, strict=True))
    return f"{ways[0].text()}, each way" if near else f"forward {ways[0].text()}; backward {ways[1].text()}"


def playouts_for(scene: Scene, ways: tuple[OneWay, OneWay]) -> tuple[str, ...]:
    """The playouts that are tried with the scene's law: newest packet and fixed delay, waves by their integral.

    A link that neither jitters nor loses leaves nothing to choose. Neither hold nor zero is tried for waves: hold plays
    a message again in the gaps, which is active, and zero fades a steady force. For samples hold changes nothing.
    """
    gaps = "integral" if scene.has_waves else "zero"
    if all(way.greatest - way.least < scene.dt and way.lost == 0.0 for way in ways):
        return ()
    late = max(way.late for way in ways)
    ticks = max(1, ceil(late / scene.dt - 1e-6))
    fixed = f"fixed:{ticks * scene.dt:.9g}"
    return (gaps, f"{fixed}:integral" if scene.has_waves else fixed)


class LawMargins(NamedTuple):
    """The stiffest wall and the longest delay tried that the gains stand; the next breaks a constraint, or is none."""

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
    def search(self) -> Tuned:
        """The result of its search, of a law that was tuned."""
        assert self.tuned is not None
        return self.tuned

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
        """True if the law claims a ledger, and none of its conditions is broken."""
        return bool(self.claims) and not self.broken


def gains(law: LawAdvice) -> str:
    """The parameters, with their units, and the playout."""
    texts = []
    for name, value in law.search.best.items():
        if name == "playout":
            continue
        knob = law.knobs[name.removeprefix("law.")].knob
        texts.append(f"{name.removeprefix('law.')} = {value:g}{' ' + knob.unit if knob.unit not in ('', '1') else ''}")
    playout = law.search.best.get("playout")
    return ", ".join(texts) + (f", playout {playout}" if playout else "")


def _over(ledger: str, claim: str) -> str:
    """The links of a claim. How waves are played matters to the ledger of waves alone."""
    return CONDITIONS[claim] if ledger == "E_link" else CONDITIONS[claim].partition(",")[0]


def promise(law: LawAdvice) -> str:
    """The law's claims, which hold for every hand and environment, in words."""
    if not law.claims:
        return "nothing of energy: what holds is what was run here"
    held = "; ".join(f"{ledger} stays above zero {_over(ledger, claim)}" for ledger, claim in law.claims.items())
    return held + (f", but for {1e3 * law.seed_energy:.3g} mJ to begin with" if law.seed_energy > 0.0 else "")


class LawJob(NamedTuple):
    """Search of one law, as a process is handed it."""

    search: SearchJob
    ways: tuple[OneWay, OneWay]
    known: tuple[Scored, ...] = ()  # points that the folder holds


class Outlook:
    """The time that searches of so many rows each will still take, by several workers. Times in s, of any clock.

    A law's time is one to begin with, in which its kernels are compiled, and one for each row. Both are the means of
    the laws so far; rows that were there before take none. Until rows have come they are `start` and `each`.
    """

    def __init__(self, laws: int, rows: int, workers: int, start: float, each: float) -> None:
        self._waiting, self._rows, self._workers = laws, rows, workers
        self._start, self._each = start, each
        self._begun: dict[int, tuple[float, int]] = {}  # by the number of a law, when it began, and with which rows
        self._first: dict[int, tuple[float, int]] = {}  # the time of its first rows, and their number
        self._last: dict[int, tuple[float, int]] = {}
        self._done: set[int] = set()

    def begin(self, law: int, now: float, known: int = 0) -> None:
        """Note that the search of a law begins with so many `known` rows."""
        self._waiting -= 1
        self._begun[law] = now, known

    def rows(self, law: int, rows: int, now: float) -> None:
        """Note the rows of a law so far."""
        if rows > self._begun[law][1]:
            self._first.setdefault(law, (now, rows))
            self._last[law] = now, rows

    def end(self, law: int) -> None:
        """Note that a law is searched."""
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


def search_laws(jobs: Sequence[LawJob], out: Path | None, workers: int, clock: Callable[[], float],
                show: Callable[[float, str], None]) -> Iterator[tuple[LawAdvice, float | None]]:
    """Search each law; yield its result as it comes, with the time in all (s) that was predicted after `SETTLED`.

    `out`: the folder, made or gone on with; None: none. Raises `Refused`.
    """
    store = None if out is None else Store.open(out, definition(jobs))
    try:
        if store is not None:
            jobs = [job._replace(known=tuple(points)) for job, points in zip(jobs, _points(store, jobs), strict=True)]
        yield from LawSearches(jobs, store, workers, clock, show).run()
    finally:
        if store is not None:
            store.close()


class LawSearches:
    """Searches of all laws in their processes, kept and shown as they go on."""

    def __init__(self, jobs: Sequence[LawJob], store: Store | None, workers: int, clock: Callable[[], float],
                 show: Callable[[float, str], None]) -> None:
        self.jobs, self.store, self.workers, self.clock, self.show = jobs, store, workers, clock, show
        first = jobs[0].search
        each = PLAIN * load_scene(first.scene, **first.fixed).ticks
        engine = "plain" if first.engine == "plain" else "c" if compiles() else "plain"
        self.outlook = Outlook(len(jobs), first.budget, min(workers, len(jobs)), COMPILES[engine],
                               each if engine == "plain" else each / FASTER)
        self.points = [len(job.known) for job in jobs]
        self.current, self.ended = "", 0
        self.predicted: float | None = None

    def run(self) -> Iterator[tuple[LawAdvice, float | None]]:
        """Yield each law's result as it comes, with the predicted time in all (s)."""
        self.began = self.clock()
        for number, advice in stream(search_law, self.jobs, self.workers, self.begin, self.take, self.poll):
            self.outlook.end(number)
            self.ended += 1
            self.poll()
            yield advice, self.predicted

    def begin(self, number: int) -> None:
        """Note the start of a law's search."""
        self.current = self.jobs[number].search.law
        self.outlook.begin(number, self.clock(), sum(
            (each.stop - each.first) * len(each.score.figures) for each in self.jobs[number].known))
        self.poll()

    def take(self, number: int, part: int | list[Scored]) -> None:
        """Take in the rows of a law so far, or keep its points."""
        if isinstance(part, int):
            self.outlook.rows(number, part, self.clock())
        elif self.store is not None:
            first, job = self.points[number], self.jobs[number].search
            self.store.append([_cells(number * job.budget + first + i, job.law, each) for i, each in enumerate(part)])
            self.points[number] += len(part)
        self.poll()

    def poll(self) -> None:
        """Show the progress of the searches."""
        now = self.clock()
        busy = max(1.0, getloadavg()[0] / cores())
        left, spent = self.outlook.time_left(now, busy), now - self.began
        if spent >= SETTLED and self.predicted is None:
            self.predicted = spent + left
        part = spent / (spent + left) if spent >= SETTLED else 0.0
        self.show(part, f"{self.ended} of {len(self.jobs)} laws, {self.current}")


def search_law(job: LawJob, send: Callable[[int | list[Scored]], None]) -> LawAdvice:
    """Tune one law, and find the conditions that its best gains break; rows and points are sent as they come."""
    search = job.search
    try:
        scene = load_scene(search.scene, **{**search.fixed, "law": search.law})
        playouts = () if "playout" in search.fixed else playouts_for(scene, job.ways)
        margin = MARGIN if "k_e" in scene.knobs else 1.0
        tuned = LawSearch(search._replace(margin=margin, playouts=playouts), tell=lambda rows, _: send(rows), workers=1,
                          keep=lambda points: send([*points]), known=job.known).run()
        best = load_scene(search.scene, **tuned.knobs)
        conditions = tuple(unmet(best, search.seed))
    except Refused as refused:
        return LawAdvice(law=search.law, tuned=None, refused=str(refused), knobs={}, claims={})
    return LawAdvice(law=search.law, tuned=tuned, knobs=knobs_of_fields(type(best.law)), claims=claims_of(best.law),
                     seed_energy=seed_energy(best.law, best.dt), broken=conditions)


def definition(jobs: Sequence[LawJob]) -> dict[str, Any]:
    """Definition by which the folder of an advice is known again."""
    first, sources = jobs[0].search, []
    for job, *_ in jobs:
        try:
            sources.append(plan_sweep(job.scene, fixed={**job.fixed, "law": job.law}).sources)
        except Refused as refused:  # as its search will be
            sources.append(str(refused))
    axes = [{"knobs": ["law"], "values": [job.search.law for job in jobs]},
            {"knobs": ["point"], "values": {"count": first.budget}}]
    return {"scene": "advise", "of": first.scene, "fixed": {key: json_value(each) for key, each in first.fixed.items()},
            "objective": first.objective, "budget": first.budget, "grid": {"axes": axes, "seeds": [first.seed]},
            "metrics": [], "sources": digest(sources), "version": __version__}


def _points(store: Store, jobs: Sequence[LawJob]) -> list[list[Scored]]:
    """The points of each law in the folder, in the order in which its search asked for them."""
    by_law: list[dict[int, Scored]] = [{} for _ in jobs]
    for row in store.rows():
        law, number = divmod(row["row"], jobs[0].search.budget)
        by_law[law][number] = Scored(tuple(row["point"]), row["seed"], row["seed"] + row["seeds"], _score(row["score"]))
    return [[points[i] for i in range(len(points)) if i in points] for points in by_law]


def _cells(number: int, law: str, scored: Scored) -> dict[str, Any]:
    """A point as a row of the store."""
    score = scored.score
    cells = [score.value, score.broken, score.amount, _pairs(score.terms),
             [[task, _pairs(figures)] for task, figures in score.figures.items()], [*score.values], score.unmet]
    return {"row": number, "law": law, "seed": scored.first, "seeds": scored.stop - scored.first,
            "point": [*scored.point], "score": cells}


def _score(cells: Sequence[Any]) -> Score:
    value, broken, amount, terms, figures, values, conditions = cells
    return Score(float(value), broken, float(amount), _numbers(terms),
                 {task: _numbers(pairs) for task, pairs in figures}, tuple(map(float, values)), int(conditions))


def _pairs(numbers: Mapping[str, float]) -> list[list[Any]]:
    return [[name, value] for name, value in numbers.items()]


def _numbers(pairs: Sequence[Sequence[Any]]) -> dict[str, float]:
    return {name: float(value) for name, value in pairs}
