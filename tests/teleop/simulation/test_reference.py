"""The tick as it stands is the reference: what is made of it gives the same numbers, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from teleop.laws.direct import Direct
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.felt import frame_of
from teleop.simulation.plan import link_plans
from teleop.simulation.prepared import prepare
from teleop.simulation.source import RowRecorder, bind, functions, live_of, loop_of
from teleop.simulation.structure import live_structure, numbers_of, run_of, structure_of
from teleop.simulation.tick import live, loop
from teleop.stages.end import Recorder
from teleop.stages.force_cap import Cap
from teleop.stages.watchdog import Watchdog
from teleop.sweeps.kernels import figures as running
from teleop.sweeps.kernels.kernel import (
    LinkSchedule,
    RowInputs,
    available,
    functions_of_kernel,
    kernel_lines,
    plain_kernel,
    tree_of,
)
from tests.teleop.simulation.lanes import WIDTH, WORDS, lane_by_lane, side_by_side

SCENES = {
    "waves": lambda: replace(load_scene("canonical"), energy=True),
    "a link that loses, a watchdog and caps": lambda: load_scene("hard_wall", link="delay(0.02) | bernoulli(0.2)"),
    "sums over two axes": lambda: replace(
        load_scene("hard_wall", law="pfra"), axes=2, environment=(load_scene("hard_wall").environments[0], None)),
    "a device": lambda: load_scene("encoder_wall"),
    "a device with all there is": lambda: load_scene("virtual_wall", cap=0.8, f_max=3),
    "an inner state": lambda: load_scene("relaxing_tissue"),
    "ticks that are left out": lambda: replace(
        load_scene("canonical", law="pfra", link="delay(0.02) | bernoulli(0.2)", left_out=0.2), energy=True,
        watchdog=Watchdog(timeout=0.01), cap=Cap(f_max=9.0, slew=2000.0, power=0.05)),
    "no hand, no link": lambda: replace(load_scene("canonical", law=Direct(kf=0.3)), hand=None, link=None),
}


def arguments(scene: Scene, rows: dict[str, list[float]]) -> tuple[Any, ...]:
    """What a loop is given for 200 ticks."""
    ready = prepare(scene)
    fwd, bwd = link_plans(scene, 3)
    size = 1 + max((plan.lag for plan in (fwd, bwd) if plan is not None), default=0)
    return (ready.numbers, scene.law, scene.dt_ns / 1e9, scene.ticks, scene.x_limit, ready.starts["m"],
            ready.starts["s"],
            bwd and bwd.play, fwd and fwd.play, size, ready.reference, ready.bodies.numbers(),
            (rows["m"].extend, rows["s"].extend))


@pytest.mark.parametrize("name", SCENES)
def test_the_specialised_loop_gives_the_bits_of_the_tick_as_it_stands(name: str) -> None:
    scene = replace(SCENES[name](), duration=0.2)
    bodies = prepare(scene).bodies
    made: dict[str, list[float]] = {"m": [], "s": []}
    told = loop_of(scene, bodies)(*arguments(scene, made))
    run = run_of(structure_of(scene), RowRecorder())
    bind(run, {**functions(scene), **bodies.functions()})
    stood: dict[str, list[float]] = {"m": [], "s": []}
    assert loop(run, *arguments(scene, stood)) == told
    assert repr(stood) == repr(made)
    assert len(made["m"]) > 200


@pytest.mark.parametrize("e", ["m", "s"])
def test_so_does_a_live_end(e: str) -> None:
    scene = load_scene("hard_wall", law="pfra")
    run = run_of(live_structure(structure_of(scene), e), Recorder())
    bind(run, functions(scene))
    numbers = numbers_of(scene, {e: (0.0,)})
    beginning: tuple[Any, ...] = (numbers, scene.law, 1e-3, (0.0,), (0.0,), (0.0,))
    made, stood = live_of(scene, e)(*beginning), live(run, getattr(run, e), *beginning)
    next(made)
    next(stood)
    for k, missed in ((0, 1), (1, 1), (5, 4), (6, 1)):
        sent = (k, (0.01 * k,), (0.1,), (0.3,), False, -1, None, None, 1.0 if missed == 1 else 0.0, (0.2,), missed,
                0.0, 1.0)
        assert repr(made.send(sent)) == repr(stood.send(sent))


@pytest.mark.parametrize("left_out", [0.0, 0.2])
def test_lines_for_eight_scenes_run_in_plain_python_and_give_the_bits_of_each(left_out: float) -> None:
    scenes = [replace(load_scene("soft_tissue", law=Direct(K=100.0 + 10.0 * i, B=2.0), left_out=left_out),
                      duration=0.05, x_limit=limit)
              for i, limit in enumerate([1e6] * 6 + [1e-4, 2e-3])]
    first = scenes[0]
    ready = [prepare(scene) for scene in scenes]
    measures = tuple(sorted(available(first)))
    rows = [RowInputs(tree_of(scene, own.bodies, compiled=False), None, scene.ticks,
                      LinkSchedule.of(link_plans(scene, 0)),
                   own.reference, None, frame_of(scene)) for scene, own in zip(scenes, ready, strict=True)]
    lags = [row.schedule.lags for row in rows]
    alone = plain_kernel(first, ready[0].bodies, measures).run(rows, lags)
    made = kernel_lines(first, measures, engine="vector")
    names = {**made.names(functions_of_kernel(first, ready[0].bodies)), **WORDS}
    for word, function in names.items():
        if getattr(function, "__module__", "") == running.__name__:  # they branch
            names[word] = lane_by_lane(function)
    exec(made.code, names)
    given, law, dt, x_limit, start_m, start_s, held = side_by_side([row.tree for row in rows])
    out: list[Any] = [None] * WIDTH
    schedule = rows[0].schedule
    bwd, fwd = schedule.plans[1], schedule.plans[0]
    names["loop"](given, law, dt, first.ticks, x_limit, start_m, start_s, bwd and bwd.play, fwd and fwd.play,
                  64, ready[0].reference, held, (*schedule.lags, out, *rows[0].windows))
    assert [(ran, tuple(map(repr, figures))) for ran, figures in out] == [
        (each.ran, tuple(map(repr, each.figures))) for each in alone]
    assert {ran < 0 for ran, _ in out} == {True, False}
