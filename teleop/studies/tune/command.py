"""What `teleop tune` does."""

from __future__ import annotations

import sys
from argparse import Namespace

from teleop.storage.folder import new_folder
from teleop.storage.strict_json import write_document
from teleop.studies.tune.report import document, text, write_points
from teleop.studies.tune.search import tune_law
from teleop.terminal.answer import Answer
from teleop.terminal.options import knobs_from
from teleop.terminal.plotting import asked_formats
from teleop.terminal.progress import shown_on


def command(args: Namespace) -> Answer:
    """Search, and leave summary.json, points.csv, front.csv and a plot in a new folder. Raises `Refused`."""
    formats = asked_formats(args)
    playouts = [] if args.playouts is None else [one.strip() for one in args.playouts.split(",") if one.strip()]
    stem = "".join(c if c.isalnum() or c in "_-" else "-" for c in args.law.rsplit("/", 1)[-1]).strip("-") or "law"
    with shown_on(None if args.json else sys.stderr, args.seconds, args.budget) as show, \
            new_folder(args.out, f"{stem}-tune") as new:
        tuned = tune_law(args.scene, args.law, args.budget, args.seed, fixed=knobs_from(args), playouts=playouts,
                         objective=args.objective, margin=args.margin, tell=show, workers=args.workers,
                         engine=args.engine)
        names = tuned.names
        write_points(new.inside / "points.csv", names, tuned.tried)
        write_points(new.inside / "front.csv", names, tuned.front())
        told = document(tuned, args.typed)
        plots = []
        if formats:
            from teleop.studies.tune.plot import draw

            plots = draw(tuned, new.inside / "tune", formats)
        write_document(new.inside / "summary.json", told)
    return Answer(text(tuned), told).kept_in(new.path).with_plots(new.path, plots)
