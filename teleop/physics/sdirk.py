"""SDIRK2 with the contact and the friction solved inside each stage: motion that has no closed form.

A body in one axis, at depth p in what it touches and with speed u against it,

    p' = u,    m u' = f - b u - g(p, u) - fc Sgn(u + s),

f held and s, the speed of what it touches over the ground, constant; Sgn(0) is all of [-1, 1], so a body
sticks. Alexander's L-stable SDIRK2, gamma = 1 - 1/sqrt(2) (SIAM J. Numer. Anal. 14, 1977), makes of a step
two stages, each with one unknown U and known y, w and tau = gamma h:

    (m + tau b) U + tau g(y + tau U, U) + tau fc Sgn(U + s)  contains  m w + tau f.

m > 0 makes the left side strictly increasing if U -> g(y + tau U, U) does not decrease. It does not, for every
resistance here with k, d, lam >= 0 and n >= 1: the bonded k p + d u is linear, max(0, k p + d u) rises with p
and u, k p^n max(0, 1 + lam u) is a product of two factors that rise and are not negative, and where p passes 0
there is no jump or one upwards, filled by the forces between 0 and d u. Hence a stage has exactly one solution,
whatever the step. The method is L-stable but not algebraically stable: a step can make energy, as far as the
error that is estimated goes and no further.
"""

from __future__ import annotations

from math import isfinite, nan, sqrt
from typing import NamedTuple

GAMMA = 1.0 - sqrt(0.5)
ON = (1.0 - GAMMA) / GAMMA
MOST_SUBSTEPS = 1024  # kept in one tick: half of them where the error asks for them, half to reach its end with
SHORTEST = 2.0**-40  # of a tick
NOTHING, WALL, BOND, HUNT_CROSSLEY = range(4)


# What a stage computes with: kind of resistance, m, b, k, d, n, lam, fc of the equation of motion above.
Core = tuple[int, float, float, float, float, float, float, float]


class Kept(NamedTuple):
    """A tick that was integrated: where it ends, its error, its sub-steps, the longest step as part of the tick."""

    p: float
    u: float
    error: float
    substeps: int
    longest: float


def power(p: float, n: float) -> float:
    """p^n for p > 0 and n up to 10, quickly for n = 1.5; NaN where it could overflow."""
    if n == 1.5:
        return p * sqrt(p)
    return p**n if p < 1e30 else nan


def resistance_force(c: Core, p: float, u: float) -> float:
    """g(p, u), the force of what the body touches against it."""
    kind, _, _, k, d, n, lam, _ = c
    if kind == BOND:
        return k * p + d * u
    if kind == NOTHING or p <= 0.0:
        return 0.0
    if kind == WALL:
        return max(0.0, k * p + d * u)
    return k * power(p, n) * max(0.0, 1.0 + lam * u)


def touching(c: Core, p: float, u: float, push: float) -> int:
    """0 outside, 1 in contact, 2 inside but drawn out too fast to be followed. At p = 0 the way on decides."""
    kind, _, _, k, d, _, lam, _ = c
    if kind == BOND:
        return 1
    if kind == NOTHING or p < 0.0 or (p == 0.0 and (u < 0.0 or (u == 0.0 and push <= 0.0))):
        return 0
    return 1 if (1.0 + lam * u if kind == HUNT_CROSSLEY else k * p + d * u) > 0.0 else 2


def setting_out(c: Core, p: float, u: float, f: float, s: float) -> tuple[float, int]:
    """Acceleration and mode at the start of a step; the mode is `touching` plus 3 times the sign of sliding."""
    m, b, fc = c[1], c[2], c[7]
    push = f - b * u - resistance_force(c, p, u)
    v = u + s
    slide_sign = 0
    if fc > 0.0:
        if v != 0.0:
            slide_sign = 1 if v > 0.0 else -1
            push -= slide_sign * fc
        elif -fc <= push <= fc:
            push = 0.0
        else:
            slide_sign = 1 if push > 0.0 else -1
            push -= slide_sign * fc
    return push / m, touching(c, p, u, push) + 3 * slide_sign


def stage(c: Core, y: float, w: float, tau: float, f: float, s: float) -> tuple[float, int]:
    """The speed U of one stage, and its mode: `m (U - w) = tau (f - b U - g(y + tau U, U) - fc Sgn(U + s))`.

    It sticks, U = -s, if the force that is left over then is within +-fc; else it slides to the side of what is
    left over, and fc is one more held force (soft threshold).
    """
    kind, m, b, k, d, n, lam, fc = c
    mass = m + tau * b
    drive = m * w + tau * f
    slide_mode = 0
    if fc > 0.0:
        over = drive + mass * s - tau * resistance_force(c, y - tau * s, -s)
        rub = tau * fc
        if -rub <= over <= rub:
            return 0.0 - s, touching(c, y - tau * s, -s, over)
        slide_mode = 3 if over > 0.0 else -3
        drive += -rub if over > 0.0 else rub
    free = drive / mass
    if kind == NOTHING:
        return free, slide_mode
    if kind == BOND:
        return (drive - tau * k * y) / (mass + tau * (d + tau * k)), slide_mode + 1
    p = y + tau * free
    if not p > 0.0:
        return free, slide_mode
    if kind == WALL:
        if k * p + d * free <= 0.0:
            return free, slide_mode + 2
        u = (drive - tau * k * y) / (mass + tau * (d + tau * k))
        return (u if y + tau * u > 0.0 else -y / tau), slide_mode + 1
    if 1.0 + lam * free <= 0.0:
        return free, slide_mode + 2
    if not p < 1e30:
        return nan, slide_mode + 1
    return _hunt_crossley(k * tau, n, lam, mass, drive, y, w, tau, free), slide_mode + 1


def _hunt_crossley(kt: float, n: float, lam: float, mass: float, drive: float, y: float, u: float, tau: float,
                   high: float) -> float:
    """Root U of the increasing, convex `mass U + kt p^n (1 + lam U) - drive`, p = y + tau U: bracketed Newton from u.

    It lies between where the force begins (p = 0 or 1 + lam U = 0) and the free solution `high`. Where Newton's
    step leaves the bracket it is halved; from the right of the root a convex function needs no halving.
    """
    low = -y / tau
    if lam > 0.0 and -1.0 / lam > low:
        low = -1.0 / lam
    if not low < u < high:
        u = high
    for _ in range(100):
        p = y + tau * u
        q, slope, lost = mass * u - drive, mass, abs(mass * u) + abs(drive)
        if p > 0.0:
            grown, open_ = kt * (p * sqrt(p) if n == 1.5 else power(p, n)), 1.0 + lam * u
            q += grown * open_
            slope += grown * (n * tau * open_ / p + lam)
            lost += grown * open_ * (1.0 + n * abs(y) / p)
        if not abs(q) > 4e-16 * lost:  # all that is left is rounding; or not a number
            return u
        if q > 0.0:
            high = u
        else:
            low = u
        new = u - q / slope
        if not low < new < high:
            new = 0.5 * (low + high)
            if not low < new < high:
                return u
        u = new
    return u


def step(c: Core, p: float, u: float, f: float, s: float, h: float) -> tuple[float, float, float, float, int, int]:
    """Step of SDIRK2: depth and speed after it, then acceleration and mode of each stage."""
    tau = GAMMA * h
    u1, mode1 = stage(c, p, u, tau, f, s)
    w = u + ON * (u1 - u)
    y = p + (h - tau) * u1
    u2, mode2 = stage(c, y, w, tau, f, s)
    return y + tau * u2, u2, (u1 - u) / tau, (u2 - w) / tau, mode1, mode2


def unseen(c: Core, p: float, u: float, s: float, a: float, mode: int,
           end: tuple[float, float, float, float, int, int], span: float) -> bool:
    """True if contact or friction may have begun and ended between the stages of a step, unseen by them.

    Outside, on its way in and then out again: a free speed is convex in time until it turns, so the depth grows by at
    most half of u times span. Sliding slower, then faster: the speed falls by at most |a| span.
    """
    kind, fc = c[0], c[7]
    if mode % 3 == 0 and kind != NOTHING and u > 0.0 > end[1] and p + 0.5 * u * span >= 0.0:
        return True
    if fc == 0.0 or 0 <= mode <= 2:
        return False
    slide_sign = 1.0 if mode > 2 else -1.0
    return slide_sign * a < 0.0 < slide_sign * end[3] and slide_sign * (u + s + a * span) <= 0.0


def liveliness(c: Core, p: float, u: float, f: float, dt: float) -> float:
    """omega dt or 1 if that is more, omega that of the body on what it touches: how fast a misplaced body gets in dt.

    For Hunt-Crossley at the depth where its spring alone would have stopped the body.
    """
    kind, m, _, k, _, n, _, _ = c
    if kind == HUNT_CROSSLEY and k > 0.0:
        v = min(abs(u) + abs(f) * dt / m, 1e6)
        depth = max(min((0.5 * (n + 1.0) * m * v * v / k)**(1.0 / (n + 1.0)), p + v * dt, 1e6), p, 0.0)
        k *= n * power(depth, n) / depth if depth > 0.0 else 0.0
    return max(1.0, dt * sqrt(k / m)) if kind != NOTHING and k > 0.0 else 1.0


def integrate(c: Core, p: float, u: float, f: float, s: float, dt: float, tol: float, first: float) -> Kept:
    """Move over dt with an estimated error of at most `tol`, by steps that are dt, dt/2, dt/4, ... long.

    Each step is made whole and in two halves; the halves are kept (and are the sub-steps that are counted), and
    the step is halved until its error is small enough. The error weighs dt times m/s like metres, and metres by
    `liveliness`; it is

    * one third of the difference of the two, for a step without a change of mode: the leading term of a method of
      2nd order. Such steps share tol/2 by their length, and rounding is let be;
    * for a step within which contact or sliding begins or ends, where halves may agree by chance: the difference,
      or |jump of the acceleration| h times dt (times h if it ends sticking, its speed then being exact) if that is
      more. It bounds what misplacing the change within h does, which is of 1st order. Each may have tol/16.

    The errors of the steps are added, as if none cancelled and none were damped. `first` is the length of the
    first step as a part of dt, a power of 2. What costs more than `MOST_SUBSTEPS` is finished with equal steps and
    then as a rule exceeds tol. What is below tol is not resolved: a vibration of less may be taken as rest.
    Over some thousand random ticks the true error stayed below twice the estimate plus a tenth of tol.
    """
    a, mode = setting_out(c, p, u, f, s)
    weight = liveliness(c, p, u, f, dt)
    h, done, error, longest, used = first, 0.0, 0.0, 0.0, 0
    whole = step(c, p, u, f, s, h * dt)
    while done < 1.0 and used < MOST_SUBSTEPS:
        span = h * dt
        half = step(c, p, u, f, s, 0.5 * span)
        end = step(c, half[0], half[1], f, s, 0.5 * span)
        off = max(weight * abs(end[0] - whole[0]), dt * abs(end[1] - whole[1]))
        smooth = mode == whole[4] == whole[5] == half[4] == half[5] == end[4] == end[5]
        if smooth:
            off /= 3.0
            share = 0.5 * tol * h + 2.3e-16 * (weight * abs(p) + dt * abs(u))
            after, turned = end[3], mode
        else:
            after, turned = setting_out(c, end[0], end[1], f, s)
            sticks = c[7] > 0.0 and 0 <= turned <= 2
            jump = max(abs(half[2] - a), abs(half[3] - a), abs(end[2] - a), abs(end[3] - a), abs(after - a))
            off = max(off, jump * span * (span if sticks else dt))
            share = 0.0625 * tol
        if (not off <= share or unseen(c, p, u, s, a, mode, end, span)) and h > SHORTEST and used < MOST_SUBSTEPS // 2:
            if not isfinite(off + end[1]):
                return Kept(nan, nan, nan, used, 1.0)
            h *= 0.5
            whole = half
            continue
        p, u = end[0], end[1]
        a, mode = after, turned
        done += h
        error += off
        used += 2
        if used <= MOST_SUBSTEPS // 2:
            longest = max(longest, h)
        if used == MOST_SUBSTEPS // 2:
            h = (1.0 - done) / (MOST_SUBSTEPS // 4)
        elif used < MOST_SUBSTEPS // 2:
            if s == 0.0 and c[7] > 0.0 and 0 <= mode <= 2:
                break  # nothing changes any more: it sticks to the end
            if off < 0.125 * share and done % (2.0 * h) == 0.0:
                h *= 2.0
        if done < 1.0:
            whole = step(c, p, u, f, s, h * dt)
    return Kept(p, u, error, used, longest)
