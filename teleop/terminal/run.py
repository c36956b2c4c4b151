"""The commands `teleop run` and `teleop show`, and the answer of every command on a run."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from teleop.errors import Refused
from teleop.scene.loading import load_scene
from teleop.simulation.result import RUNNING, Result
from teleop.simulation.source import rendered
from teleop.simulation.virtual import run
from teleop.storage.folder import new_folder
from teleop.terminal.answer import Answer
from teleop.terminal.options import knobs_from
from teleop.terminal.run_table import table

PLOT = "plot"  # and the suffix of its format


def command(args: Namespace, runner: Callable[..., Result] | None = None) -> Answer:
    """Run the scene in virtual time and leave its folder. Raises `Refused`. `other`: what runs it in place of `run`."""
    scene = load_scene(args.scene, **knobs_from(args), **({} if args.hand is None else {"hand": args.hand}))
    formats: Sequence[str] = ()
    if args.plot or args.format:
        from teleop.terminal.plotting import asked_formats

        formats = asked_formats(args)
    with new_folder(args.out, stem(args.scene)) as new:  # before the run: a folder that cannot be written is found now
        result = (runner or run)(scene, seed=args.seed, clock=args.nanoseconds, bodies=args.bodies)
        result.write(new.inside, args.typed)
    result = replace(result, path=new.path)
    return with_plot(answer_of(result, args.typed), result, new.path, formats)


def answer_of(result: Result, typed: Sequence[str]) -> Answer:
    """Answer on a run; of a live one that goes on it says that nothing is written yet."""
    answer = Answer(table(result), {**result.summary(typed), "path": str(result.path)})
    if result.status == RUNNING:
        return answer._replace(text=f"{answer.text}\nnothing is written while it runs")
    return answer.kept_in(result.path)


def with_plot(answer: Answer, result: Result, folder: Path, formats: Sequence[str]) -> Answer:
    """Draw a run that is stored in `folder`, in each of `formats`, and name the files.

    That it cannot be drawn is said and no error: the run is stored by then.
    """
    if not formats:
        return answer
    from teleop.terminal.run_plot import draw

    try:
        return answer.with_plots(folder, draw(result, folder / PLOT, formats))
    except Refused as refused:
        return answer.without_plot(refused)


def stem(scene: str) -> str:
    """The name, without its number, of the folder of a run of `scene` (a name, or the path of a file)."""
    return Path(scene).name.removesuffix(".py")


def show_command(args: Namespace) -> Answer:
    """The lines of the tick as a scene's loop has them, or one of its live ends. Raises `Refused`."""
    scene = load_scene(args.scene, **knobs_from(args))
    if scene.slave is None and args.end is not None:
        raise Refused(f"scene {scene.name} has no slave, so it has no live ends; leave --end {args.end} out")
    text = rendered(scene, args.end)
    return Answer(text.rstrip("\n"), {"scene": scene.name, "end": args.end, "tick": text})
