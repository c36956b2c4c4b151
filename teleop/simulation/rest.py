"""Rest, limit cycle or growth: what a scene does from the tick on from which nothing moves it any more.

Nothing moves a scene once the hand's reference stays where it is (or there is no hand) and no environment is carried
along a path. The time from there to the end of the run is divided into `WINDOWS` equal windows, and of the last `LATE`
of them the swing is looked at. Runs in virtual time, every engine of a sweep and the analyses in virtual time share
this definition.

The *swing* of a coordinate in a window is the lesser of its largest rise and its largest fall there: the greatest of
`x(j) - x(i)` and the greatest of `x(i) - x(j)` over i <= j. It takes the lowest and the highest place so far, and
nothing else, so that a sweep works it out as it goes. It is 0 of what only creeps one way, however far; of an
oscillation of one and a half periods or more it is the size peak to peak; a drift of c m/s beside an oscillation of
period P takes at most c P/2 off. The swing of a window is the greatest of all ends and axes.

The *trend* of the swings of the late windows says what they come to:

- falls: the last two are half of the first or less; or each is no greater than the one before, by steps that are alike
  (of the mean step at least half and at most twice) and by more than `SLOW` in all;
- grows: each is no smaller than the one before, and the last is twice the first or more, or the steps are alike and
  more than `SLOW` in all;
- stays: all else, and what falls or grows but levels off: over the second half of the late windows it changed by less
  than half of what it did over the first, and more than twice that change is left of the swing. If the changes go on
  so, what is still to come is less than the last of them. An exponential decay or growth never levels off so.

What decays in windows shorter than its period may seem to stay: there that is no verdict, see `Still.short`. A run of
one length cannot tell more. `teleop.analysis.models.rest` makes it again with twice the length.

The status of a run goes by what a person at the handle is to be told. A swing below `FELT` is rest: a hand at rest
feels a vibration of a few Hz from some 0.02 to 0.05 mm peak to peak on (Bolanowski et al., "Four channels mediate the
mechanical aspects of touch", J. Acoust. Soc. Am. 84 (1988)). Behind an encoder `STEPS` of its steps are rest too. A
link that loses or jitters, and ticks that are left out at random, move a scene for ever: below `DISTURBED` a swing may
be all theirs, and is no limit cycle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import ceil, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.scene.parts import varies
from teleop.scene.scene import Scene

WINDOWS = 8
LATE = 5  # of them
LEAST = 50  # ticks of a window
TRIPS = 3  # round trips of the loop that a window holds: it swings with a period of two of them, and its own lag
PERIODS = 1.5  # that a window holds: the swing of as many is the size peak to peak
SLOW = 0.01
FELT = 5e-5  # m peak to peak
DISTURBED = 1e-3  # m peak to peak; loss of 30 % or a jitter of 20 ms moves `hard_wall` by 0.02 to 0.4 mm
STEPS = 2.0  # steps of the encoder, peak to peak, that count as rest: near an edge the reading flickers for good


class Still(NamedTuple):
    """View of the end of a run from whose tick `since` on nothing moves the scene."""

    since: int
    window: int  # ticks
    step: float  # m, of the coarsest encoder; 0.0 without one
    late: int = 0  # ticks by which the computation and the renewal of the forces of both ends are late
    periods: int = 0  # ticks of one and a half periods of all masses on the hand's spring: see `period`
    least_swing: float = FELT  # m, below which it rests

    def first(self, ticks: int) -> int:
        """The first tick of the late windows of a run of so many ticks, which they end with."""
        return ticks - LATE * self.window

    def status(self, swings: Sequence[float], trip: int) -> str:
        """The status of a run that came to its end; `trip`: the round trip of its link, ticks.

        `swings`: of the late windows, m. Where a window is too short for the loop there is no verdict, which is ok.
        """
        if self.rests(swings[-1]) or self.short(swings, trip):
            return "ok"
        return {"falls": "ok", "stays": "limit cycle", "grows": "unstable"}[trend(swings)]

    def rests(self, swing: float) -> bool:
        """True of a swing (m, peak to peak) that counts as rest in the status of a run."""
        return swing <= max(self.least_swing, STEPS * self.step)

    def short(self, swings: Sequence[float], trip: int) -> bool:
        """True if the windows are too short for a verdict.

        They are where a window holds less than `TRIPS` round trips of the loop. Where it is shorter than `periods`,
        what decays may seem to stay, as the swing goes by where in a period each window begins.
        """
        return self.window < TRIPS * (trip + self.late) or (self.window < self.periods and trend(swings) == "stays")

    def least(self, trip: int) -> int:
        """The least window, ticks, that any verdict can be told from; `trip`: the round trip of the link, ticks."""
        return max(TRIPS * (trip + self.late), self.periods)

    def swing_left(self, swings: Sequence[float], trip: int) -> float:
        """The swing (m) that is left: the greatest over the last round trip of the loop, where a window is shorter."""
        return max(swings[-max(1, -(-(trip + self.late) // self.window)):])

    def undecided(self, swings: Sequence[float], trip: int) -> bool:
        """True if something swings that a longer run would give a verdict on."""
        return self.short(swings, trip) and not self.rests(self.swing_left(swings, trip))


def still(scene: Scene, path: Sequence[Sequence[float]] | None) -> Still | None:
    """Make the view of the end of a run of `scene`; None where something moves it nearly to the end.

    `path`: the samples of the hand's reference at the ticks 0 .. n, for each axis; None without a hand.
    """
    ticks = scene.ticks
    if any(axis[ticks] != axis[ticks - 1] for axis in path or ()) or any(
            hasattr(each, "path") for each in scene.environments):
        return None
    since = max([_stops(axis, ticks) for axis in path or ()], default=0)
    window = (ticks - since) // WINDOWS
    late = sum(end.delay + end.every - 1 for end in _devices(scene)[::scene.axes] if end)
    periods = ceil(PERIODS * period(scene) * 1e9 / scene.dt_ns)
    return Still(since, window, encoder_step(scene), late, periods, least_swing(scene)) if window >= LEAST else None


def least_swing(scene: Scene) -> float:
    """The swing (m) below which a scene rests, its encoders aside: more where its link, or its ticks, disturb it."""
    return DISTURBED if disturbed(scene) else FELT


def disturbed(scene: Scene) -> bool:
    """True if a link that loses or jitters, or ticks that are left out, move the scene for ever: see `DISTURBED`.

    One end by itself they do not: what it holds over ticks that are left out is no other than at rest.
    """
    late = scene.left_out_m is not None or scene.left_out_s is not None
    return scene.slave is not None and (late or (scene.link is not None and varies(scene.link)))


def period(scene: Scene) -> float:
    """The longest period (s) of the masses of hand, master and slave on the hand's spring; 0.0 without one.

    No loop with a hand swings much more slowly by itself: what else is stiff makes it quicker.
    """
    slaves = [None] * scene.axes if scene.slave is None else scene.per_axis("slave")
    longest = 0.0
    for hand, master, slave in zip(scene.per_axis("hand"), scene.per_axis("master"), slaves, strict=True):
        if hand is not None and hand.k > 0.0:
            mass = hand.mass + master.mass + (0.0 if slave is None else slave.mass)
            longest = max(longest, 2.0 * pi * sqrt(mass / hand.k))
    return longest


def encoder_step(scene: Scene) -> float:
    """The step of the coarsest encoder of both ends, m; 0.0 without one."""
    bodies = (*scene.per_axis("master"), *scene.per_axis("slave"))
    steps: list[float] = [getattr(body, "step", 0.0) for body in bodies]
    return float(max(*steps, *[end.encoder.step for end in _devices(scene) if end and end.encoder]))


def _devices(scene: Scene) -> tuple[Any, ...]:
    """List the devices between the axes of both ends and the law."""
    return (*scene.per_axis("device_m"), *scene.per_axis("device_s"))


def _stops(axis: Sequence[float], ticks: int) -> int:
    """The first sample that is the same as all after it."""
    samples = np.asarray(axis, dtype=float)[: ticks + 1]
    moves = np.flatnonzero(samples[1:] != samples[:-1])
    return int(moves[-1]) + 1 if len(moves) else 0


def swings(columns: Iterable[NDArray[np.float64]], window: int, count: int = LATE) -> list[float]:
    """The swing (m) of each of the last `count` windows of so many ticks.

    `columns`: places by tick, of shape (ticks,), or (ticks, axes) where there are several axes.
    """
    greatest = np.zeros(count)
    for column in columns:
        for place in np.reshape(column, (len(column), -1)).T:
            late = place[len(place) - count * window:].reshape(count, window)
            with np.errstate(over="ignore"):  # places may be as far apart as no float is
                rise = (late - np.minimum.accumulate(late, axis=1)).max(axis=1)
                fall = (np.maximum.accumulate(late, axis=1) - late).max(axis=1)
            greatest = np.maximum(greatest, np.minimum(rise, fall))
    swings_found: list[float] = greatest.tolist()
    return swings_found


def risen(place: NDArray[np.float64]) -> tuple[float, float]:
    """The largest rise and the largest fall (m) of one coordinate in a window."""
    with np.errstate(over="ignore"):  # places may be as far apart as no float is
        return (float((place - np.minimum.accumulate(place)).max()),
                float((np.maximum.accumulate(place) - place).max()))


def places(trace: Any) -> list[NDArray[np.float64]]:
    """The places of the ends in a trace, by tick."""
    return [trace[name] for name in ("x_m", "x_s") if name in trace]


def trend(swings: Sequence[float]) -> str:
    """Trend of successive swings: "falls", "stays" or "grows", see the head of this file."""
    first, middle, last = swings[0], swings[len(swings) // 2], swings[-1]
    before, after = abs(middle - first), abs(last - middle)
    steps = [b - a for a, b in pairwise(swings)]
    mean = (last - first) / len(steps)
    alike = all(0.5 <= step / mean <= 2.0 for step in steps) if abs(last - first) > SLOW * first else False
    if after < 0.5 * before and last > 2.0 * after and (middle - first) * (last - middle) >= 0.0:
        return "stays"
    if max(swings[-2:]) <= 0.5 * first or (last < first and alike):
        return "falls"
    if min(steps) >= 0.0 and last > first and (last >= 2.0 * first or alike):
        return "grows"
    return "stays"


def frequency(signal: Any, dt: float) -> float:
    """The strongest frequency (Hz) of a signal sampled every dt seconds, from the peak of its spectrum.

    Its straight line is taken off first. Hann window, the peak refined by the parabola through the logarithms of three
    lines.
    """
    top = float(np.abs(signal).max())  # by which it is divided: no square overflows
    lines = np.abs(np.fft.rfft(_level(signal / top if top > 1.0 else signal) * np.hanning(len(signal)))) + 1e-300
    i = int(lines[1:-1].argmax()) + 1
    a, b, c = np.log(lines[i - 1:i + 2])
    shift = 0.5 * (a - c) / (a - 2.0 * b + c) if a - 2.0 * b + c < 0.0 else 0.0
    return float((i + shift) / (len(signal) * dt))


def pitch(columns: Iterable[NDArray[np.float64]], window: int, dt: float) -> float:
    """The frequency (Hz) of the coordinate that swings most, over the last two windows of so many ticks."""
    each = [place[-2 * window:] for column in columns for place in np.reshape(column, (len(column), -1)).T]
    return frequency(max(each, key=lambda place: swings([place], window, 1)), dt)


def _level(signal: Any) -> NDArray[np.float64]:
    """A signal without the straight line that fits it best: a drift is no swing."""
    t = np.linspace(-1.0, 1.0, len(signal))
    centred: NDArray[np.float64] = signal - np.mean(signal)
    level: NDArray[np.float64] = centred - t * ((t * centred).sum() / (t * t).sum())
    return level
