"""What a law costs: a live tick of either end in one axis, three and six joints, and kernels beside those of `wave`.

The live tick is the end's generator by itself, `hard_wall` with its watchdog and force cap, a fresh message at every
tick: what of a live end is the law's, without socket and record. Only the processor's time is counted, of each law in
turns, and the least of all rounds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from teleop.bench.kernels import kernel_of
from teleop.bench.playout import seconds
from teleop.law import find_law, known_laws, messages
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.prepared import prepare
from teleop.simulation.source import live_of
from teleop.simulation.structure import NAMES

Row = tuple[str, str, str]
TICKS = 2000
LEAST = {1: "asked: at most 10", 3: "asked: at most 25"}
JOINTS = ("pp", "four_channel", "wave", "tdpa")  # laws of the scene leader_follower
SIDE = {"scalar": 1, "vector": 8}  # rows at once


def laws(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked)."""
    from teleop.sweeps.kernels.compiled import need_numba

    need_numba("scalar")
    names = ["wave", *[name for name in known_laws() if name != "wave" and hasattr(find_law(name), "master")]]
    rows: list[Row] = []
    for axes, asked in LEAST.items():
        ends = {(name, e): ticks(replace(load_scene("hard_wall", law=name), axes=axes, environment=None), e)
                for name in names for e in NAMES}
        took = least(ends, rounds)
        for name in names:
            each = " / ".join(f"{took[name, e] / TICKS * 1e6:.1f}" for e in NAMES)
            rows.append((f"{name}: live tick in {axes} {'axis' if axes == 1 else 'axes'}, master / slave", f"{each} us",
                         asked))
    rows += joints(rounds)
    for engine, count in SIDE.items():
        calls = {name: kernel_of(engine, [load_scene("canonical", law=name, playout="zero", k_e=5e3 + n) for n in
                                          range(count)], [1] * count) for name in names}
        took_kernel = least(calls, rounds)
        rows += [(f"{name}: {engine}, over wave", f"{took_kernel[name] / took_kernel['wave']:.2f} times",
                  "asked: at most 2.2" if name == "tdpa" and engine == "scalar" else "asked: at most 2")
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
    found = dict.fromkeys(calls, float("inf"))
    for call in calls.values():
        call()  # the first compiles
    for _ in range(3 * rounds):
        for key, call in calls.items():
            found[key] = min(found[key], seconds(call))
    return found


def ticks(scene: Scene, e: str) -> Callable[[], None]:
    """A call that runs `TICKS` ticks of a live end, with another motion and message at each."""
    prepared, law = prepare(scene), scene.law
    forth, back = messages(scene.laws[0])
    heard = back if e == "m" else forth
    make, axes = live_of(scene, e), range(scene.axes)
    given = []
    for k in range(TICKS):
        a = 1e-3 * ((7 * k) % 101 - 50)
        each = tuple([a] * scene.axes)
        rx = tuple([heard(*[a] * len(heard._fields)) for _ in axes])
        given.append((k, each, each, each, True, k, rx, None, 1.0, tuple([0.5 * a] * scene.axes), 1, 0.0, 1.0))

    def call() -> None:
        zero = tuple([0.0] * scene.axes)
        end = make(prepared.numbers, law, scene.dt, zero, zero, zero)
        next(end)
        send = end.send
        for each in given:
            send(each)

    return call

