"""The cost of laws and of playing waves by their integral: live ticks, runs and kernels.

`laws`: a live tick of either end in one axis, three and six joints, and kernels beside those of `wave`. The live tick
is the end's generator by itself, `hard_wall` with its watchdog and force cap, a fresh message at every tick: the part
of a live end that is the law's, without socket and record.

`playout`: runs and kernels of each playout beside those of `zero`. The canonical scene runs over 50 ms each way, where
every playout plays the same waves, and over jitter and loss.

Only the processor's time is counted, of each law or playout in turns, and the least of all rounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from teleop.law import find_law, known_laws, messages
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.bodies import exact_bodies, reference_samples
from teleop.simulation.plan import link_plans
from teleop.simulation.prepared import prepare
from teleop.simulation.source import live_of
from teleop.simulation.structure import NAMES
from teleop.simulation.virtual import run
from teleop.sweeps.engine import kernel_maker, need_compiler
from teleop.sweeps.kernels.kernel import LinkSchedule, RowInputs, leaves, tree_of

MEASURES = ("x_err_rms", "x_err_max")


def kernel_of(engine: str, scenes: Sequence[Scene], seeds: Sequence[int]) -> Callable[[], Any]:
    """A call that runs these rows by the kernel of the first scene's structure; scenes of one link share a schedule."""
    schedules: dict[Any, LinkSchedule] = {}
    paths: dict[Any, Any] = {}
    rows = []
    for scene, seed in zip(scenes, seeds, strict=True):
        schedule = schedules.setdefault((scene.link, seed), LinkSchedule.of(link_plans(scene, seed)))
        reference = scene.hand and scene.hand.reference
        path = paths.setdefault(reference, tuple([np.asarray(axis) for axis in reference_samples(scene) or ()]))
        rows.append(RowInputs(None, leaves(tree_of(scene, exact_bodies(scene))), scene.ticks, schedule, path))
    kernel = kernel_maker(engine)(scenes[0], exact_bodies(scenes[0]), MEASURES)
    lags = [row.schedule.lags for row in rows]
    return lambda: kernel.run(rows, lags)


Row = tuple[str, str, str]
LINKS = {"50 ms": "delay(0.05)", "jitter and loss": "delay(0.05) | uniform(0.02) | bernoulli(0.1)"}
PLAYOUTS = ("zero", "integral", "integral:0.005", "energy", "scaled:0.1")
ASKED = {"integral": "asked: at most 1.5", "integral:0.005": "asked: at most 1.5"}
ROWS = {"plain": 1, "c": 1, "vector": 8}  # at once


def playout(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked)."""
    need_compiler("c")
    rows: list[Row] = []
    for engine, count in ROWS.items():
        for what, link in LINKS.items():
            calls = {name: ready(engine, name, link, count) for name in PLAYOUTS}
            least = dict.fromkeys(PLAYOUTS, float("inf"))
            for call in calls.values():
                call()
            for _ in range(4 * rounds):
                for name, call in calls.items():
                    least[name] = min(least[name], seconds(call))
            ticks = count * load_scene("canonical").ticks
            rows += [(f"{engine}, {what}: zero", f"{least['zero'] / ticks * 1e9:.1f} ns a tick", ""),
                     *((f"  {name}", f"{least[name] / least['zero']:.2f} times", ASKED.get(name, ""))
                       for name in PLAYOUTS[1:])]
    return rows


def ready(engine: str, name: str, link: str, count: int) -> Callable[[], Any]:
    """A call that runs `count` rows of a playout."""
    scenes = [load_scene("canonical", playout=name, link=link, k_e=5000.0 + 10.0 * n) for n in range(count)]
    if engine == "plain":
        return lambda: run(scenes[0])
    return kernel_of(engine, scenes, [1] * count)


def seconds(call: Callable[[], Any]) -> float:
    """Processor time of a call, s."""
    began = time.process_time()
    call()
    return time.process_time() - began


TICKS = 2000
LEAST = {1: "asked: at most 10", 3: "asked: at most 25"}
JOINTS = ("pp", "four_channel", "wave", "tdpa")  # laws of the scene leader_follower
SIDE = {"c": 1, "vector": 8}  # rows at once


def laws(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked)."""
    need_compiler("c")
    names = ["wave", *[name for name in known_laws() if name != "wave" and hasattr(find_law(name), "master")]]
    rows: list[Row] = []
    for axes, bound in LEAST.items():
        ends = {(name, e): ticks(replace(load_scene("hard_wall", law=name), axes=axes, environment=None), e)
                for name in names for e in NAMES}
        took = least(ends, rounds)
        for name in names:
            each = " / ".join(f"{took[name, e] / TICKS * 1e6:.1f}" for e in NAMES)
            rows.append((f"{name}: live tick in {axes} {'axis' if axes == 1 else 'axes'}, master / slave", f"{each} us",
                         bound))
    rows += joints(rounds)
    for engine, count in SIDE.items():
        calls = {name: kernel_of(engine, [load_scene("canonical", law=name, playout="zero", k_e=5e3 + n) for n in
                                          range(count)], [1] * count) for name in names}
        took_kernel = least(calls, rounds)
        rows += [(f"{name}: {engine}, over wave", f"{took_kernel[name] / took_kernel['wave']:.2f} times",
                  "asked: at most 2.2" if name == "tdpa" and engine == "c" else "asked: at most 2")
                 for name in names[1:]]
    return rows


def joints(rounds: int) -> list[Row]:
    """A live tick of six joints with a law for each: with all stages, and without ledgers, watchdog and caps."""
    scenes = {name: load_scene("leader_follower", law=name) for name in JOINTS}
    calls = {(name, bare, e): ticks(replace(scene, energy=False, watchdog=None, cap=None) if bare else scene, e)
             for name, scene in scenes.items() for bare in (False, True) for e in NAMES}
    took = least(calls, rounds)
    return [(f"{name}: live tick of six joints{', the law alone' * bare}, master / slave",
             " / ".join(f"{took[name, bare, e] / TICKS * 1e6:.1f}" for e in NAMES) + " us",
             "" if bare else "asked: at most 40") for name in JOINTS for bare in (False, True)]


def least(calls: dict[Any, Callable[[], Any]], rounds: int) -> dict[Any, float]:
    """The least processor time of each call, s; the calls in turns."""
    seconds_of = dict.fromkeys(calls, float("inf"))
    for call in calls.values():
        call()  # the first compiles
    for _ in range(3 * rounds):
        for key, call in calls.items():
            seconds_of[key] = min(seconds_of[key], seconds(call))
    return seconds_of


def ticks(scene: Scene, e: str) -> Callable[[], None]:
    """A call that runs `TICKS` ticks of a live end, with another motion and message at each."""
    prepared, law = prepare(scene), scene.law
    forth, back = messages(scene.laws[0])
    heard = back if e == "m" else forth
    make, axes = live_of(scene, e), range(scene.axes)
    inputs = []
    for k in range(TICKS):
        a = 1e-3 * ((7 * k) % 101 - 50)
        each = tuple([a] * scene.axes)
        rx = tuple([heard(*[a] * len(heard._fields)) for _ in axes])
        inputs.append((k, each, each, each, True, k, rx, None, 1.0, tuple([0.5 * a] * scene.axes), 1, 0.0, 1.0))

    def call() -> None:
        zero = tuple([0.0] * scene.axes)
        end = make(prepared.numbers, law, scene.dt, zero, zero, zero)
        next(end)
        send = end.send
        for each in inputs:
            send(each)

    return call
