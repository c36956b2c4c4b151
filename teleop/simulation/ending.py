"""The end of a run that came to it: whether what is left swings, or grows, and what to type then."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from teleop.errors import enumerated, number_of, plural
from teleop.law import is_built_in, law_name
from teleop.law.contract import not_finite
from teleop.scene.axes import labels_of
from teleop.scene.library import known_scenes, scene_function
from teleop.scene.playout import Playout, as_typed
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies
from teleop.simulation.metrics import found_at_rest, in_base_of_master
from teleop.simulation.plan import Plan
from teleop.simulation.prepared import Prepared
from teleop.simulation.rest import WINDOWS, pitch, places, swings, trend
from teleop.stages.slave_units import scales

BEYOND = 2.0  # times the way that the hand's reference and the environment have
OWN = 1e-3  # m or rad of swing besides


class GrowthNote(str):
    """Note on a run with a motion that law and link feed, and which still grows."""

    __slots__ = ()


class Ending(NamedTuple):
    """Ending of a run: its status, its sentence and its notes."""

    status: str  # ok, limit cycle, unstable or diverged
    sentence: str
    at_rest: Mapping[str, float] = {}  # metrics of a scene that nothing moves any more
    notes: tuple[str, ...] = ()


def ending(prepared: Prepared, trace: Mapping[str, Any], trip: int, sentence: str, *, advises: bool = True) -> Ending:
    """Judge a run that came to its end, as `sentence` says; `trip`: the round trip of its link, ticks.

    Where nothing moves the scene any more the status goes by what is left, see `teleop.simulation.rest`; where the hand
    moves to the end, and where there was no time for a verdict, a note says if the motion grows. `advises`: the scene's
    own bodies have moved, so an analysis of the scene says more.
    """
    scene, still = prepared.scene, prepared.still
    if still is None:
        return Ending("ok", sentence, {}, tuple(growth(prepared, trace, advises)))
    swung = swings(motion := places(trace), still.window)
    status = still.status(swung, trip)
    unit = position_unit(scene)
    at_rest = {"swing_end": swung[-1], **found_at_rest(scene, trace, still, status)}
    since = f"{sentence}; nothing has moved the scene since t = {still.since * scene.dt_ns / 1e9:g} s, and"
    if still.undecided(swung, trip):
        enough = (still.since + WINDOWS * still.least(trip)) * scene.dt_ns / 1e9
        sentence = (f"{since} {still.swing_left(swung, trip):.3g} {unit} of swing are left, but that was too short "
                    f"a time for a verdict; type --set duration={enough:g}")
        return Ending(status, sentence, at_rest, tuple(growth(prepared, trace, advises)))
    if status != "ok":
        does = "keeps swinging" if status == "limit cycle" else f"swings ever more ({swung[0]:.3g} {unit} before)"
        hertz = at_rest.get("swing_frequency") or pitch(motion, still.window, scene.dt)
        sentence = f"{since} it {does}: {hertz:.3g} Hz, {swung[-1]:.3g} {unit} peak to peak"
        if advises:
            sentence += f"; to see what becomes of it: teleop stability {scene_arguments(scene, '--time')}"
    return Ending(status, sentence, at_rest)


def position_unit(scene: Scene) -> str:
    """The unit of the largest of the positions of all axes: m, rad, or either where some axes turn."""
    return labels_of(scene).unit("m") or "m or rad"


def growth(prepared: Prepared, trace: Mapping[str, Any], advises: bool) -> list[str]:
    """The note on a run that came to its end with a motion which law and link feed, and which still grows.

    It is due where all of these hold:

    - the swing (`teleop.simulation.rest`) in the last eighth of the run is more than `BEYOND` times the way of the
      hand's reference and of the environment's path, so that these do not explain it;
    - its trend over the last five eighths is to grow;
    - law and link have given out more energy (-E_port) than the hand's own will put in, which is the work of its force
      along its reference where that is positive. At resonance a passive loop swings more and more too, but all its
      energy is the hand's.
    """
    scene, ran = prepared.scene, prepared.scene.ticks
    window = ran // WINDOWS
    if not window:
        return []
    motion = places(trace)
    if (scene.scaling is not None or scene.frame is not None) and len(motion) > 1:  # in the master's units
        motion[1] = in_base_of_master(scene, motion[1] / np.array([scale_x for scale_x, _ in scales(scene)]))
    swung = swings(motion, window)
    if trend(swung) != "grows":
        return []
    carried = [each.path.samples(1, ran + 1, scene.dt_ns)[0] for each in scene.environments
               if each is not None and hasattr(each, "path")]
    paths = [*(prepared.reference or ()), *carried]
    way = max([float(np.ptp(path)) for path in paths], default=0.0)
    with np.errstate(all="ignore"):  # forces and ways may be so large that no float holds their work
        out, put_in = given_out(trace), _will(prepared, trace)
    if swung[-1] <= BEYOND * way + OWN or not out > put_in:
        return []
    unit = position_unit(scene)
    return [GrowthNote(
        f"the motion still grows at the end: a swing of {swung[-1]:.3g} {unit} peak to peak in the last eighth of "
        f"the run and of {swung[0]:.3g} {unit} half a run before, where the hand's reference moves over {way:.3g} "
        f"{unit}; law and link have given out {out:.3g} J (E_port), the hand has put in {put_in:.3g} J"
        + (f"; to see whether the loop is stable: teleop stability {scene_arguments(scene)}" if advises else ""))]


def given_out(trace: Mapping[str, Any]) -> float:
    """Energy (J) that law and link have given out at both ends: each force with the motion that it was held over."""
    def work(f: str, x: str) -> float:
        return float((trace[f][:-1] * np.diff(trace[x], axis=0)).sum())

    policy = work("f_policy_m", "x_m") if "f_policy_m" in trace else 0.0  # whose part of f_m is -f_policy_m
    return (work("f_s", "x_s") if "x_s" in trace else 0.0) - work("f_m", "x_m") - policy


def _will(prepared: Prepared, trace: Mapping[str, Any]) -> float:
    """Energy (J) that the hand's own will put in: the work of its force along its reference, where that is positive."""
    if prepared.reference is None:
        return 0.0
    ran = prepared.scene.ticks
    steps = np.diff(np.array([axis[: ran + 1] for axis in prepared.reference], dtype=float), axis=1)
    work = (trace["f_h"].reshape(ran, -1).T * steps).sum(axis=0)
    return float(work[work > 0.0].sum())


def scene_arguments(scene: Scene, *options: str) -> str:
    """A scene as it is typed: its name, the knobs that are not as it has them by itself, and more options.

    Where the file of a scene lies its name does not say.

    >>> from teleop import load_scene
    >>> scene_arguments(load_scene("hard_wall", law="direct", delay=0.1))
    'hard_wall --set law=direct --set delay=0.1'
    """
    from shlex import quote

    from teleop.scene.knobs import knobs_of, read_law

    if scene.name not in known_scenes():
        return " ".join([f"{scene.name}.py", *options]) + ", with its path and the --set of the run"
    knobs = knobs_of(scene_function(scene.name))
    words = [scene.name]
    value: Any
    for key, value in scene.knobs.items():
        usual = knobs[key].default if key in knobs else None
        if key == "law" and value != usual:
            if type(value) is not type(usual):
                name = law_name(value) if is_built_in(value) else _file(type(value))
                words.append(f"--set law={quote(name)}")
                usual = read_law(name, usual) if is_built_in(value) else type(value)()
            words += [f"--set law.{each.name}={getattr(value, each.name)}" for each in fields(value)
                     if getattr(value, each.name) != getattr(usual, each.name)]
        elif value != usual:
            text = ",".join(map(str, value)) if isinstance(value, tuple) else "none" if value is None else str(value)
            text = as_typed(value) if isinstance(value, Playout) else text
            words.append(f"--link {quote(text)}" if key == "link" else f"--set {key}={quote(text)}")
    return " ".join([*words, *options])


def _file(kind: type[Any]) -> str:
    """The file and the class of a law that does not come with this package, with the stages around it."""
    if (inner := vars(kind).get("inner_law")) is not None:
        return f"{kind.stage.name} | {_file(inner)}"
    file = getattr(sys.modules.get(kind.__module__), "__file__", None)
    return f"{file or kind.__module__}:{kind.__name__}"


def verdict(prepared: Prepared, trace: Mapping[str, Any], ran: int, end: Any, trip: int, *, advises: bool = True
            ) -> Ending:
    """Judge a run. `end` is None, or the positions that left the bounds; `trip`: the round trip of its link, ticks.

    What is not finite anywhere in the trace is a divergence, even of a run that came to its end.
    `advises`: see `ending`.
    """
    scene = prepared.scene
    lost = {
        name: int(np.argmin(sound.reshape(ran, -1).all(axis=1)))
        for name in ("f_m", "f_s", *trace) if name in trace and not (sound := np.isfinite(trace[name])).all()
    }
    if lost:
        name = min(lost, key=lost.__getitem__)  # the first of several at the same tick
        return Ending("diverged", divergence(scene, lost[name], not_finite(scene.laws[0], name)))
    if end is None:
        return ending(prepared, trace, trip, ran_to_end(scene, ran), advises=advises)
    far = [name for name, xs in zip(("x_m", "x_s"), end, strict=False) if not all(abs(x) < scene.x_limit for x in xs)]
    return Ending("diverged", divergence(scene, ran - 1, f"{far[0]} passed {scene.x_limit:g} {position_unit(scene)}"))


def ran_to_end(scene: Scene, ran: int) -> str:
    """The sentence of a run that came to its end, after so many ticks."""
    return f"ran to its end, {number_of(ran, 'tick')} of {scene.dt:g} s"


def divergence(scene: Scene, k: int, what: str) -> str:
    """The sentence of a run that diverged at tick k."""
    when = f"diverged at t = {k * scene.dt_ns / 1e9:g} s (tick {k})"
    return f"{when}: {what}; a smaller dt, gain or delay may hold it"


def too_old(scene: Scene, end: str, plan: Plan | None, ran: int) -> list[str]:
    """The note on messages that were too old for an end's watchdog: how many, how old, and what to type."""
    age = getattr(scene.watchdog, "age", None)
    if plan is None or age is None:
        return []
    ages = (np.arange(ran) - plan.played_at[:ran])[plan.played_at[:ran] >= 0] * scene.dt
    old = ages[ages > age + 0.5 * scene.dt]
    return [age_note(end, len(old), float(old.max()), age)] if len(old) else []


def age_note(end: str, count: int, most: float, age: float) -> str:
    """The sentence for messages that were too old for the watchdog of an end."""
    enough = f"{2.0 * most:.2g}"
    were = f"{number_of(count, 'message')} {plural(count, 'was', 'were')}"
    return (f"{were} more than the watchdog's age of {age:g} s old when the {end} played "
            f"{plural(count, 'it', 'them')}, up to {most:g} s, so it let go; for a link as long as that type --set "
            f"age={enough}, or in a scene of your own watchdog=Watchdog(age={enough}); "
            "with none in place of a number a message may be of any age")


def handed_over(scene: Scene, trace: Mapping[str, Any]) -> list[str]:
    """The note on a scene's policy: its time and work, what was left in its tank, and who took it back, and when."""
    if "policy_m" not in trace:
        return []
    from teleop.stages.authority import Standing

    t, standing = trace["t"], trace["policy_m"]
    ticks = {each: int((standing == each).sum()) for each in Standing}
    full = scene.handover.energy  # type: ignore[union-attr]  # it has one, for there is the column
    note = (f"the policy had authority for {ticks[Standing.POLICY] * scene.dt:.3g} s and did "
            f"{trace['E_policy_m'][-1]:.3g} J of work; its tank of {full:g} J was never below "
            f"{trace['E_tank_m'].min():.3g} J")
    taken = t[1:][(standing[1:] == Standing.GRIPPED) & (standing[:-1] != Standing.GRIPPED)]
    if len(taken):
        note += f"; the operator took over by force at t = {enumerated([f'{at:.3g}' for at in taken[:5]])} s"
    if ticks[Standing.LATE]:
        note += f"; it gave way for {ticks[Standing.LATE] * scene.dt:.3g} s in which no action came"
    return [note]


def integration(scene: Scene, bodies: Bodies, inner: tuple[tuple[Any, ...], tuple[Any, ...]]) -> dict[str, Any]:
    """The reports of the bodies that are integrated, by end: of each figure the worst of the axes.

    `inner`: the inner states that each end's bodies ended with, per axis.
    """
    reports = {"master": [bodies.report_m] * scene.axes, "slave": [plant.report for plant in bodies.slaves]}
    reports_by_end = {}
    for (end, each), states in zip(reports.items(), inner, strict=True):
        axes = [report(z) for report, z in zip(each, states, strict=False) if report is not None]
        names = {name for one in axes for name in one}
        if names:
            reports_by_end[end] = {name: max(one[name] for one in axes if name in one) for name in sorted(names)}
    return {"integration": reports_by_end} if reports_by_end else {}


def over_tolerance(reports: dict[str, Any], unit: str) -> list[str]:
    """The notes on the ends whose integration was not within the scene's tolerance (`unit`: m or rad) at every tick."""
    return [f"{number_of(over, 'tick')} of the {end} {plural(over, 'is', 'are')} not within {report['tolerance']:g} "
            f"{unit}: the figures may be off by the estimates and by what the loop makes of them; a smaller dt may help"
            for end, report in reports.get("integration", {}).items() if (over := report.get("ticks_over_tolerance"))]
