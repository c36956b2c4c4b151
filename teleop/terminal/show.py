"""What `teleop show` does."""

from __future__ import annotations

from argparse import Namespace

from teleop.errors import Refused
from teleop.scene.loading import load_scene
from teleop.simulation.source import rendered
from teleop.terminal.answer import Answer
from teleop.terminal.options import knobs_from


def command(args: Namespace) -> Answer:
    """The lines of the tick as a scene's loop has them, or one of its live ends. Raises `Refused`."""
    scene = load_scene(args.scene, **knobs_from(args))
    if scene.slave is None and args.end is not None:
        raise Refused(f"scene {scene.name} has no slave, so it has no live ends; leave --end {args.end} out")
    text = rendered(scene, args.end)
    return Answer(text.rstrip("\n"), {"scene": scene.name, "end": args.end, "tick": text})
