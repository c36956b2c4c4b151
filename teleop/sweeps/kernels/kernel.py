"""A scene's loop with running figures in place of a record: run as it is, or compiled.

It is `teleop.simulation.tick` and the functions that it names, so a sweep runs the very lines that a single run and a
live end run, in the same order, and gives the same bits. What is compiled is each of these functions
as it stands; fast-math is off, so every engine agrees with plain Python to the last bit.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import lru_cache
from math import isfinite
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from teleop.errors import Refused
from teleop.law import law_name
from teleop.law.contract import attempt
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies, reference_samples
from teleop.simulation.felt import AT_END, AT_REST, OF_SLAVE, Basis, frame_of, resting
from teleop.simulation.felt import figures as summed
from teleop.simulation.metrics import energy_out
from teleop.simulation.plan import Plan, link_plans, median_age
from teleop.simulation.rest import Still
from teleop.simulation.source import Lines, functions, lines
from teleop.simulation.structure import numbers_of, record, structure_of
from teleop.simulation.tick import loop
from teleop.stages.end import RunHas
from teleop.sweeps.kernels.figures import (
    KEPT,
    MAGNITUDES,
    SWINGS,
    LaneFigures,
    RunningFigures,
    accumulators,
    layout,
    magnitude_of,
)


class NotCompiled(Exception):
    """Why a structure of scene has no compiled kernel."""


class NotVectorised(NotCompiled):
    """Why a structure of scene has no kernel over lanes."""


class RowInputs(NamedTuple):
    """Inputs of a kernel for one row."""

    tree: Any  # its numbers, see `tree_of`
    flat: Leaves | None  # the same laid out flat, for compiled code
    ticks: int
    schedule: LinkSchedule
    path: Any  # of the hand: lists for plain Python, arrays for compiled code
    still: Still | None = None  # how its end is looked at; the kernel then gives `SWINGS`
    frame: Basis | None = None  # what of its scene the sums go by; left out, as of the scene that the kernel is made of

    @property
    def windows(self) -> tuple[int, int, int]:
        """The first tick of the late windows, the ticks of each, and the first tick of the last `END`.

        Past the end where there are none.
        """
        last = self.ticks if self.frame is None else self.ticks - self.frame.last
        return (self.ticks, 1, last) if self.still is None else (self.still.first(self.ticks), self.still.window, last)


class KernelOutput(NamedTuple):
    """The output of a kernel for one row."""

    ran: int  # ticks; below zero if it left the bounds in the last of them
    figures: tuple[float, ...]  # what the kernel gives, and 1.0 if all is finite


class Kernel(NamedTuple):
    """A loop made for one structure of scene."""

    engine: str
    measures: tuple[str, ...]  # the figures that are asked of it
    gives: tuple[str, ...]  # the figures and sums that it gives, in order
    frame: Basis  # of the scene that it is made of
    run: Callable[[Sequence[RowInputs], Sequence[tuple[int, int]]], list[KernelOutput]]  # of rows and their lags
    width: int = 1  # rows that it runs at once
    why: str = ""  # it runs them, where another engine was asked for
    fallback: Callable[[str], Kernel] | None = None  # makes, with a reason, the kernel of rows that this one cannot run


def available(scene: Scene) -> frozenset[str]:
    """The figures that a kernel of this scene can give."""
    structure = structure_of(scene)
    return _available(structure.has, structure.m.has_stage("watchdog"))


@lru_cache(maxsize=256)
def _available(has: RunHas, watchdog: bool) -> frozenset[str]:
    offered = {"waves": has.waves, "energy": has.energy, "stored": has.stored, "watchdog": watchdog,
               "told": has.deadband}
    named = {name for name, what in KEPT.items()
             if name not in AT_REST and all(offered.get(each, True) for each in what)}
    of_slave = {"x_err_rms", "x_err_max", "f_err_rms", "f_err_max", "f_s_max", "f_env_max", "g_s_min"}
    return frozenset(named if has.slave else named - of_slave - OF_SLAVE)


def kernel_lines(scene: Scene, measures: Sequence[str], *, engine: str = "plain") -> Lines:
    """The lines of a scene's loop that work out `measures` as they go, and at the end whether all is finite."""
    structure = structure_of(scene)
    kinds = {each for name in measures for each in accumulators(name)}
    m, s = [end._replace(has=end.has._replace(felt=end.has.felt or bool(kinds & felt))) for end, felt in (
        (structure.m, {"f_h_max"}), (structure.s, {"f_err", "f_env_max", "free", "f_env", "touch"}))]
    return lines(structure._replace(m=m, s=s), loop, LaneFigures if engine == "vector" else RunningFigures,
                 (structure.axes, structure.has, layout(measures, scene.ticks)), engine=engine)


def gives(scene: Scene, measures: Sequence[str]) -> tuple[str, ...]:
    """The figures and sums that a kernel gives for these measures, in order."""
    return layout(measures, scene.ticks).names(scene.axes)


def functions_of_kernel(scene: Scene, bodies: Bodies) -> dict[str, Any]:
    """The functions of a scene's law, devices and bodies that the lines of its kernel find by name."""
    return {**functions(scene), **bodies.functions(), "magnitude": MAGNITUDES.get(scene.axes, magnitude_of)}


def names_of(scene: Scene, bodies: Bodies, made: Lines | None = None) -> dict[str, Any]:
    """Names that the lines of a kernel use, with their functions."""
    return (made or kernel_lines(scene, ())).names(functions_of_kernel(scene, bodies))


def plain_kernel(scene: Scene, bodies: Bodies, measures: Sequence[str]) -> Kernel:
    """The kernel in plain Python."""
    own_loop = kernel_lines(scene, measures).function(functions_of_kernel(scene, bodies))

    def run(rows: Sequence[RowInputs], lags: Sequence[tuple[int, int]]) -> list[KernelOutput]:
        outputs = []
        for row, lag in zip(rows, lags, strict=True):
            numbers, law, dt, x_limit, start_m, start_s, held = row.tree
            size = max(row.schedule.size, 1 + max(lag))
            fwd, bwd = [None if plan is None else plan.orders.tolist() for plan in row.schedule.plans]
            outputs.append(KernelOutput(*attempt(
                law, own_loop, numbers, law, dt, row.ticks, x_limit, start_m, start_s, bwd, fwd, size,
                row.path, held, (*lag, *row.windows))))
        return outputs

    return Kernel("plain", tuple(measures), gives(scene, measures), frame_of(scene), run)


def has_packets(plan: Plan | None) -> bool:
    """True if a plan is of packets; the plan of a one-port scene has the skipped ticks alone."""
    return plan is not None and plan.sent > 0


class LinkSchedule(NamedTuple):
    """The link of a row, drawn up front: what rows with the same link, seed and clock share."""

    plans: tuple[Plan | None, Plan | None]  # fwd, bwd
    plays: tuple[Any, Any]  # the packets played, as arrays
    orders: tuple[Any, Any]  # what the loop is told of them
    lags: tuple[int, int]
    size: int  # of a ring of messages

    @classmethod
    def of(cls, plans: tuple[Plan | None, Plan | None]) -> LinkSchedule:
        """Schedule of two plans."""
        plays = tuple([np.zeros(0, np.int64) if plan is None else plan.played_at for plan in plans])
        lags = tuple([median_age(play) if has_packets(plan) else 1 for plan, play in zip(plans, plays, strict=True)])
        orders = tuple([play if plan is None else plan.orders for plan, play in zip(plans, plays, strict=True)])
        size = max((plan.reach for plan in plans if plan is not None), default=0) + 1
        return cls(plans, plays, orders, lags, size)  # type: ignore[arg-type]  # there are two

    def lags_until(self, ran: int) -> tuple[int, int]:
        """Lags of a run that ended early."""
        if ran == len(self.plays[0]):
            return self.lags
        fwd, bwd = [median_age(play[:ran]) if has_packets(plan) else 1 for plan, play in
                       zip(self.plans, self.plays, strict=True)]
        return fwd, bwd


def tree_of(scene: Scene, bodies: Bodies, *, compiled: bool = True) -> tuple[Any, ...]:
    """The numbers of a row, as the loop is given them."""
    starts = {e: scene.vector(f"start_{e}", getattr(scene, f"start_{e}")) for e in ("m", "s")}
    law = scene.law
    if compiled:
        law = tuple(map(_numbers_of_law, law)) if isinstance(law, tuple) else _numbers_of_law(law)
    return (numbers_of(scene, starts), law, scene.dt_ns / 1e9, scene.x_limit, starts["m"], starts["s"],
            bodies.numbers())


def _numbers_of_law(law: Any) -> Any:
    """A law as compiled code is given it."""
    names = tuple([field.name for field in fields(law)])
    try:
        return record("Law", names)(*[float(getattr(law, name)) for name in names])
    except (TypeError, ValueError):
        odd = next(name for name in names if type(getattr(law, name)) not in (float, int, bool))
        raise NotCompiled(f"law {law_name(law)} has {odd}={getattr(law, odd)!r}, which is no number") from None


def figures(kernel: Kernel, rows: Sequence[RowInputs]) -> list[tuple[str, int, dict[str, float]]]:
    """Status, ticks and figures of rows; a figure that is not finite is left out, as in a single run.

    Where the kernel gives the swings of the late windows, the status is that of `Still`, and of a run that came to its
    end `swing_end` is a figure.
    """
    rows = [row if row.frame is not None else row._replace(frame=kernel.frame) for row in rows]
    lags = [row.schedule.lags for row in rows]
    outputs = kernel.run(rows, lags)
    # The lag of a run that ended early is that of the messages which came until then.
    early_lags = {i: rows[i].schedule.lags_until(-output.ran) for i, output in enumerate(outputs) if output.ran < 0}
    # Its last ticks are others too.
    if any(group in AT_END for name in kernel.measures for group in accumulators(name)):
        for i, lag in early_lags.items():
            if outputs[i].ran != -rows[i].ticks:
                outputs[i], = kernel.run([rows[i]._replace(ticks=-outputs[i].ran)], [lag])
    elif again := [i for i, lag in early_lags.items() if lag != lags[i]]:
        anew = kernel.run([rows[i] for i in again], [early_lags[i] for i in again])
        for i, output in zip(again, anew, strict=True):
            outputs[i] = output
    results = []
    for row, output in zip(rows, outputs, strict=True):
        status = "ok" if output.ran >= 0 and output.figures[-1] == 1.0 else "diverged"
        values = dict(zip(kernel.gives, output.figures[:-1], strict=True))
        named = {name: values[name] for name in kernel.measures if name in values and name not in SWINGS}
        if "energy_out" in kernel.measures:
            named["energy_out"] = energy_out(values["E_port_min"])
        ran, frame = abs(output.ran), row.frame or kernel.frame
        named |= summed(kernel.measures, values, frame, ran, min(frame.last, ran))
        if row.still is not None and status == "ok":
            swings = [values[name] for name in SWINGS]
            status, named["swing_end"] = row.still.status(swings, sum(row.schedule.lags)), swings[-1]
            named |= resting(kernel.measures, values, frame, status)
        known = {name: float(value) for name, value in named.items() if isfinite(value)}
        results.append((status, abs(output.ran), known))
    return results


FLOATS = {float}
_SHAPES: dict[Any, Any] = {}  # one of each, however many rows have it


class Leaves(NamedTuple):
    """A tree taken apart."""

    shape: tuple[Any, ...]  # "(", ")", "i", "a", so many floats, and the class of each NamedTuple in place of its "("
    reals: array[float]
    wholes: list[int]
    arrays: list[Any]


def leaves(tree: Any) -> Leaves:
    """A tree taken apart. A list is an array; None the whole number 0: what a kernel is given and does not name."""
    flat = Leaves((), array("d"), [], [])
    shape: list[Any] = []
    _take(tree, shape, *flat[1:])
    kind = tuple(shape)
    return Leaves(_SHAPES.setdefault(kind, kind), *flat[1:])


def _take(tree: Any, shape: list[Any], reals: array[float], wholes: list[int], arrays: list[Any]) -> None:
    if isinstance(tree, tuple):
        shape.append(type(tree) if hasattr(tree, "_fields") else "(")
        if set(map(type, tree)) == FLOATS:  # nearly always
            shape.append(len(tree))
            reals.extend(tree)
        else:
            for each in tree:
                _take(each, shape, reals, wholes, arrays)
        shape.append(")")
    elif isinstance(tree, float):
        shape.append(1)
        reals.append(float(tree))
    elif isinstance(tree, list):
        shape.append("a")
        arrays.append(np.asarray(tree))
    else:
        shape.append("i")
        wholes.append(0 if tree is None else int(tree))


TICKS = 4_000_000  # of schedules and paths, about: 64 MB

_HELD: dict[Any, tuple[Any, int]] = {}  # what was made, and for how many ticks
_KEEPING = Lock()


class Schedules:
    """The link of some rows: what a seed makes of it, drawn when it is asked for."""

    __slots__ = ("_key", "_scene", "_seed")

    def __init__(self, key: Any, scene: Scene, seed: int) -> None:
        self._key, self._scene, self._seed = key, scene, seed

    @property
    def dt(self) -> float:
        """The tick, s."""
        return self._scene.dt_ns / 1e9

    def schedule(self) -> LinkSchedule:
        """The packets played at each tick. Raises `Refused` where the link does."""
        return _once(self._key, self._scene.ticks, lambda: LinkSchedule.of(link_plans(self._scene, self._seed)))  # type: ignore[no-any-return]


def schedules_key(scene: Scene, seed: int) -> Any:
    """Key that tells the schedules of a row from other rows'."""
    left_out = scene.left_out_m, scene.left_out_s
    if scene.link is None and left_out == (None, None) and scene.deadband is None:
        return "no link", scene.ticks, scene.dt_ns
    key = scene.link, scene.played_as, seed, scene.ticks, scene.dt_ns, scene.wire_size, left_out, (
        scene.slave is None, scene.deadband is None)
    try:
        hash(key)
    except TypeError:  # a link of the user's own that has no hash
        return id(scene.link), key[2:6], object()
    return key


def path_of(scene: Scene, *, compiled: bool) -> Any:
    """The hand's path, as lists for plain Python and as arrays for compiled code."""
    if scene.reference is None:
        return () if compiled else None

    def make() -> Any:
        path = reference_samples(scene) or ()
        if len(path) != scene.axes or any(len(axis) <= scene.ticks for axis in path):
            raise Refused(f"the hand's path has not the {scene.ticks + 1} samples for each of {scene.axes} axes that "
                          "it was asked for; see its samples(axes, count, dt_ns)")
        return tuple([np.ascontiguousarray(axis, dtype=np.float64) for axis in path]) if compiled else path

    return _once(("path", scene.reference, scene.axes, scene.ticks, scene.dt_ns, compiled), scene.ticks, make)


def _once(key: Any, ticks: int, make: Callable[[], Any]) -> Any:
    """Call `make` once for a key and keep its result; the oldest is dropped. A key without a hash is made anew."""
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
