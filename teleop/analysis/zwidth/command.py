"""What `teleop zwidth` does: find a scene's Z-width, write it and draw it; Ctrl-C keeps what is done."""

from __future__ import annotations

import sys
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

from teleop.analysis.models.by_axis import along
from teleop.analysis.zwidth.assess import assess, span
from teleop.analysis.zwidth.report import summary, table
from teleop.scene.loading import load_scene
from teleop.storage.folder import new_folder
from teleop.storage.strict_json import write_document
from teleop.terminal.answer import Answer
from teleop.terminal.interrupt import interrupts_wait
from teleop.terminal.options import DONE, INTERRUPTED, knobs_from
from teleop.terminal.plotting import asked_formats
from teleop.terminal.progress import shown_on


def command(args: Namespace) -> Answer:
    """Find the Z-width; leave summary.json and, if asked to, its plots in a new folder.

    An interrupt leaves what was found until then: the search stops at once, of the plots the one at hand is finished.
    Raises `Refused`, and KeyboardInterrupt if nothing was found yet.
    """
    formats = asked_formats(args)
    scene = along(load_scene(args.scene, **knobs_from(args)), args.axis)
    span_K, span_B = span("--range-k", args.range_k), span("--range-b", args.range_b)
    with new_folder(args.out, f"{scene.name}-zwidth") as new:
        with shown_on(None if args.json else sys.stderr, args.seconds) as show:
            found = assess(scene, span_K=span_K, span_B=span_B, seed=args.seed, show=show)
        with interrupts_wait() as interrupt:
            write_document(new.inside / "summary.json", summary(found, args.typed))
            plots: list[Path] = []
            missing = []
            if formats:
                from teleop.analysis.zwidth.plot import PLOTS

                for name, draw in PLOTS.items():
                    if interrupt.came:
                        missing.append(name)
                    else:
                        plots += draw(found, new.inside / name, formats)
            if interrupt.came:
                note = [f"interrupted before it was drawn: {', '.join(missing)}"] if missing else []
                found = replace(found, interrupted=True, notes=[*found.notes, *note])
                write_document(new.inside / "summary.json", summary(found, args.typed))
    code = INTERRUPTED if found.interrupted else DONE
    return Answer(table(found), summary(found, args.typed), code).kept_in(new.path).with_plots(new.path, plots)
