"""Exact bodies with one state more than position and velocity, as closed-form steps with the force held.

A body whose surroundings remember (a spring in series with a damper, a capacitor across the motor) is

    m x'' + c x' + k x + g z = f,        tau z' = h x' - z        (tau > 0)

which is linear, so a force held for one tick moves it by a matrix exponential of three states, made once
before the run. Two such bodies stand here:

- tissue that relaxes, the standard linear solid (Y. C. Fung, "Biomechanics: Mechanical Properties of Living
  Tissues", 2nd ed., Springer 1993, section 2.11): a spring in parallel with a Maxwell branch, a spring k1 in
  series with a dashpot k1 tau, whose force is phi: `g = 1`, `z = phi`, `h = k1 tau`;
- a master whose motor is damped electrically (see `ElectricalDamping`): `g = -b_e`, `h = 1`, and z is the
  velocity u for which the capacitor's voltage stands.

Signs and words: teleop/DESIGN.md. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal, localcontext
from math import isfinite, pi
from typing import NamedTuple

from teleop.errors import Refused, number
from teleop.physics.plant import Coefficients, MassDamper, Plant

Exact = float | Decimal
Triple = tuple[Decimal, Decimal, Decimal]
Matrix = tuple[Triple, Triple, Triple]
Inner = tuple[float]
NONE, ONE = Decimal(0), Decimal(1)
WIDE = Context(prec=60, Emin=MIN_EMIN, Emax=MAX_EMAX, traps=[])  # whatever the caller's own context is like
UNITS = ((ONE, NONE, NONE), (NONE, ONE, NONE), (NONE, NONE, ONE))


class Step3(NamedTuple):
    """Step with the force held: `x1 = a11 x + a12 v + a13 z + b1 f`, then the same for v and z."""

    a11: float
    a12: float
    a13: float
    b1: float
    a21: float
    a22: float
    a23: float
    b2: float
    a31: float
    a32: float
    a33: float
    b3: float


def step3(m: float, c: Exact, k: float, g: Exact, h: Exact, tau: float, dt: float) -> Step3:
    """The exact step of `m x'' + c x' + k x + g z = f`, `tau z' = h x' - z` over dt.

    Every entry is rounded once, from decimal arithmetic with as many digits as the fastest rate asks for:
    no case of damping or stiffness loses any. With A the matrix of the three states times dt, the entries are
    I + A psi(A) and, for the force, dt psi(A) (0, 1/m, 0), where psi(s) = (e^s - 1)/s. By Cayley and Hamilton
    psi(A) is a quadratic in A: psi is wanted only modulo the characteristic polynomial P of A. A power series
    gives (e^(hs) - 1)/s for an h = 2^-n that makes h A small; n times `psi <- 2 psi + s psi^2` doubles h.

    Refused where an argument or an entry is not finite.
    """
    numbers = (m, c, k, g, h, tau, dt)
    with localcontext(WIDE) as context:
        _, p = _problem(numbers)
        # No root of P is larger than twice the largest of |p2|, |p1|^(1/2), |p0|^(1/3) (Fujiwara, 1916).
        decades = 1 + max(0, *(-(-(p[3 - n].adjusted() + 1) // n) for n in (1, 2, 3) if p[3 - n] != 0))
        context.prec = 50 + 6 * decades
        a, p = _problem(numbers)
        psi = _psi(p, 4 * decades, context.prec)
        columns = [_times(a, _apply(psi, a, unit)) for unit in UNITS]
        held = _apply(psi, a, (NONE, a[0][1] / Decimal(m), NONE))
        entries = [float(each) for i in range(3)
                   for each in (*(UNITS[j][i] + columns[j][i] for j in range(3)), held[i])]
    if not all(map(isfinite, entries)):
        raise Refused(f"a body of {m:g} kg with {float(c):g} N s/m, {k:g} N/m and a branch of {tau:g} s has no finite "
                      f"step of {dt:g} s; check the units: kg, N s/m, N/m, s")
    return Step3(*entries)


def _problem(numbers: tuple[Exact, ...]) -> tuple[Matrix, Triple]:
    """A, and P as the coefficients of 1, s, s^2 (that of s^3 is 1)."""
    m, c, k, g, h, tau, t = map(Decimal, numbers)
    spring, damper, branch, rate = k * t / m, c * t / m, g * t / m, t / tau
    a = ((NONE, t, NONE), (-spring, -damper, -branch), (NONE, h * rate, -rate))
    return a, (spring * t * rate, spring * t + damper * rate + branch * h * rate, damper + rate)


def _psi(p: Triple, doublings: int, digits: int) -> Triple:
    """The coefficients of 1, s, s^2 in (e^s - 1)/s modulo P, of which each root is below 2^doublings / 8."""
    p0, p1, p2 = p
    h = Decimal(1) / (1 << doublings)
    term = (h, NONE, NONE)  # h (hs)^j / (j+1)!
    x, y, z = term
    size, least, j = Decimal(1), Decimal(10) ** -digits, 1
    while size > least:
        j += 1
        low, mid, high = (h * each / j for each in term)
        term = (-p0 * high, low - p1 * high, mid - p2 * high)
        x, y, z = x + term[0], y + term[1], z + term[2]
        size /= 2 * j  # h s is at most 1/8; the rest is for what P adds
    for _ in range(doublings):
        # s psi^2 has the powers 1 to 5 of s; P turns the powers 5, 4, 3 into lower ones.
        one, two, three, four, five = x * x, 2 * x * y, 2 * x * z + y * y, 2 * y * z, z * z
        four, three, two = four - p2 * five, three - p1 * five, two - p0 * five
        three, two, one = three - p2 * four, two - p1 * four, one - p0 * four
        x, y, z = 2 * x - p0 * three, 2 * y + one - p1 * three, 2 * z + two - p2 * three
    return x, y, z


def _times(a: Matrix, q: Triple) -> Triple:
    x, y, z = (row[0] * q[0] + row[1] * q[1] + row[2] * q[2] for row in a)
    return x, y, z


def _apply(psi: Triple, a: Matrix, q: Triple) -> Triple:
    """psi(A) q."""
    once = _times(a, q)
    twice = _times(a, once)
    x, y, z = (psi[0] * q[i] + psi[1] * once[i] + psi[2] * twice[i] for i in range(3))
    return x, y, z


def move_relaxing(c: Coefficients, x: float, v: float, f: float, z: Inner) -> tuple[float, float, int, Inner]:
    """Move a body bonded to a relaxing spring over one tick with f held; c is (at, k, *`Step3`), z is (phi,)."""
    at, _, a11, a12, a13, b1, a21, a22, a23, b2, a31, a32, a33, b3 = c
    phi, = z
    q = x - at
    return (at + (a11 * q + a12 * v + a13 * phi + b1 * f), a21 * q + a22 * v + a23 * phi + b2 * f, 0,
            (a31 * q + a32 * v + a33 * phi + b3 * f,))


def relaxing_force(c: Coefficients, x: float, v: float, z: Inner) -> float:  # noqa: ARG001 - every force's arguments
    """Force on the relaxing spring, which can push and pull: `k (x - at) + phi`; c as in `move_relaxing`."""
    return c[1] * (x - c[0]) + z[0]


def relaxing(body: MassDamper, dt: float, *, k: float, k1: float, tau: float, at: float = 0.0) -> Plant:
    """A body bonded to a spring k (N/m) in parallel with a Maxwell branch: k1 (N/m) that relaxes within tau (s).

    `at` (m) is where the springs rest. The inner state is (phi,), the force (N) in the branch, 0 at the start
    wherever the body is then: at rest for so long that the branch has let go.
    """
    _no_friction(body, "tissue that relaxes")
    step = step3(body.mass, body.damping, k, 1.0, WIDE.multiply(Decimal(k1), Decimal(tau)), tau,
                 number("dt", dt, above=0.0))
    return Plant(move_relaxing, relaxing_force, (at, k, *step), (0.0,))


def _no_friction(body: MassDamper, where: str) -> None:
    if body.friction > 0.0:
        raise Refused(f"{where} has an exact step, and friction={body.friction:g} N has none; write friction=0")


@dataclass(frozen=True, kw_only=True, slots=True)
class ElectricalDamping:
    """Damping of a motor by its own back-emf: `b` (N s/m) above the frequency `cutoff` (Hz), less below it.

    A resistor and a capacitor in series across the motor let the current flow that the back-emf drives. With
    K the motor's constant at the handle (N/A = V s/m), R all of the resistance around and C the capacitance,
    the force against the motion is `b s/(s + w_c) v` with `b = K^2/R` and `w_c = 2 pi cutoff = 1/(R C)`. In
    mechanical words: a damper b in series with a mass `b/w_c = K^2 C`, which is what a slow hand feels instead
    of damping. J. S. Mehling, J. E. Colgate & M. A. Peshkin, "Increasing the impedance range of a haptic
    display by adding electrical damping", World Haptics 2005; US patent application 2008/0007517.

    Kept is that first-order force. Left out: the motor's inductance L, which ends the damping again above
    R/(2 pi L); a resistor alone, which is plain `damping` of the master; and what the shunt takes of the
    amplifier's current, which is taken to make the force that it is asked for.
    """

    b: float
    cutoff: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "b", number("b", self.b, low=0.0))
        object.__setattr__(self, "cutoff", number("cutoff", self.cutoff, above=0.0))


def relaxing_master(body: MassDamper, hand_mass: float, k: float, d: float, dt: float, *, b_e: float, cutoff: float
                    ) -> Plant:
    """Master `body` damped electrically and held by a hand of `hand_mass` through a spring k and damper d.

    `move` is `move_held`, `force` is `held_force`, `c` is (*`Step3`, dt, b, k, d, hand, mass, b_e) with b
    of the master alone, `hand` of the hand alone and `mass` of both. The inner state is (u,), the velocity (m/s)
    for which the capacitor's voltage stands: 0 at the start. Without a hand: `hand_mass = k = d = 0`.
    """
    _no_friction(body, "a master with electrical damping")
    damping = ElectricalDamping(b=b_e, cutoff=cutoff)
    tau = 1.0 / (2.0 * pi * damping.cutoff)
    if tau == 0.0:
        raise Refused(f"cutoff must be a frequency in Hz, not {cutoff:g}; write for example cutoff=10")
    mass = body.mass + hand_mass
    dampers = WIDE.add(WIDE.add(Decimal(body.damping), Decimal(d)), Decimal(damping.b))
    step = step3(mass, dampers, k, -damping.b, 1.0, tau, number("dt", dt, above=0.0))
    return Plant(move_held, held_force, (*step, dt, body.damping, k, d, hand_mass, mass, damping.b), (0.0,))


def move_held(c: Coefficients, x: float, v: float, f_m: float, r0: float, r1: float, z: Inner
              ) -> tuple[float, float, Inner]:
    """Move the held master over one tick in which the reference runs straight from r0 to r1; c as there.

    With b_e (v - u) the force of the shunt and tau u' = v - u, only differences of velocities count there: as
    a mass behind a damper it is the same in a frame that moves evenly. So with s = (r1 - r0)/dt,
    y = x - x_ref and u - s in place of x and u, the ramp vanishes but for the master's own damping:
    `M y'' + (b + d) y' + k y + b_e (y' - (u - s)) = -(f_m + b s)`.
    """
    a11, a12, a13, b1, a21, a22, a23, b2, a31, a32, a33, b3, dt, b, _, _, _, _, _ = c
    s = (r1 - r0) / dt
    f = -(f_m + b * s)
    y = x - r0
    w = v - s
    u = z[0] - s
    return (r1 + (a11 * y + a12 * w + a13 * u + b1 * f), s + (a21 * y + a22 * w + a23 * u + b2 * f),
            (s + (a31 * y + a32 * w + a33 * u + b3 * f),))


def held_force(c: Coefficients, x: float, v: float, f_held: float, r: float, slope: float, z: Inner) -> float:
    """`f_h`, what passes through the grip, as the left limit at a tick (see `plant.grip_force`); c as there.

    `f_h = k (x_ref - x) + d (v_ref - v) - m_h a`, where `M a` is the muscle's force less that of the dampers
    b v and b_e (v - u) and of the motor.
    """
    _, _, _, _, _, _, _, _, _, _, _, _, _, b, k, d, hand, mass, b_e = c
    muscle = k * (r - x) + d * (slope - v)
    return muscle - hand * ((muscle - b * v - b_e * (v - z[0]) - f_held) / mass)
