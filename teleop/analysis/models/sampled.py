"""The damping that a device needs so that a force worked out from samples, and held, makes no energy.

A controller reads the position every T, and its force is held. E(z) is its force per backward-difference velocity
v(k) = (x(k) - x(k-1))/T: K T/(1 - z^-1) for a spring, B for a damper on that velocity. With d whole samples of delay a
device of damping b, of any mass, is passive to any hand iff

    b >= max over th in (0, pi] of  -Re[e^(-j(d+1)th) E(e^(j th))].

That is Colgate and Schenkel's `b > T/2/(1 - cos wT) Re[(1 - e^-jwT) H]` with `H = E (1 - z^-1)/T`, force over position
(J. E. Colgate and G. G. Schenkel, "Passivity of a class of sampled-data systems: application to haptic interfaces", J.
Robotic Systems 14(1), 1997). The one sample beyond d is what holding costs: f(k) does its work on x(k+1) - x(k).

Conditions: E stable apart from a pole at z = 1, whose residue (the stiffness) is not negative; the hand passive and
not known otherwise; a linear controller, which a wall is in contact, where it is worst (above its surface the force
is nothing).

A force renewed at every n-th tick alone is no linear time-invariant system of either rate, but its passivity is exact
as well. Over the frequencies w_l = w + 2 pi l/(nT) that one sample of a rate 1/(nT) cannot tell apart, a velocity with
components V_l has the energy sum |V_l|^2 in the damper and takes from the port

    Re[g conj(sum p_l V_l) (sum conj(q_l) V_l)],   g = (1 - e^-jnwT)/(nT),  p_l = 1/w_l,
    conj(q_l) = H(e^(j w_l T)) e^(-j w_l T d)/w_l,

a Hermitian form of rank two. Its greatest eigenvalue is what b must reach:

    1/2 (Re[g <q,p>] + sqrt(|g|^2 |p|^2 |q|^2 - Im[g <q,p>]^2)).

H takes only n values on the w_l, at th_i = (nwT + 2 pi i)/n, and sum T^2/(w_l T)^2 over one of these classes is
T^2/|1 - e^(-j th_i)|^2, so all sums have n terms. For n = 1 both vectors are parallel and the first formula is left.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.models.linear import StateSpace
from teleop.analysis.models.loop import transfer
from teleop.analysis.models.peak import FIRST, Peak, Points, Reals, highest
from teleop.errors import number, whole_number

Impedance = Callable[[Any], Any]  # of z (an array): force per backward-difference velocity, N s/m


class Needed(NamedTuple):
    """The least damping that keeps a port passive."""

    damping: float  # N s/m; inf: none does
    frequency: float  # Hz, where that much is needed


def needed_damping(E: Impedance, T: float, *, d: int = 0, every: int = 1) -> Needed:
    """The least device damping for the controller E(z), tick T (s), d ticks of delay, renewed at every `every`-th.

    Found to about 1e-10 of it; see `peak.highest` for what it cannot see. inf for a spring of negative stiffness.
    """
    T, d, every = number("T", T, above=0.0), whole_number("d", d, low=0), whole_number("every", every, low=1)
    th = highest(lambda th: damping_curve(E, T, th, d=d, every=every), (d + 1) / every)
    if _negative_spring(E, T):
        return Needed(float("inf"), 0.0)
    return Needed(th.value, frequency(th, every * T))


def frequency(peak: Peak, T: float) -> float:
    """Frequency of a peak in Hz, for samples every T seconds; the places nearest to 0 stand for 0."""
    return 0.0 if peak.th <= FIRST else peak.th / (2.0 * pi * T)


def damping_curve(E: Impedance, T: float, th: Reals, *, d: int = 0, every: int = 1) -> Reals:
    """The damping (N s/m) needed at each frequency, th in rad per renewal of the force, in (0, pi]."""
    at = (th[:, None] + 2.0 * pi * np.arange(every)) / every  # the n classes
    apart = step(at)
    E_late = smooth(E, at) * np.exp(-1j * d * at)
    p, q = T / np.abs(apart), (E_late * apart / np.abs(apart)).conj()
    taken = (q.conj() * p).sum(axis=1)  # <q, p>
    g = step(th) / (every * T)
    of_p = (p * p).sum(axis=1)
    rest = q - p * (taken.conj() / of_p)[:, None]  # what is not along p; 0 for n = 1
    real: Reals = (g * taken).real
    cross = np.abs(g) ** 2 * of_p * (np.abs(rest) ** 2).sum(axis=1)
    needed: Reals = 0.5 * (real + np.sqrt(real * real + cross)) if every > 1 else real
    return needed


def step(th: Reals) -> Points:
    """1 - e^(-j th), without the cancellation at small th."""
    difference: Points = 2j * np.sin(0.5 * th) * np.exp(-0.5j * th)
    return difference


def on_circle(th: Reals) -> Any:
    """e^(j th) with more digits where the machine has them: 1/(1 - z^-1) loses two for each decade that th falls."""
    return np.exp(1j * th.astype(np.longdouble))


def smooth(E: Impedance, th: Reals) -> Points:
    """E(e^(j th)) by way of the force over position, which a spring keeps finite where E itself loses its digits."""
    z = on_circle(th)
    over_position = (np.asarray(E(z)) * (1.0 - 1.0 / z)).astype(np.complex128)
    impedance: Points = over_position / step(th)
    return impedance


def _negative_spring(E: Impedance, T: float) -> bool:
    z = on_circle(np.array([1e-6]))
    stiffness = complex(np.asarray(E(z) * (1.0 - 1.0 / z) / T)[0])
    return stiffness.real < -1e-3 * abs(stiffness)


def spring_damper(K: float, B: float, T: float) -> Impedance:
    """A virtual spring K (N/m) with a damper B (N s/m) on the backward difference."""
    return lambda z: K * T / (1.0 - 1.0 / z) + B


def of_state_space(controller: StateSpace, T: float) -> Impedance:
    """E(z) of a controller given as matrices from a position (m) to a force (N); its one input and one output."""
    def E(z: Any) -> Any:
        points = z.astype(np.complex128).ravel()
        return transfer(controller, points)[:, 0, 0].reshape(z.shape) * T / (1.0 - 1.0 / z)

    return E


def quantised_stiffness(*, b: float, T: float, step: float, friction: float) -> float:
    """The greatest spring (N/m) that stays passive behind an encoder of `step` (m): min(2 b/T, 2 fc/step).

    Device damping b (N s/m), Coulomb friction fc (N). Two leaks that do not mix: what holding makes, the damper takes
    up; what quantising makes, the friction does. Necessary and sufficient for a mass with viscous and Coulomb friction,
    a spring alone, a force renewed at every tick and no delay (J. J. Abbott and A. M. Okamura, "Effects of position
    quantization and sampling rate on virtual-wall passivity", IEEE Trans. Robotics 21(5), 2005).

    >>> quantised_stiffness(b=0.8, T=1e-3, step=1e-5, friction=0.004)
    800.0
    """
    b, T = number("b", b, low=0.0), number("T", T, above=0.0)
    step, friction = number("step", step, low=0.0), number("friction", friction, low=0.0)
    return min(2.0 * b / T, 2.0 * friction / step if step > 0.0 else float("inf"))
