"""Sweeps: a grid of knobs and seeds over one scene, in chunks, by any executor."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, islice
from os import PathLike
from pathlib import Path
from threading import Event
from typing import Any

from teleop.errors import Refused, nearest
from teleop.law import is_built_in
from teleop.scene.knobs import check_text, knobs_of, read_link
from teleop.scene.library import OwnFile, own_file, scene_function
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.metrics import UNITS
from teleop.sweeps.chunk import ChunkResult, Job, work
from teleop.sweeps.engine import Measure, choose
from teleop.sweeps.grid import Grid, check_count, clean_values, grid, json_value
from teleop.sweeps.kernels.functions import digest, file_digest, sources
from teleop.sweeps.kernels.kernel import available
from teleop.sweeps.store import METRIC_SOURCES, Store
from teleop.sweeps.table import Table, TableBuilder
from teleop.version import __version__

CHUNK = 0.5  # s of work that a chunk aims at
LARGEST = 4096  # rows in one
POLL = 1.0  # s after which an executor is asked again how much it can take
MOST_LAWS = 32  # of an axis that are looked at beforehand
ENDS = ("master_start", "slave_start", "master", "slave", "master_sums", "slave_sums", "start", "force")
USUAL = ("x_err_rms", "x_err_max", "f_m_max", "E_link_min", "E_port_min")

Show = Callable[[int, int], None]


@dataclass(kw_only=True)
class Sweep:
    """A sweep and how far it has come."""

    scene: str
    first: Scene  # that of the first row
    others: tuple[Scene, ...] = ()  # the same with every other law of the grid, the first `MOST_LAWS` of them
    grid: Grid
    fixed: Mapping[str, object]
    measures: tuple[Measure, ...]
    engine: str
    why: str  # the engine
    sources: str = ""  # a digest of what of the sweep is the user's own: scene file and laws
    files: tuple[OwnFile, ...] = ()  # that have these, as they were read
    ran: Counter[tuple[str, str]] = field(default_factory=Counter)  # rows by engine, and why it was not the one above
    workers: int = 0  # threads that rows are run by at a time; 0 before any was run

    def definition(self) -> dict[str, Any]:
        """Definition that the folder of this sweep must match."""
        metric_digests = {one.__name__: digest(sources([one])) for one in self.measures if not isinstance(one, str)}
        return {
            "scene": self.scene,
            "fixed": {key: json_value(clean_values(key, [value])[0]) for key, value in self.fixed.items()},
            "grid": self.grid.definition(), "metrics": _names(self.measures), "sources": self.sources,
            "version": __version__, **({METRIC_SOURCES: metric_digests} if metric_digests else {}),
        }


def sweep(
    scene: str | PathLike[str], axes: Mapping[Any, Iterable[Any]] | Grid | None = None, *,
    seeds: int | Iterable[int] = 1, metrics: Sequence[Measure] | None = None,
    fixed: Mapping[str, object] | None = None, engine: str | None = None, executor: Executor | None = None,
    workers: int | None = None, out: Path | str | None = None, show: Show | None = None, mended: Sequence[str] = (),
) -> Table:
    """Run `scene` (a name, or the path of a file) at every point of a grid and with every seed.

        sweep("soft_tissue", {"law": ["wave", "direct"], "delay": [0.0, 0.05]}, seeds=3)["x_err_rms"]

    `axes`: knobs and their values as `load_scene` takes them; a tuple of knobs goes with a list of tuples. `fixed`:
    knobs that are the same in every row. `metrics`: names of `teleop.simulation.metrics.UNITS`, or functions of a
    `Result`, which cost a whole record. `engine`: plain, c or vector; left out, by the amount of work and what
    is installed. `executor`: any of concurrent.futures; left out, threads. `workers`: how many it has; left out, one
    for each core. `out`: a folder that rows are appended to as they finish; the same sweep there goes on where it
    stopped. `show` is told rows done and rows in all. A function among `metrics` that raises, or returns no number,
    ends the sweep; `mended` names those that were edited since and do not change the rows that are in `out`. Raises
    `Refused`.
    """
    plan = plan_sweep(scene, axes, seeds=seeds, metrics=metrics, fixed=fixed, engine=engine)
    return carry_out(plan, executor=executor, workers=workers, out=out, show=show, mended=mended)


def plan_sweep(
    scene: str | PathLike[str], axes: Mapping[Any, Iterable[Any]] | Grid | None = None, *,
    seeds: int | Iterable[int] = 1, metrics: Sequence[Measure] | None = None,
    fixed: Mapping[str, object] | None = None, engine: str | None = None,
) -> Sweep:
    """The sweep, checked before anything is run or written.

    Its first row must make a scene, and every text of its axes must be a value of its knob. A number that is out of
    bounds, or that does not go with the others, refuses its row alone.
    """
    scene = str(scene) if isinstance(scene, PathLike) else scene
    points = axes if isinstance(axes, Grid) else grid(axes or {}, seeds)
    fixed = dict(fixed or {})
    twice = [knob for knob in points.knobs if knob in fixed]
    if twice:
        raise Refused(f"{twice[0]} is an axis of the grid and set besides; leave one of them out")
    first = load_scene(scene, **{**fixed, **points.point(0)[0]})
    known = knobs_of(scene_function(scene))
    for knob, value in _axis_values(points):
        if isinstance(value, str):
            check_text(knob, value, known)
    others = _of_each_law(scene, points, fixed)
    offered = {name for one in (first, *others) for name in available(one)}
    measures = tuple(name for name in USUAL if name in offered) if metrics is None else _checked(metrics)
    chosen, why = choose(engine, first, len(points), measures)
    # As the scene has it, so that "0.30" and 0.3 are the same sweep.
    read = {key: first.knobs[key] for key, value in fixed.items()
            if isinstance(value, str) and (key == "link" or isinstance(first.knobs.get(key), bool | int | float))}
    laws = [one.law for one in (first, *others)]
    made_by: list[Any] = [scene_function(scene), *map(type, laws)]
    files = map(own_file, made_by)
    return Sweep(scene=scene, first=first, others=tuple(others), grid=points, fixed={**fixed, **read},
                 measures=measures, engine=chosen, why=why, sources=_own_sources(scene, laws, _replayed(points)),
                 files=tuple([file for file in files if file is not None]))


def _axis_values(points: Grid) -> Iterator[tuple[str, Any]]:
    """Each value of each axis, with its knob."""
    return ((knob, value) for knobs, values in points.axes for at in values
            for knob, value in zip(knobs, at, strict=True))


def _replayed(points: Grid) -> list[str]:
    """The links of the axes that replay a live run, with the digests of what they replay."""
    links = {value for knob, value in _axis_values(points) if knob == "link" and isinstance(value, str)}
    return sorted(shown for link in links if (shown := read_link(link)[0]) != link)


def _of_each_law(name: str, points: Grid, fixed: Mapping[str, object]) -> list[Scene]:
    """The first row's scene with every other law of the grid; what is refused, its rows will say."""
    scenes = []
    laws = [value for knob, value in _axis_values(points) if knob == "law"]
    for law in laws[1:MOST_LAWS]:
        with suppress(Refused):
            scenes.append(load_scene(name, **{**fixed, **points.point(0)[0], "law": law}))
    return scenes


def _checked(metrics: object) -> tuple[Measure, ...]:
    """The metrics that were asked for. Raises `Refused`."""
    if isinstance(metrics, str) or not isinstance(metrics, Iterable):
        raise Refused(f"metrics are a list, not {metrics!r}; write for example metrics=['x_err_rms']")
    measures = tuple(metrics)
    for one in measures:
        if isinstance(one, str) and one not in UNITS:
            raise Refused(f"there is no metric {one!r}; {nearest(one, UNITS)}")
        if not isinstance(one, str) and not (callable(one) and hasattr(one, "__name__")):
            raise Refused(f"a metric is the name of one, or a function of a Result with a name, not {one!r}")
    names = _names(measures)
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise Refused(f"{twice} is asked for twice; name each metric once")
    return measures


def _names(measures: Iterable[Measure]) -> list[str]:
    return [one if isinstance(one, str) else one.__name__ for one in measures]


def _own_sources(name: str, laws: Iterable[Any], links: Iterable[str]) -> str:
    """A digest of the scene file, laws and replayed links that are the user's own; the others go by the version."""
    scene = Path(name).absolute() if name.endswith(".py") else None
    texts = [] if scene is None else [file_digest(scene)]
    own_laws = [law for law in laws if not is_built_in(law)]
    texts += [file.digest for file in map(own_file, map(type, own_laws)) if file is not None and file.path != scene]
    functions = [getattr(type(law), end) for law in own_laws for end in ENDS if hasattr(type(law), end)]
    for part in functions:
        texts += sources([part])
    texts += links
    return digest(texts) if texts else ""


def carry_out(plan: Sweep, *, executor: Executor | None = None, workers: int | None = None,
              out: Path | str | None = None, show: Show | None = None, mended: Sequence[str] = (),
              chunk: int | None = None) -> Table:
    """Run what is not done yet of a sweep, see `sweep`. `chunk`: rows of a job, for one whose rows are known to be
    short; left out, as many as take about `CHUNK` seconds. Raises `Refused`.
    """
    most = cores() if workers is None else check_count("workers", workers)
    total, definition = len(plan.grid), plan.definition()
    _check_mended(mended, definition.get(METRIC_SOURCES, ()))
    store = None if out is None else Store.open(Path(out), definition, mended)
    builder = TableBuilder(plan.grid.knobs, tuple(_names(plan.measures)))
    try:
        done = 0 if store is None else len(store.done)
        if show is not None:
            show(done, total)
        waiting = iter(range(total)) if store is None else chain.from_iterable(store.done.gaps(total))
        for finished in _chunks(plan, waiting, total - done, executor, most, chunk):
            plan.ran.update(finished.ran)
            if store is not None:
                store.append(finished.rows)
            else:
                builder.extend(finished.rows)
            done += len(finished.rows)
            if show is not None:
                show(done, total)
            if finished.mistake is not None:
                raise finished.mistake.error
        return builder.table() if store is None else store.table()
    finally:
        if store is not None:
            store.close()


def _check_mended(mended: Sequence[str], names: Iterable[str]) -> None:
    if isinstance(mended, str):
        raise Refused(f"mended is a list of names, not {mended!r}; write mended=[{mended!r}]")
    for name in mended:
        if name not in names:
            raise Refused(f"mended names {name!r}, which is no function among the metrics; leave it out")


def _chunks(plan: Sweep, waiting: Iterator[int], left: int, executor: Executor | None, most: int,
            chunk: int | None) -> Iterator[ChunkResult]:
    """Jobs handed out as workers get free, of `chunk` rows or about as long as `CHUNK`, and what comes back.

    Towards the end, with `left` rows to be handed out, they get shorter, so that all workers end together. `most`: of
    these at a time, where the executor does not say how many it has.
    """
    pool, is_own, workers_of = _pool(executor, most)
    stop = Event()
    stop_check = (stop.is_set,) if executor is None else ()  # others may be in other processes
    each, size = 0.0, chunk or 1  # s a row, rows of the last chunk
    running: dict[Future[ChunkResult], None] = {}  # in the order in which they were handed out
    complete = False
    try:
        while True:
            while len(running) < 2 * (workers := workers_of()):
                if each > 0.0 and chunk is None:  # rows to come may cost more: grow step by step
                    size = max(1, min(LARGEST, int(CHUNK / each), 4 * size, left // (2 * workers)))
                    size -= size % 8 if size > 8 else 0  # as many as an engine may run side by side
                job = _job(plan, list(islice(waiting, size)))
                if not job.rows:
                    break
                left -= len(job.rows)
                plan.workers = max(plan.workers, workers)
                running[pool.submit(work, job, *stop_check)] = None
            if not running:
                complete = True
                return
            ended = wait(running, POLL, FIRST_COMPLETED).done
            for future in sorted([one for one in running if one in ended], key=_ends_the_sweep):
                del running[future]
                done = future.result()
                spent = done.seconds / max(1, len(done.rows))
                each = max(spent, each / 8.0)  # the first may have compiled
                yield done
    finally:
        stop.set()
        for future in running:
            future.cancel()
        if is_own:  # a job that compiles cannot be stopped: it ends by itself, and what it has compiled is kept
            pool.shutdown(wait=complete, cancel_futures=True)


def _ends_the_sweep(future: Future[ChunkResult]) -> bool:
    """True if a job has failed: the rows of others that have come are taken before it."""
    return future.exception() is not None or future.result().mistake is not None


def cores() -> int:
    """The number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _pool(executor: Executor | None, workers: int) -> tuple[Executor, bool, Callable[[], int]]:
    """The executor that jobs are handed to, whether it is to be shut down after them, and how many workers it has."""
    if executor is None:
        return ThreadPoolExecutor(workers), True, lambda: workers
    if type(executor).__module__.startswith("distributed."):
        from teleop.sweeps.cluster import Cluster

        cluster = Cluster(executor)
        return cluster, True, cluster.threads  # the client that it is of stays open
    threads: Callable[[], int] | None = getattr(executor, "threads", None)  # of a cluster, whose workers come and go
    return executor, False, threads or (lambda: workers)


def _job(plan: Sweep, numbers: list[int]) -> Job:
    return Job(plan.scene, dict(plan.fixed), plan.grid.rows(numbers), plan.measures, plan.engine, plan.files)
