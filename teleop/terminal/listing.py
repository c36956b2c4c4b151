"""What `teleop list` does."""

from __future__ import annotations

from argparse import Namespace

from teleop.scene.catalogue import details, overview
from teleop.terminal.answer import Answer


def command(args: Namespace) -> Answer:
    """All that there is by name, or the knobs of one. Raises `Refused` if nothing has that name."""
    return Answer(overview() if args.name is None else details(args.name), {})
