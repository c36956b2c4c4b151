"""Some rows of a sweep, run in one thread: what an executor is given.

A row's result depends on its own knobs and seed alone, whatever stands beside it. What rows have in common, the kernel
of their structure, their schedules and the path of their hand, is made once (`teleop.sweeps.shared`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from threading import Lock
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.errors import Refused
from teleop.scene.library import scene_function
from teleop.scene.loading import made_by
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies, exact_bodies
from teleop.simulation.metrics import of_plan
from teleop.simulation.structure import structure_of
from teleop.simulation.virtual import run
from teleop.sweeps.kernels.digest import constants
from teleop.sweeps.kernels.kernel import Inputs, Kernel, NotCompiled, available, figures, names_of, tree_of
from teleop.sweeps.kernels.leaves import Leaves
from teleop.sweeps.shared import TICKS, Schedules, kernel_of, path_of, schedules_key

if TYPE_CHECKING:
    from teleop.simulation.result import Result

Row = dict[str, Any]
Measure = str | Callable[["Result"], float]
OF_PLAN = frozenset(("fresh_fwd", "fresh_bwd", "T_fwd_mean", "T_fwd_max", "T_bwd_mean", "T_bwd_max"))
WHOLE = "a figure needs the whole record of a run"
_READYING = Lock()


class Job(NamedTuple):
    """A scene, the knobs that all rows share, and the rows: number, knobs and seed of each."""

    scene: str
    fixed: dict[str, object]
    rows: Sequence[tuple[int, dict[str, object], int]]
    measures: tuple[Measure, ...]
    engine: str


class Done(NamedTuple):
    """What a job came to: its rows, how many which engine ran, and the time that took."""

    rows: list[Row]
    ran: Counter[tuple[str, str]]  # by engine, and why it was not the one that was asked for
    seconds: float


class Stopped(Exception):
    """A job was given up, and its rows with it."""


def work(job: Job, stopped: Callable[[], bool] | None = None) -> Done:
    """Run every row of a job. Raises `Stopped` soon after `stopped` says so."""
    began = perf_counter()
    rows: dict[int, Row] = {number: {"row": number, "seed": seed, **knobs} for number, knobs, seed in job.rows}
    ran: Counter[tuple[str, str]] = Counter()
    with _READYING:  # one thread at a time has use for Python; the others run what they made ready
        groups = _readied(job, rows, ran, stopped)
    for group in groups:
        for batch in _batches(group):
            if stopped is not None and stopped():
                raise Stopped
            try:
                kernel = _run(batch, job.measures)
                ran[kernel.engine, kernel.why] += len(batch)
            except NotCompiled as why:
                again = frozenset(ready.row["row"] for ready in batch)
                plainly = [one for one in job.rows if one[0] in again]
                rows |= {row["row"]: row for row in work(job._replace(rows=plainly, engine="plain"), stopped).rows}
                ran["plain", str(why)] += len(batch)
    return Done(list(rows.values()), ran, perf_counter() - began)


def _readied(job: Job, rows: dict[int, Row], ran: Counter[tuple[str, str]], stopped: Callable[[], bool] | None
             ) -> list[list[Ready]]:
    """The rows of a job, those of one kernel together; what is refused or needs a record is told already."""
    groups: dict[Any, list[Ready]] = {}
    waters: dict[Any, Schedules] = {}
    stamps: dict[Any, object] = {}
    function = scene_function(job.scene)
    before: Any = None  # knobs, scene and what else rows that differ by their seeds alone share
    for number, knobs, seed in job.rows:
        row = rows[number]
        if stopped is not None and stopped():
            raise Stopped
        try:
            if before is None or not _same(before[0], knobs):
                scene = made_by(function, job.scene, {**job.fixed, **knobs})
                whole = whole_runs(job.measures, scene)
                before = knobs, scene, None if whole else _prepared(scene, job, stamps)
            _, scene, prepared = before
            if prepared is None:
                _tell(row, *_recorded(scene, seed, job.measures, row))
                ran["plain", WHOLE if job.engine != "plain" else ""] += 1
                continue
            kernel, given = prepared
            key = schedules_key(scene, seed)
            schedules = waters.get(key) or waters.setdefault(key, Schedules(key, scene, seed))
            beside = id(kernel), given.ticks, tuple(given.flat.wholes) if given.flat else ()
            groups.setdefault(beside, []).append(Ready(row, kernel, given, schedules))
        except Refused as refused:  # bodies and paths have refusals of their own
            _refuse(row, refused)
    return list(groups.values())


def _same(knobs: dict[str, object], others: dict[str, object]) -> bool:
    """Are these the same knobs, to the bit: -0.0 is not 0.0, and 1 not True."""
    return all(a is b or (type(a) is type(b) is float and a == b != 0.0)
               for a, b in zip(knobs.values(), others.values(), strict=True))


def _tell(row: Row, status: str, ticks: int, told: dict[str, float]) -> None:
    row.update(status=status, ticks=ticks, **told)


def _refuse(row: Row, refused: Refused) -> None:
    row.update(status="refused", ticks=0, sentence=str(refused))


class Ready(NamedTuple):
    """A row that waits for others to be run with. It does not hold its scene: there are many of these at once."""

    row: Row
    kernel: Kernel
    given: Given
    schedules: Schedules


class Given(NamedTuple):
    """What a kernel is given of a scene, but for its schedules."""

    tree: Any
    flat: Leaves | None
    ticks: int
    path: Any


def _prepared(scene: Scene, job: Job, stamps: dict[Any, object]) -> tuple[Kernel, Given]:
    bodies, known = exact_bodies(scene), available(scene)
    wanted = tuple([one for one in job.measures if isinstance(one, str) and one in known])
    kernel, flat = kernel_of(scene, bodies, wanted, job.engine, _stamp(scene, bodies, job.engine, stamps))
    tree = None if flat else tree_of(scene, bodies, compiled=False)
    return kernel, Given(tree, flat, scene.ticks, path_of(scene, compiled=flat is not None))


def _stamp(scene: Scene, bodies: Bodies, engine: str, stamps: dict[Any, object]) -> object:
    """The constants that a kernel is compiled with as they are now; looked at once in a job."""
    if engine == "plain":
        return None
    functions = bodies.functions()
    key = type(scene.law), *functions.values()
    if key not in stamps:
        stamps[key] = tuple(constants([*names_of(scene, bodies).values()]))
    return stamps[key]


def _batches(group: Sequence[Ready]) -> Iterator[Sequence[Ready]]:
    """Rows to be handed to their kernel at one call, those with the same schedules together.

    Where a kernel runs rows side by side, those that fill its lanes go first. No more rows at a call than have
    schedules of `TICKS` ticks in all.
    """
    width = group[0].kernel.width
    if group[0].kernel.engine == "plain":  # row by row, to be stopped in between
        yield from ([ready] for ready in group)
        return
    alike: dict[int, list[Ready]] = {}
    for ready in group:
        alike.setdefault(id(ready.schedules), []).append(ready)
    left: list[Ready] = []
    batch: list[Ready] = []
    drawn, most = 0, max(width, TICKS // group[0].given.ticks)
    for several in alike.values():
        whole = len(several) - len(several) % width
        left += several[whole:]
        batch += several[:whole]
        drawn += 1
        if drawn >= most:
            yield batch
            batch, drawn = [], 0
    if batch:
        yield batch
    yield from (left[first:first + most] for first in range(0, len(left), most))


def _run(batch: Sequence[Ready], measures: Sequence[Measure]) -> Kernel:
    """Run rows at once and write into each what it came to; the kernel that ran them."""
    kernel = batch[0].kernel
    rows, given = [], []
    for ready in batch:
        try:
            water = ready.schedules.water()
        except Refused as refused:  # a link may have refusals of its own
            _refuse(ready.row, refused)
            continue
        rows.append(ready)
        given.append(Inputs(ready.given.tree, ready.given.flat, ready.given.ticks, water, ready.given.path))
    if not rows:
        return kernel
    try:
        found = figures(kernel, given)
    except NotCompiled as why:
        kernel = kernel if kernel.plainer is None else kernel.plainer(str(why))
        if kernel.engine in ("plain", batch[0].kernel.engine):
            raise
        found = figures(kernel, given)
    except Refused as refused:  # the law's doing; plain Python alone raises it, and runs one row at a time
        _refuse(rows[0].row, refused)
        return kernel
    of_plan_too = [name for name in measures if name in OF_PLAN]
    for ready, (status, ran, told) in zip(rows, found, strict=True):
        if of_plan_too:
            drawn = _of_schedules(ready.schedules, ran)
            told |= {str(name): drawn[str(name)] for name in of_plan_too if name in drawn}
        _tell(ready.row, status, ran, told)
    return kernel


def _of_schedules(schedules: Schedules, ran: int) -> dict[str, float]:
    told: dict[str, float] = {}
    water = schedules.water()
    for way, plan, play in zip(("fwd", "bwd"), water.plans, water.plays, strict=True):
        if plan is not None:
            told |= of_plan(way, play[:ran], schedules.dt)
    return told


def whole_runs(measures: Sequence[Measure], scene: Scene) -> bool:
    """Do these figures need a whole record, so that no kernel gives them."""
    return _whole_runs(tuple(measures), structure_of(scene).has.waves)


@lru_cache(maxsize=256)
def _whole_runs(measures: tuple[Measure, ...], waves: bool) -> bool:
    return any(not isinstance(one, str) or (waves and one in ("E_fwd_min", "E_bwd_min")) for one in measures)


def _recorded(scene: Scene, seed: int, measures: Sequence[Measure], row: Row) -> tuple[str, int, dict[str, float]]:
    """A whole run, for figures that need its record; of a figure that fails `row` has the sentence."""
    result = run(scene, seed=seed)
    told = {}
    for one in measures:
        if isinstance(one, str):
            if one in result.metrics:
                told[one] = result.metrics[one]
        else:
            try:
                told[one.__name__] = float(one(result))
            except Exception as error:  # the user's own code: one row's failure is no reason to lose the others
                row["sentence"] = f"metric {one.__name__} stopped with {type(error).__name__}: {error}"
    return result.status, result.ticks, told
