"""The advice: every law with two ends tuned for one link and one wall, ranked, and its margins measured.

Each law gets the same number of rows (`teleop.studies.tune`). Of the laws that keep the constraints, and whose own
conditions link and bodies keep (`teleop.law.offers`), the one with the least value of the objective is advised; those
whose value is within the spread over the seeds are said to be as good. A law that does better while a condition of it
is broken is shown beside it: what it does here it promises for no other hand.
Its margins are measured: the stiffest wall and the longest further delay, of the factors that are tried, up to which
the same gains keep all constraints. Gains are not tuned again for them, as nobody does while a robot moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from teleop.law import find_law, known_laws
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.facts import unmet
from teleop.simulation.virtual import run
from teleop.studies.advise.laws import LawAdvice, LawJob, LawMargins, searched
from teleop.studies.advise.links import OneWay, one_way
from teleop.studies.tune.objective import SCENE, YIELDS, Score, objective_named
from teleop.studies.tune.rod import rod
from teleop.studies.tune.search import judged

WALLS = (2.0, 5.0, 10.0, 20.0)  # times k_e
DELAYS = (0.25, 0.5, 1.0, 2.0)  # further delay each way, of the median
OTHERS = ("zero", "hold")  # playouts of waves that are shown beside the best
MEASURED = 3  # laws whose margins are measured
JUMPS = 8  # runs that jumps are looked for in
CLOSE = 2.0  # standard deviations of the difference between two laws that are equally good


class Jumps(NamedTuple):
    """The greatest jumps of the force against the hand over some runs, N."""

    tick: float  # from one tick to the next
    message: float  # from before a message was played to before the next one was
    within: float  # within `YIELDS`, in which a hand does not yield
    runs: int


@dataclass(frozen=True, kw_only=True)
class Advice:
    """All of it."""

    scene: Scene
    fixed: Mapping[str, object]
    ways: tuple[OneWay, OneWay]
    objective: str
    laws: tuple[LawAdvice, ...]  # the best first
    budget: int  # rows of each law
    rows: int  # that were run
    playouts: tuple[tuple[str, Score, tuple[str, ...]], ...] = ()  # others, with the best gains, and what they break
    jumps: Jumps | None = None  # of the best
    told: float | None = None  # s that the searches would take in all, as it was told while they ran

    @property
    def best(self) -> LawAdvice | None:
        """The law that is advised; None if no law keeps the constraints."""
        able = [one for one in self.laws if one.value < float("inf")]
        return min([one for one in able if not one.broken] or able, key=lambda one: one.value, default=None)

    @property
    def bolder(self) -> LawAdvice | None:
        """The law that does better, while a condition of it is broken."""
        best = self.best
        able = [one for one in self.laws if best is not None and one.value < best.value]
        return min(able, key=lambda one: one.value, default=None)

    def alike(self) -> list[LawAdvice]:
        """The laws whose value cannot be told from the best one's by the seeds that were run."""
        best = self.best
        if best is None:
            return []
        return [other for other in self.laws if other is not best and not other.broken and other.value - best.value
                <= CLOSE * sqrt(best.deviation**2 + other.deviation**2)]


def two_port_laws() -> list[str]:
    """The names of all laws with two ends, built in and of installed packages."""
    return [name for name in sorted(known_laws()) if hasattr(find_law(name), "slave")]


def advise(scene: str, budget: int, *, fixed: Mapping[str, object], laws: Sequence[str] | None = None,
           objective: str = "balanced", seed: int = 0, show: Callable[[float, str], None] = lambda *_: None,
           clock: Callable[[], float] = lambda: 0.0, workers: int = 1, engine: str | None = None,
           out: Path | None = None) -> Advice:
    """Tune each law in `budget` rows, and measure the margins of the best. Raises `Refused`.

    `scene` with the knobs `fixed`, the link among them. `laws`: which; left out, all that have two ends. `workers`:
    processes, with a law each. `out`: a folder that keeps what was run; the same advice there goes on where it
    stopped. `show` is given the part that is done, by time, and what is done.
    """
    objective_named(objective)
    names = two_port_laws() if laws is None else [*laws]
    first = load_scene(scene, **fixed)
    rod(first)  # a scene in which no law can be tuned is refused at once, and not law by law
    ways = one_way(first, 0, seed), one_way(first, 1, seed)
    jobs = [LawJob(scene, law, budget, fixed, ways, objective, seed, engine, ()) for law in names]
    ended = [*searched(jobs, out, workers, clock, show)]
    found = [each for each, _ in ended]
    found.sort(key=lambda one: (one.tuned.score.order if one.tuned is not None else (float("inf"), 0.0, 0.0),
                                names.index(one.law)))
    rows = sum(one.tuned.rows for one in found if one.tuned is not None)
    able = [one for one in found if one.value < float("inf")]
    top = sorted([one for one in able if not one.broken] or able, key=lambda one: one.value)
    show(1.0, "margins")
    for one in [*top[:MEASURED], *[each for each in able[:1] if each not in top[:MEASURED]]]:
        margins, more = _margins(one, first, ways, 1)
        rows += more
        found[found.index(one)] = replace(one, margins=margins)
    others, more = _other_playouts(top[0], 1) if top and "playout" not in fixed else ((), 0)
    return Advice(scene=first, fixed=fixed, ways=ways, objective=objective, laws=tuple(found), budget=budget,
                  rows=rows + more, playouts=others, jumps=_jumps(top[0]) if top else None, told=ended[-1][1])


def _jumps(one: LawAdvice) -> Jumps:
    """The jumps of the force at the hand, in runs of the scene with the seeds that the law was judged by."""
    tuned = one.tuned
    assert tuned is not None
    scene = load_scene(tuned.scene, **tuned.knobs)
    window = max(1, round(YIELDS * 1e9 / scene.dt_ns))
    tick = message = within = 0.0
    for seed in [*tuned.fresh][:JUMPS]:
        trace = run(scene, seed=seed).trace
        force = np.asarray(trace["f_m"], dtype=float).reshape(len(trace["t"]), -1)
        tick = max(tick, _greatest(force, 1))
        within = max(within, _greatest(force, window))
        played = _played(trace["seq_m"]) if "seq_m" in trace else None
        if played is not None and len(played):
            ends = np.append(played[1:], len(force)) - 1  # the tick before the next message is played
            jumps = force[ends] - force[np.maximum(played - 1, 0)]
            message = max(message, float(np.abs(jumps).max()))
    return Jumps(tick, message, within, len([*tuned.fresh][:JUMPS]))


def _played(newest: Any) -> Any:
    """The ticks at which a message is played that is newer than all before."""
    return np.flatnonzero(np.diff(np.maximum.accumulate(np.asarray(newest, dtype=np.int64)), prepend=-1) > 0)


def _greatest(force: Any, ticks: int) -> float:
    """The greatest change of a force (ticks, axes) over so many ticks, N."""
    return float(np.abs(force[ticks:] - force[:-ticks]).max(initial=0.0))


def _margins(one: LawAdvice, scene: Scene, ways: tuple[OneWay, OneWay], workers: int | None) -> tuple[LawMargins, int]:
    """Stiffer walls and longer delays with the best gains, each once; and how many rows that took."""
    tuned = one.tuned
    assert tuned is not None
    rows = 0
    told = {"wall": (0.0, ""), "delay": (0.0, "")}
    k_e, link, lag = scene.knobs.get("k_e"), tuned.fixed.get("link"), max(way.median for way in ways)
    tries: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    if isinstance(k_e, float):
        told["wall"] = (k_e, "")
        own = tuned.tasks[SCENE]  # k_e, and d_e where the scene has one
        tries["wall"] = [(factor * k_e, {knob: factor * value for knob, value in own.items()}) for factor in WALLS]
    if isinstance(link, str):
        tries["delay"] = [(share * lag, {"link": _later(link, share * lag)}) for share in DELAYS]
    for what, points in tries.items():
        scores, ran = judged(tuned, [knobs for _, knobs in points], tasks=[SCENE], workers=workers)
        rows += ran
        for (amount, _), found in zip(points, scores, strict=True):
            if found.broken:
                told[what] = (told[what][0], found.broken)
                break
            told[what] = (amount, "")
    return LawMargins(told["wall"][0], told["delay"][0], told["wall"][1], told["delay"][1]), rows


def _other_playouts(one: LawAdvice, workers: int | None
                    ) -> tuple[tuple[tuple[str, Score, tuple[str, ...]], ...], int]:
    """What becomes of the best gains of a law of waves where gaps are filled otherwise; and how many rows that took."""
    tuned = one.tuned
    assert tuned is not None
    if not load_scene(tuned.scene, **tuned.knobs).has_waves or "playout" not in tuned.names:
        return (), 0
    scores, rows = judged(tuned, [{"playout": playout} for playout in OTHERS], workers=workers)
    told = []
    for playout, found in zip(OTHERS, scores, strict=True):
        scene = load_scene(tuned.scene, **{**tuned.knobs, "playout": playout})
        told.append((playout, found, tuple(unmet(scene, tuned.seed))))
    return tuple(told), rows


def _later(link: str, more: float) -> str:
    """The text of a link with a further constant delay in both directions."""
    return " ; ".join(f"{way.strip()} | delay({more:.9g})" for way in link.split(";"))

