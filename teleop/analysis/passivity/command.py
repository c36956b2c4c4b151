"""The command `teleop passivity`, with plots of a two-port over frequency, or a one-port's damping and its coupling."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from functools import partial
from math import ceil, floor, isfinite, log10
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from teleop.analysis.models.by_axis import along
from teleop.analysis.models.coupling import alpha_max, alpha_miller
from teleop.analysis.models.sampled import smooth
from teleop.analysis.passivity.one_port import Behind, RenderedImpedance
from teleop.analysis.passivity.report import PassivityAnswer, ask, curves, lacking, summary, table
from teleop.scene.loading import load_scene
from teleop.simulation.result import write_npz
from teleop.terminal.answer import Answer, Task, command_of, titled
from teleop.terminal.options import knobs_from
from teleop.terminal.plotting import (
    BLUE,
    DARK,
    FAILS,
    GREEN,
    ORANGE,
    PNG,
    RED,
    SKY,
    UNDER,
    grid_lines,
    literal,
    new_figure,
    save,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLES = {"sampled": UNDER, "continuous": {"linestyle": "--", "linewidth": 1.1}}  # nearly the same at low frequencies
ETA = (-1.3, 4.0)  # shown of Llewellyn's parameter


def draw(answer: PassivityAnswer, path: Path, formats: Sequence[str] = PNG) -> list[Path]:
    """Draw `answer` into `path` with the suffix of each format, as `save` does; returns the files."""
    alone = answer.one is not None and answer.one.behind is None
    title = literal(titled(answer.scene))
    figure = new_figure((9.5, 5.0) if alone else (13.0, 8.5),
                        f"{title}\n{fill(literal(answer.sentence), 110 if alone else 170)}")
    data = curves(answer)
    if answer.one is not None:
        _draw_one_port(figure, answer.one, data)
    else:
        _draw_two_port(figure, answer, data)
    return save(figure, path, formats)


def _frequency(axes: Axes, label: str) -> None:
    axes.set_xscale("log")
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(label)
    grid_lines(axes)


def _legend(axes: Axes) -> None:
    """Above the panel, where no line runs."""
    axes.legend(frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, borderaxespad=0.2)


def _draw_two_port(figure: Figure, answer: PassivityAnswer, data: dict[str, Any]) -> None:
    (top, eta), (passed, felt) = figure.subplots(2, 2, sharex=True)
    for name, shown in STYLES.items():
        if f"{name}_h" not in data:
            continue
        f, h = data[f"{name}_frequency"], data[f"{name}_h"]
        top.plot(f, np.abs(h[:, 0, 0]), color=BLUE, label=f"$|h_{{11}}|$ free motion, {name}", **shown)
        top.plot(f, 1.0 / np.abs(h[:, 1, 1]), color=RED, label=f"$1/|h_{{22}}|$ master held, {name}", **shown)
        wide = {**shown, "linewidth": 2.0 * shown["linewidth"]}  # of a reciprocal two-port both are the same
        passed.plot(f, np.abs(h[:, 0, 1]), color=GREEN, label=f"$|h_{{12}}|$ force, {name}", **wide)
        passed.plot(f, np.abs(h[:, 1, 0]), color=ORANGE, label=f"$|h_{{21}}|$ velocity, {name}", **shown)
        eta.plot(f, np.clip(data[f"{name}_eta"], -10.0, 1e3), color=BLUE, label=name, **shown)
        if f"{name}_felt" in data:
            felt.plot(f, np.abs(data[f"{name}_felt"]), color=BLUE, label=f"felt by the hand, {name}", **shown)
    _touched(felt, data)
    _bands(eta, answer)
    eta.axhline(1.0, color=FAILS, linewidth=0.9)
    eta.set_ylim(*ETA)
    for axes in (top, passed, felt):
        axes.set_yscale("log")
    passed.axhline(1.0, color=DARK, linewidth=0.6)
    labels = {top: "impedance (N s/m)", eta: "Llewellyn's parameter", passed: "force and velocity ratio",
              felt: "impedance (N s/m)"}
    for axes, label in labels.items():
        _frequency(axes, label)
        _legend(axes)
    for axes in (top, eta):
        axes.set_xlabel("")
    eta.set_xlim(answer.low, answer.high)


def _touched(axes: Axes, data: dict[str, Any]) -> None:
    for name in STYLES:
        if f"{name}_touched" in data:
            size = np.abs(data[f"{name}_touched"])
            if size.max() > 0.0:
                axes.plot(data[f"{name}_frequency"], size, color=RED, linewidth=1.4, label="touched by the slave")
            else:
                axes.plot([], [], color=RED, label="touched by the slave: nothing")
            return
    axes.text(0.5, 0.5, "the environment is not linear", ha="center", transform=axes.transAxes, color=DARK)


def _bands(axes: Axes, answer: PassivityAnswer) -> None:
    """The bands in which the criterion fails: those of the sampled two-port, or of the only one there is."""
    judged = answer.two and (answer.two.sampled or answer.two.continuous)
    for i, band in enumerate(judged.bands if judged else ()):
        which = "sampled" if answer.two and answer.two.sampled else "continuous"
        axes.axvspan(*band, color=FAILS, alpha=0.12, linewidth=0.0, label=f"fails, {which}" if i == 0 else None)


def _draw_one_port(figure: Figure, one: RenderedImpedance, data: dict[str, Any]) -> None:
    if one.behind is None:
        _needed(figure.subplots(), one, data)
        return
    (needed, diagram), (lost, real) = figure.subplots(2, 2)
    _needed(needed, one, data)
    _diagram(diagram, one, one.behind)
    _lost(lost, one, one.behind, data)
    _legend(lost)
    _real(real, one, one.behind, data["frequency"][data["frequency"] < 0.49 / one.T])


def _lost(axes: Axes, one: RenderedImpedance, behind: Behind, data: dict[str, Any]) -> None:
    """Draw the cost of the coupling: the environment's impedance, the coupling's, and both together."""
    f = data["frequency"]
    theta = 2.0 * np.pi * one.T * f
    parts: tuple[tuple[Any, str, dict[str, Any], str], ...] = (
        (behind.E, RED, UNDER, "$|E|$ of the environment"),
        (behind.C, ORANGE, UNDER, "$|C|$ of the coupling"),
        (one.E, BLUE, {"linewidth": 1.2}, "$|Z|$ rendered: both in series"),
    )
    for part, colour, shown, label in parts:
        axes.plot(f, np.abs(smooth(part, theta)), color=colour, label=label, **shown)
    slow = float(data["gap"][0])
    axes.plot([], [], " ", label=f"$|E - Z|/|E|$ = {slow:.3g} at {f[0]:.3g} Hz, at most {float(data['gap'].max()):.3g}")
    axes.set_yscale("log")
    _frequency(axes, "impedance (N s/m)")


def _needed(axes: Axes, one: RenderedImpedance, data: dict[str, Any]) -> None:
    f, need = data["frequency"], data["needed_damping"]
    axes.plot(f, need, color=BLUE, label="damping that the held force asks for")
    axes.axhline(one.damping, color=GREEN, label="the device's damping $b$")
    has = data.get("damping_with_shunt", np.full_like(f, one.damping))
    if "damping_with_shunt" in data:
        axes.plot(f, has, color=GREEN, linestyle="--", label="with the shunt of its motor")
    axes.fill_between(f, has, need, where=list(need > has), color=FAILS, alpha=0.15, linewidth=0.0,
                      label="more than that" if np.any(need > has) else None)
    axes.axhline(0.0, color=DARK, linewidth=0.6)
    _frequency(axes, "damping (N s/m)")
    _legend(axes)


def _diagram(axes: Axes, one: RenderedImpedance, behind: Behind) -> None:
    """Draw the passivity that an environment may lack, over the coupling made stiffer and more damped alike."""
    delta = one.damping
    factors = np.geomspace(1e-2, 1e2, 400)
    gamma = behind.gamma * factors
    axes.plot(gamma, [alpha_miller(delta, g) for g in gamma], color=ORANGE,
              label=r"$\delta\gamma/(\delta+\gamma)$, Miller et al.")
    axes.axhline(delta, color=GREEN, linewidth=0.9, label=r"$\delta$: without a coupling")
    if behind.conditions:
        edge = delta / behind.passive_needs  # that grows with C in proportion
        few = np.union1d(factors[::10][factors[::10] < edge], [edge * (1.0 - 1e-6)])
        axes.axvline(behind.gamma * edge, color=DARK, linestyle=":", linewidth=1.0,
                     label="beyond: a rigid one makes energy")
        limits = [alpha_max(delta, _scaled(behind, factor), one.T, d=one.d, tol=1e-4) for factor in few]
        most = [np.nan if alpha is None else alpha for alpha in limits]
        axes.plot(behind.gamma * few, most, color=BLUE, marker=".", markersize=4,
                  label="exact for linear ones, holding included")
    alpha = behind.alpha.alpha
    lacks = rf"$\alpha_e$ = {alpha:.3g} N s/m" if isfinite(alpha) else behind.alpha.why
    axes.plot([behind.gamma], [min(alpha, 3.0 * delta)], color=RED, marker="*" if alpha <= 3.0 * delta else "^",
              markersize=13, linestyle="none", label=f"this scene, {lacks}")
    axes.set_ylim(-0.05 * delta, 3.1 * delta if alpha > delta else 1.25 * delta)
    _frequency(axes, r"$\alpha_e$ allowed (N s/m)")
    axes.set_xlabel(r"$\gamma$ of the coupling, stiffness and damping scaled alike (N s/m)")
    _legend(axes)


def _scaled(behind: Behind, factor: float) -> Any:
    return lambda z: factor * behind.C(z)


def _real(axes: Axes, one: RenderedImpedance, behind: Behind, frequency: Any) -> None:
    """The real part of the environment's impedance on the unit circle, by integrator; what it is not says the legend.

    Below 0 it is not passive; above it is if nothing of it grows or anticipates, which the circle does not show.
    """
    looks = (("explicit", RED), ("semi-implicit", ORANGE), ("trapezoid", SKY), ("backward", BLUE))
    greatest = one.damping
    for under, (name, colour) in enumerate(reversed(looks)):
        if name in behind.by:
            lack = behind.integrators[name]
            real = smooth(behind.by[name], 2.0 * np.pi * one.T * frequency).real
            axes.plot(frequency, real, color=colour, linestyle=":" if lack.why else "-",
                      linewidth=1.2 + 0.9 * under, zorder=2.5 - 0.1 * under,  # wider below others: equal ones are seen
                      label=f"{name}: {lacking(lack)}")
            greatest = max(greatest, float(np.abs(real).max()))
    axes.axhline(-one.damping, color=GREEN, linewidth=0.9, label=r"$-\delta$")
    axes.axhline(0.0, color=DARK, linewidth=0.6)
    linear = 10.0 ** floor(log10(max(one.damping, 1e-3)))  # within +- this the axis is linear
    decades = max(1, ceil(log10(greatest / linear)))
    axes.set_yscale("symlog", linthresh=linear)
    top = [linear * 10.0**i for i in range(0, decades + 1, 1 + decades // 5)]
    axes.set_yticks([-value for value in reversed(top)] + [0.0] + top)
    axes.minorticks_off()
    axes.set_ylim(-2.0 * linear * 10.0**decades, 2.0 * linear * 10.0**decades)
    _frequency(axes, "Re $E$ on the unit circle (N s/m)")
    _legend(axes)


def find(args: Namespace) -> Task:
    """Judge the scene. Raises `Refused`."""
    scene = along(load_scene(args.scene, **knobs_from(args)), args.axis)

    def work() -> Answer:
        passivity = ask(scene, seed=args.seed, span=args.range)
        return Answer(table(passivity), summary(passivity, args.typed),
                      files={"curves.npz": lambda path: write_npz(path, curves(passivity))},
                      plots={"passivity": partial(draw, passivity)})

    return Task(scene.name, work)


command = command_of(find, "passivity", always=False)
