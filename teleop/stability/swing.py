"""Stability as it shows in virtual time, for scenes that have no eigenvalues.

The scene is run once as it is. It is run again with the hand staying where the slave touched hardest, or without a
slave where the master was pushed hardest (half way, if there was no force), after a kick of `KICK`; without a hand the
master starts that far off. What then remains is the loop's own motion: the swing of all ends about their drift, peak to
peak, in `WINDOWS` equal pieces of time.

- stable: the swing is below `QUIET`, or fell by 10 % or more over the last half;
- limit cycle: it stayed, within 10 % down and 20 % up, and is bounded;
- unstable: the run diverged, or the swing still grew after the time was made four times as long.

This is one experiment about one place: a nonlinear loop may answer otherwise to another kick or another place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.scene import Reference, Scene

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from teleop.result import Result

KICK = 1e-3  # m
QUIET = 1e-7  # m
WINDOWS = 8


class Swing(NamedTuple):
    """What a scene does when nothing moves it any more."""

    verdict: str  # stable, limit cycle or unstable
    sentence: str
    amplitude: float | None  # m, half the swing peak to peak in the last window; None if it diverged
    frequency: float | None  # Hz; None if there is no swing


@dataclass(frozen=True, kw_only=True, slots=True)
class Staying:
    """A reference that follows `path` up to tick `until` and stays there, after one kick along the first axis."""

    path: Reference
    until: int

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[list[float], ...]:
        """For each axis the position (m) at the ticks 0 .. count-1."""
        moved = self.path.samples(axes, self.until + 1, dt_ns)
        rise = max(1, 10_000_000 // dt_ns)  # 10 ms up and as long down
        pulse = [KICK * min(i, 2 * rise - i) / rise for i in range(1, 2 * rise)]
        tail = [[place[-1]] * (count - self.until - 1) for place in moved]
        tail[0] = [at + extra for at, extra in zip(tail[0], pulse + [0.0] * len(tail[0]), strict=False)]
        return tuple((place + rest)[:count] for place, rest in zip(moved, tail, strict=True))


@dataclass(frozen=True, kw_only=True, slots=True)
class _Grip:
    mass: float
    k: float
    d: float
    reference: Reference


def swing(scene: Scene, *, seed: int = 0) -> Swing:
    """Run `scene` and say whether it comes to rest, keeps swinging, or does not stay bounded."""
    from teleop.lockstep import run

    first = run(scene, seed=seed)
    if first.status != "ok":
        return Swing("unstable", first.sentence, None, None)
    until = 0 if scene.hand is None else _hardest(first)
    trip = first.metrics.get("T_fwd_mean", 0.0) + first.metrics.get("T_bwd_mean", 0.0)
    lasting = max(scene.duration, 5.0 * WINDOWS * trip)
    found = _held(scene, until, lasting, seed)
    return _held(scene, until, 4.0 * lasting, seed) if found.sentence.startswith("grows") else found


def _hardest(result: Result) -> int:
    """The tick at which the slave pressed hardest (without one: the master was pushed hardest), or the middle one."""
    import numpy as np

    touch = np.abs(result.trace.get("f_env", result.trace["f_m"])).reshape(result.ticks, -1).max(axis=1)
    return int(touch.argmax()) if touch.max() > 0.0 else result.ticks // 2


def _held(scene: Scene, until: int, lasting: float, seed: int) -> Swing:
    import numpy as np

    from teleop.lockstep import run

    dt = scene.dt_ns / 1e9
    kicked = replace(scene, duration=until * dt + lasting, energy=False)
    if scene.hand is None:
        start = scene.vector("start_m", scene.start_m)
        kicked = replace(kicked, start_m=(start[0] + KICK, *start[1:]))
    else:
        hand = scene.hand
        own = _Grip(mass=hand.mass, k=hand.k, d=hand.d, reference=Staying(path=hand.reference, until=until))
        kicked = replace(kicked, hand=own)
    result = run(kicked, seed=seed)
    if result.status != "ok":
        return Swing("unstable", result.sentence, None, None)
    motion = np.column_stack([result.trace[name].reshape(result.ticks, -1) for name in ("x_m", "x_s")
                              if name in result.trace])[until:]
    size = len(motion) // WINDOWS
    if size < 8:
        return Swing("stable", "too short to see a swing; give it more ticks with a longer duration", 0.0, None)
    pieces = [_level(motion[i * size:(i + 1) * size]) for i in range(WINDOWS)]
    sizes = np.array([np.ptp(piece, axis=0) for piece in pieces])
    most = int(sizes[-1].argmax())
    earlier, last = sizes[WINDOWS // 2 - 1].max(), sizes[-1].max()
    amplitude = float(0.5 * last)
    if last < QUIET:
        return Swing("stable", f"comes to rest: less than {QUIET:g} m of swing is left", amplitude, None)
    pitch = frequency(_level(motion[-2 * size:])[:, most], dt)
    told = f"{pitch:.4g} Hz, {last:.3g} m peak to peak"
    if last < 0.9 * earlier:
        return Swing("stable", f"dies away: {told} left", amplitude, pitch)
    if last > 1.2 * earlier:
        return Swing("unstable", f"grows: {told} by now", amplitude, pitch)
    return Swing("limit cycle", f"keeps swinging: {told}", amplitude, pitch)


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
