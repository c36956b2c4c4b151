"""Stability as it shows in virtual time, for scenes that have no eigenvalues.

The scene is run once as it is. It is run again with the hand staying where the slave touched hardest, or without a
slave where the master was pushed hardest (half way, if there was no force), after a kick of `KICK` along the first
axis, or along each where axes have parts of their own; without a hand the master starts that far off. What then remains
is the loop's own motion, and what it comes to is told by `teleop.analysis.models.rest`.

This is one experiment about one place: a nonlinear loop may answer otherwise to another kick or another place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from teleop.analysis.models.by_axis import own_parts
from teleop.analysis.models.rest import FreeMotion, HeldGrip, settled
from teleop.scene.parts import Reference
from teleop.scene.scene import Scene
from teleop.simulation.rest import WINDOWS

if TYPE_CHECKING:
    from teleop.simulation.result import Result

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
    from teleop.simulation.virtual import run

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
    import numpy as np

    touch = np.abs(result.trace.get("f_env", result.trace["f_m"])).reshape(result.ticks, -1).max(axis=1)
    return int(touch.argmax()) if touch.max() > 0.0 else result.ticks // 2
