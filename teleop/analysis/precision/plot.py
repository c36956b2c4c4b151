"""The plot of a comparison: error over run time, and both kinds of error along the run. Needs the extra `plot`."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.analysis.precision.contenders import TOLERANCES
from teleop.analysis.precision.measure import SUBSTEPS
from teleop.analysis.precision.report import axis_of
from teleop.errors import number_of
from teleop.scene.axes import told_along, unit_on
from teleop.terminal.plotting import (
    BLACK,
    BLUE,
    BROWN,
    DARK,
    FAILS,
    GREEN,
    GREY,
    OLIVE,
    ORANGE,
    PINK,
    PNG,
    PURPLE,
    RED,
    SKY,
    WINE,
    grid_lines,
    literal,
    new_figure,
    save,
)
from teleop.terminal.run_table import heading
from teleop.terminal.table import si

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from teleop.analysis.precision.measure import Entry, Precision


class Look(NamedTuple):
    """Colour, marker and line of a method; methods of first order are dashed, scipy's dash-dotted."""

    colour: str
    marker: str
    line: str


LOOKS = {
    "euler": Look(GREY, "v", "--"), "semi_implicit_euler": Look(ORANGE, "^", "--"),
    "verlet": Look(RED, "D", "-"), "rk4": Look(PINK, "s", "-"),
    "backward_euler": Look(BROWN, "o", "--"), "midpoint": Look(SKY, "P", "-"),
    "trapezoid": Look(BLUE, "X", "-"), "sdirk2": Look(GREEN, "h", "-"), "radau": Look(PURPLE, "p", "-"),
    "DOP853": Look(OLIVE, "<", "-."), "LSODA": Look(WINE, ">", "-."), "Radau": Look(BLACK, "d", "-."),
}
SIZES = (10.0, 7.0, 5.0, 3.5)  # of the marks, from coarse to fine
PANELS = (("x_s", "x_err", "slave's position", "m"), ("f_env", "f_err", "force on the environment", "N"))


def draw(got: Precision, path: Path, formats: Sequence[str] = PNG) -> list[Path]:
    """Draw `got` into `path` with the suffix of each format, as `save` does; returns the files."""
    by = got.truth.method if not got.truth.estimates else f"scipy's {got.truth.method}, every change of mode located"
    off, axis = got.truth.off, axis_of(got)
    good = f"good to {si(off['x_s'], 'm')}, {si(off['f_env'], 'N')}"
    reference = f"\nreference: {by}, {told_along(good, axis)}"
    scipys = "" if all(e.contender.rtol is None for e in got.entries) else (
        f"; scipy: rtol {', '.join(f'{rtol:.0e}' for rtol in TOLERANCES)}")
    counts = f"({number_of(got.result.ticks, 'tick')}, {number_of(got.contacts, 'contact')})"
    marks = f"marks from large to small: {', '.join(map(str, SUBSTEPS))} sub-steps per tick{scipys}"
    title = f"{literal(heading(got.result))}: error against run time {counts}\n{marks}{reference}"
    figure = new_figure((13.0, 9.5), title)
    every = figure.subplots(2, 2, height_ratios=(3, 2), squeeze=True)
    for column, (series, track, what, along) in enumerate(PANELS):
        unit = unit_on(along, axis)
        _work(every[0, column], got, series, what, unit)
        _time(every[1, column], got, series, track, what, unit)
    every[1, 0].sharex(every[1, 1])
    handles, labels = every[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False, fontsize=9)
    handles, labels = every[1, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right lower", frameon=False, fontsize=9)
    return save(figure, path, formats)


def _work(axes: Axes, got: Precision, series: str, what: str, unit: str) -> None:
    """Draw a curve for each method, with smaller marks for finer steps."""
    by_method: dict[str, list[Entry]] = {}
    for e in got.entries:
        by_method.setdefault(e.contender.method, []).append(e)
    top = _top(got, series)
    for method, entries in by_method.items():
        entries.sort(key=lambda e: -(e.contender.rtol or 0.0))
        points = [(e.ns_per_tick * 1e-3, _height(e, series, top, got.truth.off[series]), e) for e in entries]
        if method in ("exact", "default"):
            x, y, e = points[0]
            axes.scatter([x], [y], marker="*", s=220, color=BLACK, zorder=5, label=e.contender.label)
            axes.axvline(x, color=BLACK, linewidth=0.6, alpha=0.5)
            if got.truth.bound:
                axes.scatter([x], [got.truth.bound[series]], marker="*", s=220, facecolors="none", edgecolors=BLACK,
                             zorder=5, label="its own bound")
            continue
        look = LOOKS[method]
        axes.plot([x for x, _, _ in points], [y for _, y, _ in points], linestyle=look.line, color=look.colour,
                  linewidth=1.1)
        axes.plot([], [], linestyle=look.line, color=look.colour, marker=look.marker, label=entries[0].contender.label)
        for x, y, e in points:
            axes.plot([x], [y], color=look.colour, marker=look.marker, markersize=_mark(e), markeredgecolor="white",
                      markeredgewidth=0.4)
            if e.status == "diverged":
                axes.scatter([x], [y], marker="x", s=110, color=FAILS, zorder=6)
            elif e.missed:
                axes.scatter([x], [y], marker="o", s=150, facecolors="none", edgecolors=FAILS, zorder=6)
    _marks(axes, got)
    if any(e.errors[series].max <= got.truth.off[series] for e in got.entries):
        axes.axhline(got.truth.off[series], color=DARK, linewidth=0.8, linestyle=":", label="reference's own error")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("run time of the whole loop (us per tick)")
    axes.set_ylabel(f"largest error of the {what} ({unit})")
    grid_lines(axes)


def _mark(e: Entry) -> float:
    steps = SUBSTEPS if e.contender.substeps else TOLERANCES
    return SIZES[steps.index(e.contender.substeps or e.contender.rtol or 0.0)]


def _marks(axes: Axes, got: Precision) -> None:
    """The legend's lines for contenders that diverged or missed contacts, and the reference's own error."""
    if any(e.status == "diverged" for e in got.entries):
        axes.scatter([], [], marker="x", s=90, color=FAILS, label="diverged (drawn at the top)")
    if any(e.missed for e in got.entries):
        axes.scatter([], [], marker="o", s=90, facecolors="none", edgecolors=FAILS, label="missed contacts")


def _top(got: Precision, series: str) -> float:
    """Place of contenders that diverged: above all others."""
    sizes = [e.errors[series].max for e in got.entries if e.status != "diverged" and isfinite(e.errors[series].max)]
    return 30.0 * max([*sizes, 1e-15])


def _height(e: Entry, series: str, top: float, off: float) -> float:
    """Place of the error on the logarithmic axis, not below the reference's own error."""
    size = e.errors[series].max
    return min(max(size, off, 1e-18), top) if e.status != "diverged" and isfinite(size) else top


def _time(axes: Axes, got: Precision, series: str, track: str, what: str, unit: str) -> None:
    """Tracking error, and the numerical error of some methods, along the run.

    The methods' curves get thinner one after the other, with the stack's own above them all, so that one that another
    covers is still seen beside it.
    """
    t = got.along["t"]
    axes.plot(t, _above(got.along[track], 0.0), color=BLACK, linewidth=4.0, alpha=0.25,
              label="tracking and transparency")
    some = _some(got)
    for i, e in enumerate(some):
        look = LOOKS.get(e.contender.method, Look(BLACK, "", "-"))
        label = f"numerical, {e.contender.label} {e.contender.step}".rstrip()
        width = 0.7 + 0.4 * (len(some) - 1 - i) * (i > 0)
        axes.plot(t, _above(got.along[f"{series}:{e.key}"], got.truth.off[series]), color=look.colour, linewidth=width,
                  zorder=3.0 if i == 0 else 2.0, marker=".", markersize=1.5 * width, label=label)
    axes.set_yscale("log")
    axes.set_xlabel("time (s)")
    axes.set_ylabel(f"error of the {what} ({unit})")
    grid_lines(axes)


def _some(got: Precision) -> list[Entry]:
    """The stack's own steps, and a choice of methods from coarse to fine."""
    wanted = ("exact", "default", "euler/1", "semi_implicit_euler/1", "rk4/1", "sdirk2/16", "radau/64", "verlet/64")
    return [e for e in got.entries if e.key in wanted]


def _above(column: Any, least: float) -> Any:
    """The column where it is above `least`, NaN elsewhere."""
    import numpy as np

    return np.where(column > least, column, np.nan)
