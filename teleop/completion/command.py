"""The command `teleop completion`."""

from __future__ import annotations

from argparse import Namespace

from teleop.completion.script import script
from teleop.terminal.answer import Answer
from teleop.terminal.commands import parser


def command(args: Namespace) -> Answer:
    """The script for the shell that was named."""
    text = script(args.shell, parser())
    return Answer(text.rstrip("\n"), {"shell": args.shell, "script": text})
