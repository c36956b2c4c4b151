"""What `teleop precision` does."""

from __future__ import annotations

import sys
from argparse import Namespace

from teleop.analysis.precision.measure import measure
from teleop.analysis.precision.report import summary, table
from teleop.scene.loading import load_scene
from teleop.simulation.result import write_arrays
from teleop.storage.files import replacing
from teleop.storage.folder import new_folder
from teleop.storage.strict_json import write_document
from teleop.terminal.answer import Answer
from teleop.terminal.options import knobs_from
from teleop.terminal.plotting import drawable
from teleop.terminal.progress import shown_on


def command(args: Namespace) -> Answer:
    """Measure the scene; leave summary.json, errors.npz and, where the extra is there, precision.png in a new folder.

    Raises `Refused`.
    """
    scene = load_scene(args.scene, **knobs_from(args))
    with new_folder(args.out, f"{scene.name}-precision") as new:
        with shown_on(None if args.json else sys.stderr, args.seconds) as show:
            found = measure(scene, seed=args.seed, clock=args.nanoseconds, rounds=args.rounds, show=show)
        answer = Answer(table(found), summary(found, args.typed))
        with replacing(new.inside / "errors.npz") as file:
            write_arrays(file, found.along)
        write_document(new.inside / "summary.json", answer.document)
        if drawable():
            from teleop.analysis.precision.plot import draw

            draw(found, new.inside / "precision.png")
    return answer.kept_in(new.path)
