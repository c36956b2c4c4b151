"""The command `teleop precision`: its comparison as a table, as a JSON document and as a plot."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from math import isfinite, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from teleop.analysis.models.by_axis import along
from teleop.analysis.precision.contenders import TOLERANCES, there
from teleop.analysis.precision.measure import EULER, FASTER, SUBSTEPS, Entry, Precision, measure
from teleop.analysis.precision.reference.deviation import SERIES
from teleop.errors import number_of
from teleop.scene.axes import labels_of, told_along, unit_on
from teleop.scene.loading import load_scene
from teleop.simulation.result import write_npz
from teleop.terminal import plotting as plot
from teleop.terminal.answer import Answer, Task, WithUnit, command_of, finite, scene_head, with_units
from teleop.terminal.options import knobs_from
from teleop.terminal.progress import shown_for
from teleop.terminal.run_table import heading
from teleop.terminal.table import columns, facts, si

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEAD = ("method/sub-steps", "per tick", "x_s max", "x_s rms", "x_s end", "f_env max", "f_env rms", "peak", "")
LENGTHS = {"error_estimate_max", "error_estimate_sum", "tolerance"}  # among the estimates of an end
NO_TIME = "no time; a shorter duration or --rounds 1 has them"
TRACKING = (
    ("tracking error", "x_err", "m", "slave against the delayed master, whatever the method"),
    ("force error", "f_err", "N", "force felt against the force touched one delay ago"),
)


def table(got: Precision) -> str:
    """The comparison as lines of text, the stack's own steps first, then method by method from coarse to fine."""
    rows = [HEAD, *(_row(e, got.truth.off) for e in sorted(got.entries, key=_order(got.entries)))]
    if got.truth.bound is not None:
        mark = f"by itself at most {si(got.truth.bound['x_s'], 'm')}"
        rows[1] = (*rows[1][:-1], ", ".join([mark, *filter(None, rows[1][-1:])]))
    axis = axis_of(got)
    cells = [tuple([told_along(cell, axis) for cell in row]) for row in rows]
    lines = [(label, told_along(text, axis)) for label, text in _facts(got)]
    return f"{columns(cells, left=(0, len(HEAD) - 1))}\n\n{facts(lines)}"


def axis_of(got: Precision) -> str:
    """The unit of the axis that was looked at, m or rad."""
    return labels_of(got.scene).units_for(got.scene.axes)[0]


def _order(entries: Sequence[Entry]) -> Any:
    """Key that sorts methods as they came, each from coarse to fine."""
    methods = list(dict.fromkeys(e.contender.method for e in entries))
    return lambda e: (methods.index(e.contender.method), e.contender.substeps or 0, -(e.contender.rtol or 0.0))


def _row(e: Entry, off: Mapping[str, float]) -> tuple[str, ...]:
    """The row of a contender. An error that may be the reference's own is shown as a bound."""
    x, f = e.errors["x_s"], e.errors["f_env"]
    sizes = [*(_size(size, off["x_s"], "m") for size in x), *(_size(size, off["f_env"], "N") for size in f[:2])]
    peak = "-" if e.peak_ratio is None else f"{e.peak_ratio:.4g}"
    return e.key, si(e.ns_per_tick * 1e-9, "s"), *sizes, peak, _remarks(e)


def _size(error: float, off: float, unit: str) -> str:
    return "-" if isnan(error) else f"<= {si(off, unit)}" if error <= off else si(error, unit)


def _remarks(e: Entry) -> str:
    """A divergence, missed contacts, and which contender beats this one."""
    words = ["diverged"] * (e.status == "diverged")
    words += [f"missed {number_of(e.missed, 'contact')}"] * (e.missed > 0)
    words += [f"beaten by {e.beaten_by}"] if e.beaten_by else []
    return ", ".join(words)


def _facts(got: Precision) -> list[tuple[str, str]]:
    first, others = got.entries[0], got.entries[1:]
    beaten = sum(e.beaten_by == first.key for e in others)
    lines = [
        ("run", f"{heading(got.result)}, {number_of(got.result.ticks, 'tick')}, {number_of(got.contacts, 'contact')}, "
                f"seed {got.seed}"),
        ("status", f"{got.result.status}: {got.result.sentence}"),
        ("verdict", verdict(got)),
        ("beaten means", f"another is at least as accurate in x_s and f_env and more than {FASTER:g} times faster; "
                         f"{first.key} beats {beaten} of {len(others)}"),
        ("reference", f"{got.truth.sentence}; an error at or below that is shown as <="),
        (f"{first.key}, one tick", one_tick(got)),
        *_estimated(got),
    ]
    if EULER in got.step_ns:
        stack, euler = got.step_ns[first.key], got.step_ns[EULER]
        lines.append((f"{first.key}, its cost", f"{stack / euler:.2f} semi-implicit Euler steps: {stack:.0f} and "
                                                f"{euler:.0f} ns to move all bodies by a tick, without the loop"))
    for label, name, unit, what in TRACKING:
        if f"{name}_rms" in got.result.metrics:
            rms, most = (si(got.result.metrics[f"{name}_{kind}"], unit) for kind in ("rms", "max"))
            lines.append((label, f"{rms} rms, {most} max: {what}"))
    runs = sorted({e.runs for e in got.entries if e.contender.rtol is None})
    timing = f"whole loop, medians of {' to '.join(map(str, runs))} interleaved runs"
    scipys = any(e.contender.rtol is not None for e in got.entries)
    lines.append(("timing", timing + "; scipy's one run, for the slave only" * scipys))
    return lines + [("left out", f"{', '.join(keys)}: {why}") for why, keys in _left_out(got).items()]


def one_tick(got: Precision) -> str:
    """The error of single steps of the stack's own, over all of the run, in one sentence."""
    first = next(iter(got.truth.steps.values()))
    integrated = f"{first.integrated} of them integrated, " if got.truth.estimates else ""
    bodies = number_of(round(first.count / got.result.ticks), "body", "bodies")
    every = (f"all {number_of(first.count, 'step')} of the run ({bodies}, every tick; {integrated}{first.changes} with "
             "a change of mode), each from the reference's state: ")
    return every + "; ".join(
        f"off {method} by at most {si(one.x, 'm')}, {si(one.v, 'm/s')}" + f" ({one.gave_up} not compared: it gave up)"
        * (one.gave_up > 0) for method, one in got.truth.steps.items())


def _estimated(got: Precision) -> list[tuple[str, str]]:
    """The stack's own estimates of its integration error, what they bound, and the true error."""
    errors, estimates = got.entries[0].errors, got.truth.estimates
    if not estimates:
        return []

    def by_end(name: str) -> str:
        return ", ".join(f"{si(one[name], 'm')} ({end})" for end, one in estimates.items() if name in one)

    true = ", ".join(f"{_size(errors[name].max, got.truth.off[name], unit)} in {name}"
                     for name, unit in SERIES.items())
    effort = [f"{end}: at most {one['substeps_max']:.0f} sub-steps in a tick, {one['ticks_over_tolerance']:.0f} ticks "
              "over the tolerance" for end, one in estimates.items() if "substeps_max" in one]
    return [
        ("default, estimated", f"at most {by_end('error_estimate_max')} in one tick; over the run they add up to "
                               f"{by_end('error_estimate_sum')}, which is no bound: the loop carries errors on"),
        ("default, bound", f"{_bound(got)}; true at most {true}"),
        *((("default, its effort", "; ".join(effort)),) if effort else ()),
    ]


def _bound(got: Precision) -> str:
    """The bound of the error that the stack can tell without a reference."""
    if got.truth.bound is None:
        return "none: a smaller tolerance does not halve the estimates, or nothing was integrated"
    sizes = ", ".join(f"{si(size, SERIES[name])} in {name}" for name, size in got.truth.bound.items())
    return f"at most {sizes}, twice the difference from the same run with a smaller tolerance"


def _left_out(got: Precision) -> dict[str, list[str]]:
    """Contenders that are left out, by reason; all that there was no time for under one reason."""
    by_reason: dict[str, list[str]] = {}
    for key, why in got.left_out.items():
        by_reason.setdefault(NO_TIME if key in got.too_slow else why, []).append(key)
    return by_reason


def verdict(got: Precision) -> str:
    """The contenders that are not beaten, in one sentence."""
    best = [e.key for e in got.entries if e.beaten_by is None]
    return f"not beaten: {', '.join(best)}"


def summary(got: Precision, command: Sequence[str] = ()) -> dict[str, Any]:
    """The JSON document; a number that does not exist, or has no bound, is null."""
    result, axis = got.result, axis_of(got)

    def along(unit: str, value: object) -> WithUnit:
        """The value in the unit that it has on this axis, by that along a line."""
        return WithUnit(value, unit_on(unit, axis))

    def series(values: Mapping[str, float]) -> dict[str, Any]:
        return {name: along(SERIES[name], finite(value)) for name, value in values.items()}

    body = {
        "ticks": result.ticks, "rounds": got.rounds, "contacts": got.contacts,
        "reference": {
            "method": got.truth.method, "sentence": got.truth.sentence, "off_by": series(got.truth.off),
            "per_tick": {method: {**asdict(steps), "x": along("m", steps.x), "v": along("m/s", steps.v)}
                         for method, steps in got.truth.steps.items()},
            "step_ns": WithUnit(dict(got.step_ns), "ns"),
        },
        "estimates": {end: {name: along("m", value) if name in LENGTHS else value for name, value in estimates.items()}
                      for end, estimates in got.truth.estimates.items()},
        "bound": None if got.truth.bound is None else series(got.truth.bound),
        "tracking": {name: along("m" if name[0] == "x" else "N", value) for name, value in result.metrics.items()
                     if name[:5] in ("x_err", "f_err")},
        "methods": [_entry(e, got.truth.off, along) for e in got.entries],
        "left_out": dict(got.left_out), "notes": list(result.notes),
    }
    return {**scene_head(got.scene, "precision", status=result.status, sentence=verdict(got), seed=got.seed,
                         command=command, also=["scipy"] if there() else []), **with_units(body)}


def _entry(e: Entry, off: Mapping[str, float], along: Callable[[str, object], WithUnit]) -> dict[str, Any]:
    """The keys of one contender; `resolved` is false where its largest error may be the reference's own."""
    c = e.contender
    return {
        "name": e.key, "method": c.method, "label": c.label, "substeps": c.substeps, "rtol": c.rtol,
        "ns_per_tick": WithUnit(e.ns_per_tick, "ns"), "runs": e.runs, "status": e.status, "sentence": e.sentence,
        "errors": {name: along(SERIES[name], {**{k: finite(v) for k, v in error._asdict().items()},
                                              "resolved": not error.max <= off[name]})
                   for name, error in e.errors.items()},
        "peak_ratio": WithUnit(e.peak_ratio, "1"), "missed_contacts": e.missed, "beaten_by": e.beaten_by,
    }


class Look(NamedTuple):
    """Colour, marker and line of a method; methods of first order are dashed, scipy's dash-dotted."""

    colour: str
    marker: str
    line: str


LOOKS = {
    "euler": Look(plot.GREY, "v", "--"), "semi_implicit_euler": Look(plot.ORANGE, "^", "--"),
    "verlet": Look(plot.RED, "D", "-"), "rk4": Look(plot.PINK, "s", "-"),
    "backward_euler": Look(plot.BROWN, "o", "--"), "midpoint": Look(plot.SKY, "P", "-"),
    "trapezoid": Look(plot.BLUE, "X", "-"), "sdirk2": Look(plot.GREEN, "h", "-"), "radau": Look(plot.PURPLE, "p", "-"),
    "DOP853": Look(plot.OLIVE, "<", "-."), "LSODA": Look(plot.WINE, ">", "-."), "Radau": Look(plot.BLACK, "d", "-."),
}
ALONG = ("exact", "default", "euler/1", "semi_implicit_euler/1", "rk4/1", "sdirk2/16", "radau/64", "verlet/64")
SIZES = (10.0, 7.0, 5.0, 3.5)  # of the marks, from coarse to fine
PANELS = (("x_s", "x_err", "slave's position", "m"), ("f_env", "f_err", "force on the environment", "N"))


def draw(got: Precision, path: Path, formats: Sequence[str] = plot.PNG) -> list[Path]:
    """Draw `got` into `path` with the suffix of each format, as `save` does; returns the files."""
    by = got.truth.method if not got.truth.estimates else f"scipy's {got.truth.method}, every change of mode located"
    off, axis = got.truth.off, axis_of(got)
    good = f"good to {si(off['x_s'], 'm')}, {si(off['f_env'], 'N')}"
    reference = f"\nreference: {by}, {told_along(good, axis)}"
    scipys = "" if all(e.contender.rtol is None for e in got.entries) else (
        f"; scipy: rtol {', '.join(f'{rtol:.0e}' for rtol in TOLERANCES)}")
    counts = f"({number_of(got.result.ticks, 'tick')}, {number_of(got.contacts, 'contact')})"
    marks = f"marks from large to small: {', '.join(map(str, SUBSTEPS))} sub-steps per tick{scipys}"
    title = f"{plot.literal(heading(got.result))}: error against run time {counts}\n{marks}{reference}"
    figure = plot.new_figure((13.0, 12.0), title)
    upper = figure.add_subfigure((grid := figure.add_gridspec(2, 1, height_ratios=(3, 2)))[0])
    lower = figure.add_subfigure(grid[1])
    work, time = upper.subplots(1, 2), lower.subplots(1, 2, sharex=True)
    for column, (series, track, what, metric) in enumerate(PANELS):
        unit = unit_on(metric, axis)
        _work(work[column], got, series, what, unit)
        _time(time[column], got, series, track, what, unit)
    for part, panels, across in ((upper, work, 5), (lower, time, 4)):
        part.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", frameon=False, fontsize=11,
                    ncols=across)
    return plot.save(figure, path, formats)


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
            axes.scatter([x], [y], marker="*", s=220, color=plot.BLACK, zorder=5, label=e.contender.label)
            axes.axvline(x, color=plot.BLACK, linewidth=0.6, alpha=0.5)
            if got.truth.bound:
                axes.scatter([x], [got.truth.bound[series]], marker="*", s=220, facecolors="none", zorder=5,
                             edgecolors=plot.BLACK, label="its own bound")
            continue
        look = LOOKS[method]
        axes.plot([x for x, _, _ in points], [y for _, y, _ in points], linestyle=look.line, color=look.colour,
                  linewidth=1.1)
        axes.plot([], [], linestyle=look.line, color=look.colour, marker=look.marker, label=entries[0].contender.label)
        for x, y, e in points:
            axes.plot([x], [y], color=look.colour, marker=look.marker, markersize=_mark(e), markeredgecolor="white",
                      markeredgewidth=0.4)
            if e.status == "diverged":
                axes.scatter([x], [y], marker="x", s=110, color=plot.FAILS, zorder=6)
            elif e.missed:
                axes.scatter([x], [y], marker="o", s=150, facecolors="none", edgecolors=plot.FAILS, zorder=6)
    _marks(axes, got)
    if any(e.errors[series].max <= got.truth.off[series] for e in got.entries):
        axes.axhline(got.truth.off[series], color=plot.DARK, linewidth=0.8, linestyle=":",
                     label="reference's own error")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("run time of the whole loop (us per tick)")
    axes.set_ylabel(f"largest error of the {what} ({unit})")
    plot.grid_lines(axes)


def _mark(e: Entry) -> float:
    steps = SUBSTEPS if e.contender.substeps else TOLERANCES
    return SIZES[steps.index(e.contender.substeps or e.contender.rtol or 0.0)]


def _marks(axes: Axes, got: Precision) -> None:
    """The legend's lines for contenders that diverged or missed contacts, and the reference's own error."""
    if any(e.status == "diverged" for e in got.entries):
        axes.scatter([], [], marker="x", s=90, color=plot.FAILS, label="diverged (drawn at the top)")
    if any(e.missed for e in got.entries):
        axes.scatter([], [], marker="o", s=90, facecolors="none", edgecolors=plot.FAILS, label="missed contacts")


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
    axes.plot(t, _above(got.along[track], 0.0), color=plot.BLACK, linewidth=4.0, alpha=0.25,
              label="tracking and transparency")
    some = [e for e in got.entries if e.key in ALONG]
    for i, e in enumerate(some):
        look = LOOKS.get(e.contender.method, Look(plot.BLACK, "", "-"))
        label = f"numerical, {e.contender.label} {e.contender.step}".rstrip()
        width = 0.7 + 0.4 * (len(some) - 1 - i) * (i > 0)
        axes.plot(t, _above(got.along[f"{series}:{e.key}"], got.truth.off[series]), color=look.colour, linewidth=width,
                  zorder=3.0 if i == 0 else 2.0, marker=".", markersize=1.5 * width, label=label)
    axes.set_yscale("log")
    axes.set_xlabel("time (s)")
    axes.set_ylabel(f"error of the {what} ({unit})")
    plot.grid_lines(axes)


def _above(column: Any, least: float) -> Any:
    """The column where it is above `least`, NaN elsewhere."""
    return np.where(column > least, column, np.nan)


def find(args: Namespace) -> Task:
    """Measure the scene's errors against run time. Raises `Refused`."""
    scene = along(load_scene(args.scene, **knobs_from(args)), args.axis)

    def work() -> Answer:
        with shown_for(args) as show:
            precision = measure(scene, seed=args.seed, clock=args.nanoseconds, rounds=args.rounds, show=show)
        return Answer(table(precision), summary(precision, args.typed),
                      files={"errors.npz": partial(write_npz, arrays=precision.along)},
                      plots={"precision": partial(draw, precision)})

    return Task(scene.name, work)


command = command_of(find, "precision")
