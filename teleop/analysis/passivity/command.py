"""What `teleop passivity` does: ask, write a folder where one is wanted, and say what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def passivity(name: str, knobs: Mapping[str, object], *, seed: int = 0, span: str | None = None,
              out: str | None = None, plot: bool = False, command: Sequence[str] = ()) -> tuple[dict[str, Any], str]:
    """The answer for the scene `name` as JSON and as a table; `span` is LOW:HIGH in Hz as typed. Raises `Refused`.

    With `out` or `plot` summary.json and curves.npz go into a new folder, with `plot` passivity.png too.
    """
    from teleop.analysis.passivity.report import ask, summary, table, write
    from teleop.scene.loading import load_scene
    from teleop.storage.folder import new_folder

    scene = load_scene(name, **knobs)
    answer = ask(scene, seed=seed, span=span)
    told, text = summary(answer, command), table(answer)
    if out is None and not plot:
        return told, text
    with new_folder(out, f"{scene.name}-passivity") as new:
        write(answer, new.inside, command)
        if plot:
            from teleop.analysis.passivity.plot import draw

            draw(answer, new.inside / "passivity.png")
    return {**told, "path": str(new.path)}, f"{text}\nwritten to {new.path}"
