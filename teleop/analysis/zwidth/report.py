"""The command `teleop zwidth`: its answer as a table, as a JSON document and as plots.

Plots: the plane of stiffness and damping, impedance over frequency, the levers. Ctrl-C keeps what is done.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Sequence
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from teleop.analysis.models.by_axis import along
from teleop.analysis.zwidth.assess import LeverRow, ZWidth, assess, span
from teleop.analysis.zwidth.plane import Boundary, passive_line, published_rule
from teleop.scene.axes import labels_of, unit_on
from teleop.scene.loading import load_scene
from teleop.terminal import plotting as plot
from teleop.terminal.answer import Answer, Task, WithUnit, command_of, finite, scene_head, titled, with_units
from teleop.terminal.options import DONE, INTERRUPTED, knobs_from
from teleop.terminal.progress import shown_for
from teleop.terminal.table import columns, facts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class LeverColumn(NamedTuple):
    """A metric of the levers: its key in the JSON, its head in the table and its unit along a line."""

    key: str
    head: str
    unit: str


METRICS = (
    LeverColumn("z_width_1hz", "Z-width 1 Hz", "N s/m"), LeverColumn("area", "area", "decades x decades"),
    LeverColumn("passive_K", "passive K", "N/m"), LeverColumn("passive_B", "passive B", "N s/m"),
    LeverColumn("stable_K_any_B", "stable K", "N/m"), LeverColumn("stable_K", "at own B", "N/m"),
    LeverColumn("K_at_rest", "at rest", "N/m"),
)
UNITS = {metric.key: metric.unit for metric in METRICS} | {
    "stable_K_free": "N/m", "z_max_1hz": "N s/m", "z_min_1hz": "N s/m", "gap": "decades",
}
MEANING = {
    "z_width_1hz": "Z_max - Z_min at 1 Hz, 0 where nothing wider than the device is passive",
    "area": "integral of log10(Z_max/Z_min) over log10 f, 0.1 to 100 Hz or half the rate, where above 0",
    "gap": "area over the decades of frequency",
    "passive_K": "greatest K of the passive region at any B", "passive_B": "greatest B of it at any K",
    "stable_K": "least unstable K of the linear loop at the scene's own B, with its hand",
    "stable_K_free": "the same without a hand",
    "stable_K_any_B": "the same with the hand, if there is one, at the B where it is greatest",
    "K_at_rest": "greatest K that came to rest in virtual time at the scene's own B",
    "null": "not claimed, not looked at, or none in the range", "beyond": "no limit within the range looked at",
    "ratio": "to the scene as it is",
}


def numbers(row: LeverRow) -> dict[str, float | None]:
    """A row's metrics by their keys."""
    c = row.curves
    return {
        "z_max_1hz": c.at_one[0], "z_min_1hz": c.at_one[1], "z_width_1hz": c.width, "area": c.area, "gap": c.gap,
        "passive_K": row.region.stiffest, "passive_B": row.region.most_damped, "stable_K": row.stable,
        "stable_K_free": row.stable_free, "stable_K_any_B": row.stable_any, "K_at_rest": row.rest,
    }


def ratios(row: LeverRow, base: LeverRow) -> dict[str, float | None]:
    """A row's metrics over those of the scene as it is; None where there is no such ratio."""
    base_values = numbers(base)
    factors: dict[str, float | None] = {}
    for key, value in numbers(row).items():
        before = base_values[key]
        comparable = value is not None and isfinite(value) and before and isfinite(before)
        factors[key] = value / before if comparable and value is not None and before else None
    return factors


def table(got: ZWidth) -> str:
    """The levers as lines, the factor to the scene as it is behind each number, and below what it all is."""
    if not got.rows:
        return facts(_facts(got))
    head = ("", *(metric.head for metric in METRICS))
    unit = ("", *(metric.unit.replace("decades x decades", "dec^2") for metric in METRICS))
    body = [(row.name, *_cells(row, got.base, first=i == 0)) for i, row in enumerate(got.rows)]
    return f"{columns([head, unit, *body])}\n\n{facts(_facts(got))}"


def _cells(row: LeverRow, base: LeverRow, *, first: bool) -> Iterator[str]:
    values, times = numbers(row), ratios(row, base)
    for metric in METRICS:
        value, factor = values[metric.key], times[metric.key]
        behind = " " * 7 if first or factor is None else f" x{factor:<5.3g}"
        yield format_value(value) + behind


def format_value(value: float | None) -> str:
    """A number to four digits; a dash for None, words for what has no limit."""
    if value is None:
        return "-"
    if not isfinite(value):
        return "no limit"
    return f"{float(f'{value:.4g}'):.0f}" if 1e4 <= value < 1e8 else f"{value:.4g}"


def _facts(got: ZWidth) -> Iterator[tuple[str, str]]:
    if got.interrupted:
        yield "interrupted", "what was done until then is here, the rest is missing"
    yield "scene", f"{titled(got.scene)}, own K {got.scene.law.K:g} N/m, own B " \
                   f"{got.scene.law.B:g} N s/m"
    if not got.rows:
        return
    base = got.base
    low, high = base.curves.at_one[1], base.curves.at_one[0]
    wide = "" if base.curves.width is None else f", Z-width {base.curves.width:.4g} N s/m"
    yield "at 1 Hz", f"Z_max {format_value(high)}, Z_min {format_value(low)} N s/m{wide}"
    if base.curves.area is not None:
        yield "0.1-100 Hz", f"area {base.curves.area:.4g} decades of impedance times decades of frequency, a gap of " \
                            f"{base.curves.gap:.4g} decades on average"
    yield "passive", base.region.sentence
    free = "" if base.stable_free is None else f"; there with a free handle {format_value(base.stable_free)} N/m"
    yield "stable K", f"of the linear loop at the B where it is greatest, then at the scene's own B{free}"
    if got.measured:
        limits = ", ".join(f"{B:.3g}: {format_value(K)}" for B, K in got.measured)
        yield "at rest", f"in virtual time, at B = {limits} N/m"
    for row in got.rows[1:]:
        yield row.name, row.what + ("; " + row.region.sentence if row.region.corners is None
                                    and row.region.sentence != base.region.sentence else "")
    for note in got.notes:
        yield "note", note


def summary(got: ZWidth, command: Sequence[str] = ()) -> dict[str, Any]:
    """The JSON document; what does not exist is null."""
    sentence = got.base.region.sentence if got.rows else "interrupted before anything was found"
    axis = labels_of(got.scene).units_for(got.scene.axes)[0]
    stiffness, damping = unit_on("N/m", axis), unit_on("N s/m", axis)

    def boundary(edge: Boundary | None) -> dict[str, Any] | None:
        return edge and {"B": WithUnit(list(edge.B), damping), "K": WithUnit([finite(K) for K in edge.K], stiffness)}

    body = {
        "meaning": MEANING,
        "range": {"K": WithUnit(list(got.span_K), stiffness), "B": WithUnit(list(got.span_B), damping)},
        "stable": {"hand": boundary(got.stable), "free": boundary(got.stable_free)},
        "measured": [{"B": WithUnit(B, damping), "K": WithUnit(finite(K), stiffness)} for B, K in got.measured],
        "levers": [_row(row, got.base, axis) for row in got.rows], "notes": list(got.notes),
    }
    if got.rows:
        region, curves = got.base.region, got.base.curves
        body |= {
            "passive": {"corners": None if region.corners is None else [[0.0, 0.0], *map(list, region.corners)],
                        "sentence": region.sentence},
            "impedance": {"frequency": WithUnit(curves.frequency.tolist(), "Hz"),
                          "upper": WithUnit(None if curves.upper is None else curves.upper.tolist(), damping),
                          "lower": WithUnit(curves.lower.tolist(), damping)},
            **_with_units(numbers(got.base), axis),
        }
    return {**scene_head(got.scene, "zwidth", status="interrupted" if got.interrupted else "done", sentence=sentence,
                         seed=got.seed, command=command), **with_units(body)}


def _row(row: LeverRow, base: LeverRow, axis: str) -> dict[str, Any]:
    values = numbers(row)
    return {
        "name": row.name, "what": row.what, **_with_units(values, axis),
        "beyond": [key for key, value in values.items() if value is not None and not isfinite(value)],
        "ratio": WithUnit(ratios(row, base), "1"), "sentence": row.region.sentence,
    }


def _with_units(values: dict[str, float | None], axis: str) -> dict[str, WithUnit]:
    return {key: WithUnit(finite(value), unit_on(UNITS[key], axis)) for key, value in values.items()}


PANELS = (
    ("z_width_1hz", "Z_max - Z_min at 1 Hz (N s/m)"), ("area", "area, 0.1-100 Hz (decades x decades)"),
    ("passive_K", "greatest passive K (N/m)"), ("stable_K_any_B", "greatest stable K at any B (N/m)"),
    ("stable_K", "least unstable K at B = {B:g} N s/m (N/m)"),
    ("K_at_rest", "greatest K at rest at B = {B:g} N s/m (N/m)"),
)


def _new(got: ZWidth, title: str, size: tuple[float, float]) -> Figure:
    heading = f"{titled(got.scene)}: {title}"
    return plot.new_figure(size, plot.literal(heading + " (interrupted)" * got.interrupted))


def _plane(got: ZWidth, path: Path, formats: Sequence[str]) -> list[Path]:
    """The whole stable region; beside it its corner with the passive one, which the whole is too large to show."""
    from matplotlib.patches import Rectangle

    figure = _new(got, "stable and passive stiffness and damping", (12.0, 6.2))
    whole, corner = figure.subplots(1, 2)
    region = got.base.region
    edges = [edge for edge in (got.stable, got.stable_free) if edge is not None]
    b, line = got.scene.master.damping, float(passive_line(got.scene, np.zeros(1))[0])
    rested = [(B, K) for B, K in got.measured if K and isfinite(K)]
    far_B = got.span_B.high or 1.05 * max([edge.B[-1] for edge in edges] + [2.0 * b, *(B for B, _ in rested)])
    edge_K = [K for edge in edges for K in edge.K if isfinite(K)]
    far_K = got.span_K.high or 1.08 * max([*edge_K, region.stiffest or 0.0, *(K for _, K in rested)])
    far_B, far_K = far_B or 1.0, far_K or line or 1.0
    near_B = min(2.5 * (region.most_damped or b) or far_B, far_B)
    near_K = max(2.5 * (region.stiffest or line), 1.15 * max([K for B, K in rested if near_B >= B], default=0.0))
    near_K = min(near_K or far_K, far_K)
    for axes, B, K, words in ((whole, far_B, far_K, "the whole stable region"),
                              (corner, near_B, near_K, "its corner with the passive region")):
        _regions(axes, got, B, K)
        axes.set_xlim(got.span_B.low, B)
        axes.set_ylim(got.span_K.low, K)
        axes.set_title(words, fontsize=10)
        axes.set_xlabel("virtual damping B (N s/m)")
        axes.set_ylabel("virtual stiffness K (N/m)")
        plot.grid_lines(axes)
    low_B, low_K = got.span_B.low, got.span_K.low
    whole.add_patch(Rectangle((low_B, low_K), near_B - low_B, near_K - low_K, fill=False, edgecolor=plot.BLACK,
                              linewidth=1.2, zorder=3, label="the part that is shown on the right", clip_on=False))
    if not region.corners:
        corner.text(0.97, 0.03, "no K or B above 0 is passive", transform=corner.transAxes, ha="right", color=plot.RED)
    handles, labels = whole.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return plot.save(figure, path, formats)


def _regions(axes: Axes, got: ZWidth, far_B: float, far_K: float) -> None:
    B = np.linspace(0.0, far_B, 400)
    edge = got.stable or got.stable_free
    if edge is not None:
        capped = np.minimum(edge.K, 1e12)
        axes.fill_between(edge.B, 0.0, capped, color=plot.SKY, alpha=0.15, linewidth=0.0)
    _edge(axes, got.stable, "stable below: exact sampled loop, with the scene's hand", plot.UNDER)
    _edge(axes, got.stable_free, "stable below: the same, free handle", {"linestyle": "--", "linewidth": 1.2})
    corners = got.base.region.corners
    if corners:
        shape = np.array([(0.0, 0.0), *corners])
        axes.fill(shape[:, 1], shape[:, 0], color=plot.GREEN, alpha=0.45, linewidth=1.5, label="passive, to any hand")
    axes.plot(B, passive_line(got.scene, B), color=plot.BLACK, linestyle=":", linewidth=1.3,
              label="K T/2 + B = b, no delay (Colgate & Schenkel 1997)")
    axes.plot(B, published_rule(got.scene, B), color=plot.ORANGE, linestyle="-.", linewidth=1.3,
              label="K = (b + B)/(T/2 + $t_d$) (Gil, Hulin et al. 2009)")
    rested = [(B, K) for B, K in got.measured if K is not None and isfinite(K)]
    if rested:
        axes.plot(*zip(*rested, strict=True), color=plot.RED, marker="o", markersize=4.5, linestyle="none",
                  label="measured: at rest up to here, in virtual time")
    own_K, own_B = got.scene.law.K, got.scene.law.B
    seen = got.span_K.low <= own_K <= far_K and got.span_B.low <= own_B <= far_B  # whole even on the axes' edge
    axes.plot([own_B], [own_K], marker="*", markersize=11, color=plot.BLACK, linestyle="none",
              label="the scene's own K and B", clip_on=not seen)


def _edge(axes: Axes, edge: Boundary | None, label: str, shown: dict[str, Any]) -> None:
    if edge is not None:
        some = [(B, K) for B, K in zip(edge.B, edge.K, strict=True) if isfinite(K)]
        axes.plot([B for B, _ in some], [K for _, K in some], color=plot.BLUE, label=label, **shown)


def _impedance(got: ZWidth, path: Path, formats: Sequence[str]) -> list[Path]:
    """Both curves, and what lies between them."""
    c = got.base.curves
    wide = "no upper curve is claimed" if c.area is None else (
        f"Z-width {format_value(c.width)} N s/m at 1 Hz, area {c.area:.3g} decades x decades")
    figure = _new(got, wide, (9.0, 5.4))
    axes = figure.subplots()
    shown = c.upper is not None and bool((c.upper > 0.0).any())
    if c.upper is not None and shown:
        axes.plot(c.frequency, c.upper, color=plot.GREEN, linewidth=1.6,
                  label="$Z_{max}$: the greatest passive |K/s + B|")
        axes.fill_between(c.frequency, c.lower, c.upper, where=c.upper > c.lower, color=plot.GREEN, alpha=0.15,
                          linewidth=0.0)
        high = c.at_one[0]
        if high is not None and c.width:
            axes.annotate("", (1.0, high), (1.0, c.at_one[1]), arrowprops={"arrowstyle": "<->", "color": plot.GREY})
            axes.annotate(f"{c.width:.4g} N s/m", (1.08, float(np.sqrt(high * c.at_one[1]))), fontsize=9,
                          color=plot.DARK)
    elif c.upper is not None:
        axes.text(0.5, 0.9, "no K or B above 0 is passive", transform=axes.transAxes, ha="center", color=plot.RED)
    axes.plot(c.frequency, c.lower, color=plot.BLUE, linewidth=1.6, label="$Z_{min}$: the device alone")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(c.frequency[0], c.frequency[-1])
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("impedance (N s/m)")
    plot.grid_lines(axes)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return plot.save(figure, path, formats)


def _levers(got: ZWidth, path: Path, formats: Sequence[str]) -> list[Path]:
    """A bar for each lever and metric; the line is the scene as it is."""
    rows = got.rows
    panels = [(title, [numbers(row)[key] for row in rows], key) for key, title in PANELS]
    tops = [max([value for value in values if value is not None and isfinite(value)], default=0.0)
            for _, values, _ in panels]
    panels = [one for one, most in zip(panels, tops, strict=True) if most > 0.0] or panels[:1]
    lines = 1 if len(panels) <= 3 else 2
    figure = _new(got, "one lever at a time", (13.0, max(4.5, lines * (1.2 + 0.33 * len(rows)))))
    every: Any = figure.subplots(lines, -(-len(panels) // lines), sharey=True, squeeze=False)
    for axes in every.ravel()[len(panels):]:
        axes.set_axis_off()
    for axes, (title, values, key) in zip(every.ravel(), panels, strict=False):
        most = max([value for value in values if value is not None and isfinite(value)], default=0.0) or 1.0
        for i, value in enumerate(values):
            sound = value is not None and isfinite(value)
            axes.barh(i, value if sound else 0.0, color=plot.GREY if i == 0 else plot.SKY, height=0.66)
            text = format_value(value) if value is not None else "not claimed" if "rest" not in key else "-"
            axes.text((value if sound and value is not None else 0.0) + 0.015 * most, i, text, va="center", fontsize=8)
        if values and values[0]:
            axes.axvline(values[0], color=plot.GREY, linewidth=0.8, linestyle="--")
        axes.set_xlim(0.0, 1.22 * most)
        axes.set_title(title.format(B=got.scene.law.B), fontsize=9)
        axes.set_yticks(range(len(rows)), [row.name for row in rows], fontsize=9)
        axes.tick_params(axis="x", labelsize=8)
        axes.locator_params(axis="x", nbins=5)
        axes.grid(visible=True, axis="x", linewidth=0.4, alpha=0.5)
        axes.set_axisbelow(True)
    every[0, 0].invert_yaxis()
    return plot.save(figure, path, formats)


PLOTS = {"plane": _plane, "impedance": _impedance, "levers": _levers}  # each draws as `save` does


def find(args: Namespace) -> Task:
    """Find the scene's Z-width. An interrupt leaves what was found until then.

    Raises `Refused`, and the task KeyboardInterrupt if nothing was found yet.
    """
    scene = along(load_scene(args.scene, **knobs_from(args)), args.axis)
    span_K, span_B = span("--range-k", args.range_k), span("--range-b", args.range_b)

    def work() -> Answer:
        with shown_for(args) as show:
            z_width = assess(scene, span_K=span_K, span_B=span_B, seed=args.seed, show=show)
        return Answer(table(z_width), summary(z_width, args.typed), INTERRUPTED if z_width.interrupted else DONE,
                      plots={name: partial(draw, z_width) for name, draw in PLOTS.items()})

    return Task(scene.name, work)


command = command_of(find, "zwidth")
