"""A metric of a sweep over one knob: medians over the seeds, with their quartiles."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from teleop.report import svg
from teleop.report.knobs import axis_of, plain
from teleop.report.markup import Markup
from teleop.report.scales import Axis, along, around
from teleop.report.style import LINES
from teleop.sweeps.pictures.layout import PlottedKnob, groups_of, spacing, spread, text_of

if TYPE_CHECKING:
    from teleop.sweeps.pictures.layout import Panel
    from teleop.sweeps.table import Table

CURVES = 5  # lines in a panel


def curves(rows: Table, panels: Sequence[Panel], knobs: Sequence[PlottedKnob], metric: str, measured: str
           ) -> tuple[Markup, str]:
    """Medians of the runs that ended ok, over the seeds, with their quartiles; a cross where not every run did."""
    import numpy as np

    x, by = knobs[0], knobs[1] if len(knobs) > 1 else None
    shown = [0] if by is None else spread(len(by.values), CURVES)
    told: list[list[tuple[str, str, list[float], Any, list[int]]]] = []
    for panel in panels:
        told.append([])
        for i, place in enumerate(shown):
            own = panel.rows if by is None else panel.rows[by.place[panel.rows] == place]
            if not len(own):
                continue
            ok = rows["status"][own] == "ok"
            groups = groups_of(rows[metric][own], x.place[own], ok, len(x.values))
            three = np.array([np.quantile(each, (0.25, 0.5, 0.75)) if len(each) else [np.nan] * 3 for each in groups])
            at = [float(value) for value in x.values] if x.numeric else [float(j) for j in range(len(x.values))]
            name = "" if by is None else f"{by.name} {text_of(by.values[place])}"
            told[-1].append((LINES[i % len(LINES)], name, at, three, sorted({*x.place[own][~ok].tolist()})))
    every = np.concatenate([three.ravel() for lines in told for *_, three, _ in lines] or [np.array([])])
    every = every[np.isfinite(every) & (np.abs(every) < 1e30)]
    kind, bend = spacing(every) if len(every) else ("linear", 0.0)
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)
    y = around(low, high) if kind == "linear" or not high > low else along([low, high], kind, bend)
    axis = axis_of(x) if x.numeric else Axis(-0.5, len(x.values) - 0.5)
    texts = None if x.numeric else [text_of(value)[:16] for value in x.values]
    boxes, total = svg.grid_of(len(panels), 3, 180.0, top=2.0 * svg.TITLE + 12.0, apart=svg.TITLE + 8.0, below=32.0)
    parts = [svg.label(12.0, 11.0, measured, style="b"),
             svg.legend([*dict.fromkeys((f"l {style}", name) for lines in told for style, name, *_ in lines if name)],
                        svg.WIDTH - svg.RIGHT, 11.0)]
    for i, (box, panel, lines) in enumerate(zip(boxes, panels, told, strict=True)):
        parts.append(svg.frame(box, axis, y, title=plain(panel.title), x_texts=texts, y_labels=i % 3 == 0,
                               x_labels=i + 3 >= len(panels)))
        for style, name, at, three, bad in lines:
            points = [(axis.at(a), *[y.at(float(v)) for v in row]) for a, row in zip(at, three, strict=True)
                      if np.isfinite(row).all() and np.abs(row).max() < 1e30]
            if x.numeric:
                parts.append(svg.segments([(a[0], a[2], b[0], b[2]) for a, b in pairwise(points)],
                                          box, f"l {style}"))
            parts += [svg.segments([(a, low_, a, high_) for a, low_, _, high_ in points if high_ > low_], box,
                                   f"l w {style}"),
                      svg.dots([(a, v, f"{name} {m:.4g}".strip()) for (a, _, v, _), m in zip(
                          points, [float(row[1]) for row in three if np.isfinite(row).all()], strict=False)], box,
                          style, 2.4)]
            parts.append(svg.crosses([(axis.at(at[place]), 0.03) for place in bad], box))
    below = f"{x.name} ({x.unit})" if x.unit else x.name
    crossed = "; a cross: not every run ended ok" if any(bad for lines in told for *_, bad in lines) else ""
    parts.append(svg.label(svg.WIDTH - svg.RIGHT, total - 5.0, below + crossed, anchor="end"))
    left = f"{len(shown)} of {len(by.values)} values of {by.name}" if by is not None and len(shown) < len(by.values) \
        else ""
    return svg.figure(f"{metric} over {x.name}", f"Medians of the runs that ended ok, from {low:.4g} to {high:.4g}.",
                      total, *parts), left
