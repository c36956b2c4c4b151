"""The command line: finds the command that was typed, and prints its answer.

What may be typed is in `teleop.terminal.commands`. Clocks reach the commands from here, as arguments.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from time import gmtime, perf_counter, perf_counter_ns, strftime

from teleop.terminal.commands import COMMANDS, FIRST, parser
from teleop.terminal.options import DONE, INTERRUPTED, guarded

# Where each command is carried out: a function of the parsed arguments, which returns an `Answer`.
HOME = {
    "run": "teleop.terminal.run:command",
    "run, with devices": "teleop.live.in_process:command",
    "demo": "teleop.live.demo:command",
    "sweep": "teleop.sweeps.command:command",
    "tune": "teleop.studies.tune.report:command",
    "advise": "teleop.studies.advise.report:command",
    "matrix": "teleop.sweeps.matrix:command",
    "compare": "teleop.studies.compare.command:command",
    "study": "teleop.people.command:command",
    "precision": "teleop.analysis.precision.report:command",
    "stability": "teleop.analysis.stability.command:command",
    "passivity": "teleop.analysis.passivity.command:command",
    "zwidth": "teleop.analysis.zwidth.report:command",
    "reproduce": "teleop.studies.reproduce.command:command",
    "list": "teleop.terminal.listing:command",
    "manifest": "teleop.export.manifest:command",
    "emit": "teleop.emit.command:command",
    "show": "teleop.terminal.run:show_command",
    "check": "teleop.live.devices.command:command",
    "identify": "teleop.live.devices.identify:command",
    "doctor": "teleop.doctor.command:command",
    "completion": "teleop.completion:command",
    "keygen": "teleop.live.options:keygen",
    "report": "teleop.report.command:command",
    "replay": "teleop.live.replay.command:command",
    "export": "teleop.export.command:export",
    "stream": "teleop.export.command:stream",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command in `argv` (default: the command line); return the exit code of its answer or of `guarded`."""
    typed = sys.argv[1:] if argv is None else list(argv)
    return guarded(lambda: _obey(typed))


def leave(code: int) -> int:
    """The exit code; after Ctrl-C the process ends with it here and now, if a thread is still at work.

    At its end Python waits for every thread, and one that compiles cannot be stopped before it is done.
    """
    if code == INTERRUPTED:
        import threading

        if any(not one.daemon for one in threading.enumerate() if one is not threading.main_thread()):
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError, ValueError):
                    stream.flush()
            os._exit(code)
    return code


def _obey(typed: Sequence[str]) -> int:
    if "_ARGCOMPLETE" in os.environ:  # set by a shell that asks for completions
        from teleop.completion import complete

        complete(parser())
    args, unknown = parser(*[word for word in typed[:1] if word in COMMANDS]).parse_known_args(typed)
    if unknown:
        parser().parse_args(typed)  # which says in one sentence where such an option belongs
    if args.do is None:
        from teleop.terminal import screen

        print(screen.answer(FIRST, sys.stdout), end="")
        return DONE
    from teleop.terminal.answer import say

    args.typed = ["teleop", *typed]
    args.seconds, args.nanoseconds = perf_counter, perf_counter_ns
    args.date = strftime("%Y-%m-%dT%H:%M:%SZ", gmtime())
    with_devices = args.do == "run" and (args.device is not None or args.robot is not None)
    module, _, function = HOME["run, with devices" if with_devices else args.do].partition(":")
    command = getattr(import_module(module), function)
    if not gc.isenabled():  # see `scenarios.__main__`
        gc.freeze()
        gc.enable()
    answer = command(args)
    say(answer, json=args.json)
    return int(answer.code)


if __name__ == "__main__":
    raise SystemExit(leave(main()))
