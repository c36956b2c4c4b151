"""What `teleop zwidth` does: find a scene's Z-width, show how far that has come, write it and draw it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from teleop.zwidth.assess import ZWidth


def carry_out(name: str, knobs: Mapping[str, object], *, range_k: str | None, range_b: str | None, seed: int,
              out: str | None, command: Sequence[str], clock: Callable[[], float], stream: TextIO | None
              ) -> tuple[ZWidth, Path]:
    """Find the Z-width of scene `name` and leave it in a new folder: what was found, and where.

    `clock` (s) times the line of progress on `stream`; None: no such line. An interrupt leaves what was done until
    then. Raises `Refused`.
    """
    from teleop.console import Progress
    from teleop.figure import drawable
    from teleop.folder import new_folder, numbered
    from teleop.scene import load_scene
    from teleop.zwidth.assess import assess, span
    from teleop.zwidth.report import write

    scene = load_scene(name, **knobs)
    spans = span("--range-k", range_k), span("--range-b", range_b)
    folder = Path(out) if out is not None else numbered(Path("runs"), f"{scene.name}-zwidth")
    line = None if stream is None else Progress(stream, 1.0)

    def show(part: float, text: str) -> None:
        if line is not None:
            line.show(part, clock(), text)

    with new_folder(folder) as inside:
        try:
            got = assess(scene, span_K=spans[0], span_B=spans[1], seed=seed, show=show)
        finally:
            if line is not None:
                line.end()
        write(got, inside, command)
        if drawable():
            from teleop.zwidth.figure import draw

            draw(got, inside)
    return got, folder
