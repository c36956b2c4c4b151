"""What `teleop stability` does."""

from __future__ import annotations

import sys
from argparse import Namespace

from teleop.analysis.stability.report import ask, summary, table
from teleop.storage.folder import new_folder
from teleop.storage.strict_json import write_document
from teleop.terminal.answer import Answer
from teleop.terminal.options import DONE, INTERRUPTED, knobs_from
from teleop.terminal.progress import shown_on


def command(args: Namespace) -> Answer:
    """Judge the scene and find its margins; with --out leave summary.json in a new folder.

    An interrupt of the search for a critical value leaves what that knows. Raises `Refused`, and KeyboardInterrupt
    before the search.
    """
    with shown_on(None if args.json or args.critical is None else sys.stderr, args.seconds) as show:
        found = ask(args.scene, knobs_from(args), seed=args.seed, in_time=args.time, continuous=args.continuous,
                    knob=args.critical, span=args.range, tol=args.tol, show=show)
    answer = Answer(table(found), summary(found, args.typed), DONE if found.so_far is None else INTERRUPTED)
    if args.out is None:
        return answer
    with new_folder(args.out) as new:
        write_document(new.inside / "summary.json", answer.document)
    return answer.kept_in(new.path)
