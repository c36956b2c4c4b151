"""The command line: finds the command that was typed, and prints its answer.

What may be typed is in `teleop.terminal.commands`. Clocks reach the commands from here, as arguments.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from time import perf_counter, perf_counter_ns

from teleop.terminal.commands import parser
from teleop.terminal.options import DONE, guarded

# Where each command is carried out: a function of the parsed arguments, which returns an `Answer`.
HOME = {
    "run": "teleop.terminal.run:command",
    "demo": "teleop.live.command:demo",
    "sweep": "teleop.sweeps.command:command",
    "matrix": "teleop.sweeps.matrix:command",
    "precision": "teleop.analysis.precision.command:command",
    "stability": "teleop.analysis.stability.command:command",
    "passivity": "teleop.analysis.passivity.command:command",
    "zwidth": "teleop.analysis.zwidth.command:command",
    "list": "teleop.terminal.listing:command",
    "show": "teleop.terminal.show:command",
    "doctor": "teleop.doctor:command",
    "keygen": "teleop.live.command:keygen",
    "report": "teleop.report:command",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Do what `argv` (left out: the command line) asks for; returns the exit code, that of the answer or `guarded`."""
    typed = sys.argv[1:] if argv is None else list(argv)
    return guarded(lambda: _obey(typed))


def _obey(typed: Sequence[str]) -> int:
    known = parser()
    args = known.parse_args(typed)
    if args.do is None:
        known.print_help()
        return DONE
    from teleop.terminal.answer import say

    args.typed = ["teleop", *typed]
    args.seconds, args.nanoseconds = perf_counter, perf_counter_ns
    module, _, function = HOME[args.do].partition(":")
    answer = getattr(import_module(module), function)(args)
    say(answer, json=args.json)
    return int(answer.code)


if __name__ == "__main__":
    raise SystemExit(main())
