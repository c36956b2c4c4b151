"""The answer of a command: what a person reads, the same as a JSON document, and the exit code.

Every document begins with the same keys, those of `teleop.simulation.result.head`. A number that does not exist, or has
no bound, is null in it.
"""

from __future__ import annotations

import signal
import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from teleop.scene.scene import Scene
from teleop.storage.folder import LAST, NewFolder, new_folder
from teleop.storage.strict_json import json_text, write_document
from teleop.terminal.options import DONE, INTERRUPTED
from teleop.terminal.screen import render
from teleop.terminal.table import printable

_NONE: Mapping[str, Any] = MappingProxyType({})
_DT: Mapping[str, str] = MappingProxyType({"dt": "s"})


class Answer(NamedTuple):
    """The result of a command: a text, a document, an exit code, and what it has to write and to draw."""

    text: str  # for a person; several lines
    document: Mapping[str, Any]  # the same for a program, as JSON can hold it
    code: int = DONE  # with which the process ends
    files: Mapping[str, Callable[[Path], object]] = _NONE  # of its folder, and how each is written
    plots: Mapping[str, Callable[[Path, Sequence[str]], list[Path]]] = _NONE  # likewise, in each of some formats

    def kept_in(self, folder: Path | str | None) -> Answer:
        """The same answer, which says that its files are in `folder`."""
        return self._replace(text=f"{self.text}\nwritten to {folder}", document={**self.document, "path": str(folder)})

    def with_plots(self, folder: Path, files: Iterable[Path]) -> Answer:
        """The same answer, which names the `files` of its plots; they are in `folder` by now."""
        plots = [str(folder / file.name) for file in files]
        if not plots:
            return self
        text = "\n".join([self.text, *(f"plot: {plot}" for plot in plots)])
        return self._replace(text=text, document={**self.document, "plots": plots})

    def interrupted(self, missing: Sequence[str]) -> Answer:
        """The same answer after Ctrl-C, which names the plots that are `missing`."""
        notes = [f"interrupted before it was drawn: {', '.join(missing)}"] if missing else []
        changed = {"status": "interrupted", "notes": [*self.document.get("notes", ()), *notes]}
        return self._replace(text="\n".join([self.text, *notes]), document={**self.document, **changed},
                             code=INTERRUPTED)

    def without_plot(self, why: object) -> Answer:
        """The same answer, which says why no plot was drawn."""
        return self._replace(text=f"{self.text}\nno plot: {why}")


def say(answer: Answer, *, json: bool) -> None:
    """Print the answer: its document as one JSON object, or its text, in colours and folded on a terminal.

    What a terminal would obey, or its encoding does not know, is written out, and stops nothing.
    """
    text = json_text(answer.document) if json else answer.text
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    text = printable(text, lines=True).encode(encoding, "backslashreplace").decode(encoding)
    print(text if json else render(text, sys.stdout))


def titled(scene: Scene) -> str:
    """Scene and law with its gains, as a table and a plot are headed."""
    from teleop.simulation.result import law_with_gains, parameters

    return f"{scene.name}, law {law_with_gains(parameters(scene)['law'])}"


def scene_head(scene: Scene, mode: str, *, sentence: str, seed: int, command: Sequence[str], status: str = "done",
               also: Sequence[str] = ()) -> dict[str, Any]:
    """The first keys of the document about a scene; `mode` is the command, `also` names further packages in use."""
    from teleop.simulation.result import head, parameters

    return head(status=status, sentence=sentence, scene=scene.name, mode=mode, parameters=parameters(scene), seed=seed,
                command=command, dt=scene.dt_ns / 1e9, also=also)


class WithUnit(NamedTuple):
    """A value of a document, or several alike, in `unit`; empty: values of different units."""

    value: Any
    unit: str


def with_units(body: Mapping[str, Any], head: Mapping[str, str] = _DT) -> dict[str, Any]:
    """The body of a document that begins with `scene_head`: plain values, and their `units` by key.

    Where values of one key have different units, each unit stands under the path of its value. `head`: units of values
    before the body.

    >>> with_units({"delay": WithUnit(3, "ticks"), "limit": {"delay": WithUnit(0.1, "s")}})
    {'units': {'dt': 's', 'delay': 'ticks', 'limit.delay': 's'}, 'delay': 3, 'limit': {'delay': 0.1}}
    """
    by_key: dict[str, dict[str, str]] = {}  # the units of each key, by path

    def without_units(value: Any, path: tuple[str, ...] = ()) -> Any:
        if isinstance(value, WithUnit):
            if value.unit:
                by_key.setdefault(path[-1], {})[".".join(path)] = value.unit
            return value.value
        if isinstance(value, Mapping):
            return {key: without_units(each, (*path, key)) for key, each in value.items()}
        return [without_units(each, path) for each in value] if isinstance(value, list) else value

    values = without_units(body)
    units = dict(head)
    for key, by_path in by_key.items():
        units |= by_path if len({*by_path.values()}) > 1 else {key: next(iter(by_path.values()))}
    return {"units": units, **values}


def finite(value: float | None) -> float | None:
    """The number, or None where it has no bound.

    >>> finite(0.5), finite(float("inf")), finite(None)
    (0.5, None, None)
    """
    return value if value is not None and isfinite(value) else None


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
        from teleop.terminal.plotting import asked_formats  # loaded by commands that may draw

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


class DelayedInterrupt:
    """Ctrl-C that waits: `is_pending` from the first one on."""

    __slots__ = ("is_pending",)

    def __init__(self) -> None:
        self.is_pending = False

    def __call__(self, *_: object) -> None:
        self.is_pending = True


@contextmanager
def interrupts_wait() -> Iterator[DelayedInterrupt]:
    """Have Ctrl-C raise nothing until the end; where it is ignored, or already has a handler, that stays."""
    interrupt = DelayedInterrupt()
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
