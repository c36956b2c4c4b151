"""What `teleop stability` does."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from teleop.analysis.stability.assess import Stability
from teleop.analysis.stability.report import StabilityAnswer, ask, summary, table
from teleop.errors import Refused
from teleop.scene.loading import load_scene
from teleop.simulation.result import write_arrays
from teleop.storage.files import replacing
from teleop.storage.folder import NewFolder, new_folder
from teleop.storage.strict_json import write_document
from teleop.terminal.answer import Answer
from teleop.terminal.interrupt import interrupts_wait
from teleop.terminal.options import DONE, INTERRUPTED, knobs_from
from teleop.terminal.plotting import asked_formats
from teleop.terminal.progress import shown_on

if TYPE_CHECKING:
    from collections.abc import Sequence

    from teleop.analysis.stability.picture import Swept


def command(args: Namespace) -> Answer:
    """Judge the scene and find its margins; with --out or --plot leave summary.json, and plots, in a new folder.

    An interrupt of the search for a critical value, or of the margins over its knob, leaves what is known until then.
    Raises `Refused`, and KeyboardInterrupt before the search.
    """
    formats = asked_formats(args)
    if formats and args.time:
        raise Refused("a plot shows the roots and the open loop, which a run in virtual time does not have; leave "
                      f"--plot out, or see the motion itself: teleop run {args.scene} --plot")
    with shown_on(None if args.json or args.critical is None else sys.stderr, args.seconds) as show:
        found = ask(args.scene, knobs_from(args), seed=args.seed, in_time=args.time, continuous=args.continuous,
                    knob=args.critical, span=args.range, tol=args.tol, show=show)
    if args.out is None and not formats:
        return Answer(table(found), summary(found, args.typed), DONE if found.so_far is None else INTERRUPTED)
    with new_folder(args.out, f"{found.scene.name}-stability") as new:
        swept = None
        if formats and found.edge is not None:
            try:
                swept = _swept(args, found)
            except KeyboardInterrupt:
                found = found._replace(cut_short=True)
        document, plots = summary(found, args.typed), list[Path]()
        with interrupts_wait():
            if formats:
                more, plots = _drawn(args, found, swept, new, formats)
                document |= more
            write_document(new.inside / "summary.json", document)
    code = DONE if found.finished else INTERRUPTED
    return Answer(table(found), document, code).kept_in(new.path).with_plots(new.path, plots)


def _drawn(args: Namespace, found: StabilityAnswer, swept: Swept | None, new: NewFolder, formats: Sequence[str]
           ) -> tuple[dict[str, Any], list[Path]]:
    """The numbers behind the plots, for the document, and their files."""
    from teleop.analysis.stability.picture import curves, numbers, picture
    from teleop.analysis.stability.plot import draw, draw_swept

    assert isinstance(found.found, Stability)  # refused above
    drawn = picture(found.scene, unstable=found.found.unstable > 0, gain_margin=found.found.gain_margin, seed=args.seed)
    with replacing(new.inside / "curves.npz") as file:
        write_arrays(file, curves(drawn, swept))
    plots = draw(found, drawn, new.inside / "stability", formats)
    if swept is not None:
        plots += draw_swept(found, swept, new.inside / "critical", formats)
    return numbers(drawn), plots


def _swept(args: Namespace, found: StabilityAnswer) -> Swept:
    """Growth and margins at the places that the critical value was looked for at, and close to it."""
    from teleop.analysis.stability.picture import sweep

    assert found.edge is not None
    knobs, knob = knobs_from(args), found.edge.knob
    with shown_on(None if args.json else sys.stderr, args.seconds) as show:
        values = found.places
        return sweep(lambda value: load_scene(args.scene, **{**knobs, knob: value}), values, seed=args.seed,
                     tell=lambda done: show(done / len(values), f"margins over {knob}"))
