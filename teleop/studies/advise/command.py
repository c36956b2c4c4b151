"""What `teleop advise` does."""

from __future__ import annotations

import sys
from argparse import Namespace
from importlib.util import find_spec
from pathlib import Path

from teleop.errors import Refused, number, number_of
from teleop.scene.knobs import check_text, knobs_of
from teleop.scene.library import scene_function
from teleop.storage.files import replacing_text
from teleop.storage.strict_json import write_document
from teleop.studies.advise.advice import advise, two_port_laws
from teleop.studies.advise.report import document, text, write_laws
from teleop.sweeps.definition import DEFINITION
from teleop.sweeps.runner import cores
from teleop.sweeps.typed import listed
from teleop.terminal.answer import Answer
from teleop.terminal.options import INTERRUPTED, knobs_from
from teleop.terminal.plotting import asked_formats
from teleop.terminal.progress import shown_on

POINT = 3  # rows of one point at most
ROWS, PLAIN_ROWS = 12_000, 60  # of each law where none are asked for: compiled, and without the extra `batch`


def command(args: Namespace) -> Answer:
    """Advise a law, and leave summary.json, laws.csv and a plot in a folder that can be gone on with.

    Raises `Refused`.
    """
    formats = asked_formats(args)
    began = args.seconds()
    laws = two_port_laws() if args.laws is None else listed(args.laws)
    if not laws:
        raise Refused("--laws names none; write for example --laws wave,pfra, or leave it out for all")
    for law in laws:
        check_text("law", law, {})
    knobs = _knobs(args)
    compiled = find_spec("numba") is not None
    each = args.budget // len(laws) if args.budget is not None else ROWS if compiled else PLAIN_ROWS
    if each < POINT:
        raise Refused(f"--budget {args.budget} leaves each of {number_of(len(laws), 'law')} {number_of(each, 'row')}, "
                      f"and one point of the search takes up to {POINT}: the scene, free space and a stiffer wall; "
                      f"write --budget {POINT * len(laws)} or more, or fewer --laws")
    folder = Path(args.out) if args.out is not None else Path("runs") / f"{Path(args.scene).stem}-advise"
    try:
        with shown_on(None if args.json else sys.stderr, args.seconds) as show:
            found = advise(args.scene, each, fixed=knobs, laws=laws, objective=args.objective, seed=args.seed,
                           show=show, clock=args.seconds, workers=args.workers or cores(), out=folder)
    except KeyboardInterrupt:
        if not (folder / DEFINITION).is_file():
            raise  # nothing was begun
        sentence = "interrupted: the same command goes on from here"
        return Answer(sentence, {"status": "interrupted", "mode": "advise", "sentence": sentence,
                                 "path": str(folder)}, INTERRUPTED)
    seconds = args.seconds() - began
    told = document(found, args.typed, seconds)
    page = text(found, seconds)
    plots = []
    if formats:
        from teleop.studies.advise.plot import draw

        plots = draw(found, folder / "advise", formats)
    write_laws(folder / "laws.csv", found)
    with replacing_text(folder / "advice.txt") as file:
        file.write(page + "\n")
    write_document(folder / "summary.json", told)
    return Answer(page, told).kept_in(folder).with_plots(folder, plots)


def _knobs(args: Namespace) -> dict[str, object]:
    """The knobs that are set, with the link and the wall among them. Raises `Refused`."""
    knobs: dict[str, object] = dict(knobs_from(args))
    if args.ping is not None and args.link is not None:
        raise Refused("--ping and --link both give the link; leave one of them out")
    if args.ping is not None:
        quote = '"' if "'" in args.ping else "'"
        knobs["link"] = f"ping_log({quote}{args.ping}{quote})"
    if "link" not in knobs:
        raise Refused("no link is given; write --link 'delay(0.04) | uniform(0.02) | bernoulli(0.02)', or --ping FILE "
                      "with what `ping -D -i 0.02 HOST > FILE` has recorded")
    if args.wall is not None:
        number("--wall", args.wall, low=0.0, unit="N/m")
        if "k_e" not in knobs_of(scene_function(args.scene)):
            raise Refused(f"scene {args.scene} has no knob k_e for --wall to set; leave it out, or take another scene, "
                          "for example hard_wall or soft_tissue")
        if "k_e" in knobs:
            raise Refused("--wall and --set k_e both give the stiffness of the wall; leave one of them out")
        knobs["k_e"] = args.wall
    return knobs
