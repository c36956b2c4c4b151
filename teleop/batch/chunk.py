"""Some rows of a sweep, run one after another in one thread: what an executor is given.

Rows that share a structure share a kernel; rows that share a link, a seed and a clock share a schedule, and those that
share a hand its path. A row's result depends on its own knobs and seed alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from threading import Lock
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.batch.kernel import Kernel, Water, available, figures, names_of, numbers, plain
from teleop.bodies import Bodies, exact_bodies, reference_samples
from teleop.errors import Refused
from teleop.library import scene_function
from teleop.lockstep import link_plans, run
from teleop.metrics import UNITS, of_plan
from teleop.scene import Scene, made_by
from teleop.tick import features

if TYPE_CHECKING:
    from teleop.result import Result

Row = dict[str, Any]
Measure = str | Callable[["Result"], float]
KEPT = 64  # schedules and paths in one process
OF_PLAN = ("fresh_fwd", "fresh_bwd", "T_fwd_mean", "T_fwd_max", "T_bwd_mean", "T_bwd_max")


class Job(NamedTuple):
    """A scene, the knobs that all rows share, and the rows: number, knobs and seed of each."""

    scene: str
    fixed: dict[str, object]
    rows: Sequence[tuple[int, dict[str, object], int]]
    measures: tuple[Measure, ...]
    engine: str


class Done(NamedTuple):
    """What a job came to: its rows, and why some of them were not run by the engine that was asked for."""

    rows: list[Row]
    instead: dict[str, str]


def work(job: Job) -> Done:
    """Run every row of a job."""
    rows: list[Row] = []
    instead: dict[str, str] = {}
    function = scene_function(job.scene)
    for number, knobs, seed in job.rows:
        row: Row = {"row": number, "seed": seed, **knobs}
        try:
            scene = made_by(function, job.scene, {**job.fixed, **knobs})
            status, ticks, told = _run(scene, seed, job, instead)  # bodies and links have refusals of their own
        except Refused as refused:
            rows.append({**row, "status": "refused", "ticks": 0, "sentence": str(refused)})
            continue
        rows.append({**row, "status": status, "ticks": ticks, **told})
    return Done(rows, instead)


def whole_runs(measures: Sequence[Measure], scene: Scene) -> bool:
    """Do these figures need a whole record, so that no kernel gives them."""
    known = available(scene) | set(OF_PLAN)
    return any(not isinstance(one, str) or (one in UNITS and one not in known and _has(one, scene)) for one in measures)


def _has(measure: str, scene: Scene) -> bool:
    """Does a single run of the scene have this figure, though a kernel has not."""
    return measure in ("E_fwd_min", "E_bwd_min") and scene.has_waves and scene.energy


def _run(scene: Scene, seed: int, job: Job, instead: dict[str, str]) -> tuple[str, int, dict[str, float]]:
    if whole_runs(job.measures, scene):
        return _recorded(scene, seed, job.measures)
    key = ("water", scene.link, scene.link and scene.playout, scene.link and seed, scene.ticks, scene.dt_ns,
           scene.wire_size)
    water = _once(key, lambda: Water.of(link_plans(scene, seed)))
    bodies = exact_bodies(scene)
    wanted = tuple(one for one in job.measures if isinstance(one, str) and one in available(scene))
    kernel = _kernel(scene, bodies, wanted, job.engine, instead)
    status, ran, told = figures(kernel, numbers(kernel, scene, bodies, _reference(scene, kernel), water), water)
    if any(name in OF_PLAN for name in job.measures):
        told |= {name: value for name, value in _of_water(water, ran, scene).items() if name in job.measures}
    return status, ran, told


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


def _reference(scene: Scene, kernel: Kernel) -> Any:
    """The hand's path, as lists for plain Python and as arrays for compiled code."""
    if scene.hand is None:
        return None if kernel.given is None else ()
    key = ("path", scene.hand.reference, scene.axes, scene.ticks, scene.dt_ns, kernel.given is None)

    def make() -> Any:
        import numpy as np

        path = reference_samples(scene) or ()
        return path if kernel.given is None else tuple([np.asarray(axis) for axis in path])

    return _once(key, make)


_HELD: dict[Any, Any] = {}
_KERNELS: dict[Any, Kernel] = {}
_MAKING = Lock()


def _once(key: Any, make: Callable[[], Any]) -> Any:
    """What `make` gives, kept for the next rows; the oldest is dropped. A key that cannot be kept is made anew."""
    try:
        return _HELD[key]
    except TypeError:  # a link or a path of the user's own that has no hash
        return make()
    except KeyError:
        made = make()
        while len(_HELD) >= KEPT:
            _HELD.pop(next(iter(_HELD)), None)
        _HELD[key] = made
        return made


def _kernel(scene: Scene, bodies: Bodies, measures: tuple[str, ...], engine: str, instead: dict[str, str]) -> Kernel:
    """The kernel of a scene's structure, by `engine`, or by plain Python where it is not made for that."""
    # What the text depends on, and the functions that it names; those of a kernel that is kept live on in it.
    functions = tuple([(name, id(part)) for name, part in names_of(scene, bodies).items() if type(part) is not float])
    key = engine, measures, features(scene), scene.axes, type(scene.law), functions
    kernel = _KERNELS.get(key)
    if kernel is None:
        with _MAKING:
            kernel = _KERNELS.get(key) or _made(scene, bodies, measures, engine, instead)
            while len(_KERNELS) >= KEPT:
                del _KERNELS[next(iter(_KERNELS))]
            _KERNELS[key] = kernel
    return kernel


def _made(scene: Scene, bodies: Bodies, measures: tuple[str, ...], engine: str, instead: dict[str, str]) -> Kernel:
    if engine == "plain":
        return plain(scene, bodies, measures)
    from numba.core.errors import NumbaError

    from teleop.batch.compiled import NotCompiled, scalar

    try:
        kernel = scalar(scene, bodies, measures)
        first = load_first(scene)
        water = Water.of(link_plans(first, 0))
        figures(kernel, numbers(kernel, first, exact_bodies(first), _reference(first, kernel), water), water)
    except (NumbaError, NotCompiled, AttributeError, TypeError) as error:
        why = str(error).strip().splitlines()
        instead["plain"] = f"{type(error).__name__}: {' '.join(why[-1:])[:200]}" if why else type(error).__name__
        return plain(scene, bodies, measures)
    return kernel


def load_first(scene: Scene) -> Scene:
    """The scene for two ticks: enough to compile its kernel."""
    from dataclasses import replace

    return replace(scene, duration=min(scene.ticks, 2) * scene.dt)
