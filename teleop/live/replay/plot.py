"""The plot of a replay: each end's force as it was recorded and as the law commands it. Needs the extra `plot`."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

from teleop.errors import enumerated
from teleop.live.records.end_result import NAMES
from teleop.scene.axis_labels import labels_of
from teleop.terminal.axis_choice import TOGETHER, by_unit
from teleop.terminal.plotting import BLUE, DARK, RED, UNDER, grid_lines, literal, new_figure, save
from teleop.terminal.run_plot import LINES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from teleop.live.replay.open_loop import Commanded
    from teleop.scene.scene import Scene

COLOURS = {"m": BLUE, "s": RED}


def draw(title: str, answers: Mapping[str, Commanded], scene: Scene, path: Path, formats: Sequence[str], *,
         open_loop: bool) -> list[Path]:
    """Draw a panel for each end and unit as `path` in each of `formats`; returns the files. Raises `Refused`.

    Of more axes than share a panel, those are drawn whose force differs most from the recorded one, as a share of it.
    """
    labels, shown = labels_of(scene), _shown(answers, scene.axes)
    said = f"{title}, open loop" if open_loop else title
    if len(shown) < scene.axes:
        said += (f"; {len(shown)} of {scene.axes} axes, those whose force differs most: "
                 f"{enumerated([scene.axis_names[i] for i in shown])}")
    rows = [(e, one, unit, axes) for e, one in answers.items()
            for unit, axes in by_unit("N", shown, labels, scene.axes).items()]
    figure = new_figure((9.5, 2.4 * len(rows) + 0.8), fill(literal(said), 110))
    panels = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (e, one, unit, own) in zip(panels, rows, strict=True):
        t = one.k * scene.dt_ns / 1e9
        for i in own:
            name = f"$f_{e}$" + (f", {literal(scene.axis_names[i])}" if scene.axes > 1 else "")
            line = LINES[shown.index(i)]
            axes.plot(t, one.recorded[:, i], color=DARK, linestyle=line, label=f"{name} recorded", **UNDER)
            axes.plot(t, one.commanded[:, i], color=COLOURS[e], linestyle=line, linewidth=1.1,
                      label=f"{name} {'commanded' if open_loop else 'replayed'}")
        axes.set_ylabel(f"{NAMES[e]}'s force ({unit})")
        grid_lines(axes)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    panels[-1].set_xlabel("time (s)")
    return save(figure, path, formats)


def _shown(answers: Mapping[str, Commanded], axes: int) -> list[int]:
    import numpy as np

    if axes <= TOGETHER:
        return list(range(axes))
    with np.errstate(all="ignore"):  # of a law that gives what is not finite, and of no force at all
        share = np.nansum([np.nan_to_num(np.abs(one.commanded - one.recorded).sum(axis=0) /
                                         np.abs(one.recorded).sum(axis=0)) for one in answers.values()], axis=0)
    return sorted(np.argsort(-share, kind="stable")[:TOGETHER].tolist())
