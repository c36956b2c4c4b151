"""Adversarial search for `check_law`: an evolution of scenes and of a law's own knobs towards a claim that breaks.

A point is a number in [0, 1] for each number of a scene (`_scene`) and for each knob of the law. The law is fitted to
the link, and knobs that break one of its conditions become what the condition says to type: a claim holds where the
conditions do, and is closest to breaking where they barely do. Each goal judges a point by a fraction, which evolution
makes greater:

    books    energy that an end keeps beyond what came in by its port, over the work at that port
    E_law    its depth below zero, over the greatest work of one tick so far: more than 1 breaks the claim. No
             force cap, and no grip or wall of k T^2/m or d T/m above 1/4, see `teleop.law.offers`
    E_port   what the ports got, over all the work at them

Trials at random find faults at ordinary gains; this finds faults that need gains, hand, bodies and link at once. The
points are the same at every search. They are run in plain Python: no compiled kernel has the ledgers of each end at
each tick.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from teleop import kind
from teleop.checks import trials
from teleop.checks.conformance import conditions_of
from teleop.errors import Refused
from teleop.knob import Knob, knobs_of_fields
from teleop.law import messages
from teleop.law.offers import claims_of, seed_energy
from teleop.physics.plant import MassDamper
from teleop.scene.parts import Reference
from teleop.scene.playout import Fixed, Hold, Integral, Playout, Zero
from teleop.scene.scene import Scene
from teleop.simulation.notes import facts_of, longest
from teleop.simulation.virtual import run
from teleop.stages.force_cap import Cap
from teleop.stages.scaling import Scaling
from teleop.stages.watchdog import Watchdog

GOALS = {"E_law": ("books", "E_law"), "E_port": ("E_port",)}  # of the ledgers that are searched
RUNS = 40  # of each goal
DURATION = 0.4  # s
RANDOM = 0.3  # of the runs are drawn at random, the rest bred
PARENTS = 6
CHANGED, STEP = 0.3, 0.4  # the share of a point's numbers that are not its parent's, and how far they go
DECADES = 2.0  # either way that a knob goes from its value
CURES = 4  # rounds of typing what the conditions say
RESOLVED = 0.25  # k T^2/m and d T/m of a grip or a wall; above, it may turn its body round while a force is held
DT = 1e-3  # s


class Worst(NamedTuple):
    """Figures of a search that broke no claim: of those runs that came closest."""

    runs: int
    fractions: dict[str, float]  # the greatest by goal: of the bound for E_law, of the work for the others
    port: float  # the least E_port over its bound, the seed and one tick's work: -1 is all that may be given out
    scenes: dict[str, Scene]  # those of the fractions


@dataclass(frozen=True, kw_only=True)
class Shaken:
    """An environment that is carried along a path."""

    inner: ClassVar[bool] = True  # its plants keep the tick

    environment: trials.Block
    path: Reference


class Point:
    """Numbers in [0, 1] by name, each made when it is asked for: drawn, or bred from a parent."""

    def __init__(self, dice: Iterator[float], parents: tuple[Point, ...] = ()) -> None:
        self._dice, self._parents = dice, parents
        self._numbers: dict[str, float] = {}

    def at(self, name: str) -> float:
        """The number of this name."""
        if name not in self._numbers:
            self._numbers[name] = self._breed(name) if self._parents else next(self._dice)
        return self._numbers[name]

    def _breed(self, name: str) -> float:
        parent = self._parents[int(next(self._dice) * len(self._parents))].at(name)
        change = next(self._dice)
        if change < CHANGED / 3.0:
            return next(self._dice)
        step = STEP * (next(self._dice) + next(self._dice) + next(self._dice) - 1.5)
        return min(max(parent + step, 0.0), 1.0) if change < CHANGED else parent

    def between(self, name: str, low: float, high: float) -> float:
        """A number between these, both above zero, evenly in the logarithm."""
        return float(low * (high / low) ** self.at(name))

    def beyond(self, name: str, most: float, threshold: float = 0.5) -> float:
        """0.0 up to a threshold, and from there on up to `most`."""
        return most * max(self.at(name) - threshold, 0.0) / (1.0 - threshold)


def try_worst(law: Any, *, runs: int = RUNS, key: str = "", duration: float = DURATION) -> Worst:
    """Search with so many runs for each goal; `key` is another search. `Refused` if a claim breaks, with the scene."""
    worst = Worst(0, {}, 0.0, {})
    for ledger, goals in GOALS.items():
        if ledger in claims_of(law):
            for goal in goals:
                dice = trials.spread(f"{type(law).__name__}{goal}{key}")
                worst = _evolve(law, ledger, goal, worst, runs, dice, duration)
    return worst


def _evolve(law: Any, ledger: str, goal: str, worst: Worst, runs: int, dice: Iterator[float], duration: float
             ) -> Worst:
    """The search of one goal, with what the goals before it had."""
    best: list[tuple[float, int, Point, Scene]] = []
    port, ran = worst.port, 0
    for number in range(4 * runs):  # of points whose law cannot be had there is no run
        parents = tuple([point for _, _, point, _ in best[:PARENTS]])
        point = Point(dice, parents if ran >= RANDOM * runs else ())
        capped = goal != "E_law" and point.at("cap") > 0.7
        scene = _scene(law, point, duration, Cap(f_max=point.between("f_max", 0.1, 100.0)) if capped else None)
        if scene is None or not trials.admits(claims_of(law)[ledger], scene):
            continue
        trace = run(scene).trace
        trials.refuse_broken(scene.law, scene, trace, [ledger])
        best.append((_fraction(goal, scene, trace), -number, point, scene))
        best.sort(key=lambda each: each[:2], reverse=True)
        del best[PARENTS:]
        port = min(port, _share_of_bound(scene, trace))
        ran += 1
        if ran == runs:
            break
    if not best:
        return worst
    return Worst(worst.runs + ran, {**worst.fractions, goal: best[0][0]}, port, {**worst.scenes, goal: best[0][3]})


def _fraction(goal: str, scene: Scene, trace: Any) -> float:
    """Progress of a run towards breaking a goal."""
    works = trials.works_of(trace)
    if goal == "E_law":
        return float((-trace["E_law"] / (trials.greatest_work(works) + trials.LOW)).max())
    late = len(works[0]) // 2  # what goes in as a run begins hides what comes out later
    if goal == "books":
        return max(float(-books[late:].min() / (work.sum() + trials.LOW)) for books, work in
                   zip(trials.books_of(scene.law, scene, trace).values(), works, strict=True))
    return float(-trace[goal][late:].min() / (sum(work.sum() for work in works) + trials.LOW))


def _share_of_bound(scene: Scene, trace: Any) -> float:
    """The least E_port over what may be given out: the seed energy and, of a law with books, one tick's work."""
    bound = seed_energy(scene.law, scene.dt, scene.axes) + trials.greatest_work(trials.works_of(trace))
    return min(float((trace["E_port"] / (bound + trials.LOW)).min()), 0.0)


def _scene(law: Any, point: Point, duration: float, cap: Cap | None) -> Scene | None:
    """The scene of a point, with the law that its conditions allow there; None if there is none."""
    tuned = _with_knobs(law, point)
    if tuned is None:
        return None
    size, ticks = point.between("amplitude", 0.005, 0.5), round(duration / DT)
    lost_m, lost_s = _lost_ticks(point, "lost_m"), _lost_ticks(point, "lost_s")
    held_m, held_s = _longest_held(lost_m, 0, ticks), _longest_held(lost_s, 1, ticks)
    master, slave = point.between("m_m", 0.02, 2.0), point.between("m_s", 0.05, 5.0)
    one_end: dict[str, Any] = {
        "law": tuned, "energy": True, "duration": duration, "x_limit": 1e3, "cap": cap,
        "axes": 3 if point.at("axes") > 0.7 else 1, "observer": None if point.at("observer") < 0.5 else 200.0,
        "master": MassDamper(mass=master, damping=point.beyond("b_m", 2.0)),
        "hand": trials.Swing(mass=point.beyond("m_h", 1.0), k=point.between("k_h", 10.0, RESOLVED * master / held_m**2),
                      d=point.between("d_h", 0.1, RESOLVED * master / held_m),
                      reference=trials.Tones(amplitude=size, rate=point.between("rate", 3.0, 130.0))),
        "left_out_m": lost_m}
    if not hasattr(law, "slave"):
        return Scene(**one_end)
    block: Any = trials.Block(k=point.between("k_e", 10.0, RESOLVED * slave / held_s**2),
                              d=point.beyond("d_e", min(20.0, RESOLVED * slave / held_s)),
                              at=size * (point.at("at") - 0.3))
    if point.at("shaken") > 0.7:
        path = trials.Tones(amplitude=point.between("shaken_by", 0.001, 0.2),
                            rate=point.between("shaken_at", 3.0, 300.0))
        block = Shaken(environment=block, path=path)
    scaling = None
    if point.at("scaling") > 0.7:
        scaling = Scaling(scale_x=point.between("scale_x", 0.01, 1.0), scale_f=point.between("scale_f", 0.01, 1.0))
    return _meet_conditions(Scene(
        **one_end, slave=MassDamper(mass=slave, damping=point.beyond("b_s", 2.0)),
        environment=block if point.at("wall") > 0.4 else None, scaling=scaling, start_s=point.beyond("apart", 0.02),
        link=trials.RandomLink(ticks=int(point.between("delay", 1.0, 150.0)) - 1, loss=point.beyond("loss", 0.5),
                        jitter=int(point.beyond("jitter", 20.0)), copies=point.beyond("copies", 0.3),
                        key=point.at("key"), blackout=int(point.beyond("blackout", 150.0))),
        playout=_playout(law, point), left_out_s=lost_s,
        watchdog=Watchdog(timeout=0.03, ramp=0.02) if point.at("watchdog") > 0.8 else None))


def _playout(law: Any, point: Point) -> Playout:
    """A playout that a claim over any link admits; a law without waves may have a message played again."""
    again: Playout = Integral() if any(map(kind.waves, messages(law))) else Hold()
    return (Zero(), again, Fixed(0.02))[int(point.at("playout") * 2.999)]


def _lost_ticks(point: Point, name: str) -> trials.LostTicks | None:
    share = point.beyond(name, 0.3, 0.7)
    return trials.LostTicks(share=share, key=point.at("key")) if share > 0.0 else None


def _longest_held(lost: trials.LostTicks | None, end: int, ticks: int) -> float:
    """The longest time that an end which leaves out these ticks holds a force, s."""
    return DT if lost is None else DT * longest(np.flatnonzero(~lost.left_out(end, ticks, 0)), ticks)


def _with_knobs(law: Any, point: Point) -> Any:
    """The law with the knobs of a point, within two decades of its own; None if it refuses them."""
    knobs = {name: _number(getattr(law, name), each.knob, point.at(f"law.{name}"))
             for name, each in knobs_of_fields(type(law)).items()}
    try:
        return replace(law, **knobs)
    except Refused:
        return None


def _number(default: float, knob: Knob, at: float) -> float:
    """The value of a knob at a point: its own by a third, and its lower bound by a twentieth."""
    if at < 0.05 and knob.low is not None:
        return knob.low
    if at < 0.4:
        return default
    value = default * 10.0 ** (DECADES * (at - 0.7) / 0.3) if default else (at - 0.4) / 0.6
    value = value if knob.low is None else max(value, knob.low)
    return value if knob.high is None else min(value, knob.high)


def _meet_conditions(scene: Scene) -> Scene | None:
    """The scene with its law fitted to the link, and knobs as its conditions say to type; None if one stays broken."""
    facts, law = facts_of(scene), scene.law
    if hasattr(law, "fitted"):
        law = law.fitted(facts)
    for _ in range(CURES):
        broken = conditions_of(law, facts)
        if not broken:
            return scene if law is scene.law else replace(scene, law=law)
        cure = {knob: value for condition in broken for knob, value in condition.cure.items()}
        try:
            law = replace(law, **cure)
        except (Refused, TypeError):
            return None
    return None
