"""Environments that a virtual coupling allows behind it.

The device of damping delta = b renders, through the coupling C(z), the environment E(z); all impedances are force per
backward-difference velocity (see `sampled`). The environment lacks passivity by alpha_e, the least alpha for which
E + alpha is positive real (there may be none: `lack_behind`); gamma is the least of Re C on the unit circle, K T/2 + B
for a spring-damper. Then

    alpha_e < delta                              without a coupling,
    alpha_e < delta gamma/(delta + gamma)        with one

(B. E. Miller, J. E. Colgate and R. A. Freeman, "Guaranteed stability of haptic systems with nonlinear virtual
environments", IEEE Trans. Robotics and Automation 16(6), 2000). These count energies as if force and velocity met at
the same instant. A held force meets the velocity one sample later; how much that changes is worked out here, for linear
environments.

Derivation. The device feels Z = C E/(C + E) = C - C^2/(C + E). Where Re E >= -alpha, Re(C + E) >= rho = Re C - alpha,
and if rho > 0 the values 1/(C + E) fill the disc of centre and radius 1/(2 rho). The damping needed at th,
-Re[e^(-j(d+1)th) Z], is greatest on its rim:

    |C|^2/(2 rho) - Re[e^(-j(d+1)th) (C - C^2/(2 rho))]  =  Re[e^(-j(d+1)th/2) C]^2/rho - Re[e^(-j(d+1)th) C].

Without the sample of the hold, and for a real C, that is gamma^2/(gamma - alpha) - gamma = alpha gamma/(gamma - alpha),
which is delta where alpha = delta gamma/(delta + gamma): the condition above. With the sample, for a spring-damper
and d = 0, Re[e^(-j th/2) C] = B cos(th/2) and Re[e^(-j th) C] = B cos th - K T/2, so it is linear in cos th:

    delta >= max(gamma, K T/2 - B + B^2/(gamma - alpha)),

the first at th = pi, where a rigid environment needs it too, the second at th = 0. Hence, with gamma = K T/2 + B,

    alpha < gamma - B^2/(delta + B - K T/2)   and   delta >= gamma.

The condition of Miller et al. is inside this where delta >= gamma, and then some is left; where delta < gamma it
allows environments that are not safe, such as a rigid one.

Without a coupling the same question has no answer: an E that lacks alpha may be a spring as stiff as one likes, and
needs K T/2. There only a known E can be asked: `sampled.needed_damping`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.models.peak import Reals, highest
from teleop.analysis.models.sampled import Impedance, Needed, frequency, on_circle, smooth
from teleop.errors import number, whole_number
from teleop.law.analysis_offers import Coupling

ROUNDING = 1e-9  # of |E|: a lossless element's real part is no better known


class Lack(NamedTuple):
    """Lack of passivity of an environment."""

    alpha: float  # N s/m, 0 if it is passive; inf: no damper makes it so
    frequency: float  # Hz, where it lacks that much
    why: str = ""  # why none does


def lack_behind(coupling: Coupling, T: float) -> Lack:
    """alpha_e of what is behind a coupling, as the law offers it: inf with the reason where no damper makes it passive.

    `Coupling.flaw` is that reason: a zero or a pole of E outside the unit circle, which the circle alone does not show.
    """
    T = number("T", T, above=0.0)
    return Lack(float("inf"), 0.0, coupling.flaw) if coupling.flaw else lack(coupling.E, T)


def lack(E: Impedance, T: float) -> Lack:
    """The negative of the least Re E(e^(j th)), or 0.

    That is the lack of passivity of an E without poles outside the unit circle, at infinity included, which is not
    asked here (a law that offers a coupling says it, `lack_behind`); those on it (a spring, and the trapezoid mass at
    z = -1) must have residues of the sign that lossless elements have. What is below 1e-9 of |E| is rounding and counts
    as none.
    """
    T = number("T", T, above=0.0)

    def curve(th: Reals) -> Reals:
        at = np.minimum(th, np.pi - 1e-6)  # a pole at z = -1 is left alone
        value = smooth(E, at)
        missing: Reals = np.where(-value.real > ROUNDING * np.abs(value), -value.real, 0.0)
        return missing

    peak = highest(curve)
    return Lack(max(0.0, peak.value), frequency(peak, T) if peak.value > 0.0 else 0.0)


def least_real(C: Impedance, T: float) -> float:
    """gamma: the least of Re C(e^(j th)), the coupling's impedance in the conditions above (N s/m)."""
    T = number("T", T, above=0.0)
    return -highest(lambda th: -smooth(C, th).real).value


def damping_curve(C: Impedance, alpha: float, th: Reals, *, d: int = 0) -> Reals:
    """The damping (N s/m) that the worst environment lacking `alpha` asks for at each th (rad per sample)."""
    value = smooth(C, th)
    rho = value.real - alpha
    turned = np.exp(-0.5j * (d + 1) * th)
    needed: Reals = (turned * value).real ** 2 / rho - (turned * turned * value).real
    return np.where(rho > 0.0, needed, np.inf)


def needed_damping(C: Impedance, alpha: float, T: float, *, d: int = 0) -> Needed:
    """The least device damping behind which the coupling C(z) is passive with every linear E lacking `alpha` or less.

    T: tick (s), d: ticks of delay. inf where alpha >= gamma. To 1e-10 of it, as `sampled.needed_damping`. Attained:
    for every smaller one there are an environment and a hand that swing up.
    """
    T, d = number("T", T, above=0.0), whole_number("d", d, low=0)
    alpha = number("alpha", alpha, low=0.0)
    peak = highest(lambda th: damping_curve(C, alpha, th, d=d), d + 1)
    return Needed(peak.value, frequency(peak, T))


def alpha_max(delta: float, C: Impedance, T: float, *, d: int = 0, tol: float = 1e-9) -> float | None:
    """The greatest lack of passivity of an environment behind C with a device damping `delta`; None: none is safe.

    None means that not even every passive environment is safe. By bisection to `tol` of gamma: the disc of the
    environments grows with alpha, so the damping needed does.
    """
    delta, gamma = number("delta", delta, low=0.0), least_real(C, T)
    slack = delta * (1.0 + 1e-9)
    if gamma <= 0.0 or needed_damping(C, 0.0, T, d=d).damping > slack:
        return None
    low, high = 0.0, gamma
    while high - low > tol * gamma:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if needed_damping(C, middle, T, d=d).damping <= slack else (low, middle)
    return low


def alpha_miller(delta: float, gamma: float) -> float:
    """delta gamma/(delta + gamma), the bound of Miller, Colgate and Freeman; with gamma = inf (no coupling) delta.

    >>> alpha_miller(1.0, 1.0), alpha_miller(0.8, float("inf"))
    (0.5, 0.8)
    """
    if gamma == float("inf"):
        return delta
    return delta * gamma / (delta + gamma) if delta + gamma > 0.0 else 0.0


def rendered(C: Impedance, E: Impedance) -> Impedance:
    """Z = C E/(C + E): what the device shows of E through C."""
    return lambda z: C(z) * E(z) / (C(z) + E(z))


def gap(C: Impedance, E: Impedance, T: float, frequencies: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """|E - Z|/|E| = |E/(C + E)| at frequencies (Hz) below half the rate: the share of the environment that is lost."""
    z = np.exp(2j * np.pi * T * np.asarray(frequencies, dtype=float))
    lost: np.ndarray[Any, np.dtype[np.float64]] = np.abs(E(z) / (C(z) + E(z)))
    return lost


def stiffness(E: Impedance, T: float) -> float:
    """The spring (N/m) that E is at rest: K_c k_e/(K_c + k_e) of a spring behind a spring."""
    z = on_circle(np.array([1e-6]))
    return float((np.asarray(E(z)) * (1.0 - 1.0 / z)).real[0] / T)
