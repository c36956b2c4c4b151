"""The figure of an analysis: each person's measure by condition, and the share of "second" over felt stiffness.

The curves are drawn once a study is unblinded: where a condition's stimuli lie tells what its law lets through.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp
from typing import TYPE_CHECKING

import numpy as np

from teleop.people.adaptive import share_correct
from teleop.people.analysis import Analysed
from teleop.people.felt import with_stiffness
from teleop.people.fit import Answers, Fit
from teleop.people.plan import ON_A_LOG_SCALE, UNITS, Design, Measure
from teleop.people.study import Study
from teleop.terminal import plotting as plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (plot.BLUE, plot.ORANGE, plot.GREEN, plot.RED, plot.SKY, plot.PINK, plot.BROWN, plot.PURPLE, plot.OLIVE,
           plot.WINE, plot.DARK, plot.BLACK)


def figure_of(study: Study, analysed: Analysed) -> Figure:
    """Draw the findings after exclusions."""
    curves = bool(study.looks()) and analysed.measure is Measure.W and with_stiffness(study.plan)
    figure = plot.new_figure((10.0 if curves else 5.4, 4.4), f"{study.plan.name}, {len(study.people())} people"
                             + ", simulated" * study.simulated)
    panels = figure.subplots(1, 2 if curves else 1, squeeze=False)[0]
    _people(panels[0], study, analysed)
    if curves:
        for colour, (letter, fitted) in zip(COLOURS, analysed.after.pooled.items(), strict=False):
            _curve(panels[1], study.label(letter), analysed.after.answers[letter], fitted, colour)
        panels[1].set(xlabel="ln(felt stiffness of the second/of the first)", ylabel='share of answers "second"',
                      ylim=(-0.03, 1.03))
        panels[1].legend(frameon=False, fontsize=9)
        plot.grid_lines(panels[1])
    return figure


def _people(axes: Axes, study: Study, analysed: Analysed) -> None:
    """A dot for each person, joined where a person met several conditions; beside them the mean and its interval."""
    measure, findings = analysed.measure, analysed.after
    letters = [each.letter for each in findings.summaries]
    by_person: dict[int, list[tuple[int, float]]] = {}
    for value in findings.values:
        shown = exp(value.value) if measure in ON_A_LOG_SCALE else value.value
        by_person.setdefault(value.person, []).append((letters.index(value.condition), shown))
    joined = "-" if study.plan.design is Design.WITHIN else ""
    for points in by_person.values():
        points.sort()
        axes.plot([x for x, _ in points], [y for _, y in points], f"o{joined}", color=plot.PALE, markersize=4,
                  linewidth=0.8, zorder=1)
    for x, (colour, each) in enumerate(zip(COLOURS, findings.summaries, strict=False)):
        axes.errorbar([x], [each.mean], [[each.mean - each.low], [each.high - each.mean]], fmt="o", color=colour,
                      capsize=4, markersize=7, zorder=2)
    axes.set_xticks(range(len(letters)), [plot.literal(study.label(letter)) for letter in letters])
    unit = UNITS.get(measure, "")
    axes.set(xlim=(-0.5, len(letters) - 0.5), ylabel=f"{measure.value.replace('_', ' ')}{f' ({unit})' if unit else ''}")
    if measure in ON_A_LOG_SCALE:
        plot.scale_by_decades(axes, "y", [y for points in by_person.values() for _, y in points])
    plot.grid_lines(axes)


def _curve(axes: Axes, label: str, answers: Answers, fitted: Fit, colour: str) -> None:
    """The answers of all people, and the curve of all as one."""
    x, shown, second = (part[0] for part in answers)
    axes.plot(x, second / shown, "o", color=colour, markersize=5)
    at: Sequence[float] = np.linspace(1.2 * float(x.min()), 1.2 * float(x.max()), 200).tolist()
    curve = [share_correct(each + fitted.bias, fitted.w, fitted.lapse) for each in at]
    axes.plot(at, curve, "-", color=colour, linewidth=1.4, label=plot.literal(f"{label}: w = {fitted.w:.3f}"))
