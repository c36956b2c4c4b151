"""Two-layer passivity control: a law of any force, and below it a tank of energy at each end that has to pay for it.

Source: M. Franken, S. Stramigioli, S. Misra, C. Secchi and A. Macchelli, "Bilateral telemanipulation with time
delays: a two-layer approach combining passivity and transparency", IEEE Trans. Robotics 27(4), 2011.

Upper layer: the slave follows the master's newest position and velocity, f = K (x_rx - x_s) + B (v_rx - v_s), and
sends the force that it asked for, times the watchdog's gain; the master reflects that force. Lower layer: each end
keeps a tank H (J). With w = f_held dx (at the slave minus that) the work done on this end over the last tick, S the
energy that it has ever sent and S_rx what the other end has, of which `seen` was taken:

    H += w + (S_rx - seen), up to H_max        gives = min(beta span/dt, 1) H+        H -= gives        S += gives
    |f| <= min(f_max, sqrt(2 k H+), H+/(dt |v|)), one share for all axes
    the master adds min(alpha (H_d - H)+, d_max) v, which fills the tank from the hand

S is a sum and never the energy of one packet: a packet that is lost, doubled or late then loses and makes nothing.

Books. Each H + S - seen grows by the work done on its end, less what is above H_max. Summed over both ends

    E_port = H_m + H_s + under way - 2 H_0 + what was above H_max
    under way = (S_m - seen_s) + (S_s - seen_m) >= 0

so with E_law = H_m + H_s + under way, E_port + E_law(0) - E_law is what was above H_max, and E_law(0) = 2 H_0 is the
seed energy. What is below zero is one tick's surprise: a force is chosen before the motion d that it is held over is
known. It takes at most sqrt(2 k H) |d| out of the tank, and H - sqrt(2 k H) |d| is least at 2 H = k d^2, where it is

    H >= -k d^2/2

at each end, beside what the master's added damper gives where v turns round within one tick, at most d_max |v d|. The
next force is nothing but that damper until the tank has filled again, so this adds up over no more ticks. Over ticks
that are left out d is longer, and so is the bound. With sqrt(2 k H) a force ends without a jump where its tank runs
empty.

beta per tick: two tanks that nobody moves share evenly, and keep (1 - beta) of 2 H_0/(2 (1 - beta) + beta (T1 +
T2)/dt) each; the rest is under way. So beta has to fall with delay: `fitted` takes dt/(T1 + T2), at which a third is
under way.

Claims: E_law >= 0 less one tick's surprise, over any link; E_port >= -2 H_0 with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import sqrt
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.errors import enough
from teleop.knob import Knob, check_knobs
from teleop.law import At
from teleop.law.offers import Facts

TINY = 1e-300  # in place of nothing below a fraction
SHORT = 1e-40  # m^2, in place of no motion: what a tank pays for is no matter of it then


class Forth(NamedTuple):
    x: kind.Position  # the master's, m
    v: float  # the master's velocity, m/s
    S: kind.Total  # energy that the master has sent, J


class Back(NamedTuple):
    f_s: float  # the slave's force, N
    S: kind.Total  # energy that the slave has sent, J


class Tank(NamedTuple):
    H: float  # energy of this end, J; the same in each axis, as the others are
    S: float  # what it has sent, J
    seen: float  # what it has taken of the other end's S, J


class TwoLayerSums(NamedTuple):
    w: float  # work done on this end over the last tick, J
    ff: float  # the square of the force that is asked for, N^2
    vv: float  # the square of the velocity, m^2/s^2


@dataclass(frozen=True, kw_only=True)
class TwoLayer:
    """Position-force control above, an energy tank at each end below."""

    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.1, 500.0))] = 20.0
    beta: Annotated[float, Knob(
        "", "share of its tank that an end sends in a tick", low=0.0, high=1.0, span=(1e-4, 1.0))] = 0.01
    H_d: Annotated[float, Knob(
        "J", "energy below which the master's tank is filled from the hand", low=0.0, span=(1e-3, 2.0))] = 0.05
    H_0: Annotated[float, Knob("J", "energy of each tank at the start", low=0.0)] = 0.0
    alpha: Annotated[float, Knob(
        "N s/(m J)", "damping for each joule that is missing of H_d", low=0.0, span=(10.0, 3e4))] = 500.0
    d_max: Annotated[float, Knob("N s/m", "most of that damping", low=0.0, span=(0.5, 500.0))] = 20.0
    k: Annotated[float, Knob("N/m", "stiffness of the bound sqrt(2 k H) on a force", low=0.0, span=(10.0, 3e4))] = 500.0
    f_max: Annotated[float, Knob("N", "most force of the upper layer", low=0.0, span=(1.0, 100.0))] = 40.0
    H_max: Annotated[float, Knob("J", "most energy of a tank", low=0.0, span=(0.01, 30.0))] = 1.0

    claims: ClassVar[Mapping[str, str]] = {"E_law": "any link"}
    shows: ClassVar[tuple[str, ...]] = ("H",)

    def __post_init__(self) -> None:
        check_knobs(self)

    def conditions(self, facts: Facts) -> tuple[str, ...]:
        even, most = even_share(facts), facts.mass_m / facts.held
        share = (f"at most a third of the energy is under way where beta <= dt/(T1 + T2), which beta = {self.beta:g} "
                 f"is not; --set law.beta={enough(even, least=False)} is the most")
        damper = (f"the master's damper takes energy where d_max <= m/T, T the longest tick, which "
                  f"d_max = {self.d_max:g} N s/m is not; "
                  f"--set law.d_max={enough(most, least=False)} is the most")
        return (*([share] if self.beta > even * (1.0 + 1e-9) else []), *([damper] if self.d_max > most else []))

    def fitted(self, facts: Facts) -> TwoLayer:
        """The law with beta no more than dt/(T1 + T2), and d_max no more than m/T."""
        return replace(self, beta=min(self.beta, even_share(facts)),
                       d_max=min(self.d_max, facts.mass_m / facts.held))

    def master_start(self, at: At) -> tuple[Tank, Back]:
        return Tank(self.H_0, 0.0, 0.0), Back(0.0, 0.0)

    def slave_start(self, at: At) -> tuple[Tank, Forth]:
        return Tank(self.H_0, 0.0, 0.0), Forth(at.x, 0.0, 0.0)  # until the first message: stay

    def master_stored(self, s: Tank) -> float:
        return s.H + (s.S - s.seen)

    def slave_stored(self, s: Tank) -> float:
        return s.H + (s.S - s.seen)

    def master_sums(self, s: Tank, at: At, rx: Back) -> TwoLayerSums:
        return TwoLayerSums(at.f_held * at.dx, rx.f_s * rx.f_s, at.v * at.v)

    def master(self, s: Tank, at: At, rx: Back, over: TwoLayerSums) -> tuple[float, Forth, Tank]:
        H, S = exchange(self.beta, self.H_max, s, rx.S, over.w, at.span / at.dt)
        f_m = rx.f_s * share(self.f_max, self.k, H, over.ff, over.vv, at.dt)
        f_m = f_m + min(self.alpha * max(self.H_d - H, 0.0), self.d_max) * at.v
        return f_m, Forth(at.x, at.v, S), Tank(H, S, rx.S)

    def slave_sums(self, s: Tank, at: At, rx: Forth) -> TwoLayerSums:
        f = self.K * (rx.x - at.x) + self.B * (rx.v - at.v)
        return TwoLayerSums(-at.f_held * at.dx, f * f, at.v * at.v)

    def slave(self, s: Tank, at: At, rx: Forth, over: TwoLayerSums) -> tuple[float, Back, Tank]:
        H, S = exchange(self.beta, self.H_max, s, rx.S, over.w, at.span / at.dt)
        f = self.K * (rx.x - at.x) + self.B * (rx.v - at.v)
        f_s = f * share(self.f_max, self.k, H, over.ff, over.vv, at.dt)
        return f_s, Back(at.gain * f_s, S), Tank(H, S, rx.S)


def even_share(facts: Facts) -> float:
    """dt/(T1 + T2), 1 at most; 1 where nothing was played."""
    delay = sum(way.greatest for way in (facts.fwd, facts.bwd) if way is not None)
    return min(facts.dt / max(delay, facts.dt), 1.0)


def exchange(beta: float, H_max: float, s: Tank, S_rx: float, w: float, ticks: float) -> tuple[float, float]:
    """Tank and energy sent (J) after the work w was done on it and all that came by now is in it."""
    H = min(s.H + w + (S_rx - s.seen), H_max)
    gives = min(beta * ticks, 1.0) * max(H, 0.0)
    return H - gives, s.S + gives


def share(f_max: float, k: float, H: float, ff: float, vv: float, dt: float) -> float:
    """Share of a force that the tank H (J) pays for, 0 to 1; ff and vv are the squares of force and velocity."""
    left = max(H, 0.0)
    way = max(dt * dt * vv, SHORT)
    return sqrt(min(min(min(f_max * f_max, 2.0 * k * left) * way, left * left) / max(ff * way, TINY), 1.0))
