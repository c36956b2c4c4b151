"""The command `teleop zwidth`; Ctrl-C keeps what is done."""

from __future__ import annotations

from argparse import Namespace
from functools import partial

from teleop.analysis.models.by_axis import along
from teleop.analysis.zwidth.assess import assess, span
from teleop.analysis.zwidth.plot import PLOTS
from teleop.analysis.zwidth.report import summary, table
from teleop.scene.loading import load_scene
from teleop.terminal.answer import Answer, Task, command_of
from teleop.terminal.options import DONE, INTERRUPTED, knobs_from
from teleop.terminal.progress import shown_for


def find(args: Namespace) -> Task:
    """Find the scene's Z-width. An interrupt leaves what was found until then.

    Raises `Refused`, and the task KeyboardInterrupt if nothing was found yet.
    """
    scene = along(load_scene(args.scene, **knobs_from(args)), args.axis)
    span_K, span_B = span("--range-k", args.range_k), span("--range-b", args.range_b)

    def work() -> Answer:
        with shown_for(args) as show:
            z_width = assess(scene, span_K=span_K, span_B=span_B, seed=args.seed, show=show)
        return Answer(table(z_width), summary(z_width, args.typed), INTERRUPTED if z_width.interrupted else DONE,
                      plots={name: partial(draw, z_width) for name, draw in PLOTS.items()})

    return Task(scene.name, work)


command = command_of(find, "zwidth")
