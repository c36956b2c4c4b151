"""The end of a run in virtual time, for the analyses: rest, a limit cycle, or neither.

The swing of a window and its trend are those of `teleop.simulation.rest`, which runs and sweeps go by too. A run of one
length cannot tell a slow decay from a decay onto a limit cycle, so here it is made again with twice its length, and
again up to `LENGTHS`, until

- stable: the swing is below `QUIET`;
- limit cycle: at two successive lengths it stays as it is, and is the same at both;
- unstable: the run diverged.

Where the longest run decides nothing, a swing that grew in it is unstable. One that fell all the time is stable, but
not behind an encoder, which leaves limit cycles of any size. All else is a limit cycle.

What a link that loses or jitters, or ticks that are left out, move for ever is no limit cycle below `DISTURBED`: it is
stable, unless it grew in the longest run.

Does it rest? What is stable does, and behind an encoder also what swings by at most `STEPS` of its steps peak to peak.
Where in a step the device comes to stand is chance, and near an edge the reading flickers by one for good, so that a
stricter limit would tell where the edges are and not how stiff the wall may be. How little of a swing a hand feels is
of no account here: `QUIET` is far below it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from teleop.scene.parts import Reference
from teleop.scene.scene import Scene
from teleop.simulation.ending import position_unit
from teleop.simulation.rest import DISTURBED, STEPS, WINDOWS, disturbed, encoder_step, pitch, places, swings, trend
from teleop.simulation.result import Result
from teleop.simulation.virtual import run

QUIET = 1e-7  # m
LENGTHS = (1, 2, 4, 8, 16, 32)  # times the first
MOST = 200_000  # ticks of a run, if that is four times the first or more
KEPT = (0.95, 1.05)  # the swing stays if it changed by a factor between these


class FreeMotion(NamedTuple):
    """Behaviour of a scene that nothing moves any more."""

    verdict: str  # stable, limit cycle or unstable
    sentence: str
    amplitude: float | None  # m, half the swing peak to peak in the last window; None if it diverged
    frequency: float | None  # Hz; None if there is no swing
    rests: bool  # stable, or a limit cycle within `STEPS` of the encoder


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldGrip:
    """The scene's own grip with another `reference`, one that stays where it is."""

    mass: float  # kg
    k: float  # N/m
    d: float  # N s/m
    reference: Reference


class _Seen(NamedTuple):
    trend: str  # falls, stays or grows
    last: float  # m peak to peak
    pitch: float  # Hz


def settled(scene: Scene, *, since: int = 0, seed: int = 0) -> FreeMotion:
    """Judge a scene that nothing moves from tick `since` on. Its own duration is the first that is tried."""
    first = scene.ticks - since
    before: _Seen | None = None
    for times in LENGTHS:
        if times > 4 and times * first > MOST:
            break
        result = run(replace(scene, duration=(since + times * first + 0.5) * scene.dt_ns / 1e9), seed=seed)
        if result.status == "diverged":
            return FreeMotion("unstable", result.sentence, None, None, False)
        seen = _look(result, since)
        if seen.last < QUIET:
            sentence = f"comes to rest: less than {QUIET:g} {position_unit(scene)} of swing is left"
            return FreeMotion("stable", sentence, 0.5 * seen.last, None, True)
        if before and before.trend == seen.trend == "stays" and KEPT[0] < seen.last / before.last < KEPT[1]:
            break
        before = seen
    return _decided(scene, seen, (result.ticks - since) * result.dt)


def _look(result: Result, since: int) -> _Seen:
    motion, window = places(result.trace), (result.ticks - since) // WINDOWS
    late = swings(motion, window)
    return _Seen(trend(late), late[-1], pitch(motion, window, result.dt))


def _decided(scene: Scene, seen: _Seen, lasting: float) -> FreeMotion:
    """The verdict of the last run, which is not at rest and has not diverged."""
    step = encoder_step(scene)
    amplitude, left = 0.5 * seen.last, f"{seen.pitch:.4g} Hz, {seen.last:.3g} {position_unit(scene)} peak to peak"
    if seen.trend == "grows":
        return FreeMotion("unstable", f"still grows after {lasting:.3g} s: {left} by now", amplitude, seen.pitch, False)
    if seen.trend == "falls" and not step:
        return FreeMotion("stable", f"still dies away after {lasting:.3g} s: {left} left", amplitude, seen.pitch, True)
    if disturbed(scene) and seen.last < DISTURBED:
        return FreeMotion("stable", f"rests but for what its link or its left-out ticks move: {left}", amplitude,
                          seen.pitch, True)
    rests = seen.last <= STEPS * step
    if step:
        left += f", {seen.last / step:.2g} steps of the encoder"
        left += f", which counts as rest, as up to {STEPS:g} steps do" if rests else ""
    motion = f"has not come to rest after {lasting:.3g} s" if seen.trend == "falls" else "keeps swinging"
    return FreeMotion("limit cycle", f"{motion}: {left}", amplitude, seen.pitch, rests)
