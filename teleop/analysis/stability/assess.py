"""Stability of a scene: the verdict, its margins, and the critical value of a knob; the answers of `teleop
stability`.

    stability(load_scene("soft_tissue", law="direct")).verdict
    critical(lambda k: load_scene("soft_tissue", k_e=k), "k_e", low=10.0, high=1e5)

A linear scene is answered for by the roots of its exact sampled loop (`linear`, `loop`), counted and not
estimated; one that is not linear by a run in virtual time (`swing`).

What is not linear is run once as it is. It is run again with the hand staying where the slave touched hardest, or
without a slave where the master was pushed hardest (half way, if there was no force), after a kick of `KICK` along
the first axis, or along each where axes have parts of their own; without a hand the master starts that far off. What
then remains is the loop's own motion, and what it comes to is told by `teleop.analysis.models.rest`.

This is one experiment about one place: a nonlinear loop may answer otherwise to another kick or another place.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from math import ceil, floor, inf
from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.models.by_axis import alike, couples, own_parts
from teleop.analysis.models.linear import about_rest, linear_scene, refuse_nonlinear_parts, with_linear_law
from teleop.analysis.models.loop import sampled_loop
from teleop.analysis.models.one_port_loop import margins, settles
from teleop.analysis.models.rest import FreeMotion, HeldGrip, settled
from teleop.analysis.models.roots import Mode, dominant
from teleop.errors import Refused, number
from teleop.scene.parts import Reference
from teleop.scene.scene import Scene
from teleop.simulation.rest import WINDOWS
from teleop.simulation.result import Result
from teleop.simulation.virtual import run

PLACES = 33  # of a range that are tried before it is halved
HALVED = 5  # times: a step of 1.25 to 1.007

Tell = Callable[[float, bool], None]  # a value and its verdict


@dataclass(frozen=True, kw_only=True)
class Stability:
    """A linear scene's sampled loop. `verdict` is stable or unstable."""

    scene: str
    unstable: int  # roots outside the unit circle
    integrators: int  # roots at z = 1: positions that nothing returns; they are not held against the scene
    forth: int  # ticks
    back: int  # ticks
    dt: float  # s
    mode: Mode | None  # the root of greatest magnitude apart from the integrators; None: nothing moves for long
    gain_margin: float | None  # the factor on the loop's gain that changes the verdict, 1 if any more does; None: none
    critical_round_trip: int | None  # ticks, the least at which the loop is unstable; None: stable at every delay
    alone: bool = False  # no slave: all delays are those of the computation, `forth` in all
    tried: int | None = None  # ticks up to which a critical delay was looked for; None: any
    axes: tuple[AxisStability, ...] = ()  # of several axes each by itself; (): of one, and where the law couples them

    @property
    def verdict(self) -> str:
        """`stable` if every root but the integrators lies inside the unit circle, else `unstable`."""
        return "unstable" if self.unstable else "stable"

    @property
    def round_trip(self) -> int:
        """Ticks there and back."""
        return self.forth + self.back

    @property
    def worst(self) -> AxisStability | None:
        """The axes whose mode decays last, or grows first; None where the whole loop was judged."""
        return max(self.axes, key=lambda one: one.stability.mode.growth if one.stability.mode else -inf, default=None)

    @property
    def delay_margin(self) -> int | None:
        """Ticks that may be added to the round trip, below 0 those to take away; None: any number."""
        return None if self.critical_round_trip is None else self.critical_round_trip - 1 - self.round_trip


class AxisStability(NamedTuple):
    """Stability of axes that are alike, each by itself."""

    names: tuple[str, ...]
    stability: Stability


class Change(NamedTuple):
    """Between `low` and `high` the verdict changes."""

    value: float
    low: float
    high: float
    stable: str  # below or above


class Critical(NamedTuple):
    """Value of a knob at which the verdict changes, between `low` and `high`."""

    knob: str
    value: float  # the middle; of whole numbers, and where `method` is stepwise: `high`, the first beyond the change
    low: float
    high: float
    stable: str  # below or above
    changes: int  # of the verdict at the places tried in the range
    all: tuple[Change, ...] = ()  # these changes, upwards, as close as each was looked at
    method: str = "bisection"  # or stepwise
    tried: int = 0  # values


def stability(scene: Scene, *, seed: int = 0) -> Stability:
    """Count the unstable roots of a linear scene and find its margins. Refused if the scene is not linear.

    The link must delay by a constant number of ticks, each way 1 or more; `seed` keys it where it is not plainly so.
    Axes that the law does not couple are judged one by one, those that are alike once: the scene is stable if each of
    them is, and its margins are those of the axis that has least.
    """
    from teleop.analysis.models.margins import critical_round_trip, gain_margin, integrators

    if scene.axes > 1 and not couples(scene):
        refuse_nonlinear_parts(about_rest(with_linear_law(scene)))  # of all axes at once
        return _of_axes([AxisStability(names, stability(single, seed=seed)) for single, names in alike(scene)])
    if scene.slave is None:
        return _one_port(scene)
    linear = linear_scene(scene, seed=seed)
    resting = integrators(linear)
    return Stability(
        scene=scene.name, unstable=sampled_loop(linear).outside(linear.round_trip), integrators=resting,
        forth=linear.forth, back=linear.back, dt=linear.dt, mode=dominant(linear, resting),
        gain_margin=gain_margin(linear), critical_round_trip=critical_round_trip(linear),
    )


def _of_axes(axes: list[AxisStability]) -> Stability:
    """The loop of a scene whose axes do not touch each other: the roots of all of them."""
    shaky = [one.stability for one in axes if one.stability.unstable]
    gains = [one.gain_margin for one in shaky or [one.stability for one in axes]]
    known = [gain for gain in gains if gain is not None]
    critical = [one.stability.critical_round_trip for one in axes if one.stability.critical_round_trip is not None]
    tried = [one.stability.tried for one in axes if one.stability.tried is not None]
    first = axes[0].stability
    whole = replace(
        first, unstable=sum(len(one.names) * one.stability.unstable for one in axes),
        integrators=sum(len(one.names) * one.stability.integrators for one in axes),
        gain_margin=None if not known or (shaky and len(known) < len(gains)) else min(known),
        critical_round_trip=min(critical, default=None), tried=min(tried, default=None), axes=tuple(axes),
    )
    return replace(whole, mode=None if whole.worst is None else whole.worst.stability.mode)


def _one_port(scene: Scene) -> Stability:
    """The same of a scene without a slave: the loop in contact, its delay that of the computation."""
    margin = margins(scene)
    return Stability(
        scene=scene.name, unstable=margin.unstable, integrators=margin.integrators,
        forth=0 if scene.device_m is None else scene.device_m.delay, back=0, dt=scene.dt_ns / 1e9, mode=margin.mode,
        gain_margin=margin.gain_margin, critical_round_trip=margin.critical_delay, alone=True, tried=margin.tried,
    )


def is_stable(scene: Scene, *, seed: int = 0) -> bool:
    """The verdict alone, from the root count: quicker than `stability`."""
    if scene.axes > 1 and not couples(scene):
        return all(is_stable(single, seed=seed) for single, _ in alike(scene))
    if scene.slave is None:
        return settles(scene)
    linear = linear_scene(scene, seed=seed)
    return not sampled_loop(linear).outside(linear.round_trip)


def rests(scene: Scene, *, seed: int = 0) -> bool:
    """True if the scene comes to rest in virtual time: a limit cycle is no rest, a few steps of an encoder are."""
    return swing(scene, seed=seed).rests


def critical(
    make: Callable[[float], Scene], knob: str, *, low: float, high: float, tol: float | None = None,
    near: float | None = None, judge: Callable[[Scene], bool] = is_stable, places: int = PLACES, whole: bool = False,
    tell: Tell | None = None,
) -> Critical:
    """The value at which `make(value)` stops or starts being stable, by bisection to `tol` (in the knob's unit).

    The range is tried at `places` values first, evenly, or by equal ratios where it spans more than a decade. Of
    several changes the nearest to `near` is taken; left out, the lowest; all of them are in `all`. `tol` left out:
    1e-6 of the value. `whole`: only whole numbers are tried. `tell` is called with each value that was judged and its
    verdict. Raises `Refused` for an empty range, and where the verdict does not change in it, saying which it is.
    """
    if tol is not None:
        number("tol", tol, above=0.0)
    values = places_of(knob, low, high, places, whole)
    verdict_at = _asking(make, judge, tell)
    brackets = _brackets(knob, values, verdict_at, near)

    def refined(low: float, high: float) -> Change:
        below = verdict_at(low)
        while high - low > (1e-6 * max(abs(low), abs(high)) if tol is None else tol):
            middle = _middle(low, high, whole)
            if middle in (low, high):
                break
            low, high = (middle, high) if verdict_at(middle) == below else (low, middle)
        return Change(high if whole else 0.5 * (low + high), low, high, "below" if below else "above")

    changes = tuple(refined(values[i], values[i + 1]) for i in brackets)
    nearest = min(range(len(changes)), key=lambda j: abs(brackets[j] + 0.5 - _place(values, near)))
    return Critical(knob, *changes[nearest], len(changes), changes, "bisection", verdict_at.cache_info().currsize)


def lowest(
    make: Callable[[float], Scene], knob: str, *, low: float, high: float, tol: float | None = None,
    near: float | None = None, judge: Callable[[Scene], bool] = rests, places: int = PLACES, whole: bool = False,
    tell: Tell | None = None,
) -> Critical:
    """The lowest value tried that is judged otherwise than the range's low end: for verdicts that alternate.

    Behind an encoder what rests and what hums take turns as a knob rises, at every scale, so there is no edge to bisect
    to. The range is tried at `places` values, and the first step with a change is halved `HALVED` times, or until it is
    within `tol`, towards its low end: no value tried below is judged otherwise. The steps above are left as they are,
    in `all`. `near` is named where there is no change. `tell` and what is refused are as with `critical`.
    """
    if tol is not None:
        number("tol", tol, above=0.0)
    values = places_of(knob, low, high, places, whole)
    verdict_at = _asking(make, judge, tell)
    brackets = _brackets(knob, values, verdict_at, near)
    under, over = values[brackets[0]], values[brackets[0] + 1]
    below, halvings = verdict_at(under), 0
    while halvings < HALVED if tol is None else over - under > tol:
        middle = _middle(under, over, whole)
        if middle in (under, over):
            break
        under, over = (middle, over) if verdict_at(middle) == below else (under, middle)
        halvings += 1
    first = Change(over, under, over, "below" if below else "above")
    later = (Change(values[i + 1], values[i], values[i + 1], "below" if verdict_at(values[i]) else "above")
             for i in brackets[1:])
    return Critical(knob, *first, len(brackets), (first, *later), "stepwise", verdict_at.cache_info().currsize)


def _asking(make: Callable[[float], Scene], judge: Callable[[Scene], bool], tell: Tell | None) -> Any:
    """The verdict on a value of the knob, worked out once."""

    @cache
    def verdict_on(value: float) -> bool:
        verdict = judge(make(value))
        if tell is not None:
            tell(value, verdict)
        return verdict

    return verdict_on


def places_of(knob: str, low: float, high: float, places: int, whole: bool) -> list[float]:
    """The values of a range that are tried first."""
    low, high = number("low", low), number("high", high)
    if not low < high:
        raise Refused(f"the range {low:g}:{high:g} of {knob} is empty; write the lower value first, --range 1:1000")
    if not whole:
        return _spread(low, high, places)
    if not ceil(low) < floor(high):
        raise Refused(f"{knob} is a whole number, of which the range {low:g}:{high:g} has not two; write --range "
                      f"{floor(low)}:{max(ceil(high), floor(low) + 1)}")
    return sorted({round(value) for value in _spread(ceil(low), floor(high), places)})


def _brackets(knob: str, values: list[float], verdict_at: Callable[[float], bool], near: float | None) -> list[int]:
    """The places after which the verdict is another."""
    changes = [i for i in range(len(values) - 1) if verdict_at(values[i]) != verdict_at(values[i + 1])]
    if not changes:
        side = "stable" if verdict_at(values[0]) else "unstable"
        known = ""
        if near is not None:
            known = f", and {'stable' if verdict_at(near) else 'unstable'} at its own, {knob}={near:g}"
        raise Refused(f"{knob} has no critical value from {values[0]:g} to {values[-1]:g}: the scene is {side} at all "
                      f"{len(values)} values tried{known}; give another --range")
    return changes


def _middle(low: float, high: float, whole: bool) -> float:
    return int(low + high) // 2 if whole else 0.5 * (low + high)


def _spread(low: float, high: float, places: int) -> list[float]:
    steps = [i / (places - 1) for i in range(places)]
    if low > 0.0 and high > 10.0 * low:
        return [low, *(low * (high / low) ** step for step in steps[1:-1]), high]
    return [low, *(low + (high - low) * step for step in steps[1:-1]), high]


def _place(values: list[float], near: float | None) -> float:
    """The index at which `near` lies among the values."""
    if near is None:
        return 0.0
    return bisect(values, near) - 0.5


KICK = 1e-3  # m
LEAST = 50 * WINDOWS  # ticks


@dataclass(frozen=True, kw_only=True, slots=True)
class Staying:
    """A reference that follows `path` up to tick `until` and stays there, after one kick along the `kicked` axes."""

    path: Reference
    until: int
    kicked: tuple[int, ...] = (0,)

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[list[float], ...]:
        """For each axis the position (m) at the ticks 0 .. count-1."""
        moved = self.path.samples(axes, self.until + 1, dt_ns)
        rise = max(1, 10_000_000 // dt_ns)  # 10 ms up and as long down
        pulse = [KICK * min(i, 2 * rise - i) / rise for i in range(1, 2 * rise)]
        tail = [[place[-1]] * (count - self.until - 1) for place in moved]
        for i in self.kicked:
            tail[i] = [at + extra for at, extra in zip(tail[i], pulse + [0.0] * len(tail[i]), strict=False)]
        return tuple([*place, *rest][:count] for place, rest in zip(moved, tail, strict=True))


def swing(scene: Scene, *, seed: int = 0) -> FreeMotion:
    """Run `scene` and say whether it comes to rest, keeps swinging, or does not stay bounded."""
    first = run(scene, seed=seed)
    if first.status == "diverged":
        return FreeMotion("unstable", first.sentence, None, None, False)
    since = 0 if scene.hand is None else _hardest(first)
    trip = first.metrics.get("T_fwd_mean", 0.0) + first.metrics.get("T_bwd_mean", 0.0)
    dt = scene.dt_ns / 1e9
    lasting = max(scene.duration, 5.0 * WINDOWS * trip, LEAST * dt)
    kicked = replace(scene, duration=since * dt + lasting, energy=False)
    axes = kicked_axes(scene)
    if scene.hand is None:
        start = scene.vector("start_m", scene.start_m)
        kicked = replace(kicked, start_m=tuple([x + KICK * (i in axes) for i, x in enumerate(start)]))
    else:
        hands = [hand and HeldGrip(mass=hand.mass, k=hand.k, d=hand.d, reference=Staying(
            path=hand.reference, until=since, kicked=axes)) for hand in scene.per_axis("hand")]
        kicked = replace(kicked, hand=tuple(hands) if isinstance(scene.hand, tuple) else hands[0])
    return settled(kicked, since=since, seed=seed)


def kicked_axes(scene: Scene) -> tuple[int, ...]:
    """The axes that are kicked: the first, and each with parts of its own, whose loop is another."""
    return tuple(range(scene.axes)) if own_parts(scene) else (0,)


def _hardest(result: Result) -> int:
    """The tick at which the slave pressed hardest (without one: the master was pushed hardest), or the middle one."""
    touch = np.abs(result.trace.get("f_env", result.trace["f_m"])).reshape(result.ticks, -1).max(axis=1)
    return int(touch.argmax()) if touch.max() > 0.0 else result.ticks // 2
