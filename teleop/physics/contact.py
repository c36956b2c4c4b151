"""The wall: exact steps in three modes, with the instant of every change of mode located.

With depth `p = side (x - at)` and `g = k p + d p'` a wall is *free* (p < 0, no force), in *contact* (p > 0
and g > 0, force g) or *detached* (p > 0 and g <= 0, no force: a wall cannot pull). Each mode is linear, so
the motion within it is closed form, and so is the place of the extrema of p and g: a root is looked for
only in a bracket that is proven to hold the first one. The mode at a tick's start follows from the state
and the force, nothing is remembered. Method: event location in piecewise linear systems, derived below.
"""

from __future__ import annotations

from math import atan2, inf, isfinite, log1p, nan, pi, sqrt
from typing import NamedTuple

from teleop.errors import number
from teleop.physics.plant import Coefficients, MassDamper, Plant, free_space, linear, response

MOST_EVENTS = 32  # changes of mode followed within one tick


class WallStep(NamedTuple):
    """Coefficients of a wall: itself, the step outside, the step in contact, and g' in contact."""

    side: float
    at: float
    k: float
    d: float
    s12: float  # free: `LinearStep` for k = 0 without its trivial entries
    t1: float
    s22: float
    t2: float
    a11: float  # in contact: `LinearStep`
    a12: float
    b1: float
    a21: float
    a22: float
    b2: float
    gp: float  # in contact: g' = gp p + gu p' + gf f
    gu: float
    gf: float
    one_turn: float  # 1.0 if g turns at most once within a tick and g' is not lost in rounding, else 0.0
    mass: float
    damping: float
    dt: float


def wall(body: MassDamper, dt: float, *, k: float, d: float, at: float, side: float) -> Plant:
    """A body beside a wall of stiffness k (N/m) and damping d (N s/m) from x = at (m).

    It fills x > at with side = 1.0 and x < at with side = -1.0. With k = 0 and d = 0 there is nothing to
    feel, and the plant is free space.
    """
    if k == 0.0 and d == 0.0:
        return free_space(body, dt)
    return Plant(move_wall, wall_force, tuple(wall_coefficients(body, dt, k=k, d=d, at=at, side=side)))


def wall_coefficients(body: MassDamper, dt: float, *, k: float, d: float, at: float, side: float) -> WallStep:
    """The coefficients of `move_wall` and `wall_force`; the arguments are those of `wall`."""
    m, b = body.mass, body.damping
    free = linear(m, b, 0.0, number("dt", dt, above=0.0))
    touch = linear(m, b + d, k, dt)
    sigma, w2 = 0.5 * (b + d) / m, k / m
    gap = sigma * sigma - w2
    if gap < 0.0:
        decay, angle = sigma, sqrt(-gap) * dt
    else:
        decay, angle = w2 / (sigma + sqrt(gap)) if w2 > 0.0 else 0.0, 0.0
    one_turn = 1.0 if angle < pi and decay * dt < 10.0 else 0.0
    return WallStep(side, at, k, d, free.a12, free.b1, free.a22, free.b2, *touch,
                    -k * d / m, k - d * (b + d) / m, d / m, one_turn, m, b, dt)


def wall_force(c: Coefficients, x: float, v: float) -> float:
    """`f_env`, the force on the wall; c is `WallStep`. Nothing at p = 0: that is the limit from outside."""
    p = c[0] * (x - c[1])
    if p <= 0.0:
        return 0.0
    g = c[2] * p + c[3] * c[0] * v
    return 0.0 if g <= 0.0 else c[0] * g


def move_wall(c: Coefficients, x: float, v: float, f: float) -> tuple[float, float, int]:
    """Move a body beside a wall over one tick with f held; c is `WallStep`.

    A tick that provably stays in the mode it begins in is one matrix product. All others go to `events`.
    """
    (side, at, k, d, s12, t1, s22, t2, a11, a12, b1, a21, a22, b2,
     gp, gu, gf, one_turn, mass, damping, dt) = c
    p = side * (x - at)
    if p < 0.0:
        x1 = x + s12 * v + t1 * f
        v1 = s22 * v + t2 * f
        # A free velocity is monotone, so p has a maximum inside the tick only if it turns from in to out.
        if side * (x1 - at) < 0.0 and (side * v <= 0.0 or side * v1 >= 0.0):
            return x1, v1, 0
    elif p > 0.0 and one_turn == 1.0:
        u = side * v
        w = side * f
        p1 = a11 * p + a12 * u + b1 * w
        u1 = a21 * p + a22 * u + b2 * w
        if (k * p + d * u > 0.0 and k * p1 + d * u1 > 0.0 and p1 > 0.0
                # g turns at most once, so it has a minimum inside only if g' goes from - to +.
                and (gp * p + gu * u + gf * w >= 0.0 or gp * p1 + gu * u1 + gf * w <= 0.0)):
            return at + side * p1, side * u1, 0
    p, v, truncated = events(mass, damping, k, d, dt, p, side * v, side * f)
    return at + side * p, side * v, truncated


def events(m: float, b: float, k: float, d: float, span: float, p: float, u: float, f: float
           ) -> tuple[float, float, int]:
    """Depth p and speed u after `span`, from one change of mode to the next.

    At an event p is set to 0 where it is 0, so that no rounding error lets a wall be entered twice. After
    `MOST_EVENTS` the rest of the tick is bonded to the wall, which makes no energy: with the stored energy
    V = m u^2/2 + k max(p, 0)^2/2, every event has p >= 0, where bonding leaves V as it is; bonded,
    m u^2/2 + k p^2/2 gains at most the work of f; and V is never above that sum.
    """
    if not isfinite(abs(p) + abs(u) + abs(f)):
        return nan, nan, 0
    inside = p > 0.0  # at p = 0 it is free, and enters at once if it moves or is pushed inward
    touching = inside and k * p + d * u > 0.0
    for _ in range(MOST_EVENTS):
        if touching:
            t = falls(m, b + d, k, f, p, u, k, d, span)
            if t < 0.0:
                p, u = advance(m, b + d, k, f, p, u, span)
                return p, u, 0
            p, u = advance(m, b + d, k, f, p, u, t)
            touching = False
            if d == 0.0:
                p = 0.0
                inside = False
        elif inside:
            t = falls(m, b, 0.0, f, p, u, 1.0, 0.0, span)
            again = falls(m, b, 0.0, f, p, u, -k, -d, span)
            touching = again >= 0.0 and (t < 0.0 or again <= t)
            if touching:
                t = again
            if t < 0.0:
                p, u = advance(m, b, 0.0, f, p, u, span)
                return p, u, 0
            p, u = advance(m, b, 0.0, f, p, u, t)
            if not touching:
                p = 0.0
                inside = False
        else:
            t = falls(m, b, 0.0, f, p, u, -1.0, 0.0, span)
            if t < 0.0:
                p, u = advance(m, b, 0.0, f, p, u, span)
                return p, u, 0
            _, u = advance(m, b, 0.0, f, p, u, t)
            p = 0.0
            inside = touching = True
        span -= t
    p, u = advance(m, b + d, k, f, p, u, span)
    return p, u, 1


def advance(m: float, c: float, k: float, f: float, p: float, u: float, t: float) -> tuple[float, float]:
    """State of `m p'' + c p' + k p = f` after t."""
    s, ds, w = response(m, c, k, t)
    pull = (f - k * p) / m
    return p + s * u + w * pull, ds * u + s * pull


def falls(m: float, c: float, k: float, f: float, p: float, u: float, alpha: float, beta: float, span: float
          ) -> float:
    """The first instant in [0, span] at which `g = alpha p + beta p'` falls through zero, or -1.0.

    Under `m p'' + c p' + k p = f`, starting from g >= 0. g' obeys the same equation without f, so its zeros,
    the extrema of g, are closed form: at most one if overdamped, else one every half period, and of the
    minima of g the first is the lowest (they are a constant plus a decaying oscillation). So g falls through
    zero on its first descent or never. The bracket starts where that descent does: a root at the very start,
    which is where the last event was, is not found again while g rises from it.
    """
    sigma, w2, pull = 0.5 * c / m, k / m, (f - k * p) / m
    a = pull - 2.0 * sigma * u
    h = alpha * u + beta * a  # g'
    j = alpha * a - beta * (2.0 * sigma * a + w2 * u)  # g''
    gap = sigma * sigma - w2
    turn = half = inf
    if gap < 0.0:  # g' is a decaying A cos + B sin of the angle root t with A = h, B = (j + sigma h)/root
        root = sqrt(-gap)
        angle = atan2(h, -(j + sigma * h) / root) if h != 0.0 else pi
        turn, half = (angle if angle > 0.0 else angle + pi) / root, pi / root
    else:
        # g' is the sum of a fast and a slow exponential. With `slow` the rate of the latter, `across` is
        # j + fast h, written so that the fast part, which may be far larger, is not subtracted from itself.
        apart = 2.0 * sqrt(gap)
        slow = w2 / (sigma + 0.5 * apart) if w2 > 0.0 else 0.0
        across = (alpha - beta * slow) * (pull - slow * u)
        if h < 0.0 < across or across < 0.0 < h:
            turn = log1p(-apart * h / across) / apart if apart > 0.0 else -h / across
    low, high = 0.0, turn
    if h > 0.0 or (h == 0.0 and j >= 0.0):
        low, high = turn, turn + half
    high = min(high, span)
    if not low < high:
        return -1.0
    p1, u1 = advance(m, c, k, f, p, u, high)
    if not alpha * p1 + beta * u1 < 0.0:
        return -1.0
    t = low
    for _ in range(100):  # Newton's method, halving where it would leave the bracket
        p1, u1 = advance(m, c, k, f, p, u, t)
        g = alpha * p1 + beta * u1
        if g >= 0.0:
            low = t
        else:
            high = t
        slope = alpha * u1 + beta * (f - c * u1 - k * p1) / m
        if abs(g) <= -1e-15 * slope * t:
            break
        new = t - g / slope if slope < 0.0 else high
        if not low < new < high:
            new = 0.5 * (low + high)
            if not low < new < high:
                break
        t = new
    return t
