"""Bodies that have no closed form: Coulomb friction, and contact laws that are not linear.

What is left without one is integrated by `teleop/physics/sdirk.py` to a stated tolerance, with an estimate of the
error. Most ticks have one even so, and take it: a body that sticks through the tick stays where it is, to the bit; one
that slides in one direction feels friction as one more held force, and touches nothing or something linear, so that the
exact step of teleop/physics/plant.py is its motion. The inner state is `Effort`. Signs and words:
teleop/DESIGN.md. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite, isnan, pi, sqrt
from typing import Any, NamedTuple

from teleop.errors import number
from teleop.physics.plant import MassDamper, Plant, linear
from teleop.physics.sdirk import BOND, HUNT_CROSSLEY, NOTHING, WALL, Core, integrate, resistance_force

TOLERANCE = 1e-9  # m per tick
NO_PART = (0.0,) * 11  # where `slides` is not asked


class Resistance(NamedTuple):
    """Resistance to a body: force g along its depth p = side (x - at), m, and speed u = side v, m/s.

    NOTHING: 0. WALL: `max(0, k p + d u)` for p > 0, else 0. BOND: `k p + d u`. HUNT_CROSSLEY:
    `k p^n max(0, 1 + lam u)` for p > 0, else 0 (k in N/m^n, lam in s/m). k, d, lam >= 0, 1 <= n <= 10.
    """

    kind: int = NOTHING
    k: float = 0.0
    d: float = 0.0
    at: float = 0.0
    side: float = 1.0
    n: float = 1.5
    lam: float = 0.0


class Effort(NamedTuple):
    """The inner state: what the integration has cost so far, and where the next one begins."""

    first: float  # length of the first step, as a part of the tick
    worst: float  # largest estimate of one tick's error, m
    total: float  # sum of the estimates, m
    most: int  # sub-steps in one tick
    over: int  # ticks whose estimate exceeds the tolerance
    tolerance: float


def report(z: Any) -> Mapping[str, float]:
    """The figures of the integration in a run's summary.

    An estimate is of the error that its tick makes in position, and dt times that in speed (`integrate`). What
    becomes of it later is the motion's business: in contact it fades, in free flight an error of speed goes on.
    A tick that ends in what is not finite is one over the tolerance; the figures are those of the others.
    """
    _, worst, total, most, over, tol = z
    return {"error_estimate_max": worst, "error_estimate_sum": total, "substeps_max": most,
            "ticks_over_tolerance": over, "tolerance": tol}


def _start(tol: float) -> tuple[float, ...]:
    return tuple(Effort(1.0, 0.0, 0.0, 0, 0, number("tolerance", tol, above=0.0)))


def _core(body: MassDamper, mass: float, resistance: Resistance, friction: float) -> Core:
    kind, k, d, _, _, n, lam = resistance
    return kind, mass, body.damping, k, d, n, lam, number("friction", friction, low=0.0)


def _linear_part(body: MassDamper, mass: float, k: float, d: float, dt: float) -> tuple[float, ...]:
    """`LinearStep` in contact, k, d, total damping and mass, then 1.0 if speed and force turn at most once in dt."""
    damping = body.damping + d
    sigma, w2 = 0.5 * damping / mass, k / mass
    gap = sigma * sigma - w2
    angle = sqrt(-gap) * dt if gap < 0.0 else 0.0
    decay = sigma if gap < 0.0 else w2 / (sigma + sqrt(gap)) if w2 > 0.0 else 0.0
    one_turn = 1.0 if angle < pi and decay * dt < 10.0 else 0.0
    return (*linear(mass, damping, k, dt), k, d, damping, mass, one_turn)


def implicit_plant(body: MassDamper, dt: float, *, resistance: Resistance, friction: float = 0.0,
                   tol: float = TOLERANCE) -> Plant:
    """`body` with Coulomb `friction` (N) against the ground, in what resists it; integrated to `tol` (m) a tick.

    `move(c, x, v, f, z)` may be given the speed s of what resists over the ground as well: then x and v are
    those in its frame, at the ticks, and f is already less `b s`. Refused where a linear part has no finite step.
    """
    free = linear(body.mass, body.damping, 0.0, number("dt", dt, above=0.0))
    kind, k, d, at, side, _, _ = resistance
    part = _linear_part(body, body.mass, k, d, dt) if kind in (WALL, BOND) else NO_PART
    core = _core(body, body.mass, resistance, friction)
    c = (side, at, core, (free.a12, free.b1, free.a22, free.b2), part, dt, tol)
    return Plant(move_implicit, implicit_force, c, _start(tol), report)


def implicit_force(c: Any, x: float, v: float, z: Any) -> float:  # noqa: ARG001 - the signature of every force
    """Force on what resists, as the left limit. Nothing at p = 0 of a wall: that is the limit from outside."""
    side, at, core, _, _, _, _ = c
    g = resistance_force(core, side * (x - at), side * v)
    return side * g if g != 0.0 else 0.0


def move_implicit(c: Any, x: float, v: float, f: float, z: Any, s: float = 0.0) -> tuple[float, float, int, Any]:
    """Move over one tick with f held; c and s as `implicit_plant` says, z is `Effort`."""
    side, at, core, (a12, b1, a22, b2), part, dt, tol = c
    kind, _, b, _, _, _, _, fc = core
    p = side * (x - at)
    f_slide = 0.0
    if fc > 0.0:
        over = v + s
        if over == 0.0:
            u, push = side * v, side * (f - b * v)
            low = push - resistance_force(core, p, u)
            high = low if s == 0.0 else push - resistance_force(core, p + u * dt, u)
            if -fc <= low <= fc and -fc <= high <= fc:  # g is monotone in between
                return x if s == 0.0 else x + v * dt, v, 0, z
            over = side * low
        f_slide = fc if over > 0.0 else -fc
    if kind == NOTHING or (kind != BOND and p < 0.0):
        x1 = x + a12 * v + b1 * (f - f_slide)
        v1 = a22 * v + b2 * (f - f_slide)
        # A free velocity is monotone: friction keeps its sign if the ends say so, and p has a maximum inside
        # only if it turns from in to out.
        if (f_slide == 0.0 or f_slide * (v1 + s) >= 0.0) and (
                kind == NOTHING or (side * (x1 - at) < 0.0 and (side * v <= 0.0 or side * v1 >= 0.0))):
            return x1, v1, 0, z
    elif kind != HUNT_CROSSLEY:
        sure, p1, u1 = slides(part, kind, p, side * v, side * (f - f_slide), side * f_slide, side * s)
        if sure:
            return at + side * p1, side * u1, 0, z
    step = integrate(core, p, side * v, side * f, side * s, dt, tol, z[0])
    return at + side * step.p, side * step.u + 0.0, 0, _after(z, step.error, step.substeps, step.longest, tol)


def slides(part: tuple[float, ...], kind: int, p: float, u: float, f: float, f_slide: float, s: float
           ) -> tuple[bool, float, float]:
    """True if a tick is sure to stay in contact and to slide in one direction; depth and speed after it.

    f is the force less friction.

    Within a tick in which u' and g' turn at most once, u has its extremum inside only if u' changes sign.
    """
    a11, a12, b1, a21, a22, b2, k, d, damping, m, one_turn = part
    p1 = a11 * p + a12 * u + b1 * f
    u1 = a21 * p + a22 * u + b2 * f
    if f_slide == 0.0 and kind == BOND:
        return True, p1, u1
    if one_turn == 0.0:
        return False, p, u
    a = f - damping * u - k * p
    a1 = f - damping * u1 - k * p1
    if f_slide != 0.0 and not (f_slide * (u1 + s) >= 0.0 and (f_slide * a >= 0.0 or f_slide * a1 <= 0.0)):
        return False, p, u
    if kind == WALL and not (p > 0.0 and k * p + d * u > 0.0 and k * p1 + d * u1 > 0.0 and p1 > 0.0
                             and (k * u + d * a / m >= 0.0 or k * u1 + d * a1 / m <= 0.0)):
        return False, p, u
    return True, p1, u1


def _after(z: Any, error: float, substeps: int, longest: float, tol: float) -> tuple[float, ...]:
    _, worst, total, most, over, _ = z
    if not isfinite(total + error):
        return longest, worst, total, max(most, substeps), over + 1, tol
    return (longest, max(worst, error), total + error, max(most, substeps), over + (not error <= tol), tol)


def implicit_master(body: MassDamper, hand_mass: float, k: float, d: float, dt: float, *, friction: float = 0.0,
                    tol: float = TOLERANCE) -> Plant:
    """Master `body` with Coulomb `friction` (N), held by a hand (`teleop.physics.plant.grip`) or by none: all zeros.

    Friction acts between master and ground. Integrated to `tol` (m) a tick; Refused where there is no finite step.
    Its functions are those of a master: `move_held` and `held_force`.
    """
    mass = body.mass + hand_mass
    part = _linear_part(body, mass, k, d, number("dt", dt, above=0.0))
    core = _core(body, mass, Resistance(BOND, k, d), friction)
    return Plant(move_held, held_force, (core, part, dt, tol, hand_mass), _start(tol), report)


def move_held(c: Any, x: float, v: float, f_m: float, r0: float, r1: float, z: Any) -> tuple[float, float, Any]:
    """Move the held master over one tick in which the reference runs straight from r0 to r1; z is `Effort`.

    As in `move_gripped` the ramp vanishes in the frame of the reference, whose speed s friction sees.
    """
    core, part, dt, tol, _ = c
    _, _, b, k, d, _, _, fc = core
    s = (r1 - r0) / dt
    f = -(f_m + b * s)
    f_slide = 0.0
    if fc > 0.0:
        over = v
        if v == 0.0:
            over = k * (r0 - x) + d * s - f_m
            if -fc <= over <= fc and -fc <= k * (r1 - x) + d * s - f_m <= fc:  # linear in between
                return x, v, z
        f_slide = fc if over > 0.0 else -fc
    y, w = x - r0, v - s
    sure, y1, w1 = slides(part, BOND, y, w, f - f_slide, f_slide, s)
    if sure:
        return r1 + y1, s + w1, z
    step = integrate(core, y, w, f, s, dt, tol, z[0])
    return r1 + step.p, s + step.u, _after(z, step.error, step.substeps, step.longest, tol)


def held_force(c: Any, x: float, v: float, f_held: float, r: float, slope: float, z: Any) -> float:  # noqa: ARG001
    """`f_h`, what passes through the grip, as the left limit at a tick: `plant.grip_force` with friction.

    At v = 0 friction is what keeps the master there, up to fc.
    """
    core, _, _, _, hand = c
    _, mass, b, k, d, _, _, fc = core
    muscle = k * (r - x) + d * (slope - v)
    push = muscle - b * v - f_held
    if v > 0.0:
        push -= fc
    elif v < 0.0:
        push += fc
    elif not isnan(push):
        push -= min(max(push, -fc), fc)
    return float(muscle - hand * (push / mass))
