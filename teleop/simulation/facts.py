"""Facts: what a law's conditions depend on, worked out of a scene and the messages that its run plays."""

from __future__ import annotations

import re
from dataclasses import replace
from math import inf
from typing import Any

from teleop.errors import enumerated
from teleop.law.offers import Delay, Facts, broken
from teleop.scene.axis_labels import told_along
from teleop.scene.playout import Playout, Zero, gaps_of
from teleop.scene.scene import Scene
from teleop.simulation.plan import LinkPlans, link_plans
from teleop.stages.memory import LEFT_OUT

_NUMBER = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")


def facts_of(scene: Scene, seed: int = 0, axis: int = 0) -> Facts:
    """The facts of an axis of a scene with two ends, as a run in virtual time with this seed has them.

    Raises `Refused`.
    """
    return facts(scene, axis, *of_plans(scene, link_plans(scene, seed), scene.ticks))


def unmet(scene: Scene, seed: int = 0) -> list[str]:
    """The sentences on conditions of the law that link and bodies break in a run in virtual time with this seed."""
    return law_notes(scene, *of_plans(scene, link_plans(scene, seed), scene.ticks))


def fitted(scene: Scene, seed: int = 0) -> Scene:
    """The scene with the law of each axis fitted to link and bodies, where it knows how (`teleop.law.offers`).

    The knobs of the scene keep what was typed, so the command that runs it is that of the law's own numbers.
    """
    if scene.slave is None or not hasattr(scene.laws[0], "fitted"):
        return scene
    link = of_plans(scene, link_plans(scene, seed), scene.ticks)
    laws = tuple([law.fitted(facts(scene, i, *link)) for i, law in enumerate(scene.laws)])
    same = not isinstance(scene.law, tuple) and laws.count(laws[0]) == len(laws)
    return replace(scene, law=laws[0] if same else laws)


def of_plans(scene: Scene, plans: LinkPlans, ran: int) -> tuple[Delay | None, Delay | None, bool, float]:
    """Of the first `ran` ticks of a run in virtual time: what `facts` takes of its link and of the ticks left out."""
    import numpy as np

    dt = scene.dt_ns / 1e9
    delays = [Delay(dt, dt) if plan is None else delay(np.arange(ran), plan.played_at[:ran], dt) for plan in plans]
    if scene.deadband is not None:  # of what could be sent, before it is known what is: a silence more
        silence = inf if scene.deadband.keep_alive is None else scene.deadband.keep_alive
        delays = [each if each is None or plan is None or plan.due is None else
                  each._replace(greatest=each.greatest + silence) for each, plan in zip(delays, plans, strict=True)]
    held = max([longest(np.flatnonzero(plan.played_at[:ran] > LEFT_OUT), ran) for plan in plans if plan is not None],
               default=1)
    return delays[0], delays[1], any(plan is not None and plan.lost > 0 for plan in plans), held * dt


def longest(ticks: Any, end: int | None = None) -> int:
    """The most ticks from one of these that were run to the next, and to the `end` of the run; 1 at least."""
    import numpy as np

    at = np.asarray(ticks, dtype=np.int64)
    return int(np.diff(at if end is None else np.append(at, end)).max(initial=1))


def delay(ticks: Any, played: Any, dt: float) -> Delay | None:
    """The delay of one direction. `played`: at each of these ticks the packet played, below zero for none."""
    import numpy as np

    at, newest = np.asarray(ticks, dtype=np.int64), np.maximum.accumulate(np.asarray(played, dtype=np.int64))
    ages = (at - newest)[newest >= 0]
    return Delay(float(ages.min()) * dt, float(ages.max()) * dt) if len(ages) else None


def facts(scene: Scene, axis: int, fwd: Delay | None, bwd: Delay | None, lossy: bool, held: float) -> Facts:
    """The facts of an axis of a scene whose link did this, and whose forces were held for as long as `held` (s).

    The slave's body is as the law meets it, in the master's metres and newtons: of m_s a_s = f_s with x_s = scale_x x
    and f_s = scale_f f a mass m_s scale_x/scale_f (`teleop.stages.scaling`).
    """
    master, slave, own = [scene.per_axis(name)[axis] for name in ("master", "slave", "scaling")]
    felt = 1.0 if own is None else own.scale_x / own.scale_f
    return Facts(scene.dt_ns / 1e9, scene.axes, master.mass, master.damping, felt * slave.mass, felt * slave.damping,
                 fwd, bwd, lossy, _word(scene.played_as), held)


def law_notes(scene: Scene, fwd: Delay | None, bwd: Delay | None, lossy: bool, held: float) -> list[str]:
    """The notes on conditions of the law that a run broke; none of a scene with one end.

    A condition that is broken on some axes alone is told with their names.
    """
    if scene.slave is None:
        return []
    told: dict[str, list[tuple[str, str]]] = {}  # by what is left without the numbers
    alike = not any(isinstance(getattr(scene, name), tuple) for name in ("law", "master", "slave", "scaling"))
    for i, name in enumerate(scene.axis_names[:1] if alike else scene.axis_names):
        for sentence in broken(scene.laws[i], facts(scene, i, fwd, bwd, lossy, held)):
            own = told_along(sentence, scene.axis_units[i])
            told.setdefault(_NUMBER.sub("", own), []).append((name, own))
    return [each[0][1] if alike else _of_axes(each, scene.axes) for each in told.values()]


def _of_axes(told: list[tuple[str, str]], axes: int) -> str:
    """A sentence on some of so many axes, each with its numbers: that of the first, and the names of the others."""
    names, sentences = zip(*told, strict=True)
    if len(set(sentences)) > 1:
        return f"{names[0]}: {sentences[0]} (and {enumerated(names[1:])}, with their own numbers)"
    return sentences[0] if len(names) == axes else f"{enumerated(names)}: {sentences[0]}"


def _word(playout: Playout) -> str:
    """The word for what is played in gaps; "fixed" where that is nothing, at a fixed delay."""
    gaps = gaps_of(playout)
    return type(playout if isinstance(gaps, Zero) else gaps).__name__.lower()
