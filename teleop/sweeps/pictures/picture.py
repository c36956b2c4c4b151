"""Pictures of a sweep: where it is stable over two knobs, a metric over two knobs, a metric over one. Needs `plot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from teleop.errors import Refused, nearest, number_of
from teleop.sweeps.pictures.layout import (
    OTHER,
    STATUS,
    TEXTS,
    WITHOUT,
    Panel,
    PlottedKnob,
    axes_knobs_of,
    gradient_map,
    groups_of,
    pairs_of,
    panels_of,
    scale,
    spacing,
    spread,
    text_of,
    varying,
    with_unit,
)
from teleop.sweeps.table import Table
from teleop.terminal import plotting as plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


EDGE = "#0B0B0B"  # on cells: dark, also where a page makes black light
WIDEST, ALONG, LEVELS = 10.0, 96, 64  # of a page: inches, cells along an axis, and colours of numbers
CELLS = 4_000_000  # of a map; of more, which no picture has room for, the points are drawn as those of a sample
VECTOR_CELLS = 10_000  # of a map in a vector format; more are an image in it, for each is a path that a reader draws


def _edges(axis: Any, values: tuple[Any, ...]) -> NDArray[Any]:
    """The edges of cells: midway between neighbours on the axis as drawn; the outer cells end at the outer values.

    So the map ends where the grid does: nothing was run beyond, and there may be nothing, as with a delay below 0.
    """
    scale_of_axis = axis.get_transform()
    at = scale_of_axis.transform(np.array(values, dtype=float))
    middle = scale_of_axis.inverted().transform((at[1:] + at[:-1]) / 2.0)
    return np.concatenate([values[:1], middle, values[-1:]])


@dataclass(frozen=True, kw_only=True, slots=True)
class MapPoints:
    """Outcome of the rows at each point of a panel that has any."""

    x: NDArray[Any]  # (points,) the place of the value of each knob
    y: NDArray[Any]
    status: NDArray[Any]  # of all its rows, or "" where they differ
    share: NDArray[Any]  # of those rows that ran, how many ended ok; NaN where none ran
    value: NDArray[Any]  # what colours it: the share, or the median of the metric over the rows that ended ok


def map_points(table: Table, rows: NDArray[Any], x: PlottedKnob, y: PlottedKnob, metric: str | None) -> MapPoints:
    """Outcome of `rows` over the knobs x and y: their status, and the metric if one is shown."""
    at, where = np.unique(x.place[rows] * len(y.values) + y.place[rows], return_inverse=True)
    status = table["status"][rows]
    ok = status == "ok"
    ran = np.bincount(where[status != "refused"], minlength=len(at))
    share = np.divide(np.bincount(where[ok], minlength=len(at)), ran, out=np.full(len(at), np.nan), where=ran > 0)
    one = np.full(len(at), "", dtype=object)
    one[where] = status
    one[np.unique(where[one[where] != status])] = ""
    value = share if metric is None else np.array(
        [np.median(each) if len(each) else np.nan for each in groups_of(table[metric][rows], where, ok, len(at))])
    return MapPoints(x=at // len(y.values), y=at % len(y.values), status=one, share=share, value=value)


def draw_maps(
    figure: Figure, shown: list[tuple[Axes, Panel]], table: Table, knobs: list[PlottedKnob], metric: str | None,
    words: Mapping[str, str], measured: str, page: bool,
) -> str:
    """Coloured cells by status, by share of runs that end ok, or by a metric; the boundary. What was left out.

    `words` are what the legend says of a status, `measured` the metric with its unit; `page`: see `picture_of`.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    x, y = knobs
    most = ALONG if page else max(len(x.values), len(y.values))
    maps = [map_points(table, panel.rows, x, y, metric) for _, panel in shown]
    cells = len(x.values) * len(y.values)
    sampled = cells > CELLS or all(len(one.x) <= 2 * max(len(x.values), len(y.values)) < cells for one in maps)
    by_status = metric is None and all((one.status != "").all() for one in maps)
    norm, colours = Normalize(0.0, 1.0), LinearSegmentedColormap.from_list("share", (plot.RED, "#F5EFE6", plot.SKY))
    if metric is not None:
        values = np.concatenate([one.value for one in maps])
        norm, colours = _norm(values[np.isfinite(values)]), gradient_map()
    if page:
        colours = colours.resampled(LEVELS)
    drawn: set[str] = set()
    edged = False
    for (axes, panel), one in zip(shown, maps, strict=True):
        scale(axes, "x", x.values)
        scale(axes, "y", y.values)
        known = np.isfinite(one.value)
        labels = one.status if by_status else np.select(
            [known, np.isnan(one.share), one.share == 0.0], ["", *WITHOUT[:2]], WITHOUT[2])
        paint = np.array(colours(norm(np.ma.masked_invalid(one.value))))
        for word in {*labels.tolist()} - {""}:
            drawn.add(word)
            paint[labels == word] = to_rgba(STATUS.get(word, OTHER))
        edged |= _place(axes, x, y, one, paint, sampled, most)
        ended = float((table["status"][panel.rows] == "ok").mean())
        between = "" if not panel.title else "\n" if "\n" in panel.title else ": "
        axes.set_title(f"{panel.title}{between}{100.0 * ended:.3g} % ok", fontsize=10)
    shown_words = sorted(drawn, key=[*STATUS, *sorted(drawn)].index)
    handles: list[Any] = [Line2D([], [], marker="s", markersize=9, linestyle="none", color=STATUS.get(word, OTHER))
                          for word in shown_words]
    labels_shown = [plot.literal(words.get(word, word), most=80) for word in shown_words]
    if edged:
        handles.append((Patch(color=plot.PALE), Line2D([], [], color=EDGE, linewidth=1.4)))
        labels_shown.append("boundary" if by_status else "half of the runs end ok")
    if handles:
        figure.legend(handles, labels_shown, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    if not by_status:
        label = f"share of runs that end {words.get('ok', 'ok')}"
        if metric is not None:
            label = plot.literal(f"{measured}, median of the runs ok")
        figure.colorbar(ScalarMappable(norm, colours), ax=[axes for axes, _ in shown], label=label)
    return ", ".join(f"{most} of {len(knob.values)} values of {knob.name}" for knob in knobs
                     if len(knob.values) > most and not sampled)


def _norm(values: NDArray[Any]) -> Any:
    """From the least to the greatest value, by ratios where they are far apart."""
    from matplotlib.colors import LogNorm, Normalize, SymLogNorm

    if not len(values):
        return Normalize(0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    scaled, linear = spacing(values)
    if scaled == "symlog":
        return SymLogNorm(linear, linscale=0.5, vmin=low, vmax=high)
    return (LogNorm if scaled == "log" else Normalize)(low, high)


def _place(axes: Axes, x: PlottedKnob, y: PlottedKnob, points: MapPoints, paint: NDArray[Any], sampled: bool,
           most: int) -> bool:
    """Colour the points: cells of a grid, with the boundary between them, or dots; True if there is a boundary."""
    from matplotlib.collections import LineCollection

    if sampled:
        axes.scatter(np.array(x.values)[points.x], np.array(y.values)[points.y], s=22.0, c=paint,
                     edgecolors=plot.BLACK, linewidths=0.3)
        return False
    columns, rows = spread(len(x.values), most), spread(len(y.values), most)
    across = _edges(axes.xaxis, tuple(x.values[i] for i in columns))
    up = _edges(axes.yaxis, tuple(y.values[i] for i in rows))
    picture, good = np.ones((len(y.values), len(x.values), 4)), np.full((len(y.values), len(x.values)), np.nan)
    picture[points.y, points.x] = paint
    good[points.y, points.x] = np.where(np.isfinite(points.share), points.share >= 0.5, np.nan)
    picture, good = picture[np.ix_(rows, columns)], good[np.ix_(rows, columns)]
    axes.pcolormesh(across, up, picture, shading="flat", rasterized=picture.size > 4 * VECTOR_CELLS)
    axes.set_xlim(across[0], across[-1])
    axes.set_ylim(up[0], up[-1])
    axes.set_facecolor("white")
    lines = [((across[i + 1], up[j]), (across[i + 1], up[j + 1])) for j, i in np.argwhere(np.abs(np.diff(good)) > 0.0)]
    lines += [((across[i], up[j + 1]), (across[i + 1], up[j + 1]))
              for j, i in np.argwhere(np.abs(np.diff(good, axis=0)) > 0.0)]
    axes.add_collection(LineCollection(lines, colors=EDGE, linewidths=1.4, capstyle="projecting"), autolim=False)
    return bool(lines)


KINDS = ("stability", "metric", "curves")
LINES = 7  # at most, in one panel


def draw(
    table: Table, path: Path, kind: str | None = None, *, metric: str | None = None, title: str = "",
    units: Mapping[str, str] | None = None, words: Mapping[str, str] | None = None, formats: Sequence[str] = plot.PNG,
) -> list[Path]:
    """Draw `table` into `path` with the suffix of each of `formats`, as `save` does; returns the files.

    The rest is as in `picture_of`, under a `title`. Raises `Refused` as it does, and if the file cannot be written.
    """
    figure, remarks = picture_of(table, kind, metric, units or {}, words or {})
    ended = ", ".join(f"{count} {status}" for status, count in table.counts().items())
    heading = (title, f"{number_of(len(table), 'row')}: {ended}", *remarks)
    figure.suptitle(plot.literal(" · ".join(part for part in heading if part)), fontsize=11)
    return plot.save(figure, path, formats)


def picture_of(table: Table, kind: str | None, metric: str | None, units: Mapping[str, str],
               words: Mapping[str, str], *, page: bool = False) -> tuple[Figure, list[str]]:
    """The picture of `table`, and what is to be said of it.

    `kind`: "stability" (two knobs as axes, cells coloured by status, or by the share of seeds that end ok, and the
    boundary between them), "metric" (the median over the seeds that end ok), "curves" (a metric over one knob, with
    its quartiles and extremes over the seeds; a line for each value of another). None: of two knobs with numbers a
    map, of the metric if that is given or every row ended ok, else of stability; of one curves. Knobs left over have
    a panel for each value. `metric` is one of `table.metrics`, left out the first. `units` are those of knobs and
    metrics, `words` what the legend says of a status. Points without a grid (a random sample) are drawn as such.
    `page`: it is not wider than `WIDEST`, has at most `ALONG` cells along an axis, and colours for any ground. Raises
    `Refused` if the extra is missing or nothing varies.
    """
    plot.need_plot()
    knobs, notes = varying(table, units)
    numeric = [knob.name for knob in knobs if knob.numeric]
    check([knob.name for knob in knobs], numeric, kind, metric, table.metrics)
    if kind is None:
        plain = metric is None and ({*table.counts()} != {"ok"} or not table.metrics)
        kind = "curves" if len(numeric) < 2 else "stability" if plain else "metric"
    metric = metric or next(iter(table.metrics), None)
    measured = "" if metric is None else with_unit(metric, units)
    axes_knobs = axes_knobs_of(knobs, kind)
    others = [knob for knob in knobs if knob not in axes_knobs]
    sampled = [knob for knob in others if pairs_of(knob, axes_knobs[0]) is not None]  # of no value has it two rows
    panels, note = panels_of(table, [knob for knob in others if knob not in sampled])
    notes += [f"{knob.name} varies too" for knob in sampled]
    columns = 2 if len(panels) == 4 else min(3, len(panels))
    lines = -(-len(panels) // columns)
    wide = 1.9 + 3.7 * columns + 1.6 * (columns == 1)
    figure = plot.new_figure((min(wide, WIDEST) if page else wide, 1.2 + (2.6 if page else 3.3) * lines))
    layout: Any = figure.get_layout_engine()
    layout.set(w_pad=0.12)  # inches: the last number of a panel stands clear of the first of the next
    every: Any = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for axes in every.ravel()[len(panels):]:
        axes.set_axis_off()
    shown = [*zip(every.ravel(), panels, strict=False)]
    if kind == "curves":
        left = _curves(figure, shown, table, axes_knobs, str(metric), page)
    else:
        left = draw_maps(figure, shown, table, axes_knobs, metric if kind == "metric" else None, words, measured, page)
    for at, (axes, _) in enumerate(shown):
        if at % columns == 0:
            axes.set_ylabel(axes_knobs[1].label if kind != "curves" else plot.literal(measured))
        if at + columns >= len(panels):  # the lowest of its column, maybe above an empty place
            axes.set_xlabel(axes_knobs[0].label)
            axes.tick_params(axis="x", labelbottom=True)
    return figure, [part for part in (*notes, note, left) if part]


def check(knobs: Sequence[str], numeric: Sequence[str], kind: str | None, metric: str | None, metrics: Sequence[str]
          ) -> None:
    """Refuse a picture that cannot be: `knobs` have several values, `numeric` of them are numbers."""
    if kind is not None and kind not in KINDS:
        raise Refused(f"there is no picture {kind!r}; {nearest(kind, KINDS)}")
    if not knobs or (kind not in (None, "curves") and len(numeric) < 2):
        need = "a knob" if kind in (None, "curves") else "two knobs with numbers"
        raise Refused(f"a picture of this kind needs {need} with several values each, and the grid has "
                      f"{', '.join(knobs) or 'none'}; widen the grid, for example delay=0:0.5:51")
    if metric is not None and metric not in metrics:
        raise Refused(f"the rows have no metric {metric!r}; {nearest(metric, metrics)}" if metrics else
                      f"the rows have no metric, and so no {metric}; sweep with it, --metrics {metric}")
    if metric is not None and kind == "stability":
        raise Refused(f"a stability map shows how rows ended, and no metric; leave {metric} out, or write "
                      "--picture metric")
    if not metrics and (kind in ("metric", "curves") or len(numeric) < 2):
        raise Refused("the rows have no metric to draw; sweep with one, for example --metrics x_err_rms")


def _curves(
    figure: Figure, shown: list[tuple[Axes, Panel]], table: Table, knobs: list[PlottedKnob], metric: str, page: bool
) -> str:
    """Median, quartiles and extremes over the seeds; a cross where not every run ended ok. What was left out.

    `page`: see `picture_of`; lines of numbers have no gradient of colours, and points have names.
    """
    x, by = knobs[0], knobs[1] if len(knobs) > 1 else None
    places = [0] if by is None else spread(len(by.values), LINES)
    where_x = np.array(x.values) if x.numeric else np.arange(len(x.values))
    every: list[float] = []
    gradient = not page and by is not None and by.numeric
    for axes, panel in shown:
        crossed = 0
        for i, place in enumerate(places):
            rows = panel.rows if by is None else panel.rows[by.place[panel.rows] == place]
            if not len(rows):
                continue
            ok = table["status"][rows] == "ok"
            groups = groups_of(table[metric][rows], x.place[rows], ok, len(x.values))
            five = np.array([np.quantile(each, (0.0, 0.25, 0.5, 0.75, 1.0)) if len(each) else [np.nan] * 5
                             for each in groups]).T
            every += five[np.isfinite(five)].tolist()
            colour = gradient_map()(0.9 * i / max(1, len(places) - 1)) if gradient else TEXTS[i % len(TEXTS)]
            at = where_x if x.numeric else where_x + 0.1 * (i - (len(places) - 1) / 2.0)  # texts: side by side
            if max(map(len, groups)) > 1 and x.numeric:
                axes.fill_between(at, five[0], five[4], color=colour, alpha=0.12, linewidth=0.0)
                axes.fill_between(at, five[1], five[3], color=colour, alpha=0.28, linewidth=0.0)
            elif max(map(len, groups)) > 1:
                axes.vlines(at, five[0], five[4], color=colour, alpha=0.4, linewidth=1.5)
                axes.vlines(at, five[1], five[3], color=colour, alpha=0.4, linewidth=5.0)
            name = "" if by is None else f"{by.name} {text_of(by.values[place])} "
            under = 0 if gradient else len(places) - 1 - i  # wider below others, so that equal ones are both seen
            axes.plot(at, five[2], color=colour, marker="o", markersize=3.0 + 0.4 * under if x.numeric else 5.0,
                      linewidth=1.3 + 0.4 * under if x.numeric else 0.0,
                      gid=plot.names_id(f"{name}{value:.4g}" for value in five[2][np.isfinite(five[2])])
                      if page else None,
                      label=plot.literal(name.rstrip(), most=80) or None)
            bad = np.unique(x.place[rows][~ok])
            if len(bad):  # above the axis, in heights of the panel
                (crosses,) = axes.plot(at[bad], np.full(len(bad), 0.025 + 0.035 * crossed), color=colour,
                                       marker="x", markersize=5.0, linestyle="none",
                                       transform=axes.get_xaxis_transform())
                crosses.set_in_layout(False)
                crossed += 1
        if x.numeric:
            scale(axes, "x", x.values)
        else:
            texts = [plot.literal(text_of(value)) for value in x.values]
            long = sum(map(len, texts)) > 36
            axes.set_xticks(where_x, texts, rotation=20.0 if long else 0.0, ha="right" if long else "center")
        axes.set_title(panel.title, fontsize=10)
        plot.grid_lines(axes)
    scaled, linear = spacing(np.array(every))
    if scaled != "linear":  # the panels share it
        shown[0][0].set_yscale(scaled, **({"linthresh": linear} if scaled == "symlog" else {}))
    _explain(figure, shown, table)
    left = by is not None and len(places) < len(by.values)
    return f"{len(places)} of {len(by.values)} values of {by.name}" if by is not None and left else ""


def _explain(figure: Figure, shown: list[tuple[Axes, Panel]], table: Table) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    known = {label: handle for axes, _ in shown
             for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    if any(axes.collections for axes, _ in shown):
        known |= {"quartiles of the seeds": Patch(color=plot.GREY, alpha=0.45),
                  "extremes": Patch(color=plot.GREY, alpha=0.2)}
    if set(table.counts()) - {"ok"}:
        known["not every run ok"] = Line2D([], [], marker="x", color=plot.GREY, linestyle="none")
    if known:
        figure.legend([*known.values()], [*known], loc="outside lower center",
                      ncols=min(3 if len(shown) == 1 else 6, len(known)), frameon=False, fontsize=9)
