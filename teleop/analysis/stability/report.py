"""Output of `teleop stability`: the command line's questions put, and the result as a table and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import pairwise
from math import floor, log10
from typing import Any, NamedTuple, get_args

from teleop.analysis.models.by_axis import coupling_law
from teleop.analysis.models.continuous import Continuous
from teleop.analysis.models.continuous import continuous as without_clock
from teleop.analysis.models.rest import FreeMotion
from teleop.analysis.stability.assess import (
    HALVED,
    PLACES,
    Change,
    Critical,
    Stability,
    critical,
    lowest,
    places_of,
    rests,
    stability,
    swing,
)
from teleop.errors import Refused, enumerated, nearest, number_of, plural
from teleop.law.analysis_offers import instead
from teleop.scene.axes import labels_of
from teleop.scene.catalogue import units_of
from teleop.scene.knobs import knobs_of
from teleop.scene.library import scene_function
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.rest import STEPS
from teleop.terminal.answer import WithUnit, scene_head, titled, with_units
from teleop.terminal.options import typed_number, typed_range
from teleop.terminal.progress import Show
from teleop.terminal.table import columns, facts, si

PLACES_IN_TIME = 21  # of a range: each is a few runs
HALVINGS = 20  # of a range that is tried at `PLACES` values, or about so many
TOLD = 4  # further changes in the table


class SoFar(NamedTuple):
    """Values that an interrupted search for a critical value has judged, upwards."""

    knob: str
    tried: tuple[tuple[float, bool], ...]  # a value, and is it stable there

    @property
    def changes(self) -> list[tuple[float, float]]:
        """Neighbours with a change of the verdict between them."""
        return [(a[0], b[0]) for a, b in pairwise(self.tried) if a[1] != b[1]]

    def between(self, near: float | None) -> tuple[float, float] | None:
        """Two neighbours with a change of the verdict between them, nearest to `near`, or the lowest; None: none."""
        pairs = self.changes
        if near is None:
            return pairs[0] if pairs else None
        return min(pairs, key=lambda pair: abs(0.5 * (pair[0] + pair[1]) - near), default=None)


class StabilityAnswer(NamedTuple):
    """Result of the analysis: verdict, continuous limit and critical value."""

    scene: Scene
    assessment: Stability | FreeMotion
    limit: Continuous | None
    edge: Critical | None
    unit: str = ""  # of its knob, with a space before it, where the scene names one
    seed: int = 0
    so_far: SoFar | None = None  # of a search that was interrupted
    in_time: bool = False
    places: tuple[float, ...] = ()  # values of the knob over its range, those of the critical value among them
    cut_short: bool = False  # were the margins over the knob interrupted

    @property
    def stands_in(self) -> str:
        """The linear law that was judged in the place of the scene's own, in words; empty if none was."""
        return "" if self.in_time else instead(self.scene.laws[0])

    @property
    def finished(self) -> bool:
        """True if nothing was interrupted."""
        return self.so_far is None and not self.cut_short

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        assessment = self.assessment
        if not isinstance(assessment, Stability):
            return f"{assessment.verdict}: {assessment.sentence}"
        count = f"{assessment.unstable or 'no'} {plural(assessment.unstable or 1, 'root')}"
        shaky = [name for one in assessment.axes if one.stability.unstable for name in one.names]
        where = f" ({enumerated(shaky)})" if shaky and len(assessment.axes) > 1 else ""
        return f"{assessment.verdict}: {count} outside the unit circle{where}"


def ask(name: str, knobs: Mapping[str, object], *, seed: int = 0, in_time: bool = False, continuous: bool = False,
        knob: str | None = None, span: str | None = None, tol: str | None = None, show: Show | None = None
        ) -> StabilityAnswer:
    """Load the scene and answer; the texts `span` (LOW:HIGH) and `tol` as they were typed. Raises `Refused`.

    `show` is told how much of the search for a critical value is done, 0 to 1. An interrupt of that search ends it, and
    the answer has what it knows so far; one before it is raised as KeyboardInterrupt.
    """
    if knob is None and (span is not None or tol is not None):
        raise Refused("--range and --tol are for a critical value; name its knob with --critical KNOB")
    if in_time and continuous:
        raise Refused("--continuous is for linear scenes and --time for the others; leave one of them out")
    scene = load_scene(name, **knobs)
    scene_value = None if knob is None else own_value(scene, knob)
    low, high = (0.0, 0.0) if knob is None or scene_value is None else _span(knob, scene_value, span)
    closeness = None if tol is None else typed_number("--tol", tol, example="0.01", above=0.0)
    assessment = swing(scene, seed=seed) if in_time else stability(scene, seed=seed)
    limit = without_clock(scene) if continuous else None
    if knob is None or scene_value is None:
        return StabilityAnswer(scene, assessment, limit, None, seed=seed, in_time=in_time)

    def make(value: float) -> Scene:
        return load_scene(name, **{**knobs, knob: value})

    unit = units_of(name, [knob], type(scene.laws[0])).get(knob)
    search = _KnobSearch(knob, scene_value, f" {unit}" if unit else "", in_time, show)
    answer = StabilityAnswer(scene, assessment, limit, None, search.unit, seed, in_time=in_time)
    whole = _whole(name, knob)
    try:
        if in_time:
            edge = lowest(make, knob, low=low, high=high, near=scene_value, places=PLACES_IN_TIME, tol=closeness,
                          whole=whole, judge=lambda one: rests(one, seed=seed), tell=search)
        else:
            edge = critical(make, knob, low=low, high=high, near=scene_value, places=PLACES, tol=closeness, whole=whole,
                            tell=search)
    except KeyboardInterrupt:
        return answer._replace(so_far=search.so_far)
    if show is not None:
        show(1.0, "done")
    places = sorted({*places_of(knob, low, high, PLACES, whole), *(one.value for one in edge.all)})
    return answer._replace(edge=edge, places=tuple(places))


class _KnobSearch:
    """Progress of a search for a critical value, passed to `show` value by value."""

    __slots__ = ("in_time", "knob", "near", "show", "tried", "unit")

    def __init__(self, knob: str, scene_value: float, unit: str, in_time: bool, show: Show | None) -> None:
        self.knob, self.unit, self.in_time, self.show = knob, unit, in_time, show
        self.near = None if in_time else scene_value
        self.tried: dict[float, bool] = {}

    @property
    def so_far(self) -> SoFar:
        """The values in order."""
        return SoFar(self.knob, tuple(sorted(self.tried.items())))

    def __call__(self, value: float, stable: bool) -> None:
        self.tried[value] = stable
        if self.show is None:
            return
        places, halvings = (PLACES_IN_TIME, HALVED) if self.in_time else (PLACES, HALVINGS)
        known = self.so_far
        pair, total = known.between(self.near), places + halvings * (1 if self.in_time else max(1, len(known.changes)))
        text = f"{self.knob} = {value:.4g}{self.unit} {verdict_word(stable, self.in_time)}"
        if pair is not None:
            text += f"; changes between {pair[0]:.5g} and {pair[1]:.5g}"
        self.show(min(len(self.tried) / total, 0.99), text)


def verdict_word(stable: bool, in_time: bool) -> str:
    """The verdict on a value of a knob, in words."""
    if in_time:
        return "rests" if stable else "does not rest"
    return "is stable" if stable else "is unstable"


def _whole(name: str, knob: str) -> bool:
    """True if the scene takes only whole numbers for this knob. A law's own knobs take any numbers."""
    declared = knobs_of(scene_function(name)).get(knob)
    kinds = () if declared is None else get_args(declared.kind) or (declared.kind,)
    return int in kinds and float not in kinds


def own_value(scene: Scene, knob: str) -> float:
    """The value that a knob (`k_e`, or `law.K` of the law) has in the scene. Refused if it is no number."""
    every: Any = scene.laws
    gains = {f"law.{field.name}": tuple(getattr(law, field.name) for law in every) for field in fields(every[0])}
    gains = {key: each[0] if len(set(each)) == 1 else each for key, each in gains.items()}
    known = {key: value for key, value in {**scene.knobs, **gains}.items()
             if isinstance(value, (int, float)) and not isinstance(value, bool)}
    if knob not in known and isinstance({**scene.knobs, **gains}.get(knob), tuple):
        raise Refused(f"{knob} has a number for each axis of scene {scene.name}, and a critical value is one number; "
                      f"give one for all of them, --set {knob}=VALUE, or take another knob: {enumerated(known, 'or')}")
    if knob not in known:
        raise Refused(f"scene {scene.name} has no knob {knob!r} that is a number; {nearest(knob, known)}")
    return float(known[knob])


def _span(knob: str, scene_value: float, typed: str | None) -> tuple[float, float]:
    if typed is None:
        if scene_value <= 0.0:
            raise Refused(f"{knob} is {scene_value:g}, which gives no range to look in; write --range LOW:HIGH")
        return scene_value / 100.0, scene_value * 100.0
    return typed_range("--range", typed, what=f"values of {knob}", example="10:1e4")


def summary(answer: StabilityAnswer, command: Sequence[str] = (), drawn: Mapping[str, Any] | None = None
            ) -> dict[str, Any]:
    """The JSON document, with the numbers of what is `drawn`."""
    assessment = answer.assessment
    limit, edge = answer.limit, answer.edge
    body: dict[str, Any] = {"verdict": assessment.verdict, "linear_law": answer.stands_in or None}
    if isinstance(assessment, Stability):
        body |= {"method": "roots", "unstable": assessment.unstable, "integrators": assessment.integrators,
                 "fwd": WithUnit(assessment.forth, "ticks"), "bwd": WithUnit(assessment.back, "ticks"),
                 "round_trip": WithUnit(assessment.round_trip, "ticks"), **_margins(assessment)}
        if assessment.axes:
            body["axes"] = [{"names": list(names), "verdict": alone.verdict, "unstable": alone.unstable,
                             "integrators": alone.integrators, **_margins(alone)} for names, alone in assessment.axes]
    else:
        unit = labels_of(answer.scene).unit("m")
        body |= {"method": "virtual time", "amplitude": WithUnit(assessment.amplitude, unit),
                 "frequency": WithUnit(assessment.frequency, "Hz"), "rests": assessment.rests}
    body["continuous"] = limit and {**limit._asdict(), "round_trip": WithUnit(limit.round_trip, "s"),
                                    "frequency": WithUnit(limit.frequency, "Hz")}
    body["critical"] = edge and {**_in_unit(edge, answer.unit), "all": [_in_unit(one, answer.unit) for one in edge.all]}
    if answer.so_far is not None:
        body["so_far"] = {"knob": answer.so_far.knob, "tried": [list(one) for one in answer.so_far.tried]}
    return {**scene_head(answer.scene, "stability", sentence=answer.sentence, seed=answer.seed, command=command,
                         status="done" if answer.finished else "interrupted"), **with_units({**body, **(drawn or {})})}


def _margins(stability: Stability) -> dict[str, Any]:
    mode = stability.mode
    return {
        "critical_round_trip": WithUnit(stability.critical_round_trip, "ticks"),
        "delay_margin": WithUnit(stability.delay_margin, "ticks"), "gain_margin": WithUnit(stability.gain_margin, "1"),
        "dominant": mode and {"z": [mode.z.real, mode.z.imag], "frequency": WithUnit(mode.frequency, "Hz"),
                              "growth": WithUnit(mode.growth, "1/s"), "damping": WithUnit(mode.damping, "1")},
    }


def _in_unit(edge: Critical | Change, unit: str) -> dict[str, Any]:
    """The fields of a change of the verdict; its values are in `unit`."""
    values = {name: WithUnit(getattr(edge, name), unit.strip()) for name in ("value", "low", "high")}
    return {**edge._asdict(), **values}


def table(answer: StabilityAnswer) -> str:
    """The answer in a few lines."""
    assessment, limit, edge = answer.assessment, answer.limit, answer.edge
    rows = [("scene", titled(answer.scene)), ("verdict", answer.sentence)]
    if answer.stands_in:
        rows.append(("law", answer.stands_in))
    rows += _roots(assessment) if isinstance(assessment, Stability) else []
    if limit is not None:
        rows.append(("continuous", _without_clock(limit)))
    if edge is not None:
        rows.append(("critical", _edge(edge, answer.unit, _steps(answer.scene))))
    if answer.so_far is not None:
        rows.append(("interrupted", _unfinished(answer.so_far, answer)))
    if answer.cut_short:
        rows.append(("interrupted", "the margins over the knob are missing, and their plot"))
    if not isinstance(assessment, Stability) or answer.scene.axes == 1:
        return facts(rows)
    if not assessment.axes:
        rows.append(("axes", f"judged together: {coupling_law(answer.scene)}"))
        return facts(rows)
    if len(assessment.axes) == 1:
        rows.append(("axes", f"{enumerated(assessment.axes[0].names)} have the same loop"))
        return facts(rows)
    return f"{facts(rows)}\n\n{_by_axis(assessment)}"


def _by_axis(stability: Stability) -> str:
    """A row for each axis, or for those that are alike."""
    rows = [("axis", "verdict", "frequency", "growth", "damping", "gain margin", "delay margin")]
    for names, alone in stability.axes:
        mode, edge, gain = alone.mode, alone.critical_round_trip, alone.gain_margin
        moved = ("-",) * 3 if mode is None else (si(mode.frequency, "Hz"), f"{mode.growth:+.4g} 1/s",
                                                 f"{mode.damping:.3g}")
        rows.append((", ".join(names), alone.verdict, *moved, "none" if gain is None else f"{gain:.4g}",
                     "none" if edge is None else si((edge - 1 - alone.round_trip) * alone.dt, "s")))
    return columns(rows, left=(0, 1))


def _unfinished(so_far: SoFar, answer: StabilityAnswer) -> str:
    tried, unit, knob = so_far.tried, answer.unit, so_far.knob
    if not tried:
        return f"before any value of {knob} was judged"
    sentence = f"after {number_of(len(tried), 'value')} of {knob}, from {tried[0][0]:.4g} to {tried[-1][0]:.4g}{unit}"
    pair = so_far.between(None if answer.in_time else own_value(answer.scene, knob))
    if pair is None:
        return f"{sentence}: it {verdict_word(tried[0][1], answer.in_time)} at each of them"
    below, above = (verdict_word(dict(tried)[value], answer.in_time) for value in pair)
    return f"{sentence}: it {below} at {pair[0]:.5g}{unit} and {above} at {pair[1]:.5g}{unit}"


def _roots(loop: Stability) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    if loop.integrators:
        rows.append(("at rest", f"{loop.integrators} at z = 1: positions that nothing returns"))
    if loop.mode is not None:
        mode, word = loop.mode, "grows" if loop.mode.growth > 0.0 else "decays"
        rows.append(("first mode" if loop.unstable else "last mode", f"{si(mode.frequency, 'Hz')}, {word} at "
                     f"{abs(mode.growth):.4g} 1/s, damping ratio {mode.damping:.4g}"))
    trip, edge, dt = loop.round_trip, loop.critical_round_trip, loop.dt
    if loop.alone:
        rows.append(("computation", f"{number_of(trip, 'tick')} late, {si(trip * dt, 's')}"))
    else:
        rows.append(("round trip", f"{loop.forth} + {loop.back} = {number_of(trip, 'tick')}, {si(trip * dt, 's')}"))
    first = "none: stable at every delay" if loop.tried is None else f"none up to {number_of(loop.tried, 'tick')}"
    if edge is not None:
        first = f"unstable from a {rows[-1][0]} of {number_of(edge, 'tick')}, {si(edge * dt, 's')}, on"
    if edge == 0:
        first = "unstable without any delay"
    elif edge == 2 and not loop.alone:
        first = "unstable already at 2 ticks, the shortest round trip there is"
    rows.append(("delay margin", first))
    gain = loop.gain_margin
    margin = "none: no factor from 1e-6 to 1e6 changes the verdict"
    if gain == 1.0:
        margin = "exactly 1 (0 dB): with any more gain what rests at z = 1 moves away by itself"
    elif gain is not None:
        margin = f"{gain:.5g} ({20.0 * log10(gain):+.3g} dB)"
    return [*rows, ("gain margin", margin)]


def _without_clock(limit: Continuous) -> str:
    if not limit.stable_without_delay:
        return "unstable without any delay"
    if limit.round_trip is None or limit.frequency is None:
        return "stable at every delay"
    return f"unstable from a round trip of {limit.round_trip * 1e3:.3f} ms on, at {limit.frequency:.3f} Hz"


def _steps(scene: Scene) -> str:
    """Name the swing that counts as rest behind an encoder."""
    seen = any(end is not None and end.encoder is not None for end in (scene.device_m, scene.device_s))
    return f", to {STEPS:g} steps of the encoder" if seen else ""


def _edge(edge: Critical, unit: str, counted: str) -> str:
    at = f"{edge.knob} = {_digits(edge)}{unit}"
    if edge.method == "stepwise":
        one, next_ = ("does not come", "does") if edge.stable == "below" else ("comes", "does not")
        text = (f"{at} is the lowest of {edge.tried} values tried that {one} to rest{counted}; the next below, "
                f"{_digits(edge, edge.low)}{unit}, {next_}")
    elif isinstance(edge.high, int):
        word = "unstable" if edge.stable == "below" else "stable"
        text = f"{edge.knob} = {edge.high}{unit} is the first that is {word}, {edge.low} is not yet"
    else:
        text = f"{at} (within {edge.high - edge.low:.1g}{unit}), stable {edge.stable}"
    others = [one for one in edge.all if one[:3] != edge[1:4]]
    if not others:
        return text
    if edge.method == "stepwise":
        changes = [f"{one.low:.4g} to {one.high:.4g}{unit}" for one in others[:TOLD]]
    else:
        changes = [f"{_digits(one)}{unit} (stable {one.stable})" for one in others[:TOLD]]
    rest = f" and {len(others) - TOLD} more, see --json" if len(others) > TOLD else ""
    also = "from" if edge.method == "stepwise" else "at"
    return f"{text}; the verdict changes also {also} {', '.join(changes)}{rest}"


def _digits(edge: Critical | Change, value: float | None = None) -> str:
    """A value with the digits that the distance from low to high leaves it."""
    value = edge.value if value is None else value
    width = edge.high - edge.low
    if isinstance(value, int) or not value or not width:
        return f"{value:.7g}"
    return f"{value:.{min(max(2, 2 + floor(log10(abs(value) / width))), 7)}g}"
