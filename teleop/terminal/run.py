"""What `teleop run` does, and what every command says of a run."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from teleop.errors import Refused
from teleop.scene.loading import load_scene
from teleop.simulation.result import RUNNING, Result
from teleop.simulation.virtual import run
from teleop.storage.folder import new_folder
from teleop.terminal.answer import Answer
from teleop.terminal.options import knobs_from
from teleop.terminal.run_table import table

PLOT = "plot.png"


def command(args: Namespace) -> Answer:
    """Run the scene in virtual time and leave its folder. Raises `Refused`."""
    scene = load_scene(args.scene, **knobs_from(args))
    if args.plot:
        from teleop.terminal.plotting import need_plot

        need_plot()
    with new_folder(args.out, stem(args.scene)) as new:  # before the run: a folder that cannot be written is found now
        result = run(scene, seed=args.seed, clock=args.nanoseconds, bodies=args.bodies)
        result.write(new.inside, args.typed)
        if args.plot:
            from teleop.terminal.run_plot import draw

            draw(result, new.inside / PLOT)
    return answer_of(replace(result, path=new.path), args.typed)


def answer_of(result: Result, typed: Sequence[str]) -> Answer:
    """What is said of a run; of a live one that goes on, that nothing is written yet."""
    answer = Answer(table(result), {**result.summary(typed), "path": str(result.path)})
    if result.status == RUNNING:
        return answer._replace(text=f"{answer.text}\nnothing is written while it runs")
    return answer.kept_in(result.path)


def with_plot(answer: Answer, result: Result, folder: Path) -> Answer:
    """Draw the run into `folder` where the extra is there; that it cannot be is said and no error.

    What was asked for is done by then.
    """
    from teleop.terminal.plotting import drawable

    if not drawable():
        return answer
    from teleop.terminal.run_plot import draw

    try:
        draw(result, folder / PLOT)
    except Refused as refused:
        return answer._replace(text=f"{answer.text}\nno plot: {refused}")
    return answer


def stem(scene: str) -> str:
    """The name, without its number, of the folder of a run of `scene` (a name, or the path of a file)."""
    return Path(scene).name.removesuffix(".py")
