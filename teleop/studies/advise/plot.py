"""Plot of an advice: the terms of every law side by side, and a run of the advised law. Needs the extra `plot`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from teleop.scene.loading import load_scene
from teleop.simulation.virtual import run
from teleop.studies.advise.laws import gains, link_text
from teleop.terminal.plotting import (
    BLUE,
    DARK,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    PURPLE,
    RED,
    SKY,
    grid_lines,
    literal,
    new_figure,
    save,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from teleop.studies.advise.advice import Advice
    from teleop.studies.advise.laws import LawAdvice
    from teleop.studies.tune.search import Tuned

TERMS = {  # name -> colour, label
    "tracking": (BLUE, "tracking error"), "drag": (ORANGE, "drag in free space"),
    "touch": (GREEN, "steady force missing at the wall"), "feel": (PINK, "steady force missing at the hand"),
    "rough": (PURPLE, "roughness at the hand"),
    "force": (SKY, "force error"),
}
MOST = 1.5  # of a term that is drawn to scale


def draw(advice: Advice, path: Path, formats: Sequence[str]) -> list[Path]:
    """Draw the advice as `path` in each of `formats`; returns the files."""
    best = advice.best
    title = "no law keeps the constraints" if best is None else f"take {best.law}: {gains(best)}"
    figure = new_figure((13.0, 6.5), f"{literal(title)}\n{literal(f'{advice.scene.name}, {link_text(advice.ways)}')}")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    _laws(figure.add_subplot(grid[:, 0]), advice)
    if best is not None and best.tuned is not None:
        motion = figure.add_subplot(grid[0, 1])
        force = figure.add_subplot(grid[1, 1], sharex=motion)
        _run(motion, force, best.tuned)
    return save(figure, path, formats)


def _laws(axes: Axes, advice: Advice) -> None:
    """A row for each law: its terms as bars, its value as a mark."""
    laws = [each for each in advice.laws if each.tuned is not None]
    names = [name for name in TERMS if any(each.tuned is not None and name in each.tuned.score.terms for each in laws)]
    high = 0.8 / max(1, len(names))
    for y, law in enumerate(laws):
        assert law.tuned is not None
        if not law.tuned.feasible:
            axes.text(0.02, y, literal(f"infeasible: {law.tuned.score.broken}", most=70), va="center", fontsize=8,
                      color=RED)
            continue
        for i, name in enumerate(names):
            value = law.tuned.score.terms.get(name)
            if value is not None:
                axes.barh(y - 0.4 + (i + 0.5) * high, min(value, MOST), height=high, color=TERMS[name][0],
                          label=TERMS[name][1] if law is _first(laws) else None)
        axes.errorbar(law.value, y, xerr=law.deviation or None, fmt="D", color=DARK, markersize=5, capsize=3,
                      label="objective: root mean square" if law is _first(laws) else None, zorder=5)
    axes.set_yticks(range(len(laws)), [f"advised: {each.law}" if each is advice.best else each.law for each in laws])
    axes.set_ylim(len(laws) - 0.4, -0.6)
    axes.set_xlim(0.0, MOST)
    axes.set_xlabel(f"0: a rigid rod, 1: a law that does nothing (cut off at {MOST:g})")
    axes.axvline(1.0, color=GREY, linewidth=0.8)
    grid_lines(axes)
    axes.legend(fontsize=8, loc="upper right")  # where the best laws have the shortest bars


def _first(laws: Sequence[LawAdvice]) -> LawAdvice | None:
    return next((each for each in laws if each.tuned is not None and each.tuned.feasible), None)


def _run(motion: Axes, force: Axes, tuned: Tuned) -> None:
    """Positions and forces of a run with the advised gains."""
    result = run(load_scene(tuned.scene, **tuned.knobs), seed=tuned.seed)
    t, trace = result.trace["t"], result.trace

    def first(name: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        column = np.asarray(trace[name])
        return column if column.ndim == 1 else column[:, 0]

    motion.plot(t, 1e3 * first("x_m"), color=BLUE, label="master")
    motion.plot(t, 1e3 * first("x_s"), color=ORANGE, label="slave")
    motion.set_ylabel("position (mm)")
    force.plot(t, first("f_env") if "f_env" in trace else 0.0 * t, color=ORANGE, label="slave on the environment")
    force.plot(t, first("f_m"), color=BLUE, label="stack against the hand")
    steady = tuned.baseline.steady
    if steady is not None:
        force.axhline(steady, color=GREY, linewidth=1.0, linestyle="--", label="steady force of a rigid rod")
        top = 1.5 * max(steady, float(np.quantile(first("f_m"), 0.999)))
        force.set_ylim(top=min(top, force.get_ylim()[1]))
    force.set_ylabel("force (N)")
    force.set_xlabel("t (s)")
    for axes in (motion, force):
        grid_lines(axes)
        axes.legend(fontsize=8)
