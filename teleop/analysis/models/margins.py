"""How far a linear scene is from instability: its slowest-dying mode, its gain margin, its delay margin.

All three are found with the root count of `loop`, so that the answer is certified by it: no root lies outside the
radius of the dominant one, none outside the unit circle at any smaller gain that was tried, none at the round trip
one tick below the critical one.
"""

from __future__ import annotations

from math import exp, floor, log, pi
from typing import TYPE_CHECKING, NamedTuple

from teleop.analysis.models.linear import LinearScene
from teleop.analysis.models.loop import Loop, gains, indent, resting_loop, sampled_loop

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MOST_STATES = 400  # of a dense matrix
MOST_DELAY = 10_000_000  # ticks


class Mode(NamedTuple):
    """A root z of the loop, as the motion it makes."""

    z: complex
    frequency: float  # Hz
    growth: float  # 1/s; below 0 it dies away
    damping: float  # ratio, -cos of the angle of log z

    @classmethod
    def of(cls, z: complex, dt: float) -> Mode:
        """The motion `z^k`, ticks of dt seconds."""
        from cmath import log as clog

        rate = clog(z)
        return cls(z, abs(rate.imag) / (2.0 * pi * dt), rate.real / dt, -rate.real / abs(rate) if rate else 0.0)


def integrators(linear: LinearScene) -> int:
    """Roots at z = 1 (nearer than `teleop.analysis.models.loop.indent`): positions that nothing returns."""
    loop = resting_loop(linear)
    return len(loop.poles) - loop.outside(linear.round_trip)


def dense(linear: LinearScene) -> NDArray[np.float64]:
    """The whole loop as one matrix, the delay a line of the smaller of the two messages.

    All the delay stands on one way, which changes no eigenvalue but those at 0.
    """
    import numpy as np

    first, second = linear.master, linear.slave
    if first.D.shape[0] < first.D.shape[1]:
        first, second = second, first  # `second` sends the message that is delayed, to `first`
    n, m, q, d = len(first.A), len(second.A), first.D.shape[1], linear.round_trip
    whole = np.zeros((n + m + q * d, n + m + q * d))
    heard = slice(n + m + q * (d - 1), None)
    whole[:n, :n], whole[:n, heard] = first.A, first.B
    whole[n:n + m, :n], whole[n:n + m, n:n + m] = second.B @ first.C, second.A
    whole[n:n + m, heard] = second.B @ first.D
    sent = slice(n + m, n + m + q)
    whole[sent, :n], whole[sent, n:n + m] = second.D @ first.C, second.C
    whole[sent, heard] += second.D @ first.D
    whole[n + m + q:, n + m:-q] += np.eye(q * (d - 1))
    return whole


def dominant(linear: LinearScene, resting: int) -> Mode | None:
    """The root of greatest magnitude but the `resting` ones at z = 1; None if nothing moves for longer than a tick.

    From the eigenvalues of the dense matrix up to `MOST_STATES`. Beyond, the radius is bracketed by the count of
    roots outside it, and the root found by the secant method from where the loop's gain passes 1 on that circle.
    """
    import numpy as np

    size = len(linear.master.A) + len(linear.slave.A) + min(linear.master.D.shape) * linear.round_trip
    if size <= MOST_STATES:
        roots = np.linalg.eigvals(dense(linear)) + 0j
        moving = roots[np.abs(roots - 1.0) > indent(linear)]
        greatest = complex(moving[np.argmax(np.abs(moving))]) if moving.size else 0j
        return Mode.of(greatest, linear.dt) if abs(greatest) > 1e-6 else None
    bracket = _bracket(linear, resting)
    root = _root(linear, *bracket) if bracket else None
    return None if root is None else Mode.of(root, linear.dt)


def _bracket(linear: LinearScene, resting: int) -> tuple[float, float] | None:
    """Two values of log |z| with the greatest root between them."""
    d = linear.round_trip

    def beyond(level: float) -> bool:
        count = sampled_loop(linear, exp(level)).outside(d)
        return count > (resting if level < 0.0 else 0)

    step = 1e-3 / d
    low, high = (0.0, step) if beyond(0.0) else (-max(step, 2.0 * indent(linear)), 0.0)
    while high > 0.0 and beyond(high):
        low, high = high, 2.0 * high
    while low < 0.0 and not beyond(low):
        low, high = 2.0 * low, low
        if low < -20.0:
            return None
    for _ in range(16):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if beyond(middle) else (low, middle)
    return low, high


def _root(linear: LinearScene, low: float, high: float) -> complex | None:
    """The root with log |z| between low and high."""
    from cmath import exp as cexp

    import numpy as np

    d = linear.round_trip
    room = 0.01 * (high - low) + 1e-12
    loop = sampled_loop(linear, exp(low))
    # An end's own root that the loop does not move stands in the bracket by itself.
    found = [rate for rate in np.log(loop.poles[loop.poles != 0.0]).tolist() if low - room <= rate.real <= high + room]
    seeds = []
    for crossing in loop.crossings(d):
        psi = (crossing.log - d * crossing.at).imag / (2.0 * pi)
        seeds += [crossing.at + 2j * pi * (psi - turns) / d for turns in (floor(psi), floor(psi) + 1)]
    # Beside an end's own root the gain passes 1 in less than a step; the closest samples are near enough there.
    _, exponents, logs = loop.samples
    miss = logs - d * exponents[:, None]
    miss = np.abs(miss - 2j * pi * np.round(miss.imag / (2.0 * pi)))
    seeds += exponents[np.argsort(miss.min(axis=1))[:6]].tolist()
    for seed in seeds:
        rate = _secant(linear, seed)
        if rate is not None and low - room <= rate.real <= high + room:
            found.append(rate)
    return cexp(max(found, key=lambda rate: rate.real)) if found else None


def _secant(linear: LinearScene, rate: complex) -> complex | None:
    """A zero of `log(z^-d l_j(z))`, `rate` = log z, of the branch that is nearest to it."""
    import numpy as np

    def miss(rate: complex) -> complex:
        values = gains(linear.master, linear.slave, np.exp(np.array([rate])))[0]
        with np.errstate(divide="ignore"):
            logs = np.log(np.abs(values)) + 1j * np.angle(values) - linear.round_trip * rate
        logs = logs - 2j * pi * np.round(logs.imag / (2.0 * pi))
        return complex(logs[np.argmin(np.abs(logs))])

    try:
        last, missed = rate, miss(rate)
        rate = rate + missed / linear.round_trip  # the delay is most of the slope
        for _ in range(60):
            now = miss(rate)
            if rate == last or now == missed or abs(now) < 1e-13:
                break
            last, missed, rate = rate, now, rate - now * (rate - last) / (now - missed)
        return rate if abs(miss(rate)) < 1e-6 else None
    except np.linalg.LinAlgError:  # it ran into an end's own root
        return None


def gain_margin(linear: LinearScene) -> float | None:
    """The factor on the round trip's gain at which the scene's verdict changes.

    What rests at z = 1 is left out of it. Above 1 for a stable loop: the least gain at which a root reaches the unit
    circle, which is 1/|l_j| where the phase is a whole number of turns. Below 1 for an unstable one: the greatest at
    which it is stable, as it is at 1e-6; gains above 1 are not tried for it. None where no factor from 1e-6 to 1e6
    changes the verdict.
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
            return exp(-nearest)
        low, high = 0.0, -nearest
    while high - low > 1e-10:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if loop.outside(delay, exp(middle)) else (middle, high)
    return exp(high)


def _phase_crossover(loop: Loop, delay: int) -> float | None:
    """The greatest log |z^-d l_j| below 0 where the phase is a whole number of turns."""
    import numpy as np

    t, exponents, logs = loop.samples
    size, turns = (part - delay * way for part, way in
                   ((logs.real, exponents.real[:, None]), (logs.imag / (2 * pi), exponents.imag[:, None] / (2 * pi))))
    found: list[tuple[float, int, int, int]] = []
    for i, j in zip(*np.nonzero(np.floor(turns[1:]) != np.floor(turns[:-1])), strict=True):
        a, b = sorted((turns[i, j], turns[i + 1, j]))
        found += [(max(size[i, j], size[i + 1, j]), i, j, turn) for turn in {floor(a) + 1, floor(b)}]
    exact = [float(size[i, j]) for i in (0, -1) for j in range(size.shape[1])  # real there: no sample lies beyond
             if abs(turns[i, j] - round(turns[i, j])) < 1e-9]
    found.sort(reverse=True)
    exact += [_size_at_turn(loop, delay, t[i], t[i + 1], j, turn)
              for level, i, j, turn in [f for f in found if f[0] > log(1e-6)][:24]]
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
    import numpy as np

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
