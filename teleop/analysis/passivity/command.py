"""What `teleop passivity` does."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from teleop.analysis.models.by_axis import along
from teleop.analysis.passivity.report import ask, curves, summary, table
from teleop.scene.loading import load_scene
from teleop.simulation.result import write_arrays
from teleop.storage.files import replacing
from teleop.storage.folder import new_folder
from teleop.storage.strict_json import write_document
from teleop.terminal.answer import Answer
from teleop.terminal.options import knobs_from
from teleop.terminal.plotting import asked_formats


def command(args: Namespace) -> Answer:
    """Judge the scene; with --out or --plot leave summary.json, curves.npz and, if asked to, a plot in a new folder.

    Raises `Refused`.
    """
    formats = asked_formats(args)
    scene = along(load_scene(args.scene, **knobs_from(args)), args.axis)
    found = ask(scene, seed=args.seed, span=args.range)
    answer = Answer(table(found), summary(found, args.typed))
    if args.out is None and not formats:
        return answer
    with new_folder(args.out, f"{scene.name}-passivity") as new:
        with replacing(new.inside / "curves.npz") as file:
            write_arrays(file, curves(found))
        write_document(new.inside / "summary.json", answer.document)
        plots: list[Path] = []
        if formats:
            from teleop.analysis.passivity.plot import draw

            plots = draw(found, new.inside / "passivity", formats)
    return answer.kept_in(new.path).with_plots(new.path, plots)
