"""Parts common to the rivals, and our own engine beside them."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from teleop.bench.laws import kernel_of
from teleop.bench.sweep import wall_seconds
from teleop.errors import Refused
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene

ROWS = 64  # of ours; numpy is given the batch that suits it best


class Absent(Refused):
    """A rival that cannot be measured here, and what to do about it."""


class Rival(NamedTuple):
    """A rival that is ready to be timed."""

    what: str
    bound: int  # times ours
    steps: int  # scenario-steps of one run
    ready: Callable[[], Callable[[], Any]]  # sets a run up, which is not timed, and returns it
    error: float  # m, the greatest of x_m and x_s over a run of the canonical scene
    notes: tuple[tuple[str, str], ...] = ()


def ours() -> tuple[str, int, Callable[[], Any]]:
    """Our best engine by name, the scenario-steps of a call, and the call: rows that differ in the wall's stiffness."""
    scenes = [load_scene("canonical", k_e=float(k_e)) for k_e in stiffnesses(ROWS)]
    run = kernel_of("vector", scenes, [0] * ROWS)
    run()  # compiles
    return "vector", ROWS * scenes[0].ticks, run


def stiffnesses(count: int) -> Any:
    """The axis of the sweep: stiffnesses of the wall in N/m, the canonical one among them, first."""
    return np.concatenate([[5000.0], np.linspace(2500.0, 10000.0, count - 1)])


def exact_positions(scene: Scene) -> tuple[Any, Any]:
    """`x_m` and `x_s` (m) at the ticks of a run with exact bodies."""
    from teleop.simulation.virtual import run

    trace = run(scene).trace
    return trace["x_m"].reshape(-1), trace["x_s"].reshape(-1)


def parts(scene: Scene) -> tuple[Any, Any, Any, Any]:
    """Law, hand, wall and slave of a scene that has them."""
    assert scene.hand is not None
    assert scene.slave is not None
    return scene.law, scene.hand, scene.environments[0], scene.slave


def delay_ticks(scene: Scene) -> int:
    """The constant delay of a scene's link, each way, in whole ticks."""
    link: Any = scene.link
    return round(float(link.delay) / scene.dt)


def library(name: str, what: str) -> Any:
    """A rival's library. Raises `Absent`."""
    try:
        return import_module(name)
    except ImportError:
        raise Absent(f"{what}: pip install {name}") from None


def best_seconds(ready: Callable[[], Callable[[], Any]], times: int = 3) -> float:
    """The least of a few runs."""
    return min(wall_seconds(ready()) for _ in range(times))
