"""The command `teleop precision`."""

from __future__ import annotations

from argparse import Namespace
from functools import partial

from teleop.analysis.models.by_axis import along
from teleop.analysis.precision.measure import measure
from teleop.analysis.precision.plot import draw
from teleop.analysis.precision.report import summary, table
from teleop.scene.loading import load_scene
from teleop.simulation.result import write_npz
from teleop.terminal.answer import Answer, Task, command_of
from teleop.terminal.options import knobs_from
from teleop.terminal.progress import shown_for


def find(args: Namespace) -> Task:
    """Measure the scene's errors against run time. Raises `Refused`."""
    scene = along(load_scene(args.scene, **knobs_from(args)), args.axis)

    def work() -> Answer:
        with shown_for(args) as show:
            precision = measure(scene, seed=args.seed, clock=args.nanoseconds, rounds=args.rounds, show=show)
        return Answer(table(precision), summary(precision, args.typed),
                      files={"errors.npz": partial(write_npz, arrays=precision.along)},
                      plots={"precision": partial(draw, precision)})

    return Task(scene.name, work)


command = command_of(find, "precision")
