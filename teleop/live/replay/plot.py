"""The plot of a replay: each end's force as it was recorded and as the law commands it. Needs the extra `plot`."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

from teleop.live.records.end_result import NAMES
from teleop.terminal.plotting import BLUE, DARK, RED, UNDER, grid_lines, literal, new_figure, save

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from teleop.live.replay.open_loop import Commanded
    from teleop.scene.scene import Scene

LINES = ("-", "--", ":")  # of the axes
COLOURS = {"m": BLUE, "s": RED}


def draw(title: str, answers: Mapping[str, Commanded], scene: Scene, path: Path, formats: Sequence[str], *,
         open_loop: bool) -> list[Path]:
    """Draw a panel for each end as `path` in each of `formats`; returns the files. Raises `Refused`."""
    told = f"{title}, open loop" if open_loop else title
    figure = new_figure((9.5, 2.4 * len(answers) + 0.8), fill(literal(told), 110))
    panels = figure.subplots(len(answers), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (e, one) in zip(panels, answers.items(), strict=True):
        t = one.k * scene.dt_ns / 1e9
        for i, line in zip(range(one.recorded.shape[1]), LINES, strict=False):
            name = f"$f_{e}$" + (f", {'xyz'[i]}" if one.recorded.shape[1] > 1 else "")
            axes.plot(t, one.recorded[:, i], color=DARK, linestyle=line, label=f"{name} recorded", **UNDER)
            axes.plot(t, one.commanded[:, i], color=COLOURS[e], linestyle=line, linewidth=1.1,
                      label=f"{name} {'commanded' if open_loop else 'replayed'}")
        axes.set_ylabel(f"{NAMES[e]}'s force (N)")
        grid_lines(axes)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    panels[-1].set_xlabel("time (s)")
    return save(figure, path, formats)
