"""Command `teleop emit`: one end of a scene as C."""

from __future__ import annotations

from argparse import Namespace
from functools import partial

from teleop.emit.compiled import float_error
from teleop.emit.files import FLAGS, files
from teleop.emit.types import FLOAT
from teleop.errors import Refused
from teleop.scene.loading import live_knobs, load_scene
from teleop.scene.scene import Scene, both_ends
from teleop.storage.files import replacing
from teleop.storage.folder import new_folder
from teleop.terminal.answer import Answer, titled
from teleop.terminal.options import knobs_from
from teleop.terminal.table import facts


def command(args: Namespace) -> Answer:
    """Write the files of an end into a new folder. Raises `Refused`; then there is none."""
    knobs = knobs_from(args)
    scene = load_scene(args.scene, **knobs)
    e = end_of(scene, args.end)
    if scene.slave is not None:
        scene = both_ends(load_scene(args.scene, **live_knobs(args.scene, knobs)))
    made = files(scene, e, args.end, real=FLOAT, off=partial(float_error, scene, e)) if args.float else files(
        scene, e, args.end)
    with new_folder(args.out, f"{scene.name}-emit") as new:
        for name, text in made.texts.items():
            with replacing(new.inside / name) as file:
                file.write(text.encode())
    header, code = list(made.texts)[:2]
    lines = {name: text.count("\n") for name, text in made.texts.items()}
    libm = sorted(made.tick.program.libm)
    rows = [("emit", f"{titled(scene)}, end {args.end}"), ("written to", str(new.path)),
            *[("" if i else "files", f"{name}, {count} lines") for i, (name, count) in enumerate(lines.items())],
            ("libm", ", ".join(libm) or "nothing but what is exact: the same bits everywhere"),
            ("try it", f"cd {new.path} && cc {FLAGS} {code} check.c -lm -o check && ./check")]
    document = {"scene": scene.name, "end": args.end, "path": str(new.path), "header": header, "code": code,
                "lines": lines, "libm": libm}
    return Answer(facts(rows), document)


def end_of(scene: Scene, end: str) -> str:
    """The end as the tick has it, m or s. Raises `Refused` where the scene has none of this name."""
    if scene.slave is None and end != "hand":
        raise Refused(f"scene {scene.name} has no slave, so it has one end; type --end hand")
    if scene.slave is not None and end == "hand":
        raise Refused(f"scene {scene.name} has two ends, and --end hand is that of a scene without a slave; type "
                      "--end m or --end s")
    return "m" if end == "hand" else end
