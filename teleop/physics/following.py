"""Follower of a target that moves in steps: a critically damped filter of second order, with a bound on its speed.

A pointer that steers a hand moves in steps, and so do the actions of a policy, 30 to 60 of them a second. The reference
r goes towards such a target p, which stays where it is within a tick: with w = r',

    r'' = omega^2 (p - r) - 2 omega r'.

With y = r - p both roots are -omega, so y(t) = (y0 + (w0 + omega y0) t) exp(-omega t), and with e = p - r0,
h = omega dt, E = exp(-h), after a tick

    r1 = r0 + (1 - (1 + h) E) e + dt E w0,        w1 = omega h E e + (1 - h) E w0.

Where p is further away than `reach` = 2 V/omega, V being the greatest speed, a point at that distance stands for it.
Then |e| <= 2 V/omega, so |w0| <= V gives |w1| <= (2 h + |1 - h|) E V, which is no more than V at any h > 0: the speed
stays below V. What is faster to begin with falls below it by the same step.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, expm1, hypot
from typing import NamedTuple

BANDWIDTH = 30.0  # rad/s: the reference follows a slow motion of the target by 2/30 s = 67 ms
MOST_SPEED = 1.0  # m/s


class Follower(NamedTuple):
    """Coefficients of one tick of the filter: `following` makes them."""

    to: float  # of e in r1 - r0
    on: float  # s, of w0 in r1 - r0
    pull: float  # 1/s, of e in w1
    keep: float  # of w0 in w1
    reach: float  # m

    def step(self, r: Sequence[float], w: Sequence[float], p: Sequence[float]) -> tuple[list[float], list[float]]:
        """Place (m) and speed (m/s) a tick later, per axis; the distance of all axes together is held to `reach`."""
        e = [target - here for here, target in zip(r, p, strict=True)]
        far = hypot(*e)
        if far > self.reach:
            e = [each * (self.reach / far) for each in e]
        return ([here + self.to * each + self.on * speed for here, each, speed in zip(r, e, w, strict=True)],
                [self.pull * each + self.keep * speed for each, speed in zip(e, w, strict=True)])


def following(dt: float, bandwidth: float = BANDWIDTH, most_speed: float = MOST_SPEED) -> Follower:
    """The `Follower` of ticks of dt (s), for a bandwidth omega (rad/s) and a greatest speed (m/s)."""
    h = bandwidth * dt
    decay = exp(-h)
    return Follower(-expm1(-h) - h * decay, dt * decay, bandwidth * h * decay, (1.0 - h) * decay,
                    2.0 * most_speed / bandwidth)


def approach(c: Follower, r: float, w: float, p: float) -> tuple[float, float]:
    """Place and speed of one axis by itself a tick later, each in the axis's own unit."""
    to, on, pull, keep, reach = c
    e = max(min(p - r, reach), -reach)
    return r + to * e + on * w, pull * e + keep * w
