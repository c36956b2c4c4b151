"""The plots of a Z-width: the plane of stiffness and damping, impedance over frequency, the levers. Needs `plot`."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

from teleop.analysis.zwidth.plane import passive_line, published_rule
from teleop.analysis.zwidth.report import format_value, numbers
from teleop.terminal.answer import titled
from teleop.terminal.plotting import (
    BLACK,
    BLUE,
    DARK,
    GREEN,
    GREY,
    ORANGE,
    RED,
    SKY,
    UNDER,
    grid_lines,
    literal,
    new_figure,
    save,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from teleop.analysis.zwidth.assess import ZWidth
    from teleop.analysis.zwidth.plane import Boundary

PANELS = (
    ("z_width_1hz", "Z_max - Z_min at 1 Hz (N s/m)"), ("area", "area, 0.1-100 Hz (decades x decades)"),
    ("passive_K", "greatest passive K (N/m)"), ("stable_K_any_B", "greatest stable K at any B (N/m)"),
    ("stable_K", "least unstable K at B = {B:g} N s/m (N/m)"),
    ("K_at_rest", "greatest K at rest at B = {B:g} N s/m (N/m)"),
)


def _new(got: ZWidth, title: str, size: tuple[float, float]) -> Figure:
    heading = f"{titled(got.scene)}: {title}"
    return new_figure(size, literal(heading + " (interrupted)" * got.interrupted))


def _plane(got: ZWidth, path: Path, formats: Sequence[str]) -> list[Path]:
    """The whole stable region; beside it its corner with the passive one, which the whole is too large to show."""
    import numpy as np
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
        grid_lines(axes)
    low_B, low_K = got.span_B.low, got.span_K.low
    whole.add_patch(Rectangle((low_B, low_K), near_B - low_B, near_K - low_K, fill=False, edgecolor=BLACK,
                              linewidth=1.2, zorder=3, label="the part that is shown on the right", clip_on=False))
    if not region.corners:
        corner.text(0.97, 0.03, "no K or B above 0 is passive", transform=corner.transAxes, ha="right", color=RED)
    handles, labels = whole.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return save(figure, path, formats)


def _regions(axes: Axes, got: ZWidth, far_B: float, far_K: float) -> None:
    import numpy as np

    B = np.linspace(0.0, far_B, 400)
    edge = got.stable or got.stable_free
    if edge is not None:
        capped = np.minimum(edge.K, 1e12)
        axes.fill_between(edge.B, 0.0, capped, color=SKY, alpha=0.15, linewidth=0.0)
    _edge(axes, got.stable, "stable below: exact sampled loop, with the scene's hand", UNDER)
    _edge(axes, got.stable_free, "stable below: the same, free handle", {"linestyle": "--", "linewidth": 1.2})
    corners = got.base.region.corners
    if corners:
        shape = np.array([(0.0, 0.0), *corners])
        axes.fill(shape[:, 1], shape[:, 0], color=GREEN, alpha=0.45, linewidth=1.5, label="passive, to any hand")
    axes.plot(B, passive_line(got.scene, B), color=BLACK, linestyle=":", linewidth=1.3,
              label="K T/2 + B = b, no delay (Colgate & Schenkel 1997)")
    axes.plot(B, published_rule(got.scene, B), color=ORANGE, linestyle="-.", linewidth=1.3,
              label="K = (b + B)/(T/2 + $t_d$) (Gil, Hulin et al. 2009)")
    rested = [(B, K) for B, K in got.measured if K is not None and isfinite(K)]
    if rested:
        axes.plot(*zip(*rested, strict=True), color=RED, marker="o", markersize=4.5, linestyle="none",
                  label="measured: at rest up to here, in virtual time")
    own_K, own_B = got.scene.law.K, got.scene.law.B
    seen = got.span_K.low <= own_K <= far_K and got.span_B.low <= own_B <= far_B  # whole even on the axes' edge
    axes.plot([own_B], [own_K], marker="*", markersize=11, color=BLACK, linestyle="none",
              label="the scene's own K and B", clip_on=not seen)


def _edge(axes: Axes, edge: Boundary | None, label: str, shown: dict[str, Any]) -> None:
    if edge is not None:
        some = [(B, K) for B, K in zip(edge.B, edge.K, strict=True) if isfinite(K)]
        axes.plot([B for B, _ in some], [K for _, K in some], color=BLUE, label=label, **shown)


def _impedance(got: ZWidth, path: Path, formats: Sequence[str]) -> list[Path]:
    """Both curves, and what lies between them."""
    import numpy as np

    c = got.base.curves
    wide = "no upper curve is claimed" if c.area is None else (
        f"Z-width {format_value(c.width)} N s/m at 1 Hz, area {c.area:.3g} decades x decades")
    figure = _new(got, wide, (9.0, 5.4))
    axes = figure.subplots()
    shown = c.upper is not None and bool((c.upper > 0.0).any())
    if c.upper is not None and shown:
        axes.plot(c.frequency, c.upper, color=GREEN, linewidth=1.6, label="$Z_{max}$: the greatest passive |K/s + B|")
        axes.fill_between(c.frequency, c.lower, c.upper, where=c.upper > c.lower, color=GREEN, alpha=0.15,
                          linewidth=0.0)
        high = c.at_one[0]
        if high is not None and c.width:
            axes.annotate("", (1.0, high), (1.0, c.at_one[1]), arrowprops={"arrowstyle": "<->", "color": GREY})
            axes.annotate(f"{c.width:.4g} N s/m", (1.08, float(np.sqrt(high * c.at_one[1]))), color=DARK, fontsize=9)
    elif c.upper is not None:
        axes.text(0.5, 0.9, "no K or B above 0 is passive", transform=axes.transAxes, ha="center", color=RED)
    axes.plot(c.frequency, c.lower, color=BLUE, linewidth=1.6, label="$Z_{min}$: the device alone")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(c.frequency[0], c.frequency[-1])
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("impedance (N s/m)")
    grid_lines(axes)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return save(figure, path, formats)


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
            axes.barh(i, value if sound else 0.0, color=GREY if i == 0 else SKY, height=0.66)
            text = format_value(value) if value is not None else "not claimed" if "rest" not in key else "-"
            axes.text((value if sound and value is not None else 0.0) + 0.015 * most, i, text, va="center", fontsize=8)
        if values and values[0]:
            axes.axvline(values[0], color=GREY, linewidth=0.8, linestyle="--")
        axes.set_xlim(0.0, 1.22 * most)
        axes.set_title(title.format(B=got.scene.law.B), fontsize=9)
        axes.set_yticks(range(len(rows)), [row.name for row in rows], fontsize=9)
        axes.tick_params(axis="x", labelsize=8)
        axes.locator_params(axis="x", nbins=5)
        axes.grid(visible=True, axis="x", linewidth=0.4, alpha=0.5)
        axes.set_axisbelow(True)
    every[0, 0].invert_yaxis()
    return save(figure, path, formats)


PLOTS = {"plane": _plane, "impedance": _impedance, "levers": _levers}  # each draws as `save` does
