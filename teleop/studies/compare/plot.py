"""Plots of a comparison, one for each question. Needs the extra `plot`.

    status     over which links and in which environments does each law come to an end?
    tracking   does a law track because it is good, or because it holds the hand back?
    wall       how hard does the slave press the wall, against a rigid rod?
    feel       what does the hand perceive: stiffness in contact, mass and drag in free space?
    smooth     how rough is the reflected force?
    energy     what does the law give out, and how far do the ends drift apart?
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from math import inf, isfinite, isnan
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.studies.compare.figures import (
    BAD,
    FREE,
    ONE,
    TOUCHED,
    FigureColumn,
    LawVerdict,
    Row,
    axis_title,
    case_values,
    columns_of,
    endings,
)
from teleop.terminal.plotting import (
    BLUE,
    DARK,
    FAILS,
    GREY,
    ORANGE,
    PALE,
    PNG,
    SKY,
    grid_lines,
    literal,
    new_figure,
    save,
)

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from teleop.studies.compare.cases import Comparison

LAW_HEIGHT = 0.27  # inches a law
ACROSS = 3  # blocks of the status map
STATUS = {"ok": (SKY, "ok"), **dict.fromkeys(BAD, (ORANGE, "limit cycle, unstable or unsettled")),
          "diverged": (FAILS, "diverged"), "refused": (PALE, "refused")}
WHERE = {FREE: "nothing touched", TOUCHED: "in contact"}
LEAST = 1e-4  # share of the rigid rod's force, or of the environment's stiffness, from which on an axis goes
LOG_FROM = 50.0  # greatest to least value, from which on an axis goes by decades


Box = tuple[float, float, float, float]  # left, bottom, right and top, pixels


class Question(NamedTuple):
    """A figure of dots: its name, its title, and the columns that are its panels."""

    name: str
    title: str
    keys: tuple[str, ...]


DOTS = (
    Question("wall", "Force on the wall against a rigid rod's (dashed)", ("wall_late", "wall_peak")),
    Question("feel", "What the hand feels", ("felt_share", "felt_drag", "felt_mass")),
    Question("smooth", "Roughness of the reflected force", ("jerk_rms", "jerk_999")),
    Question("energy", "Energy given out, and drift", ("energy_out", "drift_end")),
)


def draw(rows: Sequence[Row], verdicts: Sequence[LawVerdict], comparison: Comparison, folder: Path,
         formats: Sequence[str] = PNG) -> list[Path]:
    """Draw every figure that the rows have something for into `folder`; returns the files."""
    files = save(_status(rows, verdicts, comparison), folder / "status", formats)
    scatter = _tracking(verdicts)
    if scatter is not None:
        files += save(scatter, folder / "tracking", formats)
    for question in DOTS:
        figure = _dots(question, rows, verdicts)
        if figure is not None:
            files += save(figure, folder / question.name, formats)
    return files


def _status(rows: Sequence[Row], verdicts: Sequence[LawVerdict], comparison: Comparison) -> Figure:
    """A map: laws down, links across in each environment's block."""
    from matplotlib.patches import Patch

    laws, links = [each.law for each in verdicts], [link.name for link in comparison.links]
    environments = [each.name for each in comparison.environments]
    across = min(len(environments), ACROSS)
    down = -(-len(environments) // across)
    size = (max(6.0, 0.26 * (len(links) + 1) * across + 1.6), down * (0.26 * len(laws) + 1.5) + 0.8)
    figure = new_figure(size, "How the runs ended (the worst of a case's seeds)")
    every = figure.subplots(down, across, sharey=True, squeeze=False).ravel()
    for axes in every[len(environments):]:
        axes.set_visible(False)
    ended = {law: endings(row for row in rows if row["law"] == law) for law in laws}
    for axes, environment in zip(every, environments, strict=False):
        for y, law in enumerate(laws):
            for x, link in enumerate(links):
                status = ended[law].get((environment, link))
                if status is not None:
                    axes.add_patch(_square(x, y, STATUS[status][0]))
        axes.set(xlim=(-0.5, len(links) - 0.5), ylim=(len(laws) - 0.5, -0.5), aspect="equal")
        axes.set_xticks(range(len(links)), [literal(link) for link in links], rotation=90, fontsize=7)
        axes.set_yticks(range(len(laws)), [literal(law) for law in laws], fontsize=8)
        axes.set_title(literal(environment), fontsize=9)
        axes.tick_params(length=0)
        for side in axes.spines.values():
            side.set_visible(False)
    present = {row["ended"] for row in rows}
    shown = dict.fromkeys(STATUS[status] for status in STATUS if status in present)
    figure.legend(handles=[Patch(color=colour, label=label) for colour, label in shown], loc="outside lower center",
                  ncols=len(shown), frameon=False, fontsize=8)
    return figure


def _square(x: int, y: int, colour: str) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x - 0.45, y - 0.45), 0.9, 0.9, color=colour, linewidth=0)


def _tracking(verdicts: Sequence[LawVerdict]) -> Figure | None:
    """Tracking error against free-space drag; the colour is the force on the wall against a rigid rod's."""
    drag, error, wall = [columns_of(verdicts)[key] for key in ("felt_drag", "x_err_rms", "wall_late")]
    points = [(each.law, drag.factor * each.figures["felt_drag"].value, error.factor * each.figures["x_err_rms"].value,
               wall.factor * each.figures["wall_late"].value) for each in verdicts]
    sound = [each for each in points if isfinite(each[1]) and isfinite(each[2])]
    if len(sound) < 2:
        return None
    figure = new_figure((9.5, 6.2),
                        "Tracking against free-space drag: a law at the right tracks because it holds the hand")
    axes = figure.subplots()
    colours = [min(max(press, 0.0), 200.0) if isfinite(press) else 0.0 for *_, press in sound]
    dots = axes.scatter([x for _, x, _, _ in sound], [y for _, _, y, _ in sound], c=colours, cmap="RdYlBu_r", vmin=0.0,
                        vmax=200.0, s=70, edgecolors=DARK, linewidths=0.6, zorder=3)
    bar = figure.colorbar(dots, ax=axes)
    bar.set_label("force on the wall, % of a rigid rod's", fontsize=9)
    for name, column, values in (("x", drag, [x for _, x, _, _ in sound]), ("y", error, [y for _, _, y, _ in sound])):
        _scale(axes, name, values)
        getattr(axes, f"set_{name}label")(f"{axis_title(column)}, median over the cases")
    _names(axes, figure, [(law + (f" ({press:.0f} %)" if isfinite(press) else ""), x, y) for law, x, y, press in sound])
    lost = [law for law, x, y, _ in points if not (isfinite(x) and isfinite(y))]
    if lost:
        axes.text(0.01, 0.01, literal(f"no value: {', '.join(lost)}"), transform=axes.transAxes, fontsize=8, color=DARK)
    grid_lines(axes)
    return figure


def _names(axes: Axes, figure: Figure, points: Sequence[tuple[str, float, float]]) -> None:
    """A name beside each point, at the first of eight places that is free of names and points, and inside the axes."""
    figure.draw_without_rendering()
    taken = [(x - 6.0, y - 6.0, x + 6.0, y + 6.0) for x, y in (axes.transData.transform(point[1:]) for point in points)]
    inside = axes.get_window_extent()
    for law, x, y in points:
        label = axes.annotate(literal(law), (x, y), xytext=(8, 0), textcoords="offset points", fontsize=8, va="center")
        size = label.get_window_extent()
        at_x, at_y = axes.transData.transform((x, y))
        free = None
        for step in (0, 1, -1, 2, -2, 3, -3, 4, -4):
            for left in (at_x + 12.0, at_x - 12.0 - size.width):
                low = at_y + step * 0.8 * size.height - 0.5 * size.height
                box = (left, low, left + size.width, low + size.height)
                fits = inside.x0 < box[0] and box[2] < inside.x1
                if free is None and fits and not any(map(partial(_overlap, box), taken)):
                    free = box
        if free is not None:
            points_a_pixel = 72.0 / figure.dpi
            label.set_position(((free[0] - at_x) * points_a_pixel, (0.5 * (free[1] + free[3]) - at_y) * points_a_pixel))
            taken.append(free)


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _dots(question: Question, rows: Sequence[Row], verdicts: Sequence[LawVerdict]) -> Figure | None:
    """A panel for each column: by law a dot for each case, the median, and the number of cases that failed."""
    panels = [columns_of(verdicts)[key] for key in question.keys
              if any(not isnan(each.figures[key].value) for each in verdicts)]
    if not panels:
        return None
    laws = [each.law for each in verdicts]
    figure = new_figure((2.2 + 4.3 * len(panels), LAW_HEIGHT * len(laws) + 1.7), question.title)
    for axes, column in zip(figure.subplots(1, len(panels), sharey=True, squeeze=False)[0], panels, strict=True):
        _panel(axes, column, case_values(column, rows, laws), verdicts)
        axes.set_yticks(range(len(laws)), [literal(law) for law in laws], fontsize=8)
        axes.set_ylim(len(laws) - 0.5, -0.5)
    return figure


def _panel(axes: Axes, column: FigureColumn, cases: Mapping[str, Sequence[float]], verdicts: Sequence[LawVerdict]
           ) -> None:
    every: list[float] = []
    for y, verdict in enumerate(verdicts):
        least = LEAST if column.better == ONE else -inf
        values = [column.factor * max(value, least) for value in cases[verdict.law] if isfinite(value)]
        failed = sum(value == inf for value in cases[verdict.law])
        every += values
        axes.plot(values, [y] * len(values), "o", color=GREY, alpha=0.45, markersize=3, markeredgewidth=0, zorder=2)
        middle = column.factor * verdict.figures[column.key].value
        if isfinite(middle):
            every.append(middle)
            axes.plot([middle], [y], "D", color=BLUE, markersize=6, zorder=4)
        if failed:
            axes.annotate(f"{failed} failed", (1.0, y), xycoords=("axes fraction", "data"), xytext=(4, 0),
                          textcoords="offset points", fontsize=7, color=FAILS, va="center")
    if column.better == ONE:  # by decades, and what is less than `LEAST` at the left edge
        axes.axvline(column.factor, color=DARK, linestyle="--", linewidth=1.0)
        axes.set_xscale("log")
        axes.set_xlim(left=0.7 * min([0.1 * column.factor, *every]), right=1.4 * max([column.factor, *every]))
        axes.xaxis.set_major_formatter("{x:g}")
    else:
        _scale(axes, "x", every)
    where = f", {WHERE[column.where]}" if column.where in WHERE else ""
    axes.set_xlabel(literal(f"{axis_title(column)}{where}"), fontsize=9)
    grid_lines(axes)


def _scale(axes: Axes, name: str, values: Sequence[float]) -> None:
    """Scale an axis by decades where the values ask for it; where some are zero or below, linearly around zero."""
    sizes = sorted(abs(value) for value in values if value != 0.0)
    if not sizes or sizes[-1] < LOG_FROM * sizes[len(sizes) // 20]:
        return
    if min(values) > 0.0:
        getattr(axes, f"set_{name}scale")("log")
    else:
        near = max(sizes[len(sizes) // 4], sizes[-1] * 1e-4)
        getattr(axes, f"set_{name}scale")("symlog", linthresh=near)
        if min(values) >= 0.0:
            low, high = getattr(axes, f"get_{name}lim")()
            getattr(axes, f"set_{name}lim")(max(low, -0.4 * near), high)
