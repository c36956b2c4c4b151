"""Felt stiffness: what of a wall's stiffness comes through a law to the hand, and what can be told apart of it.

A law and its link at rest are a spring in series with the wall, of compliance c (m/N):

    k_f = 1/(c + 1/k_e),        waves: c = 1/K + (T_fwd + T_bwd)/(2 b),        position-position: c = 1/K.

An observer notices a wall k' beside k_s with probability p = Phi(z) where ln(k_f'/k_f) = z sqrt(2) w, w the Weber
fraction of one felt stiffness. Solved for the wall's own stiffness,

    k' = 1/(e^(-z sqrt2 w) (c + 1/k_s) - c),

so a difference limen of k_e is told with its level and its side: upwards it is larger than downwards, and from
k_s = 1/(c (e^(z sqrt2 w) - 1)) on there is none upwards, however hard the wall. Differences of k_f have none of this,
which is why answers are fitted in felt stiffness.

Felt stiffness of a law is measured by runs in virtual time, at the lowest and the highest level, and at all others if
no one compliance explains the two.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import exp, sqrt

from teleop.errors import Refused
from teleop.people.plan import StudyCondition, StudyPlan, TaskKind
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.virtual import run

STIFFNESS = "k_e"  # the knob of a wall's stiffness in all scenes
ALIKE = 0.01  # of the compliance: what one series spring explains


def in_series(c: float, k_e: float) -> float:
    """The felt stiffness of a wall behind a compliance, N/m."""
    return 1.0 / (c + 1.0 / k_e)


def limen(c: float, k_s: float, w: float, z: float = 1.0) -> float | None:
    """The stiffness that is told from `k_s` with probability Phi(|z|), above it for z > 0; None if no wall is.

    >>> round(limen(0.002, 500.0, 0.15) / 500.0 - 1.0, 6), round(limen(0.002, 500.0, 0.15, -1.0) / 500.0 - 1.0, 6)
    (0.618867, -0.320939)
    """
    compliance = exp(-z * sqrt(2.0) * w) * (c + 1.0 / k_s) - c
    return 1.0 / compliance if compliance > 0.0 else None


def hardest(c: float, w: float, z: float = 1.0) -> float:
    """The stiffness from which on no harder wall is told from it."""
    return 1.0 / (c * (exp(z * sqrt(2.0) * w) - 1.0)) if c > 0.0 else float("inf")


def with_stiffness(plan: StudyPlan) -> bool:
    """True if walls of different stiffness are compared."""
    return plan.task.kind is TaskKind.COMPARE and plan.task.knob == STIFFNESS


def trial_scene(plan: StudyPlan, condition: StudyCondition, level: float | None = None) -> Scene:
    """The scene of an interval: the plan's, with the condition's knobs and the level's. Raises `Refused`."""
    return load_scene(plan.scene, **knobs_of(plan, condition, level))


def knobs_of(plan: StudyPlan, condition: StudyCondition, level: float | None = None) -> dict[str, object]:
    """The knobs of an interval, the level's last."""
    knobs = {**plan.knobs, **condition.knobs}
    return knobs if level is None or plan.task.kind is not TaskKind.COMPARE else {**knobs, plan.task.knob: level}


def felt_stiffness(plan: StudyPlan) -> dict[str, dict[float, float]]:
    """The felt stiffness of standard and levels under each condition, by its name. Raises `Refused`.

    Of another knob than a stiffness the level itself is what is compared. All scenes are made, so that a plan whose
    knobs are wrong is refused.
    """
    for each in plan.conditions:
        trial_scene(plan, each, plan.task.standard)
    if plan.task.kind is not TaskKind.COMPARE:
        return {each.name: {} for each in plan.conditions}
    levels = tuple(sorted({plan.task.standard, *plan.task.levels}))
    if plan.task.knob != STIFFNESS:
        return {each.name: {level: level for level in levels} for each in plan.conditions}
    return {each.name: dict(zip(levels, _of_levels(plan, each, levels), strict=True)) for each in plan.conditions}


def _of_levels(plan: StudyPlan, condition: StudyCondition, levels: tuple[float, ...]) -> list[float]:
    low, high = (_measured(plan, condition, level) for level in (levels[0], levels[-1]))
    c = [1.0 / low - 1.0 / levels[0], 1.0 / high - 1.0 / levels[-1]]
    if abs(c[1] - c[0]) <= ALIKE * max(map(abs, c)) or max(map(abs, c)) * levels[-1] < 1e-6:
        return [low, *(in_series(0.5 * (c[0] + c[1]), level) for level in levels[1:-1]), high]
    return [low, *(_measured(plan, condition, level) for level in levels[1:-1]), high]


def _measured(plan: StudyPlan, condition: StudyCondition, level: float) -> float:
    """Felt stiffness of one wall, by a run in virtual time."""
    result = run(trial_scene(plan, condition, level), seed=plan.seed)
    got = result.metrics.get("felt_stiffness")
    if got is None or not got > 0.0:
        raise Refused(f"condition {condition.name!r} has no felt stiffness at {plan.task.knob}={level:g}: the run is "
                      f"{result.status}, and the hand does not come to rest against the wall; set other knobs, or a "
                      f"longer duration (teleop run {plan.scene} shows the run)")
    return got


def compliance(felt: Mapping[float, float], standard: float) -> float:
    """The compliance of law and link at the standard, m/N."""
    return 1.0 / felt[standard] - 1.0 / standard


def check_levels(plan: StudyPlan, felt: Mapping[str, Mapping[float, float]]) -> None:
    """Refuse levels at which no harder wall could be told, however hard. Raises `Refused`."""
    task, w = plan.task, plan.simulated.w
    if not with_stiffness(plan):
        return
    harder = any(level > task.standard for level in task.levels)
    for name, of in felt.items():
        c = compliance(of, task.standard)
        if harder and limen(c, task.standard, w) is None:
            raise Refused(f"under {name!r} no wall is told from {task.standard:g} N/m, however hard: its compliance of "
                          f"{c:.3g} m/N hides differences from {hardest(c, w):.0f} N/m on (w = {w:g}); lower the "
                          "standard and the levels, or set another law")
