"""The command `teleop precision`."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

from teleop.analysis.models.by_axis import along
from teleop.analysis.precision.measure import measure
from teleop.analysis.precision.report import summary, table
from teleop.scene.loading import load_scene
from teleop.simulation.result import write_arrays
from teleop.storage.files import replacing
from teleop.storage.folder import new_folder
from teleop.storage.strict_json import write_document
from teleop.terminal.answer import Answer
from teleop.terminal.options import knobs_from
from teleop.terminal.plotting import asked_formats
from teleop.terminal.progress import shown_on


def command(args: Namespace) -> Answer:
    """Measure the scene; leave summary.json, errors.npz and, if asked to, a plot in a new folder.

    Raises `Refused`.
    """
    formats = asked_formats(args)
    scene = along(load_scene(args.scene, **knobs_from(args)), args.axis)
    with new_folder(args.out, f"{scene.name}-precision") as new:
        with shown_on(None if args.json else sys.stderr, args.seconds) as show:
            found = measure(scene, seed=args.seed, clock=args.nanoseconds, rounds=args.rounds, show=show)
        answer = Answer(table(found), summary(found, args.typed))
        with replacing(new.inside / "errors.npz") as file:
            write_arrays(file, found.along)
        write_document(new.inside / "summary.json", answer.document)
        plots: list[Path] = []
        if formats:
            from teleop.analysis.precision.plot import draw

            plots = draw(found, new.inside / "precision", formats)
    return answer.kept_in(new.path).with_plots(new.path, plots)
