"""Exact bodies: the closed-form step of everything that is linear while a force is held.

A force held for one tick on `m q'' + c q' + k q = f` has the solution of the matrix exponential, written
here with the impulse response S of that oscillator: no integration error, whatever the stiffness. The
tick functions (`move_*`, `*_force`) are pure functions of floats and of one tuple of coefficients; the
coefficients are made once, before the run. Signs and words: teleop/DESIGN.md. SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from math import cos, exp, expm1, isfinite, nan, sin, sqrt
from typing import Any, NamedTuple

from teleop.errors import Refused, number

# A tick function unpacks its coefficients at once, and only an exact tuple unpacks fast: plants hold plain
# tuples; the NamedTuples below say what is at which place.
Coefficients = tuple[float, ...]
Move = Callable[..., tuple[Any, ...]]
Force = Callable[..., float]


@dataclass(frozen=True, kw_only=True, slots=True)
class MassDamper:
    """A rigid body: `mass` in kg, above 0, viscous `damping` in N s/m and Coulomb `friction` in N, at least 0."""

    mass: float
    damping: float = 0.0
    friction: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", number("mass", self.mass, above=0.0))
        object.__setattr__(self, "damping", number("damping", self.damping, low=0.0))
        object.__setattr__(self, "friction", number("friction", self.friction, low=0.0))


class Plant(NamedTuple):
    """A body in its environment, ready to be moved tick by tick.

    `move(c, x, v, f) -> x, v, truncated` holds f for one tick; `truncated` is 1 where a wall had more events
    within the tick than are followed, else 0. `force(c, x, v)` is `f_env`, the force on the environment, as
    the left limit at that instant. Neither raises: what is not finite comes back as not finite.

    A plant with an inner state z beside (x, v) has it at the first tick as `start`, not None; then
    `move(c, x, v, f, z) -> x, v, truncated, z` and `force(c, x, v, z)`. `report(z)` is what a summary should say of
    the integration afterwards.
    """

    move: Move
    force: Force
    c: Any
    start: Any = None
    report: Callable[[Any], Mapping[str, float]] | None = None


@lru_cache
def bound(function: Callable[..., Any], inner: Callable[..., Any]) -> Callable[..., Any]:
    """`function` with `inner` for its first argument. The same two are one and the same part, also for a compiler."""
    return partial(function, inner)


def response(m: float, c: float, k: float, tau: float) -> tuple[float, float, float]:
    """Impulse response of `m q'' + c q' + k q = 0` at tau: S, its derivative S', its integral W.

    S(0) = 0 and S'(0) = 1; the state (q, q') moves by [[1 - k W/m, S], [-k S/m, S']], a held force f adds
    (W, S) f/m. For m > 0 and c, k, tau >= 0; NaN where the rates are not finite. With sigma = c/2m,
    w2 = k/m, D = sigma^2 - w2 the three textbook cases lose digits by cancellation where the motion within
    tau is small (there: Taylor series) and, in W, where k is small (there: through the two decay rates).
    """
    sigma = 0.5 * c / m
    w2 = k / m
    turned = max(sigma, sqrt(w2)) * tau
    if not isfinite(turned):
        return nan, nan, nan
    if turned < 0.5:
        return _series(2.0 * sigma * tau, w2 * tau * tau, tau)
    gap = sigma * sigma - w2
    if gap < 0.0:  # underdamped
        d = sqrt(-gap)
        decay = exp(-sigma * tau)
        s = decay * sin(d * tau) / d
        ds = decay * cos(d * tau) - sigma * s
        return s, ds, (1.0 - ds - 2.0 * sigma * s) / w2
    root = sqrt(gap)
    fast = sigma + root
    slow = w2 / fast
    apart = 2.0 * root
    gone = -expm1(-fast * tau)
    s = exp(-slow * tau) * (-expm1(-apart * tau) / apart if apart > 0.0 else tau)
    ds = exp(-fast * tau) - slow * s
    if slow > 0.25 * fast:
        return s, ds, (gone - fast * s) / w2
    lasting = -expm1(-slow * tau) / slow if slow > 0.0 else tau
    return s, ds, (lasting - gone / fast) / apart


def _series(a: float, b: float, tau: float) -> tuple[float, float, float]:
    """`response` as a power series in tau, for a = 2 sigma tau <= 1 and b = w2 tau^2 <= 1/4."""
    low, high, n = 0.0, 1.0, 1.0  # coefficients n-1 and n of S/tau; every second one may vanish
    s, ds, w = 1.0, 1.0, 0.5
    while n < 30.0 and abs(low) + abs(high) > 1e-18:
        low, high = high, -(a * n * high + b * low) / ((n + 1.0) * n)
        n += 1.0
        s += high
        ds += n * high
        w += high / (n + 1.0)
    return tau * s, ds, tau * tau * w


class LinearStep(NamedTuple):
    """Step with the force held: `q1 = a11 q + a12 v + b1 f`, `v1 = a21 q + a22 v + b2 f`."""

    a11: float
    a12: float
    b1: float
    a21: float
    a22: float
    b2: float


@lru_cache(maxsize=256)  # most rows of a sweep share all bodies but one
def linear(m: float, c: float, k: float, dt: float) -> LinearStep:
    """The exact step of `m q'' + c q' + k q = f` over dt; Refused where no finite one exists."""
    s, ds, w = response(m, c, k, dt)
    w2 = k / m
    a11 = 1.0 - w2 * w if w2 * w < 0.5 else ds + c / m * s  # exactly 1 without a spring: nothing creeps
    step = LinearStep(a11, s, w / m, -w2 * s, ds, s / m)
    if not all(map(isfinite, step)):
        raise Refused(f"a body of {m:g} kg with {c:g} N s/m and {k:g} N/m has no finite step of {dt:g} s; "
                      "check the units: kg, N s/m, N/m, s")
    return step


def move_free(c: Coefficients, x: float, v: float, f: float) -> tuple[float, float, int]:
    """Move a body that touches nothing; c is (a12, b1, a22, b2) of `LinearStep` for k = 0."""
    a12, b1, a22, b2 = c
    return x + a12 * v + b1 * f, a22 * v + b2 * f, 0


def no_force(c: Coefficients, x: float, v: float) -> float:  # noqa: ARG001 - the signature of every force
    """Free space takes no force."""
    return 0.0


def free_space(body: MassDamper, dt: float) -> Plant:
    """A body that touches nothing."""
    step = linear(body.mass, body.damping, 0.0, number("dt", dt, above=0.0))
    return Plant(move_free, no_force, (step.a12, step.b1, step.a22, step.b2))


class Sprung(NamedTuple):
    """A body on a spring k and damper d that rest at `at`: these three, then the fields of `LinearStep`."""

    at: float
    k: float
    d: float
    a11: float
    a12: float
    b1: float
    a21: float
    a22: float
    b2: float


def move_linear(c: Coefficients, x: float, v: float, f: float) -> tuple[float, float, int]:
    """Move a body bonded to a spring-damper; c is `Sprung`."""
    at, _, _, a11, a12, b1, a21, a22, b2 = c
    q = x - at
    return at + (a11 * q + a12 * v + b1 * f), a21 * q + a22 * v + b2 * f, 0


def linear_force(c: Coefficients, x: float, v: float) -> float:
    """Force on the bonded spring-damper, which can push and pull: `k (x - at) + d v`."""
    return c[1] * (x - c[0]) + c[2] * v


def spring_damper(body: MassDamper, dt: float, *, k: float, d: float, at: float = 0.0) -> Plant:
    """A body bonded to a spring k (N/m) and a damper d (N s/m) that rest at `at` (m)."""
    step = linear(body.mass, body.damping + d, k, number("dt", dt, above=0.0))
    return Plant(move_linear, linear_force, (at, k, d, *step))


class Gripped(NamedTuple):
    """Master and gripping hand as one body: the fields of `LinearStep`, then what the grip force needs."""

    a11: float
    a12: float
    b1: float
    a21: float
    a22: float
    b2: float
    dt: float
    b: float  # damping of the master alone
    k: float
    d: float
    hand: float  # mass of the hand
    mass: float  # of both together


def grip(body: MassDamper, hand_mass: float, k: float, d: float, dt: float) -> Gripped:
    """Master `body` held by a hand of `hand_mass` through a spring k and damper d to the reference."""
    mass = body.mass + hand_mass
    step = linear(mass, body.damping + d, k, number("dt", dt, above=0.0))
    return Gripped(*step, dt, body.damping, k, d, hand_mass, mass)


def move_gripped(c: Coefficients, x: float, v: float, f_m: float, r0: float, r1: float
                 ) -> tuple[float, float]:
    """Move the held master over one tick in which the reference runs straight from r0 to r1; c is `Gripped`.

    With s = (r1 - r0)/dt and y = x - x_ref the ramp vanishes: `M y'' + (b + d) y' + k y = -(f_m + b s)`,
    which is the step of `LinearStep`.
    """
    a11, a12, b1, a21, a22, b2, dt, b, _, _, _, _ = c
    s = (r1 - r0) / dt
    f = -(f_m + b * s)
    y = x - r0
    w = v - s
    return r1 + (a11 * y + a12 * w + b1 * f), s + (a21 * y + a22 * w + b2 * f)


def grip_force(c: Coefficients, x: float, v: float, f_held: float, r: float, slope: float) -> float:
    """`f_h`, what passes through the grip, as the left limit at a tick; c is `Gripped`.

    `f_h = k (x_ref - x) + d (v_ref - v) - m_h a`. On the left of a tick the force of the tick just ended,
    `f_held`, still acts, and the reference still has the `slope` of the piece just ended (0 at the start).
    """
    _, _, _, _, _, _, _, b, k, d, hand, mass = c
    muscle = k * (r - x) + d * (slope - v)
    return muscle - hand * ((muscle - b * v - f_held) / mass)
