"""Maps of a sweep over two knobs: coloured cells, or points of a sample, and the boundary between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from teleop.sweeps.pictures.layout import (
    OTHER,
    STATUS,
    WITHOUT,
    Panel,
    PlottedKnob,
    gradient_map,
    groups_of,
    scale,
    spacing,
)
from teleop.terminal.plotting import BLACK, RED, SKY, literal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from teleop.sweeps.table import Table

CELLS = 4_000_000  # of a map; of more, which no picture has room for, the points are drawn as those of a sample
VECTOR_CELLS = 10_000  # of a map in a vector format; more are an image in it, for each is a path that a reader draws


def _edges(axis: Any, values: tuple[Any, ...]) -> NDArray[Any]:
    """The edges of cells: midway between neighbours on the axis as drawn; the outer cells end at the outer values.

    So the map ends where the grid does: nothing was run beyond, and there may be nothing, as with a delay below 0.
    """
    import numpy as np

    there = axis.get_transform()
    at = there.transform(np.array(values, dtype=float))
    middle = there.inverted().transform((at[1:] + at[:-1]) / 2.0)
    return np.concatenate([values[:1], middle, values[-1:]])


@dataclass(frozen=True, kw_only=True, slots=True)
class MapPoints:
    """What became of the rows at each point of a panel that has any."""

    x: NDArray[Any]  # (points,) the place of the value of each knob
    y: NDArray[Any]
    status: NDArray[Any]  # of all its rows, or "" where they differ
    share: NDArray[Any]  # of those rows that ran, how many ended ok; NaN where none ran
    value: NDArray[Any]  # what colours it: the share, or the median of the metric over the rows that ended ok


def map_points(table: Table, rows: NDArray[Any], x: PlottedKnob, y: PlottedKnob, metric: str | None) -> MapPoints:
    """What became of `rows` over the knobs x and y: how they ended, and the metric, if one is asked for."""
    import numpy as np

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
    words: Mapping[str, str], measured: str,
) -> str:
    """Coloured cells by status, by share of runs that end ok, or by a metric; the boundary. Leaves nothing out.

    `words` are what the legend says of a status, `measured` the metric with its unit.
    """
    import numpy as np
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba
    from matplotlib.lines import Line2D

    x, y = knobs
    found = [map_points(table, panel.rows, x, y, metric) for _, panel in shown]
    cells = len(x.values) * len(y.values)
    sampled = cells > CELLS or all(len(one.x) <= 2 * max(len(x.values), len(y.values)) < cells for one in found)
    by_status = metric is None and all((one.status != "").all() for one in found)
    norm, colours = Normalize(0.0, 1.0), LinearSegmentedColormap.from_list("share", (RED, "#F5EFE6", SKY))
    if metric is not None:
        values = np.concatenate([one.value for one in found])
        norm, colours = _norm(values[np.isfinite(values)]), gradient_map()
    drawn: set[str] = set()
    edged = False
    for (axes, panel), one in zip(shown, found, strict=True):
        scale(axes, "x", x.values)
        scale(axes, "y", y.values)
        known = np.isfinite(one.value)
        said = one.status if by_status else np.select(
            [known, np.isnan(one.share), one.share == 0.0], ["", *WITHOUT[:2]], WITHOUT[2])
        paint = np.array(colours(norm(np.ma.masked_invalid(one.value))))
        for word in {*said.tolist()} - {""}:
            drawn.add(word)
            paint[said == word] = to_rgba(STATUS.get(word, OTHER))
        edged |= _place(axes, x, y, one, paint, sampled)
        ended = float((table["status"][panel.rows] == "ok").mean())
        between = "" if not panel.title else "\n" if "\n" in panel.title else ": "
        axes.set_title(f"{panel.title}{between}{100.0 * ended:.3g} % ok", fontsize=10)
    shown_words = sorted(drawn, key=[*STATUS, *sorted(drawn)].index)
    handles = [Line2D([], [], marker="s", markersize=9, linestyle="none", color=STATUS.get(word, OTHER),
                      label=literal(words.get(word, word), most=80)) for word in shown_words]
    if edged:
        half = "boundary" if by_status else "half of the runs end ok"
        handles.append(Line2D([], [], color=BLACK, linewidth=1.4, label=half))
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    if not by_status:
        label = f"share of runs that end {words.get('ok', 'ok')}"
        if metric is not None:
            label = literal(f"{measured}, median of the runs ok")
        figure.colorbar(ScalarMappable(norm, colours), ax=[axes for axes, _ in shown], label=label)
    return ""


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


def _place(axes: Axes, x: PlottedKnob, y: PlottedKnob, found: MapPoints, paint: NDArray[Any], sampled: bool) -> bool:
    """Colour the points: cells of a grid, with the boundary between them, or dots; True if there is a boundary."""
    import numpy as np
    from matplotlib.collections import LineCollection

    if sampled:
        axes.scatter(np.array(x.values)[found.x], np.array(y.values)[found.y], s=22.0, c=paint,
                     edgecolors=BLACK, linewidths=0.3)
        return False
    across, up = _edges(axes.xaxis, x.values), _edges(axes.yaxis, y.values)
    picture, good = np.ones((len(y.values), len(x.values), 4)), np.full((len(y.values), len(x.values)), np.nan)
    picture[found.y, found.x] = paint
    good[found.y, found.x] = np.where(np.isfinite(found.share), found.share >= 0.5, np.nan)
    axes.pcolormesh(across, up, picture, shading="flat", rasterized=picture.size > 4 * VECTOR_CELLS)
    axes.set_xlim(across[0], across[-1])
    axes.set_ylim(up[0], up[-1])
    axes.set_facecolor("white")
    lines = [((across[i + 1], up[j]), (across[i + 1], up[j + 1])) for j, i in np.argwhere(np.abs(np.diff(good)) > 0.0)]
    lines += [((across[i], up[j + 1]), (across[i + 1], up[j + 1]))
              for j, i in np.argwhere(np.abs(np.diff(good, axis=0)) > 0.0)]
    axes.add_collection(LineCollection(lines, colors=BLACK, linewidths=1.4, capstyle="projecting"), autolim=False)
    return bool(lines)


