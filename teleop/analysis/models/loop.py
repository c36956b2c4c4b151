"""Two linear ends closed over a pure delay: how many of the loop's roots lie outside a curve.

With the ends' transfer functions P_m, P_s and a round trip of d ticks, the roots of the loop are those of

    det(zI - A_m) det(zI - A_s) prod_j (1 - z^-d l_j(z)),        l_j the eigenvalues of P_m(z) P_s(z)

(in continuous time e^(-sT) for z^-d). By the argument principle (Nyquist's criterion for several loops: A. MacFarlane
and I. Postlethwaite, "The generalized Nyquist stability criterion and multivariable root loci", Int. J. Control 25(1),
1977) the roots outside a curve are the ends' own poles outside it less the turns of the product along it. The delay
makes it turn fast, but is known in closed form, and the l_j are slow and do not know of the delay: where
|z^-d l_j| < 1 a factor stays right of the imaginary axis and turns by nothing; while it is above 1, from entry to
exit, it makes floor(psi_exit/2pi) - floor(psi_entry/2pi) turns, psi = arg l_j - d arg z. So only the l_j are sampled
and the cost is the same at any delay.

Conditions. The l_j are sampled so that no step is longer than half the way to the nearest pole of the ends (within
which they are analytic) and none changes by more than `STEP` in magnitude or phase; steps are halved until both hold.
Hence a pole beside the curve is never stepped over, and the phase has no ambiguity. Peaks that come within 5 % of
entering are looked at more closely; what rises above 1 for less than about 1e-6 is beneath it.

Roots at z = 1 (s = 0) belong to positions that nothing returns, such as a free master's, or to the place where two ends
agree. The curve passes them on the far side, and they are counted by themselves. It keeps 1e-9 away, or 1e-6 where an
end has poles there of its own: those may be double, and rounding then parts them by 1e-8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import acos, floor, pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.analysis.models.linear import LinearScene, StateSpace
from teleop.analysis.models.peak import Points

EDGE = 1e-11  # how far outside the unit circle the curve runs, so that a pole on it is inside


class Curve(NamedTuple):
    """The upper half of a curve that is symmetric to the real axis; roots are counted on its far side."""

    point: Callable[[Any], Points]  # for a parameter from 0 to `length`
    length: float
    exponent: Callable[[Points], Points]  # by which a delay multiplies: log z, or s
    outside: Callable[[Points], Any]
    closed: bool  # does it end on the real axis, or at infinity


def reach(radius: float) -> float:
    """The radius at which `circle` runs: from the unit circle on, `EDGE` farther outside."""
    return radius + EDGE if radius >= 1.0 else radius


def circle(radius: float, indent: float) -> Curve:
    """|z| = `radius`; the unit circle and what is as near to it passes z = 1 at the distance `indent`."""
    far = reach(radius)
    if not 1.0 <= far < 1.0 + indent:
        return Curve(lambda t: far * np.exp(1j * pi * t), 1.0, np.log, lambda z: np.abs(z) > far, True)
    turn = acos(((far - 1.0) * (far + 1.0) - indent * indent) / (2.0 * indent))
    leave = float(np.angle(1.0 + indent * np.exp(1j * turn)))

    def point(t: Any) -> Points:
        around = 1.0 + indent * np.exp(1j * turn * np.minimum(t, 1.0))
        along: Points = np.where(t <= 1.0, around, far * np.exp(1j * (leave + (pi - leave) * (t - 1.0))))
        return along

    return Curve(point, 2.0, np.log, lambda z: (np.abs(z) > far) & (np.abs(z - 1.0) > indent), True)


def about_one(indent: float) -> Curve:
    """The small circle that `circle` leaves out, seen from outside."""
    return Curve(lambda t: 1.0 + indent * np.exp(1j * pi * t), 1.0, np.log, lambda z: np.abs(z - 1.0) > indent, True)


def imaginary_axis(indent: float, top: float) -> Curve:
    """s = i w up to `top` (rad/s), passing s = 0 at `indent` on the right; the right half-plane is its far side."""
    def point(t: Any) -> Points:
        around = indent * np.exp(0.5j * pi * np.minimum(t, 1.0))
        along: Points = np.where(t <= 1.0, around, 1j * indent * (top / indent) ** np.maximum(t - 1.0, 0.0))
        return along

    return Curve(point, 2.0, lambda s: s, lambda s: (s.real > 0.0) & (np.abs(s) > indent), False)


STEP = 0.25  # of log l_j between two samples
FAINT = 1e-7  # l_j below this are not followed


class Crossing(NamedTuple):
    """Crossing of a branch into (`into` = 1) or out of (-1) the part of the curve on which it is above 1."""

    t: float
    branch: int
    into: int
    at: complex  # the curve's exponent there
    log: complex  # of gain times l_j, the phase unwrapped


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """Two ends along a curve; sampled once, then asked for any delay and any gain."""

    master: StateSpace
    slave: StateSpace
    curve: Curve
    noise: float = 1e-12  # of log |l_j|: ends without loss touch 1 at rest, which is no crossing

    @cached_property
    def poles(self) -> Points:
        """The poles of both ends by themselves."""
        return open_poles(self.master, self.slave)

    @cached_property
    def samples(self) -> tuple[NDArray[np.float64], Points, Points]:
        """Parameters t (n,), exponents (n,), and log l_j (n, branches) with unwrapped phase."""
        t = np.linspace(0.0, self.curve.length, 129)
        z = self.curve.point(t)
        values = in_order(gains(self.master, self.slave, z))
        for _ in range(60):
            logs = np.log(np.maximum(np.abs(values), 1e-300))
            turned = np.abs(np.angle(values[1:] * values[:-1].conj()))
            heard = np.maximum(logs[1:], logs[:-1]) > np.log(FAINT)
            change = (np.hypot(np.diff(logs, axis=0), turned) * heard).max(axis=1, initial=0.0)
            near = np.abs(z[:, None] - self.poles).min(axis=1, initial=np.inf)
            far = np.abs(np.diff(z)) > 0.5 * np.minimum(near[1:], near[:-1])
            rough = np.flatnonzero(((change > STEP) | far) & (np.diff(t) > 1e-15))
            if not rough.size:
                break
            added = 0.5 * (t[rough] + t[rough + 1])
            t = np.insert(t, rough + 1, added)
            z = np.insert(z, rough + 1, self.curve.point(added))
            new = gains(self.master, self.slave, self.curve.point(added))
            values = in_order(np.insert(values, rough + 1, new, axis=0))
        logs = np.log(np.maximum(np.abs(values), 1e-300)) + 1j * np.unwrap(np.angle(values), axis=0)
        return t, self.curve.exponent(z), logs

    def outside(self, delay: float, gain: float = 1.0) -> int:
        """Count the roots on the curve's far side with this round trip (ticks, or s) and loop gain."""
        _, exponents, logs = self.samples
        turns = 0.0
        for place, sign in ((0, -1.0), (-1, 1.0)):
            if place == 0 or self.curve.closed:
                turns += sign * _phase(logs[place] + np.log(gain) - delay * exponents[place], self.noise)
        for c in self.crossings(delay, gain):
            turns -= 2.0 * pi * c.into * floor((c.log - delay * c.at).imag / (2.0 * pi))
        poles_outside = int(np.count_nonzero(self.curve.outside(self.poles)))
        count = poles_outside - turns / pi
        if abs(count - round(count)) > 0.1:
            raise ArithmeticError(f"the argument principle gives {count:g} roots; the loop is too ill-conditioned")
        return round(count)

    def crossings(self, delay: float, gain: float = 1.0) -> list[Crossing]:
        """Every place where a branch of gain * l_j e^(-delay*exponent) passes magnitude 1, along the curve."""
        t, exponents, logs = self.samples
        crossings = []
        for j in range(logs.shape[1]):
            size = (logs[:, j] + np.log(gain) - delay * exponents).real
            times, size = self._with_peaks(t, size, j, delay, gain)
            above = size > self.noise
            for i in np.flatnonzero(above[1:] != above[:-1]):
                crossings.append(self._refine(times[i], times[i + 1], j, delay, gain, 1 if above[i + 1] else -1))
        return sorted(crossings)

    def log_at(self, t: float, branch: int) -> tuple[complex, complex]:
        """The exponent and log l_j, phase unwrapped, at any parameter; kept, for searches halve the same intervals."""
        logs = self._logs.get((t, branch))
        if logs is None:
            logs = self._logs[t, branch] = self._log_at(t, branch)
        return logs

    @cached_property
    def _logs(self) -> dict[tuple[float, int], tuple[complex, complex]]:
        return {}

    def _log_at(self, t: float, branch: int) -> tuple[complex, complex]:
        times, _, logs = self.samples
        i = min(max(int(np.searchsorted(times, t)), 1), len(times) - 1)
        part = (t - times[i - 1]) / (times[i] - times[i - 1])
        guess = logs[i - 1, branch] + part * (logs[i, branch] - logs[i - 1, branch])
        z = self.curve.point(np.array([t]))
        values = gains(self.master, self.slave, z)[0]
        logs_here = np.log(np.maximum(np.abs(values), 1e-300)) + 1j * np.angle(values)
        logs_here = logs_here + 2j * pi * np.round((guess - logs_here).imag / (2.0 * pi))
        nearest = int(np.argmin(np.abs(logs_here - guess)))
        return complex(self.curve.exponent(z)[0]), complex(logs_here[nearest])

    def _with_peaks(self, t: Any, size: Any, j: int, delay: float, gain: float) -> tuple[Any, Any]:
        """The samples, and beside those that nearly enter or leave the extremum between the neighbours."""
        inner, steps = size[1:-1], np.diff(size)
        turning = (steps[:-1] * steps[1:] <= 0.0) & (inner * steps[:-1] <= 0.0) & (np.abs(inner) < 0.05)
        added = [self._extremum(t[i], t[i + 2], j, delay, gain, -1.0 if inner[i] > 0.0 else 1.0)
                 for i in np.flatnonzero(turning & (np.abs(inner) > 1e-12))]
        if not added:
            return t, size
        times = np.concatenate([t, [a[0] for a in added]])
        order = np.argsort(times, kind="stable")
        return times[order], np.concatenate([size, [a[1] for a in added]])[order]

    def _size(self, t: float, j: int, delay: float, gain: float) -> float:
        from math import log

        at, value = self.log_at(t, j)
        return (value - delay * at).real + log(gain)

    def _extremum(self, low: float, high: float, j: int, delay: float, gain: float, sign: float
                  ) -> tuple[float, float]:
        """Golden-section search for the greatest `sign` * size."""
        ratio = 0.6180339887498949
        for _ in range(30):
            a, b = high - ratio * (high - low), low + ratio * (high - low)
            if sign * self._size(a, j, delay, gain) > sign * self._size(b, j, delay, gain):
                high = b
            else:
                low = a
        middle = 0.5 * (low + high)
        return middle, self._size(middle, j, delay, gain)

    def _refine(self, low: float, high: float, j: int, delay: float, gain: float, into: int) -> Crossing:
        """Bisection to the crossing between two parameters."""
        from math import log

        for _ in range(60):
            middle = 0.5 * (low + high)
            if middle in (low, high):
                break
            if (self._size(middle, j, delay, gain) > 0.0) == (into > 0):
                high = middle
            else:
                low = middle
        at, value = self.log_at(high, j)
        return Crossing(high, j, into, at, value + log(gain))


def sampled_loop(linear: LinearScene, radius: float = 1.0) -> Loop:
    """The loop of a sampled scene along |z| = `radius`."""
    return Loop(master=linear.master, slave=linear.slave, curve=circle(radius, indent(linear)))


def resting_loop(linear: LinearScene) -> Loop:
    """The same about z = 1."""
    return Loop(master=linear.master, slave=linear.slave, curve=about_one(indent(linear)))


def indent(linear: LinearScene) -> float:
    """The distance from z = 1 within which a root counts as resting there."""
    return 1e-6 if (np.abs(open_poles(linear.master, linear.slave) - 1.0) < 1e-6).any() else 1e-9


def open_poles(master: StateSpace, slave: StateSpace) -> Points:
    """The eigenvalues of both ends by themselves."""
    return np.concatenate([np.linalg.eigvals(end.A) for end in (master, slave)]) + 0j


def gains(master: StateSpace, slave: StateSpace, z: Points) -> Points:
    """The eigenvalues of P_m(z) P_s(z), of the smaller of the two products, (n, branches)."""
    first, second = (master, slave) if master.D.shape[0] <= master.D.shape[1] else (slave, master)
    product = transfer(first, z) @ transfer(second, z)
    return product[:, :, 0] if product.shape[1] == 1 else np.asarray(np.linalg.eigvals(product), dtype=np.complex128)


def transfer(end: StateSpace, z: Points) -> Points:
    """`C (zI - A)^-1 B + D` at the points z, (n, fields out, fields in)."""
    resolvent = np.linalg.solve(z[:, None, None] * np.eye(len(end.A)) - end.A, end.B + 0j)
    return np.asarray(end.C @ resolvent + end.D, dtype=np.complex128)


def in_order(values: Points) -> Points:
    """The eigenvalues of neighbouring points in the same columns, each row matched to the one before."""
    if values.shape[1] == 1:
        return values
    before, after = values[:-1, :, None], values[1:, None, :]
    apart = np.abs(after - before) / (np.abs(before) + np.abs(after) + 1e-300)
    follows = np.empty(values[1:].shape, dtype=np.intp)
    rows = np.arange(len(apart))
    for _ in range(values.shape[1]):  # the closest pair of each row first
        a, b = np.divmod(apart.reshape(len(apart), -1).argmin(axis=1), values.shape[1])
        follows[rows, a] = b
        apart[rows, a, :] = apart[rows, :, b] = np.inf
    order = np.empty(values.shape, dtype=np.intp)
    order[0] = np.arange(values.shape[1])
    for i, follow in enumerate(follows):
        order[i + 1] = follow[order[i]]
    return np.take_along_axis(values, order, axis=1)


def _phase(logs: Points, noise: float) -> float:
    """The phase of prod (1 - e^log), continuous along a branch while |e^log| stays on one side of 1."""
    inside = logs.real <= noise
    small = np.exp(np.where(inside, logs, -logs))
    turned = np.angle(1.0 - small) + np.where(inside, 0.0, logs.imag - pi)
    return float(turned.sum())
