"""The roots of a linear scene's loop: the dominant one, and those of greatest growth.

Up to `MOST_STATES` states they are the eigenvalues of the whole loop as one matrix. Beyond, a long delay makes them
many and near to the circle: with rate = log z a root obeys `log l_j - d rate = 2 pi i n` (`loop` says what l_j is), and
as l_j changes slowly there is one close to each place of the circle where the left side has the phase of a whole number
of turns. From there Newton's method is taken on the determinant of both ends with the delay between them,

    | zI - A_1        0             -B_1          |
    | -B_2 C_1        zI - A_2      -B_2 D_1      |        its logarithmic derivative the trace of M^-1 M',
    | -z^-d D_2 C_1   -z^-d C_2     I - z^-d D_2 D_1 |

which has every root of the loop, also an end's own that the loop does not move, and no pole but z = 0. What is found
so is certified by the root count.
"""

from __future__ import annotations

from cmath import exp as cexp
from cmath import log as clog
from math import exp, log, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.analysis.models.linear import LinearScene, StateSpace
from teleop.analysis.models.loop import FAINT, Loop, gains, indent, reach, sampled_loop
from teleop.analysis.models.peak import Points

MOST_STATES = 400  # of a dense matrix
FARTHEST = 600.0  # log |z^-d|; what is much beyond is no number
SEEDS = 32  # places that Newton's method begins at for one root


class Mode(NamedTuple):
    """A root z of the loop, as the motion it makes."""

    z: complex
    frequency: float  # Hz
    growth: float  # 1/s; below 0 it dies away
    damping: float  # ratio, -cos of the angle of log z

    @classmethod
    def of(cls, z: complex, dt: float) -> Mode:
        """The motion `z^k`, ticks of dt seconds."""
        rate = clog(z)
        return cls(z, abs(rate.imag) / (2.0 * pi * dt), rate.real / dt, -rate.real / abs(rate) if rate else 0.0)


class Roots(NamedTuple):
    """Some roots of a loop, the greatest first."""

    z: Points  # (n,)
    total: int  # roots that the loop has, those at z = 0 of the delay included
    complete: bool  # no other is greater than the least of these


def dense(linear: LinearScene) -> NDArray[np.float64]:
    """The whole loop as one matrix, the delay a line of the smaller of the two messages.

    All the delay stands on one way, which changes no eigenvalue but those at 0.
    """
    first, second = _in_order(linear)
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


def states(linear: LinearScene) -> int:
    """States of the whole loop, the delay of the smaller of the two messages among them."""
    return len(linear.master.A) + len(linear.slave.A) + int(min(linear.master.D.shape)) * linear.round_trip


def _in_order(linear: LinearScene) -> tuple[StateSpace, StateSpace]:
    """The two ends, the second the one that sends the smaller message, which is the one that is delayed."""
    ends = linear.master, linear.slave
    return ends if linear.master.D.shape[0] >= linear.master.D.shape[1] else ends[::-1]


def dominant(linear: LinearScene, resting: int) -> Mode | None:
    """The root of greatest magnitude but the `resting` ones at z = 1; None if nothing moves for longer than a tick.

    From the eigenvalues of the dense matrix up to `MOST_STATES`. Beyond, the radius is bracketed by the count of
    roots outside it, and the root found by Newton's method from that circle.
    """
    if states(linear) <= MOST_STATES:
        roots = np.linalg.eigvals(dense(linear)) + 0j
        moving = roots[np.abs(roots - 1.0) > indent(linear)]
        greatest = complex(moving[np.argmax(np.abs(moving))]) if moving.size else 0j
        return Mode.of(greatest, linear.dt) if abs(greatest) > 1e-6 else None
    bracket = _bracket(linear, resting)
    root = _root(linear, *bracket) if bracket else None
    return None if root is None else Mode.of(root, linear.dt)


def greatest(linear: LinearScene, most: int) -> Roots:
    """The roots of greatest magnitude: all of a dense matrix, of longer loops up to about `most`."""
    total = states(linear)
    if total <= MOST_STATES:
        z = np.linalg.eigvals(dense(linear)).astype(np.complex128)
        return Roots(z[np.argsort(-np.abs(z))], total, True)
    loop = sampled_loop(linear)
    seeds = [*_estimates(loop, linear.round_trip, most).tolist(), *_own(loop)]
    refined = [rate for rate in (_newton(linear, seed) for seed in seeds) if rate is not None]
    rates = _distinct(np.array(refined, dtype=np.complex128), 1e-6 / linear.round_trip)[:most // 2]
    both = np.concatenate([rates, rates[(rates.imag > 0.0) & (rates.imag < pi)].conj()])
    both = both[np.argsort(-both.real, kind="stable")]
    complete = False
    if both.size:
        level = both[-1].real
        beyond = sampled_loop(linear, exp(level - 1e-6 * abs(level)))
        complete = beyond.outside(linear.round_trip) <= len(both)
    return Roots(np.exp(both), total, complete)


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
    loop = sampled_loop(linear, exp(low))
    low, high = log(reach(exp(low))), log(reach(exp(high)))  # where the roots were counted
    room = 0.01 * (high - low) + 1e-12
    near = _estimates(loop, linear.round_trip, 2 * SEEDS)
    near = near[np.argsort(np.abs(near.real - low))][:SEEDS]
    # Beside an end's own root the gain passes 1 in less than a step; the closest samples are near enough there.
    _, exponents, logs = loop.samples
    miss = logs - linear.round_trip * exponents[:, None]
    miss = np.abs(miss - 2j * pi * np.round(miss.imag / (2.0 * pi)))
    seeds = [*near.tolist(), *exponents[np.argsort(miss.min(axis=1))[:6]].tolist(), *_own(loop)]
    refined = [rate for rate in (_newton(linear, seed) for seed in seeds) if rate is not None]
    inside = [rate for rate in refined if low - room <= rate.real <= high + room]
    rates = _distinct(np.array(inside, dtype=np.complex128), 1e-6 / linear.round_trip)
    return cexp(complex(rates[0])) if rates.size else None


def _own(loop: Loop) -> list[complex]:
    """log z of the ends' own roots."""
    rates: list[complex] = np.log(loop.poles[loop.poles != 0.0]).tolist()
    return rates


def _distinct(rates: Points, apart: float) -> Points:
    """Each rate once, in the upper half or of a real z, those of greatest growth first."""
    angle = np.abs(rates.imag)
    upper = rates.real + 1j * np.where(angle < apart, 0.0, np.where(pi - angle < apart, pi, angle))
    upper = upper[np.argsort(-upper.real, kind="stable")]
    distinct: list[complex] = []
    for rate in upper.tolist():
        if all(abs(rate - root) > apart for root in distinct):
            distinct.append(rate)
    return np.array(distinct, dtype=np.complex128)


def _estimates(loop: Loop, delay: int, most: int) -> Points:
    """log z of about `most` roots to the first order, those where the loop's gain is greatest, in the upper half."""
    _, exponents, logs = loop.samples
    psi = logs - delay * exponents[:, None]
    turns = psi.imag / (2.0 * pi)
    level = np.maximum(psi.real[1:], psi.real[:-1])
    first = np.ceil(np.minimum(turns[1:], turns[:-1]) - 1e-9)
    last = np.floor(np.maximum(turns[1:], turns[:-1]) + 1e-9)
    count = np.where(np.maximum(logs.real[1:], logs.real[:-1]) > log(FAINT), last - first + 1.0, 0.0).astype(int)
    i, j = np.nonzero(count > 0)
    best = np.argsort(-level[i, j], kind="stable")
    enough = best[:1 + int(np.searchsorted(np.cumsum(count[i, j][best]), most))]
    least = level[i, j][enough].min(initial=np.inf)
    best = best[level[i, j][best] >= least]  # both sides of a sample that is the greatest
    i, j = i[best], j[best]
    many = count[i, j]
    turn = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many - first[i, j], many)
    i, j = np.repeat(i, many), np.repeat(j, many)
    width = turns[i + 1, j] - turns[i, j]
    part = np.clip((turn - turns[i, j]) / np.where(width == 0.0, 1.0, width), 0.0, 1.0)
    step = exponents[i + 1] - exponents[i]
    rise = logs[i + 1, j] - logs[i, j]
    at, guess = exponents[i] + part * step, logs[i, j] + part * rise
    rates: Points = at + (_nearest_log(loop, at, guess) - delay * at - 2j * pi * turn) / (delay - rise / step)
    return rates[np.argsort(-rates.real, kind="stable")][:most]


def _nearest_log(loop: Loop, at: Points, guess: Points) -> Points:
    """log l_j at z = e^at, of the branch and on the sheet that is nearest to the `guess`."""
    values = gains(loop.master, loop.slave, np.exp(at))
    logs = np.log(np.maximum(np.abs(values), 1e-300)) + 1j * np.angle(values)
    logs = logs + 2j * pi * np.round((guess[:, None] - logs).imag / (2.0 * pi))
    nearest = np.abs(logs - guess[:, None]).argmin(axis=1)
    nearest_logs: Points = logs[np.arange(len(at)), nearest]
    return nearest_logs


def _newton(linear: LinearScene, rate: complex) -> complex | None:
    """The zero of the loop's determinant that Newton's method comes to from `rate` = log z."""
    (first, second), d = _in_order(linear), linear.round_trip
    n, m, q = len(first.A), len(second.A), first.D.shape[1]
    zero = np.zeros((m, n))
    inner = np.block([[first.A, zero.T, first.B], [second.B @ first.C, second.A, second.B @ first.D]])
    sent = np.hstack([second.D @ first.C, second.C, second.D @ first.D])
    moves = np.eye(n + m, n + m + q)
    shift = np.eye(q, n + m + q, n + m)
    for _ in range(60):
        if -d * rate.real > FARTHEST:
            return None
        z, late = cexp(rate), cexp(-d * rate)
        matrix = np.vstack([z * moves - inner, shift - late * sent])
        slope = np.vstack([z * moves, d * late * sent])
        try:
            step = 1.0 / complex(np.trace(np.linalg.solve(matrix, slope)))
        except (np.linalg.LinAlgError, ZeroDivisionError):  # it stands on the root, or where nothing shows the way
            return rate if np.linalg.cond(matrix) > 1e15 else None
        rate -= step
        if abs(step) < 1e-14:
            return rate
    return rate if abs(step) < 1e-9 else None
