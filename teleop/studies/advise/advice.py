"""The advice: every law with two ends tuned for one link and one wall, ranked, and its margins measured.

Each law gets the same number of rows (`teleop.studies.tune`). Of the laws that keep the constraints, with conditions
that link and bodies keep (`teleop.law.offers`), the one with the least value of the objective is advised. Laws within
the spread over the seeds are called as good. A law that does better while a condition of it is broken is shown too: it
promises nothing for another hand. The margins of the advised law are measured: the stiffest wall and the longest
further delay, of the factors that are tried, up to which the same gains keep all constraints. Gains are not tuned again
for them, as nobody does while a robot moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from teleop.law import two_port_laws
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.notes import unmet
from teleop.simulation.virtual import run
from teleop.studies.advise.laws import LawAdvice, LawJob, LawMargins, OneWay, one_way, search_laws
from teleop.studies.baseline import rigid_baseline
from teleop.studies.tune.objective import FREE, OBJECTIVES, SCENE, YIELDS, Score, find_objective, score
from teleop.studies.tune.search import SearchJob, Tuned
from teleop.sweeps.grid import grid
from teleop.sweeps.runner import carry_out, plan_sweep

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
    """Advice on the laws for one link and one wall."""

    scene: Scene
    fixed: Mapping[str, object]
    ways: tuple[OneWay, OneWay]
    objective: str
    laws: tuple[LawAdvice, ...]  # the best first
    budget: int  # rows of each law
    rows: int  # that were run
    playouts: tuple[tuple[str, Score, tuple[str, ...]], ...] = ()  # others, with the best gains, and what they break
    jumps: Jumps | None = None  # of the best
    predicted: float | None = None  # s that the searches would take in all, as shown while they ran

    @property
    def best(self) -> LawAdvice | None:
        """The law that is advised; None if no law keeps the constraints."""
        able = [each for each in self.laws if each.value < float("inf")]
        return min([each for each in able if not each.broken] or able, key=lambda each: each.value, default=None)

    @property
    def bolder(self) -> LawAdvice | None:
        """The law that does better, while a condition of it is broken."""
        best = self.best
        able = [each for each in self.laws if best is not None and each.value < best.value]
        return min(able, key=lambda each: each.value, default=None)

    def alike(self) -> list[LawAdvice]:
        """The laws as good as the best one by the seeds that were run."""
        best = self.best
        if best is None:
            return []
        return [each for each in self.laws if each is not best and not each.broken and each.value - best.value
                <= CLOSE * sqrt(best.deviation**2 + each.deviation**2)]


def advise(scene: str, budget: int, *, fixed: Mapping[str, object], laws: Sequence[str] | None = None,
           objective: str = "balanced", seed: int = 0, show: Callable[[float, str], None] = lambda *_: None,
           clock: Callable[[], float] = lambda: 0.0, workers: int = 1, engine: str | None = None,
           out: Path | None = None) -> Advice:
    """Tune each law in `budget` rows, and measure the margins of the best. Raises `Refused`.

    `scene` with the knobs `fixed`, the link among them. `laws`: by name; left out, all that have two ends. `workers`:
    processes, with a law each. `out`: a folder that keeps the points run; the same advice there goes on where it
    stopped. `show` is called with the part that is done, by time, and a text.
    """
    find_objective(objective)
    names = two_port_laws() if laws is None else [*laws]
    first = load_scene(scene, **fixed)
    rigid_baseline(first)  # a scene in which no law can be tuned is refused at once, and not law by law
    ways = one_way(first, 0, seed), one_way(first, 1, seed)
    jobs = [LawJob(SearchJob(scene, law, budget, seed, fixed, objective, engine=engine), ways) for law in names]
    ended = [*search_laws(jobs, out, workers, clock, show)]
    advices = [each for each, _ in ended]
    advices.sort(key=lambda each: (each.tuned.score.order if each.tuned is not None else (float("inf"), 0.0, 0.0),
                                   names.index(each.law)))
    rows = sum(each.tuned.rows for each in advices if each.tuned is not None)
    able = [each for each in advices if each.value < float("inf")]
    top = sorted([each for each in able if not each.broken] or able, key=lambda each: each.value)
    show(1.0, "margins")
    for law in [*top[:MEASURED], *[each for each in able[:1] if each not in top[:MEASURED]]]:
        margins, rows_run = _margins(law, first, ways, 1)
        rows += rows_run
        advices[advices.index(law)] = replace(law, margins=margins)
    playouts, rows_run = _other_playouts(top[0], 1) if top and "playout" not in fixed else ((), 0)
    return Advice(scene=first, fixed=fixed, ways=ways, objective=objective, laws=tuple(advices), budget=budget,
                  rows=rows + rows_run, playouts=playouts, jumps=_jumps(top[0]) if top else None,
                  predicted=ended[-1][1])


def score_changes(tuned: Tuned, changes: Sequence[Mapping[str, Any]], *, tasks: Sequence[str] = (SCENE, FREE),
                  workers: int | None = None) -> tuple[list[Score], int]:
    """The scores of the best point with knobs changed besides, the same ones in each; and the number of rows run.

    With the first seed of the search. Few rows, so they run by `plain`.
    """
    changed = tuple(changes[0])
    in_order = [task for task in tasks if task in tuned.tasks]
    of_task = tuple(name for name in tuned.tasks[SCENE] if name not in changed)
    rows = [(*change.values(), *(tuned.tasks[task][name] for name in of_task))
            for change in changes for task in in_order]
    fixed = {key: value for key, value in tuned.knobs.items() if key not in (*changed, *of_task)}
    plan = plan_sweep(tuned.scene, grid({(*changed, *of_task): rows}, [tuned.seed]), metrics=list(tuned.measures),
                      fixed=fixed, engine="plain")
    table = [*carry_out(plan, workers=workers)]
    scene = load_scene(tuned.scene, **tuned.knobs)
    n = len(in_order)
    return [score(OBJECTIVES[tuned.objective], tuned.baselines, scene, [*zip(in_order, table[i:i + n], strict=True)])
            for i in range(0, len(table), n)], len(table)


def _jumps(law: LawAdvice) -> Jumps:
    """The jumps of the force at the hand, in runs of the scene with the seeds that the law was judged by."""
    tuned = law.search
    scene = load_scene(tuned.scene, **tuned.knobs)
    window = max(1, round(YIELDS * 1e9 / scene.dt_ns))
    tick = message = within = 0.0
    for seed in [*tuned.fresh][:JUMPS]:
        trace = run(scene, seed=seed).trace
        force = np.asarray(trace["f_m"], dtype=float).reshape(len(trace["t"]), -1)
        tick = max(tick, _greatest(force, 1))
        within = max(within, _greatest(force, window))
        if "seq_m" in trace:
            newest = np.maximum.accumulate(np.asarray(trace["seq_m"], dtype=np.int64))
            played = np.flatnonzero(np.diff(newest, prepend=-1) > 0)  # of a message newer than all before
            ends = np.append(played[1:], len(force)) - 1  # the tick before the next message is played
            jumps = force[ends] - force[np.maximum(played - 1, 0)]
            message = max(message, float(np.abs(jumps).max(initial=0.0)))
    return Jumps(tick, message, within, len([*tuned.fresh][:JUMPS]))


def _greatest(force: Any, ticks: int) -> float:
    """The greatest change of a force (ticks, axes) over so many ticks, N."""
    return float(np.abs(force[ticks:] - force[:-ticks]).max(initial=0.0))


def _margins(law: LawAdvice, scene: Scene, ways: tuple[OneWay, OneWay], workers: int | None) -> tuple[LawMargins, int]:
    """Try stiffer walls and longer delays with the best gains, each once; returns the number of rows run too."""
    tuned = law.search
    rows = 0
    most = {"wall": (0.0, ""), "delay": (0.0, "")}
    k_e, link, lag = scene.knobs.get("k_e"), tuned.fixed.get("link"), max(way.median for way in ways)
    tries: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    if isinstance(k_e, float):
        most["wall"] = (k_e, "")
        contact = tuned.tasks[SCENE]  # k_e, and d_e where the scene has one
        tries["wall"] = [(factor * k_e, {knob: factor * value for knob, value in contact.items()}) for factor in WALLS]
    if isinstance(link, str):
        tries["delay"] = [(share * lag, {"link": _later(link, share * lag)}) for share in DELAYS]
    for what, points in tries.items():
        scores, ran = score_changes(tuned, [knobs for _, knobs in points], tasks=[SCENE], workers=workers)
        rows += ran
        for (amount, _), changed in zip(points, scores, strict=True):
            if changed.broken:
                most[what] = (most[what][0], changed.broken)
                break
            most[what] = (amount, "")
    return LawMargins(most["wall"][0], most["delay"][0], most["wall"][1], most["delay"][1]), rows


def _other_playouts(law: LawAdvice, workers: int | None
                    ) -> tuple[tuple[tuple[str, Score, tuple[str, ...]], ...], int]:
    """Score the best gains of a law of waves with other playouts; returns the number of rows run too."""
    tuned = law.search
    if not load_scene(tuned.scene, **tuned.knobs).has_waves or "playout" not in tuned.names:
        return (), 0
    scores, rows = score_changes(tuned, [{"playout": playout} for playout in OTHERS], workers=workers)
    playouts = []
    for playout, changed in zip(OTHERS, scores, strict=True):
        scene = load_scene(tuned.scene, **{**tuned.knobs, "playout": playout})
        playouts.append((playout, changed, tuple(unmet(scene, tuned.seed))))
    return tuple(playouts), rows


def _later(link: str, delay: float) -> str:
    """The text of a link with a further constant delay (s) in both directions."""
    return " ; ".join(f"{way.strip()} | delay({delay:.9g})" for way in link.split(";"))

