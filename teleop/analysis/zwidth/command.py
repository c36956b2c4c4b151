"""What `teleop zwidth` does: find a scene's Z-width, show how far that has come, write it and draw it."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from teleop.analysis.zwidth.assess import ZWidth

FIGURES = ("plane.png", "impedance.png", "levers.png")


def carry_out(name: str, knobs: Mapping[str, object], *, range_k: str | None, range_b: str | None, seed: int,
              out: str | None, command: Sequence[str], clock: Callable[[], float], stream: TextIO | None
              ) -> tuple[ZWidth, Path]:
    """Find the Z-width of scene `name` and leave it in a new folder: what was found, and where.

    `clock` (s) times the line of progress on `stream`; None: no such line. An interrupt leaves what was done until
    then, and no file by half. Raises `Refused`, and KeyboardInterrupt if nothing was done yet.
    """
    from teleop.analysis.zwidth.assess import assess, span
    from teleop.analysis.zwidth.report import write
    from teleop.scene.loading import load_scene
    from teleop.storage.folder import new_folder
    from teleop.terminal.progress import Progress

    scene = load_scene(name, **knobs)
    spans = span("--range-k", range_k), span("--range-b", range_b)
    line = None if stream is None else Progress(stream, 1.0)

    with _interrupts() as finger, new_folder(out, f"{scene.name}-zwidth") as new:

        def show(part: float, text: str) -> None:
            if part >= 1.0:
                finger.stops = False  # from here on all of it is found, and only has to be kept
            elif finger.came:
                raise KeyboardInterrupt  # the one that was raised got lost in a library
            if line is not None:
                line.show(part, clock(), text)

        try:
            got = assess(scene, span_K=spans[0], span_B=spans[1], seed=seed, show=show)
        finally:
            finger.stops = False
            if line is not None:
                line.end()
        finger.came -= min(finger.came, int(got.interrupted))  # that one has had its effect
        write(got, new.inside, command)
        left_out = _draw(got, new.inside, finger)
        if finger.came:
            note = [f"interrupted before it was drawn: {', '.join(left_out)}"] if left_out else []
            got = replace(got, interrupted=True, notes=[*got.notes, *note])
            write(got, new.inside, command)
    return got, new.path


def _draw(got: ZWidth, folder: Path, finger: _Interrupts) -> list[str]:
    """Draw the figures, where the extra is there, until an interrupt comes; which of them are missing then."""
    from teleop.terminal.plotting import drawable

    if not drawable():
        return []
    try:
        finger.stops = not finger.came
        if finger.stops:
            from teleop.analysis.zwidth.plot import draw

            draw(got, folder)
    except KeyboardInterrupt:
        finger.came = finger.came or 1
    except Exception:  # what libraries make of an interrupt that hits them while they load
        if not finger.came:
            raise
    finally:
        finger.stops = False
    for part in folder.glob(".*.part"):
        part.unlink()
    return [figure for figure in FIGURES if not (folder / figure).is_file()]


class _Interrupts:
    """What Ctrl-C does: `came` counts it, and while `stops` the first one stops the work at once."""

    __slots__ = ("came", "stops")

    def __init__(self) -> None:
        self.stops, self.came = True, 0

    def __call__(self, *_: object) -> None:
        self.came += 1
        if self.stops:
            self.stops = False
            raise KeyboardInterrupt


@contextmanager
def _interrupts() -> Iterator[_Interrupts]:
    """Ctrl-C as `_Interrupts` has it; where it is ignored or already means something else, that stays."""
    finger = _Interrupts()
    before = signal.getsignal(signal.SIGINT)
    ours = False
    if before is signal.default_int_handler:
        with suppress(ValueError):  # in a thread, which Ctrl-C does not reach
            signal.signal(signal.SIGINT, finger)
            ours = True
    try:
        yield finger
    finally:
        if ours:
            signal.signal(signal.SIGINT, before)
