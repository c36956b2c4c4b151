"""The command `teleop passivity`: a table, JSON and curves, with plots of a two-port over frequency or of a one-port.

The plots of a one-port are of its damping and of its coupling.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Sequence
from functools import partial
from math import ceil, floor, isfinite, log10
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from teleop.analysis.models.by_axis import along
from teleop.analysis.models.coupling import Lack, alpha_max, alpha_miller, gap
from teleop.analysis.models.law_parts import effective_damping
from teleop.analysis.models.sampled import smooth
from teleop.analysis.passivity.judge import SLOW, UNIT, Judged, TwoPorts, two_ports
from teleop.analysis.passivity.one_port import Behind, RenderedImpedance, one_port
from teleop.analysis.passivity.surroundings import linear_parts
from teleop.errors import Refused
from teleop.law.analysis_offers import instead
from teleop.scene.axes import labels_of, told_along, unit_on
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.result import write_npz
from teleop.terminal import plotting as plot
from teleop.terminal.answer import Answer, Task, WithUnit, command_of, finite, scene_head, titled, with_units
from teleop.terminal.options import knobs_from, typed_range
from teleop.terminal.table import facts, si

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLES = {"sampled": plot.UNDER, "continuous": {"linestyle": "--", "linewidth": 1.1}}  # alike at low frequencies
ETA = (-1.3, 4.0)  # shown of Llewellyn's parameter
SHOWN = 3  # bands in the table
DAMPING = "N s/m"
Along = Callable[[float | None, str], WithUnit]


class PassivityAnswer(NamedTuple):
    """Result of the analysis: one port, or two."""

    scene: Scene
    one: RenderedImpedance | None
    two: TwoPorts | None
    left_out: tuple[str, ...]
    low: float  # Hz
    high: float  # Hz
    seed: int = 0

    @property
    def sentence(self) -> str:
        """The verdict."""
        if self.one is not None:
            return self.one.verdict.sentence
        assert self.two is not None
        judged = self.two.sampled or self.two.continuous
        assert judged is not None
        return _llewellyn(judged)


def ask(scene: Scene, *, seed: int = 0, span: str | None = None) -> PassivityAnswer:
    """Judge a scene; `span` is a range LOW:HIGH in Hz as it was typed. Raises `Refused`."""
    low, high = _span(span)
    if scene.slave is not None:
        two = two_ports(scene, low=low, high=high, seed=seed)
        return PassivityAnswer(scene, None, two, tuple(linear_parts(scene)[1]), two.low, two.high, seed)
    one = one_port(scene)
    top = 0.5 / (one.every * one.T)
    high = top if high is None else high
    if not 0.0 < low < high <= top:
        raise Refused(f"the range {low:g}:{high:g} Hz must lie above 0 and not above half the rate, {top:g} Hz here, "
                      "its lower end first; write for example --range 0.1:100")
    return PassivityAnswer(scene, one, None, one.left_out, low, high, seed)


def _span(typed: str | None) -> tuple[float, float | None]:
    if typed is None:
        return 0.1, None
    return typed_range("--range", typed, what="Hz", example="0.1:100", above=0.0)


def table(answer: PassivityAnswer) -> str:
    """The answer in a few lines."""
    rows = [("scene", titled(answer.scene))]
    if words := instead(answer.scene.law):
        rows.append(("law", words))
    if answer.one is not None:
        rows += _one_port_rows(answer.one)
    if answer.two is not None:
        rows += _two_port_rows(answer.two)
    if answer.left_out:
        rows.append(("left out", ", ".join(answer.left_out) + ": not linear, or not known here"))
    names = labels_of(answer.scene)
    return facts([(label, told_along(text, names.units_for(answer.scene.axes)[0])) for label, text in rows])


def _damping(value: float) -> str:
    return f"{value:.4g} N s/m"


def _one_port_rows(one: RenderedImpedance) -> list[tuple[str, str]]:
    rows = [("verdict", one.verdict.sentence)]
    late = f", {one.d} of them after the reading" if one.d else ""
    often = "tick" if one.every == 1 else f"{one.every} ticks"
    rows.append(("force", f"renewed every {often} of {si(one.T, 's')}{late}"))
    rows.append(("at rest", f"{one.stiffness:.4g} N/m"))
    if one.quantised is not None:
        most = f"a spring alone is passive up to {one.quantised:.4g} N/m"
        rows.append(("encoder", most if one.quantised > 0.0 else "no spring is passive behind it without friction"))
    return rows + ([] if one.behind is None else _behind(one, one.behind))


def _behind(one: RenderedImpedance, behind: Behind) -> list[tuple[str, str]]:
    alpha, delta = behind.alpha.alpha, one.damping
    lacks = f"lacks alpha_e = {_damping(alpha)}, it is passive"
    if alpha > 0.0:
        lacks = f"lacks alpha_e = {_damping(alpha)} at {si(behind.alpha.frequency, 'Hz')}"
    if not isfinite(alpha):
        lacks = f"not passive by any alpha_e: {behind.alpha.why}"
    most = "not known for this integrator, or a force renewed slowly"
    if behind.conditions:
        most = f"not even every passive one is safe: that needs {_damping(behind.passive_needs)}"
    if behind.most is not None:
        most = f"every one that lacks up to {_damping(behind.most)} is safe, holding and delay included"
    by_integrator = ", ".join(f"{name} {lacking(lack)}" for name, lack in behind.integrators.items())
    return [
        ("environment", f"{lacks}; {behind.stiffness:.4g} N/m at rest"),
        ("by integrator", by_integrator),
        ("uncoupled", f"alpha_e < delta = {_damping(delta)} {_holds(alpha < delta)}; that very environment needs "
                      f"{_damping(behind.alone)}"),
        ("coupled", f"gamma = {_damping(behind.gamma)}; alpha_e < delta gamma/(delta + gamma) = "
                    f"{_damping(behind.miller)} {_holds(alpha < behind.miller)}"),
        ("behind it", most),
    ]


def lacking(lack: Lack) -> str:
    """Name the passivity that an environment lacks, or why no damper makes it passive."""
    return lack.why or (f"lacks {_damping(lack.alpha)}" if lack.alpha > 0.0 else "passive")


def _holds(yes: bool) -> str:
    return "holds" if yes else "fails"


def _two_port_rows(two: TwoPorts) -> list[tuple[str, str]]:
    rows = []
    for name in ("sampled", "continuous"):
        judged: Judged | None = getattr(two, name)
        rows.append((name, two.why_not[name] if judged is None else _llewellyn(judged)))
        if judged is not None:
            alone = "passive" if judged.passive else "not passive"
            rows.append(("", f"{alone} by itself; free motion {_damping(judged.free)} at {UNIT:g} Hz"
                             f"{_perceived_stiffness(judged, two)}"))
    return rows


def _perceived_stiffness(judged: Judged, two: TwoPorts) -> str:
    if judged.felt is None or not two.stiffness:
        return ""
    return f"; {judged.felt:.4g} N/m felt of {two.stiffness:.4g} N/m touched, at {SLOW:g} Hz"


def _llewellyn(judged: Judged) -> str:
    least = f"Llewellyn's parameter is {judged.least:.4g} at its smallest, at {judged.at:.4g} Hz"
    if judged.absolutely_stable:
        return f"absolutely stable: {least}"
    bands = [f"{band.low:.4g} to {band.high:.4g}" for band in judged.bands]
    rest = f" and {len(bands) - SHOWN} more" if len(bands) > SHOWN else ""
    where = f"{bands[0]} Hz"
    if len(bands) > 1:
        where = (f"{judged.bands[0].low:.4g} to {judged.bands[-1].high:.4g} Hz in {len(bands)} bands "
                 f"({', '.join(bands[:SHOWN])}{rest})")
    return f"not absolutely stable: fails at {where}; {least}"


def summary(answer: PassivityAnswer, command: Sequence[str] = ()) -> dict[str, Any]:
    """The JSON document; what has no bound or is not known is null."""
    axis = labels_of(answer.scene).units_for(answer.scene.axes)[0]

    def along(value: float | None, unit: str) -> WithUnit:
        """The value in the unit that it has on this axis, by that along a line."""
        return WithUnit(finite(value), unit_on(unit, axis))

    body: dict[str, Any] = {
        "range": WithUnit([answer.low, answer.high], "Hz"), "left_out": list(answer.left_out),
        "linear_law": instead(answer.scene.law) or None}
    if answer.one is not None:
        body |= {"ports": 1, "passive": answer.one.passive, **_one_numbers(answer.one, along)}
    if answer.two is not None:
        two = answer.two
        body |= {"ports": 2, "touched_stiffness": along(two.stiffness, "N/m"), "why_not": two.why_not,
                 "sampled": _numbers(two.sampled, along), "continuous": _numbers(two.continuous, along)}
    return {**scene_head(answer.scene, "passivity", sentence=answer.sentence, seed=answer.seed, command=command),
            **with_units(body)}


def _one_numbers(one: RenderedImpedance, along: Along) -> dict[str, Any]:
    behind, shunt = one.behind, one.verdict.shunt
    return {
        "damping": along(one.damping, DAMPING), "needed_damping": along(one.needed.damping, DAMPING),
        "frequency": WithUnit(one.needed.frequency, "Hz"), "delay": WithUnit(one.d, "ticks"),
        "every": WithUnit(one.every, "ticks"), "stiffness": along(one.stiffness, "N/m"),
        "quantised_stiffness": along(one.quantised, "N/m"), "encoder_friction": along(one.verdict.friction, "N"),
        "shunt": shunt and {"added_damping": along(shunt.adds, DAMPING), "needed_damping": along(shunt.needs, DAMPING),
                            "frequency": WithUnit(shunt.frequency, "Hz")},
        "coupling": behind and {
            "alpha_e": along(behind.alpha.alpha, DAMPING),
            "alpha_e_frequency": WithUnit(behind.alpha.frequency, "Hz"), "delta": along(one.damping, DAMPING),
            "gamma": along(behind.gamma, DAMPING), "alpha_miller": along(behind.miller, DAMPING),
            "alpha_max": along(behind.most, DAMPING), "needed_for_passive": along(behind.passive_needs, DAMPING),
            "needed_alone": along(behind.alone, DAMPING), "stiffness": along(behind.stiffness, "N/m"),
            "alpha_by_integrator": WithUnit({name: finite(lack.alpha) for name, lack in behind.integrators.items()},
                                            along(None, DAMPING).unit),
            "why_not": {name: lack.why for name, lack in [("alpha_e", behind.alpha), *behind.integrators.items()]
                        if lack.why},
        },
    }


def _numbers(judged: Judged | None, along: Along) -> dict[str, Any] | None:
    return judged and {
        "absolutely_stable": judged.absolutely_stable,
        "bands": WithUnit([list(band) for band in judged.bands], "Hz"), "eta_min": WithUnit(finite(judged.least), "1"),
        "eta_min_frequency": WithUnit(judged.at, "Hz"), "passive": judged.passive,
        "free_impedance": along(judged.free, DAMPING), "felt_stiffness": along(judged.felt, "N/m"),
    }


def curves(answer: PassivityAnswer) -> dict[str, Any]:
    """Arrays over frequency: `frequency` and `needed_damping`, or `sampled_h` and so on, each with its `_frequency`."""
    if answer.one is not None:
        f = np.geomspace(answer.low, answer.high, 2000)
        arrays = {"frequency": f, "needed_damping": answer.one.curve(f)}
        if answer.one.verdict.shunt is not None:
            arrays["damping_with_shunt"] = effective_damping(answer.scene, 2.0 * np.pi * answer.one.T * f)
        if answer.one.behind is not None:
            arrays["gap"] = gap(answer.one.behind.C, answer.one.behind.E, answer.one.T, f)
        return arrays
    assert answer.two is not None
    two: dict[str, Any] = {}
    for name in ("sampled", "continuous"):
        judged = getattr(answer.two, name)
        if judged is not None:
            port = judged.port
            two |= {f"{name}_frequency": port.frequency, f"{name}_h": port.h, f"{name}_eta": port.eta}
            if answer.two.touched is not None:
                touched = answer.two.touched(port.frequency)
                two |= {f"{name}_felt": port.perceived_impedance(touched), f"{name}_touched": touched}
    return two


def draw(answer: PassivityAnswer, path: Path, formats: Sequence[str] = plot.PNG) -> list[Path]:
    """Draw `answer` into `path` with the suffix of each format, as `save` does; returns the files."""
    alone = answer.one is not None and answer.one.behind is None
    title = plot.literal(titled(answer.scene))
    figure = plot.new_figure((9.5, 5.0) if alone else (13.0, 8.5),
                             f"{title}\n{fill(plot.literal(answer.sentence), 110 if alone else 170)}")
    data = curves(answer)
    if answer.one is not None:
        _draw_one_port(figure, answer.one, data)
    else:
        _draw_two_port(figure, answer, data)
    return plot.save(figure, path, formats)


def _frequency(axes: Axes, label: str) -> None:
    axes.set_xscale("log")
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(label)
    plot.grid_lines(axes)


def _legend(axes: Axes) -> None:
    """Above the panel, where no line runs."""
    axes.legend(frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, borderaxespad=0.2)


def _draw_two_port(figure: Figure, answer: PassivityAnswer, data: dict[str, Any]) -> None:
    (top, eta), (passed, felt) = figure.subplots(2, 2, sharex=True)
    for name, shown in STYLES.items():
        if f"{name}_h" not in data:
            continue
        f, h = data[f"{name}_frequency"], data[f"{name}_h"]
        top.plot(f, np.abs(h[:, 0, 0]), color=plot.BLUE, label=f"$|h_{{11}}|$ free motion, {name}", **shown)
        top.plot(f, 1.0 / np.abs(h[:, 1, 1]), color=plot.RED, label=f"$1/|h_{{22}}|$ master held, {name}", **shown)
        wide = {**shown, "linewidth": 2.0 * shown["linewidth"]}  # of a reciprocal two-port both are the same
        passed.plot(f, np.abs(h[:, 0, 1]), color=plot.GREEN, label=f"$|h_{{12}}|$ force, {name}", **wide)
        passed.plot(f, np.abs(h[:, 1, 0]), color=plot.ORANGE, label=f"$|h_{{21}}|$ velocity, {name}", **shown)
        eta.plot(f, np.clip(data[f"{name}_eta"], -10.0, 1e3), color=plot.BLUE, label=name, **shown)
        if f"{name}_felt" in data:
            felt.plot(f, np.abs(data[f"{name}_felt"]), color=plot.BLUE, label=f"felt by the hand, {name}", **shown)
    _touched(felt, data)
    _bands(eta, answer)
    eta.axhline(1.0, color=plot.FAILS, linewidth=0.9)
    eta.set_ylim(*ETA)
    for axes in (top, passed, felt):
        axes.set_yscale("log")
    passed.axhline(1.0, color=plot.DARK, linewidth=0.6)
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
                axes.plot(data[f"{name}_frequency"], size, color=plot.RED, linewidth=1.4, label="touched by the slave")
            else:
                axes.plot([], [], color=plot.RED, label="touched by the slave: nothing")
            return
    axes.text(0.5, 0.5, "the environment is not linear", ha="center", transform=axes.transAxes, color=plot.DARK)


def _bands(axes: Axes, answer: PassivityAnswer) -> None:
    """The bands in which the criterion fails: those of the sampled two-port, or of the only one there is."""
    judged = answer.two and (answer.two.sampled or answer.two.continuous)
    for i, band in enumerate(judged.bands if judged else ()):
        which = "sampled" if answer.two and answer.two.sampled else "continuous"
        axes.axvspan(*band, color=plot.FAILS, alpha=0.12, linewidth=0.0, label=f"fails, {which}" if i == 0 else None)


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
        (behind.E, plot.RED, plot.UNDER, "$|E|$ of the environment"),
        (behind.C, plot.ORANGE, plot.UNDER, "$|C|$ of the coupling"),
        (one.E, plot.BLUE, {"linewidth": 1.2}, "$|Z|$ rendered: both in series"),
    )
    for part, colour, shown, label in parts:
        axes.plot(f, np.abs(smooth(part, theta)), color=colour, label=label, **shown)
    slow = float(data["gap"][0])
    axes.plot([], [], " ", label=f"$|E - Z|/|E|$ = {slow:.3g} at {f[0]:.3g} Hz, at most {float(data['gap'].max()):.3g}")
    axes.set_yscale("log")
    _frequency(axes, "impedance (N s/m)")


def _needed(axes: Axes, one: RenderedImpedance, data: dict[str, Any]) -> None:
    f, need = data["frequency"], data["needed_damping"]
    axes.plot(f, need, color=plot.BLUE, label="damping that the held force asks for")
    axes.axhline(one.damping, color=plot.GREEN, label="the device's damping $b$")
    has = data.get("damping_with_shunt", np.full_like(f, one.damping))
    if "damping_with_shunt" in data:
        axes.plot(f, has, color=plot.GREEN, linestyle="--", label="with the shunt of its motor")
    axes.fill_between(f, has, need, where=list(need > has), color=plot.FAILS, alpha=0.15, linewidth=0.0,
                      label="more than that" if np.any(need > has) else None)
    axes.axhline(0.0, color=plot.DARK, linewidth=0.6)
    _frequency(axes, "damping (N s/m)")
    _legend(axes)


def _diagram(axes: Axes, one: RenderedImpedance, behind: Behind) -> None:
    """Draw the passivity that an environment may lack, over the coupling made stiffer and more damped alike."""
    delta = one.damping
    factors = np.geomspace(1e-2, 1e2, 400)
    gamma = behind.gamma * factors
    axes.plot(gamma, [alpha_miller(delta, g) for g in gamma], color=plot.ORANGE,
              label=r"$\delta\gamma/(\delta+\gamma)$, Miller et al.")
    axes.axhline(delta, color=plot.GREEN, linewidth=0.9, label=r"$\delta$: without a coupling")
    if behind.conditions:
        edge = delta / behind.passive_needs  # that grows with C in proportion
        few = np.union1d(factors[::10][factors[::10] < edge], [edge * (1.0 - 1e-6)])
        axes.axvline(behind.gamma * edge, color=plot.DARK, linestyle=":", linewidth=1.0,
                     label="beyond: a rigid one makes energy")
        limits = [alpha_max(delta, _scaled(behind, factor), one.T, d=one.d, tol=1e-4) for factor in few]
        most = [np.nan if alpha is None else alpha for alpha in limits]
        axes.plot(behind.gamma * few, most, color=plot.BLUE, marker=".", markersize=4,
                  label="exact for linear ones, holding included")
    alpha = behind.alpha.alpha
    lacks = rf"$\alpha_e$ = {alpha:.3g} N s/m" if isfinite(alpha) else behind.alpha.why
    axes.plot([behind.gamma], [min(alpha, 3.0 * delta)], color=plot.RED, marker="*" if alpha <= 3.0 * delta else "^",
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
    looks = (("explicit", plot.RED), ("semi-implicit", plot.ORANGE), ("trapezoid", plot.SKY), ("backward", plot.BLUE))
    greatest = one.damping
    for under, (name, colour) in enumerate(reversed(looks)):
        if name in behind.by:
            lack = behind.integrators[name]
            real = smooth(behind.by[name], 2.0 * np.pi * one.T * frequency).real
            axes.plot(frequency, real, color=colour, linestyle=":" if lack.why else "-",
                      linewidth=1.2 + 0.9 * under, zorder=2.5 - 0.1 * under,  # wider below others: equal ones are seen
                      label=f"{name}: {lacking(lack)}")
            greatest = max(greatest, float(np.abs(real).max()))
    axes.axhline(-one.damping, color=plot.GREEN, linewidth=0.9, label=r"$-\delta$")
    axes.axhline(0.0, color=plot.DARK, linewidth=0.6)
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
