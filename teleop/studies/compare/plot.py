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
from math import inf, isfinite, isnan
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from teleop.studies.compare import figures
from teleop.studies.compare.cases import Comparison
from teleop.terminal import plotting as plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LAW_HEIGHT = 0.27  # inches a law
ACROSS, WIDEST = 3, 8.4  # blocks of the status map side by side: at most, and inches
STATUS = {"ok": plot.SKY, **dict.fromkeys(figures.BAD, plot.YELLOW), "unstable": plot.PURPLE,
          "diverged": plot.FAILS, "refused": plot.PALE}
WHERE = {figures.FREE: "nothing touched", figures.TOUCHED: "in contact"}
LEAST = 1e-4  # share of the rigid rod's force, or of the environment's stiffness, from which on an axis goes


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


def draw(rows: Sequence[figures.Row], verdicts: Sequence[figures.LawVerdict], comparison: Comparison, folder: Path,
         formats: Sequence[str] = plot.PNG) -> list[Path]:
    """Draw every figure that the rows have something for into `folder`; returns the files."""
    links, environments = ([each.name for each in some] for some in (comparison.links, comparison.environments))
    status = status_map(rows, verdicts, links, environments)
    status.suptitle("How the runs ended (the worst of a case's seeds)", fontsize=11)
    files = plot.save(status, folder / "status", formats)
    scatter = tracking_plot(verdicts)
    if scatter is not None:
        scatter.suptitle("Tracking against free-space drag: a law at the right tracks because it holds the hand",
                         fontsize=11)
        files += plot.save(scatter, folder / "tracking", formats)
    for question in DOTS:
        figure = _dots(question, rows, verdicts)
        if figure is not None:
            files += plot.save(figure, folder / question.name, formats)
    return files


def status_map(rows: Sequence[figures.Row], verdicts: Sequence[figures.LawVerdict], links: Sequence[str],
               environments: Sequence[str]) -> Figure:
    """A map: laws down, links across in each environment's block."""
    from matplotlib.patches import Patch, Rectangle

    laws = [each.law for each in verdicts]
    block = 0.26 * (len(links) + 1)  # inches
    across = max(1, min(len(environments), ACROSS, int(WIDEST / block)))
    down = -(-len(environments) // across)
    size = (max(6.0, block * across + 1.6), down * (0.26 * len(laws) + 1.5) + 0.8)
    figure = plot.new_figure(size)
    every = figure.subplots(down, across, sharey=True, squeeze=False).ravel()
    for axes in every[len(environments):]:
        axes.set_visible(False)
    ended = {law: figures.endings(row for row in rows if row["law"] == law) for law in laws}
    for axes, environment in zip(every, environments, strict=False):
        for y, law in enumerate(laws):
            for x, link in enumerate(links):
                status = ended[law].get((environment, link))
                if status is not None:
                    axes.add_patch(Rectangle((x - 0.45, y - 0.45), 0.9, 0.9, color=STATUS[status], linewidth=0))
        axes.set(xlim=(-0.5, len(links) - 0.5), ylim=(len(laws) - 0.5, -0.5), aspect="equal")
        axes.set_xticks(range(len(links)), [plot.literal(link) for link in links], rotation=90, fontsize=9)
        axes.set_yticks(range(len(laws)), [plot.literal(law) for law in laws], fontsize=9)
        axes.set_title(plot.literal(environment), fontsize=10)
        axes.tick_params(length=0)
        for side in axes.spines.values():
            side.set_visible(False)
    present = {status for by_case in ended.values() for status in by_case.values()}
    shown: dict[str, list[str]] = {}
    for status in [each for each in STATUS if each in present]:
        shown.setdefault(STATUS[status], []).append(status)
    figure.legend(handles=[Patch(color=colour, label=", ".join(words)) for colour, words in shown.items()],
                  loc="outside lower center", ncols=len(shown), frameon=False, fontsize=9)
    return figure


def tracking_plot(verdicts: Sequence[figures.LawVerdict]) -> Figure | None:
    """Tracking error against free-space drag; the colour is the force on the wall against a rigid rod's."""
    from matplotlib import colormaps

    drag, error, wall = [figures.columns_of(verdicts)[key] for key in ("felt_drag", "x_err_rms", "wall_late")]
    points = [(each.law, drag.factor * each.figures["felt_drag"].value, error.factor * each.figures["x_err_rms"].value,
               wall.factor * each.figures["wall_late"].value) for each in verdicts]
    sound = [each for each in points if isfinite(each[1]) and isfinite(each[2])]
    if len(sound) < 2:
        return None
    figure = plot.new_figure((9.5, 6.2))
    axes = figure.subplots()
    colours = [min(max(press, 0.0), 200.0) if isfinite(press) else 0.0 for *_, press in sound]
    dots = axes.scatter([x for _, x, _, _ in sound], [y for _, _, y, _ in sound], c=colours, vmin=0.0, vmax=200.0,
                        cmap=colormaps["RdYlBu_r"].resampled(64), s=70, edgecolors=plot.DARK, linewidths=0.6, zorder=3)
    bar = figure.colorbar(dots, ax=axes)
    bar.set_label("force on the wall, % of a rigid rod's", fontsize=9)
    for name, column, values in (("x", drag, [x for _, x, _, _ in sound]), ("y", error, [y for _, _, y, _ in sound])):
        plot.scale_by_decades(axes, name, values)
        getattr(axes, f"set_{name}label")(f"{figures.axis_title(column)}, median over the cases")
    plot.write_names(axes, figure, [(law + (f" ({press:.0f} %)" if isfinite(press) else ""), x, y)
                                    for law, x, y, press in sound])
    lost = [law for law, x, y, _ in points if not (isfinite(x) and isfinite(y))]
    if lost:
        axes.text(0.01, 0.01, plot.literal(f"no value: {', '.join(lost)}"), transform=axes.transAxes, fontsize=8,
                  color=plot.DARK)
    plot.grid_lines(axes)
    return figure


def _dots(question: Question, rows: Sequence[figures.Row], verdicts: Sequence[figures.LawVerdict]) -> Figure | None:
    """A panel for each column: by law a dot for each case, the median, and the number of cases that failed."""
    panels = [figures.columns_of(verdicts)[key] for key in question.keys
              if any(not isnan(each.figures[key].value) for each in verdicts)]
    if not panels:
        return None
    laws = [each.law for each in verdicts]
    figure = plot.new_figure((2.2 + 4.3 * len(panels), LAW_HEIGHT * len(laws) + 1.7), question.title)
    for axes, column in zip(figure.subplots(1, len(panels), sharey=True, squeeze=False)[0], panels, strict=True):
        _panel(axes, column, figures.case_values(column, rows, laws), verdicts)
        axes.set_yticks(range(len(laws)), [plot.literal(law) for law in laws], fontsize=8)
        axes.set_ylim(len(laws) - 0.5, -0.5)
    return figure


def _panel(axes: Axes, column: figures.FigureColumn, cases: Mapping[str, Sequence[float]],
           verdicts: Sequence[figures.LawVerdict]) -> None:
    every: list[float] = []
    for y, verdict in enumerate(verdicts):
        least = LEAST if column.better == figures.ONE else -inf
        values = [column.factor * max(value, least) for value in cases[verdict.law] if isfinite(value)]
        failed = sum(value == inf for value in cases[verdict.law])
        every += values
        axes.plot(values, [y] * len(values), "o", color=plot.GREY, alpha=0.45, markersize=3, markeredgewidth=0,
                  zorder=2)
        middle = column.factor * verdict.figures[column.key].value
        if isfinite(middle):
            every.append(middle)
            axes.plot([middle], [y], "D", color=plot.BLUE, markersize=6, zorder=4)
        if failed:
            axes.annotate(f"{failed} failed", (1.0, y), xycoords=("axes fraction", "data"), xytext=(4, 0),
                          textcoords="offset points", fontsize=7, color=plot.FAILS, va="center")
    if column.better == figures.ONE:  # by decades, and what is less than `LEAST` at the left edge
        axes.axvline(column.factor, color=plot.DARK, linestyle="--", linewidth=1.0)
        axes.set_xscale("log")
        axes.set_xlim(left=0.7 * min([0.1 * column.factor, *every]), right=1.4 * max([column.factor, *every]))
        axes.xaxis.set_major_formatter("{x:g}")
    else:
        plot.scale_by_decades(axes, "x", every)
    where = f", {WHERE[column.where]}" if column.where in WHERE else ""
    axes.set_xlabel(plot.literal(f"{figures.axis_title(column)}{where}"), fontsize=9)
    plot.grid_lines(axes)
