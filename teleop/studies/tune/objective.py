"""Objectives and constraints that a law is tuned by: terms and bounds, all from rows of a sweep.

Each point, a set of parameters, is run in the scene as it is. Where the scene has a knob `k_e` it is run a second time
with k_e = 0 (and d_e = 0): the same motion in free space, where the hand perceives drag alone. Each term is 0 for the
rigid rod of `teleop.studies.baseline` and about 1 for a law that does nothing:

    tracking   x_err_rms over the rms motion of the rod; the root mean square of both, in the scene and in free space
    drag       f_m_max in free space over the steady force of the rod (where the hand does not come to stand, over the
               rms force; where nothing is touched, over the hand's stiffness times the rod's rms motion)
    touch      |f_env_end - F|/F, with F the steady force of the rod on the environment
    feel       |f_m_end - F|/F: what of that steady force reaches the hand
    rough      jerk_rms times 10 ms over that force: what the force against the hand changes by while the hand, which
               follows up to some 10 Hz, cannot yield; a force that chatters from tick to tick is no steady force
    force      f_err_rms over the rod's rms force, where the hand does not come to stand against something

The value of an objective is the root mean square of its terms. So a law cannot buy a small tracking error by keeping
the hand off the wall, nor a light hand by reflecting nothing.

With a margin m above 1 each point is run a third time, in the scene with m k_e (and m d_e): that row has to keep the
constraints and has no term.

A point is feasible if every row of it has the status ok, has come to rest where the hand has (less than `REST` of
swing is left), and keeps each claimed ledger above its bound. For E_link and E_port that is -1e-9 J. For E_law it is
minus the greatest work of one tick, since no law knows the work of the tick that is running: f_m_max and f_env_max
times dt times `FASTER` times the fastest motion of the rod (an end that bounces is faster).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, isfinite, sqrt
from typing import Any, NamedTuple

from teleop.errors import Refused, nearest
from teleop.law.offers import LEDGERS, claims_of
from teleop.scene.scene import Scene
from teleop.simulation.metrics import UNITS
from teleop.studies.baseline import Baseline
from teleop.terminal.table import si

SCENE, FREE, STIFF = "scene", "free", "stiff"  # the rows of a point: as it is, in free space, m times as stiff
WHERE = {SCENE: "", FREE: " in free space", STIFF: " against the stiffer environment of the margin"}
ROUNDING = 1e-9  # J
FASTER = 5.0
YIELDS = 0.01  # s, within which a hand does not yield
REST = 1e-3  # m peak to peak: what jitter and loss may move at rest, as `teleop.simulation.rest` has it
MEASURES = ("swing_end", "x_err_rms", "f_err_rms", "f_m_max", "f_env_max", "f_m_end", "f_env_end",
            "felt_stiffness", "felt_mass", "felt_drag", "jerk_rms")


class Objective(NamedTuple):
    """The terms that count, and a sentence."""

    terms: tuple[str, ...]
    sentence: str


OBJECTIVES = {
    "balanced": Objective(("tracking", "drag", "touch", "feel", "rough", "force"),
                          "tracking error, drag in free space, what is missing of the steady force at the wall and at "
                          "the hand, and roughness, each relative to a rigid rod: their root mean square"),
    "tracking": Objective(("tracking",), "tracking error relative to the motion of a rigid rod, whatever is felt"),
    "force": Objective(("touch", "feel", "force"), "what is missing of a rigid rod's steady force at the wall and at "
                       "the hand (of a hand that keeps moving: the force error), whatever the tracking"),
    "drag": Objective(("drag",), "greatest force against the hand in free space, relative to a rigid rod's on the "
                      "environment"),
}


def find_objective(name: str) -> Objective:
    """The objective of that name. Raises `Refused` with the nearest one."""
    if name not in OBJECTIVES:
        raise Refused(f"there is no objective {name!r}; {nearest(name, OBJECTIVES)}")
    return OBJECTIVES[name]


class Score(NamedTuple):
    """Value, terms and figures of a point. It is feasible if `broken` is empty."""

    value: float  # of the objective; inf where it has none
    broken: str  # the constraint that is broken most, as a sentence
    amount: float  # by which; 0.0 if feasible
    terms: Mapping[str, float]
    figures: Mapping[str, Mapping[str, float]]  # of each task the metrics, means over the seeds
    values: tuple[float, ...] = ()  # of the objective, seed by seed
    unmet: int = 0  # conditions of the law that link and bodies break

    @property
    def order(self) -> tuple[float, float, float]:
        """Sorting key: feasible points first, those that keep the law's conditions before others, by value.

        Infeasible ones follow by how much they break.
        """
        return (self.amount, float(self.unmet), self.value)


def measures_of(law: Any) -> tuple[str, ...]:
    """The metrics that rows of a law need."""
    ledgers = [f"{ledger}_min" for ledger in LEDGERS if ledger in claims_of(law)]
    return tuple([name for name in (*MEASURES, *ledgers) if name in UNITS])


def score(objective: Objective, baselines: Mapping[str, Baseline], scene: Scene,
          rows: Sequence[tuple[str, Mapping[str, Any]]]) -> Score:
    """The score of a point by its rows, each with its task: a term is the root mean square over tasks and seeds.

    `baselines`: the rigid baseline of each task.
    """
    by_term: dict[str, list[float]] = {}
    worst, why = 0.0, ""
    for task, row in rows:
        amount, sentence = _violation(row, scene, baselines[task], task)
        if amount > worst:
            worst, why = amount, sentence
        for name, value in _terms(task, row, baselines).items():
            by_term.setdefault(name, []).append(value)
    terms = {name: root_mean_square(values) for name, values in by_term.items()}
    wanted = [terms[name] for name in objective.terms if name in terms]
    value = root_mean_square(wanted) if wanted else inf
    if worst == 0.0 and not isfinite(value):
        worst, why = 1.0, "a figure of the run is not finite"
    return Score(value, why, worst, terms, {task: _means([row for its_task, row in rows if its_task == task])
                                            for task, _ in rows})


def _means(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """The mean of each metric over the rows that have it."""
    by_metric = {name: [float(row[name]) for row in rows if name in row] for name in UNITS}
    return {name: sum(values) / len(values) for name, values in by_metric.items() if values}


def score_by_seed(objective: Objective, baselines: Mapping[str, Baseline], scene: Scene,
                  rows: Sequence[tuple[str, Mapping[str, Any]]]) -> Score:
    """The score of a point, with the value of each seed by itself."""
    seeds = dict.fromkeys(row["seed"] for _, row in rows)
    each = [score(objective, baselines, scene, [(task, row) for task, row in rows if row["seed"] == seed]).value
            for seed in seeds]
    return score(objective, baselines, scene, rows)._replace(values=tuple(each))


def root_mean_square(values: Sequence[float]) -> float:
    """The root of the mean of the squares."""
    return sqrt(sum([each * each for each in values]) / len(values))


def _terms(task: str, row: Mapping[str, Any], baselines: Mapping[str, Baseline]) -> dict[str, float]:
    """The terms that a row has; a figure that it lacks is not finite."""
    baseline = baselines[SCENE]
    if row["status"] == "refused" or task == STIFF:
        return {}

    def figure(name: str) -> float:
        return float(row.get(name, inf))

    if task == FREE:
        return {"drag": figure("f_m_max") / baseline.scale, "tracking": figure("x_err_rms") / baselines[FREE].moved}
    terms = {"tracking": figure("x_err_rms") / baseline.moved}
    if "jerk_rms" in row:
        terms["rough"] = figure("jerk_rms") * YIELDS / baseline.scale
    if baseline.steady is not None:
        terms |= {"touch": abs(figure("f_env_end") - baseline.steady) / baseline.steady,
                 "feel": abs(figure("f_m_end") - baseline.steady) / baseline.steady}
    elif baseline.pressed > 0.0:
        terms["force"] = figure("f_err_rms") / baseline.scale
    else:
        terms["drag"] = figure("f_m_max") / baseline.scale  # nothing is touched: the scene is free space
    return terms


def _violation(row: Mapping[str, Any], scene: Scene, baseline: Baseline, task: str) -> tuple[float, str]:
    """The amount by which a row breaks a constraint, 0.0 if it keeps all; and a sentence. An early end counts more."""
    where = WHERE[task]
    status = row["status"]
    if status == "refused":
        return 4.0, f"refused: {row.get('sentence', '')}"
    if status == "diverged":
        return 3.0 - row["ticks"] / max(1, scene.ticks), f"diverged at {row['ticks'] * scene.dt:.3g} s{where}"
    if status != "ok":
        return 1.5, f"{status}{where}"
    left = row.get("swing_end", 0.0)
    if not left <= REST:
        return 1.4 + min(0.1, left), f"a swing of {si(left, 'm')} is left at the end{where}"
    for ledger in LEDGERS:
        least = row.get(f"{ledger}_min")
        if least is not None and ledger in claims_of(scene.law) and not least >= -_tolerance(
                ledger, row, scene, baseline):
            return 1.0 + min(0.3, abs(least)), f"the claim is broken: {ledger} falls to {si(least, 'J')}{where}"
    return 0.0, ""


def _tolerance(ledger: str, row: Mapping[str, Any], scene: Scene, baseline: Baseline) -> float:
    """Energy (J) by which a ledger may be below zero."""
    if ledger != "E_law":
        return ROUNDING
    force = float(row.get("f_m_max", 0.0)) + float(row.get("f_s_max", row.get("f_env_max", 0.0)))
    return ROUNDING + force * FASTER * baseline.fastest * scene.dt
