"""Gain margin and delay margin of a scene's linear loop.

    margin(load_scene("hard_wall", law="direct"))                        # Margin(gain=..., delay=...)
    sweep("hard_wall", {"law.K": [100.0, 1000.0]}, metrics=[gain_margin, delay_margin])

`teleop.analysis.stability` works them out, exact for a linear scene over a constant delay. Nonlinear parts that change
nothing about small motion are left out, and each part that is replaced by another is named in `assumed`:

- a law that is not linear: the linear law that it offers (`linear`, see `teleop.law.analysis_offers`);
- a wall: bonded to it, and free of it. The lesser of the two margins counts, as the slave is in and out;
- a link that varies: a constant delay each way, the median age of the messages that a run plays, with the queue that a
  playout keeps; skipped ticks and forces that are renewed every few ticks: run at every tick;
- force caps, encoders, Coulomb friction, a passivity controller: left out.

A loop of waves that resonates at every delay has a gain margin near 1 although it is passive: its damping keeps it
stable, and no gain is to spare. A margin is no proof either: chattering at a wall and the effects of jitter are not in
it, for which there is `status`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, nan
from typing import Any, NamedTuple

from teleop.analysis.models.linear import linear_scene, link_ticks
from teleop.analysis.models.loop import sampled_loop
from teleop.analysis.stability.assess import stability
from teleop.errors import Refused
from teleop.physics.plant import MassDamper, Plant, spring_damper
from teleop.scene.knobs import knobs_of
from teleop.scene.library import import_bundled, scene_function
from teleop.scene.loading import load_scene
from teleop.scene.playout import Integral, Scaled, Zero, gaps_of
from teleop.scene.scene import Scene
from teleop.simulation.plan import link_plans, median_age
from teleop.simulation.result import Result


class Margin(NamedTuple):
    """The margins of a scene. Where they cannot be worked out, both are NaN and `why` says why."""

    gain: float  # factor on the loop's gain that makes it unstable, below 1 that makes it stable; inf: none does
    delay: float  # s that may be added to the round trip, below 0 to be taken away; inf: any
    where: str = ""  # of the lesser gain margin: "in contact" or "free"; empty where there is no such difference
    assumed: tuple[str, ...] = ()
    why: str = ""


@dataclass(frozen=True, kw_only=True)
class Bond:
    """Wall that is never left: a spring (N/m) and a damper (N s/m)."""

    k: float
    d: float

    def plant(self, body: MassDamper, dt: float) -> Plant:
        """Exact step of a body bonded to it."""
        return spring_damper(body, dt, k=self.k, d=self.d, at=0.0)


def margin(scene: Scene, *, seed: int = 0) -> Margin:
    """The margins of a scene with two ends, or of a device that renders by itself. `seed`: of its link."""
    linear, assumed = linearise(scene, seed)
    margins: list[tuple[float, float, str]] = []
    why = ""
    for where, mode in _modes(linear):
        try:
            loop = stability(mode, seed=seed)
        except Refused as refused:
            why = f"{where}: {refused}" if where else str(refused)
            continue
        delay = inf if loop.delay_margin is None else loop.delay_margin * loop.dt
        gain = loop.gain_margin
        if gain is None:
            gain = 0.0 if loop.verdict == "unstable" else inf
        margins.append((gain, delay, where))
    if why:
        return Margin(nan, nan, "", assumed, why)
    worst = min(margins)
    return Margin(worst[0], min(each[1] for each in margins), worst[2], assumed)


def stable_with(scene: Scene, gain: float, *, seed: int = 0) -> tuple[bool, str] | None:
    """True if the loop of a scene with two ends is stable with its gain and with `gain` times it, else a sentence too.

    None where it cannot be worked out. A count of roots each, far quicker than `margin`, which looks for the edge.
    """
    for where, each in _modes(linearise(scene, seed)[0]):
        try:
            linear = linear_scene(each, seed=seed)
            loop = sampled_loop(linear)
        except Refused:
            return None
        for factor in dict.fromkeys((1.0, gain)):
            if loop.outside(linear.round_trip, factor):
                raised = "" if factor == 1.0 else f" with {factor:g} times its gain"
                return False, f"the linear loop{raised} is unstable{' ' + where if where else ''}"
    return True, ""


def gain_margin(result: Result) -> float:
    """The gain margin of the scene of a run, as a metric of a sweep; NaN where it cannot be worked out."""
    return margin(_scene_of(result), seed=result.seed or 0).gain


def delay_margin(result: Result) -> float:
    """The delay margin (s) of the scene of a run, as a metric of a sweep; NaN where it cannot be worked out."""
    return margin(_scene_of(result), seed=result.seed or 0).delay


def _scene_of(result: Result) -> Scene:
    """The scene that a run of an installed scene and law was made from."""
    declared = knobs_of(scene_function(result.scene))
    # A value that JSON cannot hold stands as its text, which says only that the scene has it by default.
    knobs: dict[str, Any] = {name: value for name, value in result.parameters.items()
                             if name not in declared or value != str(declared[name].default)}
    law = knobs.pop("law")
    if "file" in law:
        raise Refused(f"the law of this run is in {law['file']}; give margin() its scene")
    numbers = {f"law.{name}": tuple(value) if isinstance(value, list) else value for name, value in law.items()
               if name != "name"}
    return load_scene(result.scene, **knobs, law=law["name"], **numbers)


def linearise(scene: Scene, seed: int) -> tuple[Scene, tuple[str, ...]]:
    """The scene without nonlinear parts that change nothing about small motion, and sentences on replaced parts."""
    linear, assumed = scene, []
    for name in ("device_m", "device_s"):
        if getattr(linear, name) is None:
            continue
        if linear.per_axis(name)[0].every > 1:
            assumed.append(f"{name} renews its force at every tick")
        linear = _change(linear, name, encoder=None, every=1)
    linear = _change(replace(linear, cap=None, passivity=None), "master", friction=0.0)
    if linear.slave is None:
        return linear, tuple(assumed)
    linear = _change(linear, "slave", friction=0.0)
    ages = _median_ages(scene, seed)
    if ages is not None:
        seconds = [ticks * scene.dt_ns / 1e9 for ticks in ages]
        fwd, bwd = seconds
        assumed.append(f"the link delays by {fwd:g} s and {bwd:g} s, its median ages")
        gaps = gaps_of(scene.played_as)
        playout = gaps if isinstance(gaps, Scaled) else Zero()
        link = import_bundled("channel.link").parse_link(f"delay({fwd!r}) ; delay({bwd!r})")
        linear = replace(linear, link=link, playout=playout, left_out_m=None, left_out_s=None)
    return linear, tuple(assumed)


def _change(scene: Scene, name: str, **numbers: Any) -> Scene:
    """The scene with other numbers in a part, on every axis."""
    part = getattr(scene, name)
    changed: Any = tuple([replace(each, **numbers) for each in part]) if isinstance(part, tuple) else replace(
        part, **numbers)
    return replace(scene, **{name: changed})


def _median_ages(scene: Scene, seed: int) -> Sequence[int] | None:
    """The ticks that a message takes each way, at least one; None where each takes as long anyway."""
    queue = scene.wave_playout.target if isinstance(scene.wave_playout, Integral) else 0.0
    left_out = scene.leaves_out("m") is not None or scene.leaves_out("s") is not None
    if not left_out and queue == 0.0:
        try:
            link_ticks(scene, seed)
        except Refused:
            pass
        else:
            return None
    queued = round(queue * 1e9 / scene.dt_ns)
    return [queued + max(1, 1 if plan is None else median_age(plan.played_at)) for plan in link_plans(scene, seed)]


def _modes(scene: Scene) -> list[tuple[str, Scene]]:
    """The scene in contact with its walls and free of them; itself where it has none."""
    still: list[Any] = [getattr(each, "environment", each) for each in scene.environments]
    if scene.slave is None or not any(_is_wall(each) for each in still):
        return [("", scene)]
    bonded = [Bond(k=each.k, d=each.d) if _is_wall(each) else each for each in still]
    free = [None if _is_wall(each) else each for each in still]
    return [("in contact", replace(scene, environment=tuple(bonded))),
            ("free", replace(scene, environment=tuple(free)))]


def _is_wall(environment: Any) -> bool:
    """True of a spring and damper that fills one side, with some stiffness or damping."""
    known = all(hasattr(environment, name) for name in ("k", "d", "side"))
    return known and (environment.k > 0.0 or environment.d > 0.0)


