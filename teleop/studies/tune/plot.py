"""The picture of a search: tracking error against drag, with the front. Needs the extra `plot`."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

from teleop.studies.tune.objective import SCENE, Score
from teleop.studies.tune.report import SHOWN, figure
from teleop.terminal.plotting import BLACK, BLUE, ORANGE, PALE, grid_lines, literal, new_figure, save

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from teleop.studies.tune.search import Tuned


def draw(tuned: Tuned, path: Path, formats: Sequence[str]) -> list[Path]:
    """Draw the points of a search as `path` in each of `formats`; returns the files."""
    settings = ", ".join(f"{name.removeprefix('law.')}={value:.4g}" if isinstance(value, float) else f"{name}={value}"
                         for name, value in tuned.best.items())
    status = "best" if tuned.feasible else f"nearest ({tuned.score.broken})"
    title = f"{literal(f'{tuned.law} in {tuned.scene}, {len(tuned.tried)} points')}\n{literal(f'{status}: {settings}')}"
    axes_figure = new_figure((8.0, 6.0), title)
    axes = axes_figure.add_subplot()
    good = [(values, found) for values, found in tuned.tried if not found.broken]
    bad = [found for _, found in tuned.tried if found.broken]
    reach = [_place(found) for _, found in good]
    limit = 1.5 * max([y for _, y in reach], default=1.0)
    near = [(x, y) for x, y in map(_place, bad) if isfinite(x) and isfinite(y) and y <= limit]
    axes.scatter(*_columns(near), marker="x", s=18, color=PALE, label="breaks a constraint", linewidths=1.0)
    shade = [1.0 - min(found.terms.get("feel", found.terms.get("force", 0.0)), 1.0) for _, found in good]
    drawn = axes.scatter(*_columns(reach), c=shade, cmap="viridis", vmin=0.0, vmax=1.0, s=26, label="feasible")
    axes_figure.colorbar(drawn, ax=axes, label="steady force that reaches the hand, 1: all of a rigid rod's"
                         if tuned.rod.steady is not None else "1 - force error term")
    front = [_place(found) for _, found in tuned.front()]
    axes.step(*_columns(front), where="post", color=BLUE, linewidth=1.2, label="front")
    if tuned.default is not None and not tuned.default.broken:
        axes.scatter(*_columns([_place(tuned.default)]), marker="s", s=70, facecolors="none", edgecolors=BLACK,
                     label="untuned")
    axes.scatter(*_columns([_place(tuned.score)]), marker="*", s=190, color=ORANGE, edgecolors=BLACK, zorder=5,
                 label="best" if tuned.feasible else "nearest")
    axes.set_xlabel("drag: greatest force against the hand in free space (N)")
    axes.set_ylabel("tracking error, rms (mm)")
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(left=0.0)
    grid_lines(axes)
    axes.legend(fontsize=8)
    return save(axes_figure, path, formats)


def _place(found: Score) -> tuple[float, float]:
    """Drag (N) and tracking error (mm) of a point; NaN where it has none."""
    drag, error = figure(found, *SHOWN["drag"][1:]), figure(found, SCENE, "x_err_rms")
    return (float("nan") if drag is None else drag, float("nan") if error is None else 1e3 * error)


def _columns(points: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return [x for x, _ in points], [y for _, y in points]
