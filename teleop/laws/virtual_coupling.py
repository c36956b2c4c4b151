"""A virtual coupling: spring and damper between the device and a simulated tool that meets a wall. One-port.

Source: J. E. Colgate, M. C. Stanley and J. M. Brown, "Issues in the haptic display of tool use", IROS 1995;
R. J. Adams and B. Hannaford, "Stable haptic interaction with virtual environments", IEEE Trans. Robotics and
Automation 15(3), 1999. With the device's reading x, v and the tool's position y and velocity u,

    f_m = K (x - y) + B (v - u)                        coupling: on the hand, and the other way on the tool
    m u' = f,   f = f_m - f_w - b u,   y' = u          tool of mass m and damping b
    f_w = max(0, k_e p + d_e u) for p = y - at > 0, 0 elsewhere       wall; it cannot pull

Integrator. At tick k the tool moves from k-1 (0) to k (1), by two weights in 0..1:

    y1 = y0 + dt ((1 - theta_x) u0 + theta_x u1)       m (u1 - u0)/dt = (1 - theta_f) f0 + theta_f f1

explicit Euler (theta_f, theta_x) = (0, 0), semi-implicit Euler (0, 1), trapezoid (Tustin) (0.5, 0.5), backward
Euler (1, 1). dt is the time since the last tick, so after ticks that were left out one step takes the tool through all
of it. f1 holds the reading of *this* tick and the tool's state at the end of it, f0 those of the last
tick; f_m is then computed from the new y1, u1. So the only late samples are those of the integrator itself.

Solution. With ye = y0 + dt (1 - theta_x) u0 the equation is, for the wall not touched and touched,

    a u1 = r,                       a = m/dt + theta_f (b + B + K dt theta_x)
    (a + theta_f c) u1 = r - theta_f k_e (ye - at),         c = d_e + k_e dt theta_x
    r = m u0/dt + (1 - theta_f) f0 + theta_f (K (x - ye) + B v)

with solutions u_free and u_in; u_at = (at - ye)/(dt theta_x) is the velocity that leads to the surface. f_w
jumps there from 0 to d_e u1 and is else a continuous, non-decreasing function of u1; with the jump filled
in (on the surface any force between the two may act, as much as stops the tool there), a u1 + theta_f f_w(u1)
is strictly increasing from -inf to inf, so for a > 0 there is one solution and only one:

    u1 = min(u_free, max(u_in, u_at)).

Proof: u_in < u_free iff the touched wall would push at u_free, so min(u_free, u_in) solves the wall that
cannot pull were it everywhere; below u_at there is none, so the solution there is u_free; the surface lies
between. For theta_x = 0 y1 is known beforehand, and u_at = -+inf for a tool that ends inside or outside.

a > 0 asks for a mass, or for theta_f > 0 and some b, B or K theta_x. mass = 0 is the god-object: with
theta_f = 1 the tool rests in balance at every tick; below theta_f = 0.5 it has no stable solution.

Passivity. In contact the law is linear, with the impedances at the end of this file, and a device of damping b
is passive on it iff b + Re(Z(z)/z) > 0 on the circle z = exp(i th) (Colgate and Schenkel 1997, for forces renewed
at every tick, without delay, v the backward difference). For theta_x = 1 and theta_f >= 1/2 it is enough that

    b >= K dt/2 + B

whatever the tool and its wall, and the tool held fast needs all of it: E is positive real, so Z = C E/(C + E) lies
in the disc |Z - h| <= h, 2 h = 1/Re(1/C), where -Re(Z/z) is at most (1 - cos th)/(2 Re(1/C)) <= K dt/2 + B. A
stiffer wall needs no more damping, which is the purpose of the coupling. For theta_x < 1 no such bound is claimed.

Claims: nothing of the ledgers; E_port contains the hold's leak.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, NamedTuple

from teleop.errors import Refused
from teleop.knob import Knob, check_knobs
from teleop.law import At
from teleop.law.analysis_offers import Coupling

INTEGRATORS = {  # (theta_f, theta_x)
    "explicit": (0.0, 0.0), "semi-implicit": (0.0, 1.0), "trapezoid": (0.5, 0.5), "backward": (1.0, 1.0),
}
UNSTABLE, ANTICIPATES = "unstable by itself", "anticipates (a pole outside the unit circle)"
TINY = 1e-300  # under a denominator that may be zero


class Tool(NamedTuple):
    y: float  # position, m
    u: float  # velocity, m/s
    net: float  # force on it: coupling less wall less its own damping, N


@dataclass(frozen=True, kw_only=True)
class VirtualCoupling:
    """Spring-damper to a simulated tool in front of a virtual wall."""

    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0)] = 1000.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0)] = 0.2
    mass: Annotated[float, Knob("kg", "mass of the tool", low=0.0)] = 0.02
    damping: Annotated[float, Knob("N s/m", "damping of the tool", low=0.0)] = 0.0
    k_e: Annotated[float, Knob("N/m", "stiffness of the wall", low=0.0)] = 1e5
    d_e: Annotated[float, Knob("N s/m", "damping of the wall", low=0.0)] = 0.0
    at: Annotated[float, Knob("m", "position of the wall's surface")] = 0.0
    theta_f: Annotated[float, Knob("", "weight of the new state in the tool's forces", low=0.0, high=1.0)] = 1.0
    theta_x: Annotated[float, Knob("", "weight of the new velocity in the tool's position", low=0.0, high=1.0)] = 1.0

    claims: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_knobs(self)
        held = self.theta_f * (self.B + self.damping + self.K * self.theta_x)
        if self.mass == 0.0 and held == 0.0:
            raise Refused("mass=0 leaves the tool's velocity undetermined with theta_f=0, or without B, damping and "
                          "K theta_x; write theta_f=1 and theta_x=1, or a mass above 0")

    def start(self, at: At) -> Tool:
        y = min(at.x, self.at)  # on its own side of the wall
        return Tool(y, 0.0, self.K * (at.x - y))

    def force(self, s: Tool, at: At) -> tuple[float, Tool]:
        K, B, th_f, th_x, x, v = self.K, self.B, self.theta_f, self.theta_x, at.x, at.v
        dt = at.span  # the tool lives through ticks that were left out too
        ye = s.y + dt * (1.0 - th_x) * s.u
        pe = ye - self.at
        c = self.d_e + self.k_e * dt * th_x
        a = max(self.mass / dt + th_f * (self.damping + B + K * dt * th_x), TINY)
        r = self.mass / dt * s.u + (1.0 - th_f) * s.net + th_f * (K * (x - ye) + B * v)
        u_free = r / a
        u_in = (r - th_f * self.k_e * pe) / (a + th_f * c)
        u_at = -pe / max(dt * th_x, TINY)
        u = min(u_free, max(u_in, u_at))
        y = ye + dt * th_x * u
        if u_in >= u_at:
            f_w = max(self.k_e * pe + c * u, 0.0)
        elif u_free > u_at:  # stopped on the surface
            f_w = (r - a * u) / max(th_f, TINY)
        else:
            f_w = 0.0
        f_m = K * (x - y) + B * (v - u)
        return f_m, Tool(y, u, f_m - f_w - self.damping * u)

    def coupling(self, dt: float) -> Coupling:
        """The impedances of coupling and tool in contact (`teleop.law.analysis_offers`), and other integrators."""
        away = replace(self, k_e=0.0, d_e=0.0)
        others = {}
        for name, (theta_f, theta_x) in INTEGRATORS.items():
            try:
                others[name] = replace(self, theta_f=theta_f, theta_x=theta_x)
            except Refused:  # a tool without a mass has no explicit step
                continue
        return Coupling(
            C=lambda z: coupling_impedance(self, z, dt), E=lambda z: tool_impedance(self, z, dt) + 0.0 * z,
            free=lambda z: rendered_impedance(away, z, dt), flaw=tool_flaw(self, dt), series=self.theta_x == 1.0,
            keeps=self.theta_x == 1.0 and self.theta_f >= 0.5, others=others,
        )


def tool_impedance(law: VirtualCoupling, z: complex, dt: float) -> complex:
    """E(z) = F_m/U (N s/m), the tool in contact as the coupling feels it: force of tick k over velocity of tick k.

    With P(z) = dt (theta_x z + 1 - theta_x)/(z - 1) and Q(z) = theta_f z + 1 - theta_f,

        E = m (z - 1)/(dt Q) + b + d_e + k_e P.

    On the circle z = exp(i th) a spring k has Re = k dt (theta_x - 1/2) at every th: -k dt/2, 0, k dt/2 for
    explicit Euler, trapezoid and backward Euler. A mass has, with h = theta_f - 1/2,

        Re = (m/dt) h/(h^2 + cot(th/2)^2/4):   -2 (m/dt) sin(th/2)^2, 0, 2 (m/dt) sin(th/2)^2.

    So E is positive real for any tool iff both weights are at least 1/2. The circle alone does not say it: for
    theta_f < 1/2 the mass has a pole outside, at z = -(1 - theta_f)/theta_f (at infinity for theta_f = 0), so no
    E + alpha is positive real, whatever Re is on the circle; and where E has a zero outside, the tool on its wall
    swings up by itself, semi-implicit Euler without damping at k_e dt^2 > 4 m (`tool_flaw`). For the tool in free
    space give the law with k_e = 0 and d_e = 0.
    """
    inertia = law.mass * (z - 1.0) / (dt * (law.theta_f * z + 1.0 - law.theta_f)) if law.mass > 0.0 else 0.0
    return inertia + law.damping + law.d_e + law.k_e * _summed(law.theta_x, z, dt)


def tool_flaw(law: VirtualCoupling, dt: float) -> str:
    """Why no damper makes the tool in contact passive: E(z) has a zero or a pole outside the unit circle; or empty.

    With h = theta - 1/2, c = b + d_e and k = k_e

        E = N(z)/(dt Q(z) (z - 1)),    N = m (z - 1)^2 + c dt Q (z - 1) + k dt^2 Q (theta_x z + 1 - theta_x).

    - N = 0 is the tool left to itself on its wall. By Jury's criterion its roots are inside or on the circle iff

          c + k dt (theta_f + theta_x - 1) >= 0   and   m + c dt h_f + k dt^2 h_f h_x >= 0,

      for semi-implicit Euler without damping k dt^2 <= 4 m. Outside, the tool swings up when a force drives it, and a
      coupling does: "unstable by itself". So does a tool without a mass at theta_f < 1/2, whose Q is in N.
    - Q = 0 at z = -(1 - theta_f)/theta_f, outside for theta_f < 1/2 and at infinity for theta_f = 0. That pole is the
      mass's, a force that knows the velocity to come. Near it Re E is as negative as one likes, which no damper makes
      good: "anticipates". What is rendered may need no more damping than there is all the same.

    Else E is analytic outside, where Re E is then nowhere less than on the circle. (For theta_f >= 1/2 and
    theta_x < 1/2 an E with zeros outside lacks a finite alpha for a prescribed motion; it is not told, since with
    theta_x < 1 coupling and tool are no series connection.)
    """
    c, k, h_f, h_x = law.damping + law.d_e, law.k_e * dt, law.theta_f - 0.5, law.theta_x - 0.5
    lost, swing = (c, k * (h_f + h_x)), (law.mass / dt, c * h_f, k * h_f * h_x)
    bare = law.mass == 0.0 and law.theta_f < 0.5
    if bare or any(sum(terms) < -1e-12 * sum(map(abs, terms)) for terms in (lost, swing)):
        return UNSTABLE
    return ANTICIPATES if law.theta_f < 0.5 and law.mass > 0.0 else ""


def coupling_impedance(law: VirtualCoupling, z: complex, dt: float) -> complex:
    """C(z) = B + K dt z/(z - 1) (N s/m): the coupling as the device feels it with the tool held fast.

    The velocity is the backward difference of the reading, whose sum is the reading: a spring by backward
    Euler, Re C = B + K dt/2, whatever the tool's integrator.
    """
    return law.B + law.K * _summed(1.0, z, dt)


def rendered_impedance(law: VirtualCoupling, z: complex, dt: float) -> complex:
    """Z(z) (N s/m), what the law renders in contact: force over backward difference of the reading, no delay.

    The tool's side of the spring sums its velocity by the integrator, C'(z) = B + K P(z); from
    F = C V - C' U = E U follows, for every pair of weights,

        Z = C E/(C' + E).

    For theta_x = 1 C' = C and Z = C E/(C + E): coupling and tool in series, at every B, theta_f and mass. For
    theta_x < 1 it is that series for another flow of the tool only, U C'/C; with B = 0 that is the backward
    difference of y, in which the wall's spring looks like one by backward Euler.
    """
    E = tool_impedance(law, z, dt)
    return coupling_impedance(law, z, dt) * E / (law.B + law.K * _summed(law.theta_x, z, dt) + E)


def _summed(theta: float, z: complex, dt: float) -> complex:
    """P(z): position over velocity, s."""
    return dt * (theta * z + 1.0 - theta) / (z - 1.0)
