"""What each engine makes of scenes of one structure, to be held to the bits of single runs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import Scene, run
from teleop.live.in_process import run_stepped
from teleop.simulation.bodies import exact_bodies, reference_samples
from teleop.simulation.felt import frame_of
from teleop.simulation.plan import link_plans
from teleop.simulation.prepared import prepare
from teleop.simulation.source import RowRecorder, bind, functions, loop_of
from teleop.simulation.structure import run_of, structure_of
from teleop.simulation.tick import loop
from teleop.sweeps.kernels.c_kernel import Form, c_kernel, kernel_text, vector_kernel
from teleop.sweeps.kernels.kernel import (
    Kernel,
    LinkSchedule,
    RowInputs,
    available,
    figures,
    leaves,
    plain_kernel,
    tree_of,
)
from tests.engines.cases import CASES
from tests.teleop.emit.printed import assert_same

MAKERS = {"plain": plain_kernel, "c": c_kernel, "alike": vector_kernel, "apart": vector_kernel}
Rows = list[tuple[str, int, dict[str, float]]]  # status, ticks and figures of each scene


@cache
def scenes_of(name: str) -> Sequence[Scene]:
    """The scenes of a case."""
    return CASES[name]()


def inputs(kernel: Kernel, of: Scene, seed: int) -> RowInputs:
    """The inputs of a kernel for one scene."""
    schedule, bodies, path = LinkSchedule.of(link_plans(of, seed)), exact_bodies(of), reference_samples(of)
    if kernel.engine == "plain":
        return RowInputs(tree_of(of, bodies, compiled=False), None, of.ticks, schedule, path, frame=frame_of(of))
    arrays = tuple(np.asarray(axis) for axis in path or ())
    return RowInputs(None, leaves(tree_of(of, bodies)), of.ticks, schedule, arrays, frame=frame_of(of))


def kernel_rows(engine: str, scenes: Sequence[Scene], *, alike: bool = False, measures: Sequence[str] = ()) -> Rows:
    """The rows of a kernel for these scenes, the seed of each its number; `alike`: all on the link and path of one."""
    kernel = MAKERS[engine](scenes[0], exact_bodies(scenes[0]), measures or sorted(available(scenes[0])))
    rows = [inputs(kernel, of, seed) for seed, of in enumerate(scenes)]
    if alike:
        rows = [row._replace(schedule=rows[0].schedule, path=rows[0].path) for row in rows]
    return figures(kernel, rows)


@cache
def plain_rows(name: str, alike: bool = False) -> Rows:
    """The rows of a case in plain Python."""
    return kernel_rows("plain", scenes_of(name), alike=alike)


def assert_as_runs(name: str) -> None:
    """Hold a kernel in plain Python to single runs."""
    scenes = scenes_of(name)
    for seed, (of, row) in enumerate(zip(scenes, plain_rows(name), strict=True)):
        single = run(of, seed=seed)
        known = {key: single.metrics[key] for key in available(scenes[0]) if key in single.metrics}
        assert row == (single.status, single.ticks, known), seed


def assert_printed(name: str) -> None:
    """Hold the ends of a case, printed as C, to what Python answers to the same inputs."""
    of = scenes_of(name)[0]
    for e in ("m", "s") if of.slave is not None else ("m",):
        with TemporaryDirectory() as folder:
            assert_same(of, e, Path(folder))


def assert_as_plain(name: str, engine: str) -> None:
    """Hold a compiled kernel to the same in plain Python, in every digit and the sign of a zero."""
    alike, offered = engine == "alike", available(scenes_of(name)[0])
    assert repr(kernel_rows(engine, scenes_of(name), alike=alike, measures=sorted(offered))) == repr(
        plain_rows(name, alike))


def one_lane_after_the_other(of: Scene) -> set[str]:
    """The functions that a kernel over lanes calls for each of them, as no lines do all of them at once."""
    text = kernel_text(of, exact_bodies(of), sorted(available(of)), Form(4))
    return set(re.findall(r"/\* (.*), one lane after the other \*/", text))


def assert_as_it_stands(name: str) -> None:
    """Hold the loop that is made of the tick to the tick as it stands."""
    of = replace(scenes_of(name)[0], duration=200 * scenes_of(name)[0].dt)
    ready, (fwd, bwd) = prepare(of), link_plans(of, 3)
    size = 1 + max((plan.reach for plan in (fwd, bwd) if plan is not None), default=0)
    orders = [plan and plan.orders.tolist() for plan in ((bwd, fwd) if of.slave else (None, None))]
    as_it_stands = run_of(structure_of(of), RowRecorder())
    bind(as_it_stands, {**functions(of), **ready.bodies.functions()})

    def call(function: Any, *first: Any) -> str:
        rows: dict[str, list[float]] = {"m": [], "s": []}
        end = function(*first, ready.numbers, of.law, of.dt_ns / 1e9, of.ticks, of.x_limit, ready.starts["m"],
                       ready.starts["s"], *orders, size, ready.reference, ready.bodies.numbers(),
                       (rows["m"].extend, rows["s"].extend))
        assert len(rows["m"]) > 200
        return repr((end, rows))

    assert call(loop_of(of, ready.bodies)) == call(loop, as_it_stands)


def assert_stepped(name: str) -> None:
    """Hold two ends with their protocol, stepped in one process, to a single run."""
    of = scenes_of(name)[0]
    stepped, single = run_stepped(of, {"m": SimulatedMaster, "s": SimulatedSlave}, seed=3), run(of, seed=3)
    assert (stepped.status, stepped.sentence, stepped.ticks, stepped.metrics, stepped.packets, stepped.notes) == (
        single.status, single.sentence, single.ticks, single.metrics, single.packets, single.notes)
    assert {key: column.tobytes() for key, column in stepped.trace.items()} == {
        key: column.tobytes() for key, column in single.trace.items() if not key.startswith(("shaft", "touch"))}
