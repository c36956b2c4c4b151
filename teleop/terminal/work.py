"""A command that works something out: its folder, files, summary and plots, and what Ctrl-C leaves of them.

A search that is interrupted stops at once. Once results are there Ctrl-C waits, so that they are written.
"""

from __future__ import annotations

import signal
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import NamedTuple

from teleop.storage.folder import LAST, NewFolder, new_folder
from teleop.storage.strict_json import write_document
from teleop.terminal.answer import Answer
from teleop.terminal.options import INTERRUPTED
from teleop.terminal.plotting import asked_formats


class Task(NamedTuple):
    """Work of a command whose arguments are checked; its folder is there before the work begins."""

    stem: str  # the name of its folder begins with it
    find: Callable[[], Answer]  # carries the work out
    folder: Path | None = None  # a folder in which the same command goes on with what was interrupted


def command_of(find: Callable[[Namespace], Task], name: str, *, always: bool = True) -> Callable[[Namespace], Answer]:
    """Build the command `name` of `find`, which checks the arguments and returns the task.

    It writes a folder `always`, or only where --out or a plot asks for one. It raises `Refused`, and KeyboardInterrupt
    where the task does.
    """
    def command(args: Namespace) -> Answer:
        formats = asked_formats(args)
        task = find(args)
        if not (always or formats or args.out is not None):
            return task.find()
        with _folder(task, args.out, name) as new:
            answer = task.find()
            if task.folder is not None and answer.code == INTERRUPTED:
                return answer
            plots: list[Path] = []
            missing: list[str] = []
            with interrupts_wait() as interrupt:
                for file, write in answer.files.items():
                    write(new.inside / file)
                write_document(new.inside / LAST, answer.document)
                for plot, draw in answer.plots.items() if formats else ():
                    if interrupt.is_pending:
                        missing.append(plot)
                    else:
                        plots += draw(new.inside / plot, formats)
                if interrupt.is_pending:
                    answer = answer.interrupted(missing)
                    write_document(new.inside / LAST, answer.document)
        return answer.kept_in(new.path).with_plots(new.path, plots)

    return command


def _folder(task: Task, out: str | None, name: str) -> AbstractContextManager[NewFolder]:
    if task.folder is not None:
        return nullcontext(NewFolder(task.folder, task.folder))
    return new_folder(out, f"{task.stem}-{name}")


class Interrupt:
    """Ctrl-C that waits: `is_pending` from the first one on."""

    __slots__ = ("is_pending",)

    def __init__(self) -> None:
        self.is_pending = False

    def __call__(self, *_: object) -> None:
        self.is_pending = True


@contextmanager
def interrupts_wait() -> Iterator[Interrupt]:
    """Have Ctrl-C raise nothing until the end; where it is ignored, or already has a handler, that stays."""
    interrupt = Interrupt()
    replaced = False
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        with suppress(ValueError):  # in a thread, which Ctrl-C does not reach
            signal.signal(signal.SIGINT, interrupt)
            replaced = True
    try:
        yield interrupt
    finally:
        if replaced:
            signal.signal(signal.SIGINT, signal.default_int_handler)
