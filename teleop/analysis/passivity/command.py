"""The command `teleop passivity`."""

from __future__ import annotations

from argparse import Namespace
from functools import partial

from teleop.analysis.models.by_axis import along
from teleop.analysis.passivity.plot import draw
from teleop.analysis.passivity.report import ask, curves, summary, table
from teleop.scene.loading import load_scene
from teleop.simulation.result import write_npz
from teleop.terminal.answer import Answer, Task, command_of
from teleop.terminal.options import knobs_from


def find(args: Namespace) -> Task:
    """Judge the scene. Raises `Refused`."""
    scene = along(load_scene(args.scene, **knobs_from(args)), args.axis)

    def work() -> Answer:
        passivity = ask(scene, seed=args.seed, span=args.range)
        return Answer(table(passivity), summary(passivity, args.typed),
                      files={"curves.npz": lambda path: write_npz(path, curves(passivity))},
                      plots={"passivity": partial(draw, passivity)})

    return Task(scene.name, work)


command = command_of(find, "passivity", always=False)
