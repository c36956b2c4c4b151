"""The cost of a run in virtual time, and of endpoints stepped in one process with a robot in MuJoCo.

`virtual`: per tick, as a whole process, in memory. The machine's own speed is measured in the same rounds by the loop
that the figure is stated with: `x = x*1.0001 + 0.5` a thousand times, about 30 us where 4 us per tick are asked for.

`mujoco`: a tick of two endpoints in one process, of the robot by itself, and its contact. It needs the extra `mujoco`.
Times are of the processor, so that others at work there count less; the rows of a round are measured one after the
other.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
import timeit
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from teleop.live.devices.opening import find_device
from teleop.live.in_process import run_stepped
from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.virtual import run

Row = tuple[str, str, str]
LOOP = "for i in range(1000): x=x*1.0001+0.5"


def virtual(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked)."""
    scene = load_scene("canonical")
    yardstick, per_tick = [], []
    for _ in range(rounds):
        yardstick.append(min(timeit.repeat(LOOP, "x=0.0", number=200, repeat=5)) / 200 * 1e6)
        took = run(scene, clock=time.perf_counter_ns).run_time
        assert took is not None
        per_tick.append(took / scene.ticks * 1e6)
    scaled = median(t * 30.0 / y for t, y in zip(per_tick, yardstick, strict=True))
    rows = [
        ("yardstick loop", f"{median(yardstick):.1f} us", ""),
        ("canonical scene, plain Python, per tick", f"{median(per_tick):.2f} us", ""),
        ("  the same where the yardstick takes 30 us", f"{scaled:.2f} us", "asked: at most 4"),
    ]
    with TemporaryDirectory() as folder:
        ours, numpys = [], []
        for i in range(2 * rounds):
            numpys.append(_seconds(["-c", "import numpy"]))
            ours.append(_seconds(["-m", "scenarios", "run", "hard_wall", "--out", str(Path(folder) / str(i))]))
    ratio = median(ours) / median(numpys)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024  # MB, since Linux counts in KiB
    rows += [
        ("`teleop run hard_wall`, whole process", f"{median(ours) * 1e3:.0f} ms", ""),
        ("  over `python -c 'import numpy'`", f"{ratio:.2f} times", "asked: at most 3.5"),
        ("  peak memory of the largest process", f"{peak:.0f} MB", "asked: at most 80"),
    ]
    return rows


def _seconds(arguments: list[str]) -> float:
    began = time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
    return time.perf_counter() - began


MUJOCO_TICKS = 2000


def mujoco(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked): medians over the rounds, us a tick, and over that of `teleop run`."""
    one, three = load_scene("hard_wall", duration=2.0), load_scene("arm", duration=2.0)
    parts: dict[str, tuple[Callable[[], float], str]] = {
        "`teleop run`, one axis": (lambda: _tick_us(run(one, clock=time.process_time_ns)), ""),
        "two endpoints in one process, simulated slave, one axis": (
            lambda: _tick_us(_stepped(one, "simulated")), "a trial had 38"),
        "two endpoints in one process, MuJoCo's arm, one axis": (
            lambda: _tick_us(_stepped(one, "mujoco")), "a trial had 65 to 74"),
        "  in three axes, simulated slave": (lambda: _tick_us(_stepped(three, "simulated")), ""),
        "  in three axes, MuJoCo's arm": (lambda: _tick_us(_stepped(three, "mujoco")), ""),
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
    return [*[(name, f"{median(took[name]):.1f} us, {over[name]:.1f} times", bound)
              for name, (_, bound) in parts.items()],
            ("a robot loaded, and pressed for its stiffness", f"{1e3 * median(opened):.0f} ms", ""),
            *[(text, "", "") for text in robot.notes]]


def _stepped(scene: Scene, robot: str) -> Any:
    make = {"m": find_device("m", "simulated").open, "s": find_device("s", robot).open}
    return run_stepped(scene, make, clock=time.process_time_ns)


def _tick_us(result: Any) -> float:
    return float(result.run_time / result.ticks * 1e6)


def _robot(scene: Scene, force: tuple[float, ...]) -> float:
    """The time (us) of a read and a hold."""
    robot = find_device("s", "mujoco").open(scene)
    for k in range(MUJOCO_TICKS):  # until it has come to rest where it presses
        robot.hold(force)
        robot.read(k)
    began = time.process_time()
    for k in range(MUJOCO_TICKS, 2 * MUJOCO_TICKS):
        robot.hold(force)
        robot.read(k)
    return (time.process_time() - began) / MUJOCO_TICKS * 1e6


def _steps(scene: Scene) -> float:
    """The time (us) of the sub-steps of a tick alone."""
    from mujoco import mj_step  # type: ignore[import-not-found,import-untyped,unused-ignore]  # an extra without types

    robot: Any = find_device("s", "mujoco").open(scene)
    model, data = robot._model.model, robot._body.data
    began = time.process_time()
    for _ in range(MUJOCO_TICKS):
        mj_step(model, data, robot._model.substeps)
    return (time.process_time() - began) / MUJOCO_TICKS * 1e6
