"""What `teleop stability` does."""

from __future__ import annotations

from argparse import Namespace

from teleop.analysis.stability.report import ask, summary, table
from teleop.storage.folder import new_folder
from teleop.storage.strict_json import write_document
from teleop.terminal.answer import Answer
from teleop.terminal.options import knobs_from


def command(args: Namespace) -> Answer:
    """Judge the scene and find its margins; with --out leave summary.json in a new folder. Raises `Refused`."""
    found = ask(args.scene, knobs_from(args), seed=args.seed, in_time=args.time, continuous=args.continuous,
                knob=args.critical, span=args.range, tol=args.tol)
    answer = Answer(table(found), summary(found, args.typed))
    if args.out is None:
        return answer
    with new_folder(args.out) as new:
        write_document(new.inside / "summary.json", answer.document)
    return answer.kept_in(new.path)
