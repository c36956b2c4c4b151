"""What a robot in MuJoCo costs: a tick of two endpoints in one process, and of the robot by itself; and its contact.

Needs the extra `mujoco`. Times are of the processor, so that others at work there count less; the rows of a round are
measured one after the other.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import Any

from teleop.live.devices.opening import find_device
from teleop.live.in_process import run_stepped
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.virtual import run

Row = tuple[str, str, str]
TICKS = 2000


def mujoco(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked): medians over the rounds, us a tick, and over that of `teleop run`."""
    one, three = load_scene("hard_wall", duration=2.0), load_scene("arm", duration=2.0)
    parts: dict[str, tuple[Callable[[], float], str]] = {
        "`teleop run`, one axis": (lambda: _loop(run(one, clock=time.process_time_ns)), ""),
        "two endpoints in one process, simulated slave, one axis": (
            lambda: _loop(_stepped(one, "simulated")), "a trial had 38"),
        "two endpoints in one process, MuJoCo's arm, one axis": (
            lambda: _loop(_stepped(one, "mujoco")), "a trial had 65 to 74"),
        "  in three axes, simulated slave": (lambda: _loop(_stepped(three, "simulated")), ""),
        "  in three axes, MuJoCo's arm": (lambda: _loop(_stepped(three, "mujoco")), ""),
        "the arm by itself, read and hold, three axes, in the air": (lambda: _robot(three, (0.0, 0.0, 0.0)), ""),
        "  pressed against the wall": (lambda: _robot(three, (5.0, 0.0, 0.0)), ""),
        "  of these MuJoCo's own four sub-steps, in the air": (lambda: _steps(three), "a trial had 16"),
    }
    took: dict[str, list[float]] = {name: [] for name in parts}
    opened = []
    for _ in range(rounds):
        for name, (measure, _) in parts.items():
            took[name].append(measure())
        began = time.process_time()
        robot: Any = find_device("s", "mujoco").open(three)
        opened.append(time.process_time() - began)
    base = took["`teleop run`, one axis"]
    over = {name: median(each / one for each, one in zip(took[name], base, strict=True)) for name in parts}
    return [*[(name, f"{median(took[name]):.1f} us, {over[name]:.1f} times", asked)
              for name, (_, asked) in parts.items()],
            ("a robot loaded, and pressed for its stiffness", f"{1e3 * median(opened):.0f} ms", ""),
            *[(text, "", "") for text in robot.notes]]


def _stepped(scene: Scene, robot: str) -> Any:
    make = {"m": find_device("m", "simulated").open, "s": find_device("s", robot).open}
    return run_stepped(scene, make, clock=time.process_time_ns)


def _loop(result: Any) -> float:
    return float(result.run_time / result.ticks * 1e6)


def _robot(scene: Scene, force: tuple[float, ...]) -> float:
    """The time (us) of a read and a hold."""
    robot = find_device("s", "mujoco").open(scene)
    for k in range(TICKS):  # until it has come to rest where it presses
        robot.hold(force)
        robot.read(k)
    began = time.process_time()
    for k in range(TICKS, 2 * TICKS):
        robot.hold(force)
        robot.read(k)
    return (time.process_time() - began) / TICKS * 1e6


def _steps(scene: Scene) -> float:
    """The time (us) of the sub-steps of a tick alone."""
    from mujoco import mj_step  # type: ignore[import-not-found,import-untyped,unused-ignore]  # an extra without types

    robot: Any = find_device("s", "mujoco").open(scene)
    model, data = robot._model.model, robot._body.data
    began = time.process_time()
    for _ in range(TICKS):
        mj_step(model, data, robot._model.substeps)
    return (time.process_time() - began) / TICKS * 1e6
