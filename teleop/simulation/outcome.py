"""The outcome of a run in words: its status, the sentence that goes with it, and the notes that a reader needs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from teleop.errors import number_of, plural
from teleop.law.contract import not_finite
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies
from teleop.simulation.ending import Ending, ending, position_unit
from teleop.simulation.plan import Plan

if TYPE_CHECKING:
    from teleop.simulation.prepared import Prepared


def verdict(prepared: Prepared, trace: Mapping[str, Any], ran: int, end: Any, trip: int
            ) -> Ending:
    """How a run ended. `end` is None, or the positions that left the bounds; `trip`: the round trip of its link, ticks.

    What is not finite anywhere in the trace is a divergence, even of a run that came to its end.
    """
    import numpy as np

    scene = prepared.scene
    lost = {
        name: int(np.argmin(sound.reshape(ran, -1).all(axis=1)))
        for name in ("f_m", "f_s", *trace) if name in trace and not (sound := np.isfinite(trace[name])).all()
    }
    if lost:
        name = min(lost, key=lost.__getitem__)  # the first of several at the same tick
        return Ending("diverged", divergence(scene, lost[name], not_finite(scene.laws[0], name)))
    if end is None:
        return ending(prepared, trace, trip, f"ran to its end, {number_of(ran, 'tick')} of {scene.dt:g} s")
    far = [name for name, xs in zip(("x_m", "x_s"), end, strict=False) if not all(abs(x) < scene.x_limit for x in xs)]
    return Ending("diverged", divergence(scene, ran - 1, f"{far[0]} passed {scene.x_limit:g} {position_unit(scene)}"))


def divergence(scene: Scene, k: int, what: str) -> str:
    """The sentence of a run that diverged at tick k."""
    when = f"diverged at t = {k * scene.dt_ns / 1e9:g} s (tick {k})"
    return f"{when}: {what}; a smaller dt, gain or delay may hold it"


def too_old(scene: Scene, end: str, plan: Plan | None, ran: int) -> list[str]:
    """The note on messages that were too old for an end's watchdog: how many, how old, and what to type."""
    age = getattr(scene.watchdog, "age", None)
    if plan is None or age is None:
        return []
    import numpy as np

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


def integration(scene: Scene, bodies: Bodies, inner: tuple[tuple[Any, ...], tuple[Any, ...]]) -> dict[str, Any]:
    """The reports of the bodies that are integrated, by end: of each figure the worst of the axes.

    `inner`: the inner states that each end's bodies ended with, per axis.
    """
    reports = {"master": [bodies.report_m] * scene.axes, "slave": [plant.report for plant in bodies.slaves]}
    found = {}
    for (end, each), states in zip(reports.items(), inner, strict=True):
        axes = [report(z) for report, z in zip(each, states, strict=False) if report is not None]
        names = {name for one in axes for name in one}
        if names:
            found[end] = {name: max(one[name] for one in axes if name in one) for name in sorted(names)}
    return {"integration": found} if found else {}


def over_tolerance(reports: dict[str, Any], unit: str) -> list[str]:
    """The notes on the ends whose integration was not within the scene's tolerance (`unit`: m or rad) at every tick."""
    return [f"{number_of(over, 'tick')} of the {end} {plural(over, 'is', 'are')} not within {own['tolerance']:g} "
            f"{unit}: the figures may be off by the estimates and by what the loop makes of them; a smaller dt may help"
            for end, own in reports.get("integration", {}).items() if (over := own.get("ticks_over_tolerance"))]
