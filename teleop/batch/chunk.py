"""Some rows of a sweep, run in one thread: what an executor is given.

Rows that share a structure share a kernel; rows that share a link, a seed and a clock share a schedule, and those that
share a hand its path. A row's result depends on its own knobs and seed alone, whatever stands beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from threading import Lock
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.batch.kernel import Inputs, Kernel, Water, available, figures, plain, tree_of
from teleop.batch.leaves import Leaves, leaves
from teleop.bodies import Bodies, exact_bodies, reference_samples
from teleop.errors import Refused
from teleop.law import functions_of
from teleop.library import scene_function
from teleop.lockstep import link_plans, run
from teleop.metrics import of_plan
from teleop.scene import Scene, made_by
from teleop.tick import features

if TYPE_CHECKING:
    from teleop.result import Result

Row = dict[str, Any]
Measure = str | Callable[["Result"], float]
KEPT = 64  # kernels in one process
TICKS = 4_000_000  # of schedules and paths in one process, about: 64 MB
OF_PLAN = ("fresh_fwd", "fresh_bwd", "T_fwd_mean", "T_fwd_max", "T_bwd_mean", "T_bwd_max")


class Job(NamedTuple):
    """A scene, the knobs that all rows share, and the rows: number, knobs and seed of each."""

    scene: str
    fixed: dict[str, object]
    rows: Sequence[tuple[int, dict[str, object], int]]
    measures: tuple[Measure, ...]
    engine: str


class Done(NamedTuple):
    """What a job came to: its rows, why some of them were not run by the engine that was asked for, and the time."""

    rows: list[Row]
    instead: dict[str, str]
    seconds: float


def work(job: Job) -> Done:
    """Run every row of a job."""
    began = perf_counter()
    rows: dict[int, Row] = {}
    instead: dict[str, str] = {}
    groups: dict[Any, list[Ready]] = {}
    function = scene_function(job.scene)
    before: Any = None  # knobs, scene and what else rows that differ by their seeds alone share
    for number, knobs, seed in job.rows:
        row: Row = {"row": number, "seed": seed, **knobs}
        rows[number] = row
        try:
            if before is None or before[0] != knobs:
                scene = made_by(function, job.scene, {**job.fixed, **knobs})
                whole = whole_runs(job.measures, scene)
                before = knobs, scene, None if whole else _prepared(scene, job, instead)
            _, scene, prepared = before
            if prepared is None:
                _tell(row, *_recorded(scene, seed, job.measures))
            else:
                ticks, kernel, tree, flat = prepared
                ready = Ready(row, scene, seed, ticks, kernel, tree, flat, _schedules(scene, seed))
                groups.setdefault(ready.beside(), []).append(ready)
        except Refused as refused:  # bodies have refusals of their own
            _refuse(row, refused)
    for group in groups.values():
        for batch in _batches(group):
            _run(batch, job.measures)
    return Done(list(rows.values()), instead, perf_counter() - began)


def _tell(row: Row, status: str, ticks: int, told: dict[str, float]) -> None:
    row.update(status=status, ticks=ticks, **told)


def _refuse(row: Row, refused: Refused) -> None:
    row.update(status="refused", ticks=0, sentence=str(refused))


class Ready(NamedTuple):
    """A row that waits for others to be run with."""

    row: Row
    scene: Scene
    seed: int
    ticks: int
    kernel: Kernel
    tree: Any
    flat: Leaves | None
    water: Any  # what tells its schedules from those of others

    def beside(self) -> Any:
        """What rows that are run at once have in common."""
        return id(self.kernel), self.ticks, tuple(self.flat.wholes) if self.flat else ()


def _schedules(scene: Scene, seed: int) -> Any:
    if scene.link is None:
        return "no link", scene.ticks
    return scene.link, scene.playout, seed, scene.ticks, scene.dt_ns, scene.wire_size


def _prepared(scene: Scene, job: Job, instead: dict[str, str]) -> tuple[int, Kernel, Any, Leaves | None]:
    """The ticks of a scene, its kernel, and its numbers as that takes them: as a tree or flat."""
    bodies, known = exact_bodies(scene), available(scene)
    wanted = tuple([one for one in job.measures if isinstance(one, str) and one in known])
    kernel, flat = _kernel(scene, bodies, wanted, job.engine, instead)
    return scene.ticks, kernel, None if flat else tree_of(scene, bodies, compiled=False), flat


def _batches(group: Sequence[Ready]) -> Iterator[Sequence[Ready]]:
    """Rows to be handed to their kernel at one call, those with the same schedule together.

    Where a kernel runs rows side by side, those that fill its lanes go first. No more rows at a call than have
    schedules of `TICKS` ticks in all.
    """
    width = group[0].kernel.width
    alike: dict[Any, list[Ready]] = {}
    for ready in group:
        try:
            alike.setdefault(ready.water, []).append(ready)
        except TypeError:  # a link of the user's own that has no hash
            alike.setdefault(id(ready), []).append(ready)
    left: list[Ready] = []
    batch: list[Ready] = []
    drawn, most = 0, max(width, TICKS // group[0].ticks)
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


def _drawn(ready: Ready) -> Water:
    return Water.of(link_plans(ready.scene, ready.seed))


def _run(batch: Sequence[Ready], measures: Sequence[Measure]) -> None:
    """Run rows at once and write into each what it came to."""
    rows, drawn = [], []
    for ready in batch:
        try:
            water = _once(ready.water, ready.ticks, partial(_drawn, ready))
            path = _reference(ready.scene, compiled=ready.flat is not None)
        except Refused as refused:  # a link or a path may have refusals of its own
            _refuse(ready.row, refused)
            continue
        rows.append(ready)
        drawn.append(Inputs(ready.tree, ready.flat, ready.ticks, water, path))
    if not rows:
        return
    for ready, given, (status, ran, told) in zip(rows, drawn, figures(rows[0].kernel, drawn), strict=True):
        if any(name in OF_PLAN for name in measures):
            of_water = _of_water(given.water, ran, ready.scene)
            told |= {name: value for name, value in of_water.items() if name in measures}
        _tell(ready.row, status, ran, told)


def whole_runs(measures: Sequence[Measure], scene: Scene) -> bool:
    """Do these figures need a whole record, so that no kernel gives them."""
    return _whole_runs(tuple(measures), "waves" in features(scene))


@lru_cache(maxsize=256)
def _whole_runs(measures: tuple[Measure, ...], waves: bool) -> bool:
    return any(not isinstance(one, str) or (waves and one in ("E_fwd_min", "E_bwd_min")) for one in measures)


def _recorded(scene: Scene, seed: int, measures: Sequence[Measure]) -> tuple[str, int, dict[str, float]]:
    """A whole run, for figures that need its record."""
    result = run(scene, seed=seed)
    told = {}
    for one in measures:
        if isinstance(one, str):
            if one in result.metrics:
                told[one] = result.metrics[one]
        else:
            told[one.__name__] = float(one(result))
    return result.status, result.ticks, told


def _of_water(water: Water, ran: int, scene: Scene) -> dict[str, float]:
    told: dict[str, float] = {}
    for way, plan, play in zip(("fwd", "bwd"), water.plans, water.plays, strict=True):
        if plan is not None:
            told |= of_plan(way, play[:ran], scene.dt_ns / 1e9)
    return told


def _reference(scene: Scene, *, compiled: bool) -> Any:
    """The hand's path, as lists for plain Python and as arrays for compiled code."""
    if scene.hand is None:
        return () if compiled else None

    def make() -> Any:
        import numpy as np

        path = reference_samples(scene) or ()
        if len(path) != scene.axes or any(len(axis) <= scene.ticks for axis in path):
            raise Refused(f"the hand's path has not the {scene.ticks + 1} samples for each of {scene.axes} axes that "
                          "it was asked for; see its samples(axes, count, dt_ns)")
        return tuple([np.ascontiguousarray(axis, dtype=np.float64) for axis in path]) if compiled else path

    return _once(("path", scene.hand.reference, scene.axes, scene.ticks, scene.dt_ns, compiled), scene.ticks, make)


_HELD: dict[Any, tuple[Any, int]] = {}  # what was made, and for how many ticks
_KERNELS: dict[Any, Kernel] = {}
_MAKING, _KEEPING = Lock(), Lock()


def _once(key: Any, ticks: int, make: Callable[[], Any]) -> Any:
    """What `make` gives, kept for the next rows; the oldest is dropped. A key that cannot be kept is made anew."""
    try:
        if (held := _HELD.get(key)) is not None:
            return held[0]
    except TypeError:  # a link or a path of the user's own that has no hash
        return make()
    made = make()
    with _KEEPING:
        _HELD[key] = made, ticks
        total = sum(each for _, each in _HELD.values()) if len(_HELD) * ticks > TICKS else 0
        while total > TICKS and len(_HELD) > 1:
            total -= _HELD.pop(next(iter(_HELD)))[1]
    return made


def _kernel(scene: Scene, bodies: Bodies, measures: tuple[str, ...], engine: str, instead: dict[str, str]
            ) -> tuple[Kernel, Leaves | None]:
    """The kernel of a scene's structure, by `engine`, or by a plainer one where it is not made for that.

    With it the row's numbers laid out flat, if it is compiled.
    """
    flat = None if engine == "plain" else leaves(tree_of(scene, bodies))
    velocities = [type(device.velocity) for device in (scene.device_m, scene.device_s) if device is not None]
    # What the text depends on, and the functions that it names.
    key = (engine, measures, features(scene), scene.axes, functions_of(scene.law), *velocities, flat and flat.shape,
           *bodies.functions().values())
    kernel = _KERNELS.get(key)
    if kernel is None:
        with _MAKING:
            kernel = _KERNELS.get(key) or _made(scene, bodies, measures, engine, instead)
            while len(_KERNELS) >= KEPT:
                del _KERNELS[next(iter(_KERNELS))]
            _KERNELS[key] = kernel
    return kernel, None if kernel.engine == "plain" else flat


PLAINER = {"vector": "scalar", "scalar": "plain"}


def _made(scene: Scene, bodies: Bodies, measures: tuple[str, ...], engine: str, instead: dict[str, str]) -> Kernel:
    if engine == "plain":
        return plain(scene, bodies, measures)
    from importlib import import_module

    from numba.core.errors import NumbaError

    from teleop.batch.compiled import NotCompiled

    try:
        kernel: Kernel = getattr(import_module(f"teleop.batch.{engine}"), engine)(scene, bodies, measures)
        first = load_first(scene)
        given = Inputs(None, leaves(tree_of(first, exact_bodies(first))), first.ticks, Water.of(link_plans(first, 0)),
                       _reference(first, compiled=True))
        figures(kernel, [given])
    except (NumbaError, NotCompiled, AttributeError, TypeError) as error:
        why = str(error).strip().splitlines()
        said = " ".join(why[-1:])[:200] if why else type(error).__name__
        instead[PLAINER[engine]] = said if isinstance(error, NotCompiled) else f"{type(error).__name__}: {said}"
        return _made(scene, bodies, measures, PLAINER[engine], instead)
    return kernel


def load_first(scene: Scene) -> Scene:
    """The scene for two ticks: enough to compile its kernel."""
    from dataclasses import replace

    return replace(scene, duration=min(scene.ticks, 2) * scene.dt)
