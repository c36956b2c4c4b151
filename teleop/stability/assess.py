"""Is a scene stable, by how much, and where does it stop: the answers behind `teleop stability`.

    stability(load_scene("soft_tissue", law="direct")).verdict
    critical(lambda k: load_scene("soft_tissue", k_e=k), "k_e", low=10.0, high=1e5)

A linear scene is answered for by the roots of its exact sampled loop (`linear`, `loop`), counted and not
estimated; one that is not linear by a run in virtual time (`swing`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from teleop.errors import Refused, number
from teleop.scene import Scene

if TYPE_CHECKING:
    from teleop.stability.margins import Mode

PLACES = 33  # of a range that are tried before it is halved


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
    gain_margin: float | None  # the factor on the loop's gain that changes the verdict; None: see `margins`
    critical_round_trip: int | None  # ticks, the least at which the loop is unstable; None: stable at every delay
    alone: bool = False  # no slave: all delays are those of the computation, `forth` in all
    tried: int | None = None  # ticks up to which a critical delay was looked for; None: any

    @property
    def verdict(self) -> str:
        """Is every root but the integrators inside the unit circle?"""
        return "unstable" if self.unstable else "stable"

    @property
    def round_trip(self) -> int:
        """Ticks there and back."""
        return self.forth + self.back

    @property
    def delay_margin(self) -> int | None:
        """Ticks that may be added to the round trip, below 0 those to take away; None: any number."""
        return None if self.critical_round_trip is None else self.critical_round_trip - 1 - self.round_trip


class Critical(NamedTuple):
    """Where a knob changes the verdict: between `low` and `high`."""

    knob: str
    value: float  # the middle
    low: float
    high: float
    stable: str  # below or above
    changes: int  # of the verdict at the places tried in the range; the one nearest to the scene's own was taken


def stability(scene: Scene, *, seed: int = 0) -> Stability:
    """Count the unstable roots of a linear scene and find its margins. Refused if the scene is not linear.

    The link must delay by a constant number of ticks, each way 1 or more; `seed` keys it where it is not plainly so.
    """
    from teleop.stability.linear import linear_scene
    from teleop.stability.loop import sampled_loop
    from teleop.stability.margins import critical_round_trip, dominant, gain_margin, integrators

    if scene.slave is None:
        return _one_port(scene)
    linear = linear_scene(scene, seed=seed)
    resting = integrators(linear)
    return Stability(
        scene=scene.name, unstable=sampled_loop(linear).outside(linear.round_trip), integrators=resting,
        forth=linear.forth, back=linear.back, dt=linear.dt, mode=dominant(linear, resting),
        gain_margin=gain_margin(linear), critical_round_trip=critical_round_trip(linear),
    )


def _one_port(scene: Scene) -> Stability:
    """The same of a scene without a slave: the loop in contact, its delay that of the computation."""
    from teleop.stability.one_port import margins

    found = margins(scene)
    return Stability(
        scene=scene.name, unstable=found.unstable, integrators=found.integrators,
        forth=0 if scene.device_m is None else scene.device_m.delay, back=0, dt=scene.dt_ns / 1e9, mode=found.mode,
        gain_margin=found.gain_margin, critical_round_trip=found.critical_delay, alone=True, tried=found.tried,
    )


def is_stable(scene: Scene, *, seed: int = 0) -> bool:
    """The verdict alone, from the root count: quicker than `stability`."""
    if scene.slave is None:
        from teleop.stability.one_port import settles

        return settles(scene)
    from teleop.stability.linear import linear_scene
    from teleop.stability.loop import sampled_loop

    linear = linear_scene(scene, seed=seed)
    return not sampled_loop(linear).outside(linear.round_trip)


def rests(scene: Scene, *, seed: int = 0) -> bool:
    """The verdict alone, from a run in virtual time: a limit cycle is not stable."""
    from teleop.stability.swing import swing

    return swing(scene, seed=seed).verdict == "stable"


def critical(
    make: Callable[[float], Scene], knob: str, *, low: float, high: float, tol: float | None = None,
    near: float | None = None, judge: Callable[[Scene], bool] = is_stable, places: int = PLACES,
) -> Critical:
    """The value at which `make(value)` stops or starts being stable, by bisection to `tol` (in the knob's unit).

    The range is tried at `places` values first, evenly, or by equal ratios where it spans more than a decade. Of
    several changes the nearest to `near` is taken; left out, the lowest. `tol` left out: 1e-6 of the value. Raises
    `Refused` for an empty range, and where the verdict does not change in it, saying which it is.
    """
    low, high = number("the range's low end", low), number("the range's high end", high)
    if not low < high:
        raise Refused(f"the range {low:g}:{high:g} of {knob} is empty; write the lower value first, --range 1:1000")
    if tol is not None:
        number("tol", tol, above=0.0)
    values = _spread(low, high, places)
    verdicts = [judge(make(value)) for value in values]
    changes = [i for i in range(places - 1) if verdicts[i] != verdicts[i + 1]]
    if not changes:
        side = "stable" if verdicts[0] else "unstable"
        raise Refused(f"{knob} has no critical value from {low:g} to {high:g}: the scene is {side} at all {places} "
                      f"values tried{_own(knob, near, make, judge)}; give another --range")
    i = min(changes, key=lambda i: abs(i + 0.5 - _place(values, near)))
    low, high, below = values[i], values[i + 1], verdicts[i]
    while high - low > (1e-6 * max(abs(low), abs(high)) if tol is None else tol):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        low, high = (middle, high) if judge(make(middle)) == below else (low, middle)
    return Critical(knob, 0.5 * (low + high), low, high, "below" if below else "above", len(changes))


def _spread(low: float, high: float, places: int) -> list[float]:
    steps = [i / (places - 1) for i in range(places)]
    if low > 0.0 and high > 10.0 * low:
        return [low, *(low * (high / low) ** step for step in steps[1:-1]), high]
    return [low, *(low + (high - low) * step for step in steps[1:-1]), high]


def _place(values: list[float], near: float | None) -> float:
    """Where among the values `near` lies, as an index."""
    if near is None:
        return 0.0
    from bisect import bisect

    return bisect(values, near) - 0.5


def _own(knob: str, near: float | None, make: Callable[[float], Scene], judge: Callable[[Scene], bool]) -> str:
    """On which side the scene itself lies."""
    if near is None:
        return ""
    return f", and {'stable' if judge(make(near)) else 'unstable'} at its own, {knob}={near:g}"
