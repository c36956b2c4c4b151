"""Margins of a linear scene: of gain, and of delay.

Both are found with the root count of `loop`, so that the answer is certified by it: no root lies outside the unit
circle at any smaller gain that was tried, none at the round trip one tick below the critical one.
"""

from __future__ import annotations

from math import exp, floor, log, pi

import numpy as np

from teleop.analysis.models.linear import LinearScene
from teleop.analysis.models.loop import Loop, indent, resting_loop, sampled_loop

MOST_DELAY = 10_000_000  # ticks


def integrators(linear: LinearScene) -> int:
    """Roots at z = 1 (nearer than `teleop.analysis.models.loop.indent`): positions that nothing returns."""
    loop = resting_loop(linear)
    return len(loop.poles) - loop.outside(linear.round_trip)


def gain_margin(linear: LinearScene) -> float | None:
    """The factor on the round trip's gain at which the scene's verdict changes.

    Above 1 for a stable loop: the least gain at which a root reaches the unit circle, which is 1/|l_j| where the phase
    is a whole number of turns. Exactly 1 if a root that rests at z = 1 leaves the unit circle with any more gain: what
    rests is stable, but has no margin. Below 1 for an unstable loop: the greatest at which it is stable, as it is at
    1e-6; gains above 1 are not tried for it. None where no factor from 1e-6 to 1e6 changes the verdict.
    """
    loop, delay = sampled_loop(linear), linear.round_trip
    if loop.outside(delay):
        if loop.outside(delay, 1e-6):
            return None
        low, high = log(1e-6), 0.0
    else:
        nearest = _phase_crossover(loop, delay)
        if nearest is None:
            return None
        if not loop.outside(delay, exp(-nearest) * (1.0 - 1e-9)):
            return 1.0 if _leaves_rest(linear, exp(-nearest)) else exp(-nearest)
        low, high = 0.0, -nearest
    while high - low > 1e-10:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if loop.outside(delay, exp(middle)) else (middle, high)
    return exp(high)


def _leaves_rest(linear: LinearScene, gain: float) -> bool:
    """True if a root that rests at z = 1 does not with a little more than `gain`: so far the curve is from there."""
    loop = resting_loop(linear)
    return loop.outside(linear.round_trip, gain * (1.0 + 1e-9)) > loop.outside(linear.round_trip)


def _phase_crossover(loop: Loop, delay: int) -> float | None:
    """The greatest log |z^-d l_j| below 0 where the phase is a whole number of turns."""
    t, exponents, logs = loop.samples
    size, turns = (part - delay * way for part, way in
                   ((logs.real, exponents.real[:, None]), (logs.imag / (2 * pi), exponents.imag[:, None] / (2 * pi))))
    brackets: list[tuple[float, int, int, int]] = []
    for i, j in zip(*np.nonzero(np.floor(turns[1:]) != np.floor(turns[:-1])), strict=True):
        a, b = sorted((turns[i, j], turns[i + 1, j]))
        brackets += [(max(size[i, j], size[i + 1, j]), i, j, turn) for turn in {floor(a) + 1, floor(b)}]
    exact = [float(size[i, j]) for i in (0, -1) for j in range(size.shape[1])  # real there: no sample lies beyond
             if abs(turns[i, j] - round(turns[i, j])) < 1e-9]
    brackets.sort(reverse=True)
    exact += [_size_at_turn(loop, delay, t[i], t[i + 1], j, turn)
              for level, i, j, turn in [f for f in brackets if f[0] > log(1e-6)][:24]]
    return max((min(level, 0.0) for level in exact if log(1e-6) < level <= 1e-9), default=None)


def _size_at_turn(loop: Loop, delay: int, low: float, high: float, j: int, turn: int) -> float:
    def psi(t: float) -> complex:
        at, value = loop.log_at(t, j)
        return value - delay * at

    rising = psi(low).imag < 2.0 * pi * turn
    for _ in range(60):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        if (psi(middle).imag < 2.0 * pi * turn) == rising:
            low = middle
        else:
            high = middle
    return psi(0.5 * (low + high)).real


def critical_round_trip(linear: LinearScene, least: int = 2) -> int | None:
    """The least round trip in ticks, from `least` on, at which the loop is unstable; None if there is none.

    On the unit circle a delay changes phases alone, so the places where |l_j| = 1 are found once and the count of
    roots follows for every delay from them. What it comes to is then counted in full, there and a tick below.
    """
    loop = sampled_loop(linear)
    first = loop.outside(least)
    if first:
        return least
    crossings = [c for c in loop.crossings(least) if c.at.imag > 2.0 * indent(linear)]
    logs = loop.samples[2]
    throughout = int(np.count_nonzero(logs[-1].real > 0.0))
    if not crossings and not throughout:
        return None
    begin, width = least + 1, 4096
    while begin < MOST_DELAY:
        ticks = np.arange(begin, begin + width)
        roots = first + throughout * (ticks - least)
        for c in crossings:
            turns = np.floor((c.log.imag - ticks * c.at.imag) / (2.0 * pi))
            roots += 2 * c.into * (turns - floor((c.log.imag - least * c.at.imag) / (2.0 * pi))).astype(int)
        unstable = np.flatnonzero(roots > 0)
        if unstable.size:
            return _settled(loop, int(ticks[unstable[0]]), least)
        begin, width = begin + width, 2 * width
    return None


def _settled(loop: Loop, ticks: int, least: int) -> int:
    """The nearest round trip at which the full count agrees."""
    while ticks > least and loop.outside(ticks - 1):
        ticks -= 1
    while not loop.outside(ticks):
        ticks += 1
    return ticks
