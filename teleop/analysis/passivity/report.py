"""Output of `teleop passivity`: a table for a person, JSON, and the curves behind them."""

from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.models.coupling import Lack, gap
from teleop.analysis.models.law_parts import effective_damping
from teleop.analysis.passivity.judge import SLOW, UNIT, Judged, TwoPorts, two_ports
from teleop.analysis.passivity.one_port import Behind, RenderedImpedance, one_port
from teleop.analysis.passivity.surroundings import linear_parts
from teleop.errors import Refused
from teleop.law.analysis_offers import instead
from teleop.scene.axes import labels_of, told_along, unit_on
from teleop.scene.scene import Scene
from teleop.terminal.answer import WithUnit, finite, scene_head, titled, with_units
from teleop.terminal.options import typed_range
from teleop.terminal.table import facts, si

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


