"""What a run comes to: rest, a limit cycle, or neither; the one definition of it that all commands share.

A run is looked at in `WINDOWS` equal pieces of time, and of each the swing: of all ends about their drift, peak to
peak. One length cannot tell a slow decay from a decay onto a limit cycle, so the run is made again with twice its
length, and again up to `LENGTHS`, until

- stable: the swing is below `QUIET`;
- limit cycle: at two successive lengths it stays as it is, and is the same at both;
- unstable: the run diverged.

Where the longest run decides nothing, a swing that grew in it is unstable. One that fell all the time is stable, but
not behind an encoder, which leaves limit cycles of any size. All else is a limit cycle.

Does it rest? What is stable does, and behind an encoder also what swings by at most `STEPS` of its steps peak to peak.
Where in a step the device comes to stand is chance, and near an edge the reading flickers by one for good, so that a
stricter limit would tell where the edges are and not how stiff the wall may be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.scene.parts import Reference
from teleop.scene.scene import Scene

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from teleop.simulation.result import Result

QUIET = 1e-7  # m
STEPS = 2.0
WINDOWS = 8
LENGTHS = (1, 2, 4, 8, 16, 32)  # times the first
MOST = 200_000  # ticks of a run, if that is four times the first or more
KEPT = (0.9, 1.2)  # the swing stays if it changed by a factor between these
SLOW = 0.01  # and did not change by more than this from piece to piece always the same way


class FreeMotion(NamedTuple):
    """What a scene does when nothing moves it any more."""

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
    """What a scene that nothing moves from tick `since` on comes to. Its own duration is the first that is tried."""
    from teleop.simulation.virtual import run

    first = scene.ticks - since
    before: _Seen | None = None
    for times in LENGTHS:
        if times > 4 and times * first > MOST:
            break
        result = run(replace(scene, duration=(since + times * first + 0.5) * scene.dt_ns / 1e9), seed=seed)
        if result.status != "ok":
            return FreeMotion("unstable", result.sentence, None, None, False)
        seen = _look(result, since)
        if seen.last < QUIET:
            told = f"comes to rest: less than {QUIET:g} m of swing is left"
            return FreeMotion("stable", told, 0.5 * seen.last, None, True)
        if before and before.trend == seen.trend == "stays" and KEPT[0] < seen.last / before.last < KEPT[1]:
            break
        before = seen
    return _decided(scene, seen, (result.ticks - since) * result.dt)


def _look(result: Result, since: int) -> _Seen:
    import numpy as np

    motion = np.column_stack([result.trace[name].reshape(result.ticks, -1) for name in ("x_m", "x_s")
                              if name in result.trace])[since:]
    size = len(motion) // WINDOWS
    motion = motion[len(motion) - WINDOWS * size:]
    sizes = np.array([np.ptp(_level(piece), axis=0) for piece in motion.reshape(WINDOWS, size, -1)])
    late = sizes.max(axis=1)[WINDOWS // 2 - 1:]
    most = int(sizes[-1].argmax())
    ratio, steps = float(late[-1]) / max(float(late[0]), 1e-300), np.diff(late)
    trend = "stays"
    if ratio <= KEPT[0] or (ratio < 1.0 - SLOW and (steps < 0.0).all()):
        trend = "falls"
    elif ratio >= KEPT[1] or (ratio > 1.0 + SLOW and (steps > 0.0).all()):
        trend = "grows"
    return _Seen(trend, float(late[-1]), frequency(_level(motion[-2 * size:])[:, most], result.dt))


def _decided(scene: Scene, seen: _Seen, lasting: float) -> FreeMotion:
    """What the last run says, which is not at rest and has not diverged."""
    step = max((end.encoder.step for end in (scene.device_m, scene.device_s) if end and end.encoder), default=0.0)
    amplitude, told = 0.5 * seen.last, f"{seen.pitch:.4g} Hz, {seen.last:.3g} m peak to peak"
    if seen.trend == "grows":
        return FreeMotion("unstable", f"still grows after {lasting:.3g} s: {told} by now", amplitude, seen.pitch, False)
    if seen.trend == "falls" and not step:
        return FreeMotion("stable", f"still dies away after {lasting:.3g} s: {told} left", amplitude, seen.pitch, True)
    rests = seen.last <= STEPS * step
    if step:
        told += f", {seen.last / step:.2g} steps of the encoder"
        told += f", of which {STEPS:g} count as rest" if rests else ""
    kept = f"has not come to rest after {lasting:.3g} s" if seen.trend == "falls" else "keeps swinging"
    return FreeMotion("limit cycle", f"{kept}: {told}", amplitude, seen.pitch, rests)


def _level(motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Without the straight line that fits best: a drift is no swing."""
    import numpy as np

    t = np.linspace(-1.0, 1.0, len(motion))[:, None]
    centred: NDArray[np.float64] = motion - motion.mean(axis=0)
    level: NDArray[np.float64] = centred - t * ((t * centred).sum(axis=0) / (t * t).sum())
    return level


def frequency(signal: Any, dt: float) -> float:
    """The strongest frequency (Hz) of a signal sampled every dt seconds, from the peak of its spectrum.

    Hann window, the peak refined by the parabola through the logarithms of three lines.
    """
    import numpy as np

    lines = np.abs(np.fft.rfft(signal * np.hanning(len(signal)))) + 1e-300
    i = int(lines[1:-1].argmax()) + 1
    a, b, c = np.log(lines[i - 1:i + 2])
    shift = 0.5 * (a - c) / (a - 2.0 * b + c) if a - 2.0 * b + c < 0.0 else 0.0
    return float((i + shift) / (len(signal) * dt))
