"""Passive set-point modulation: a spring to a set point at each end, which moves as far as the energy kept there goes.

Source: D. Lee and K. Huang, "Passive-set-position-modulation framework for interactive robotic systems", IEEE Trans.
Robotics 26(2), 2010.

Each end sends its position x. It is drawn to a set point y by a spring, and damped: the master's force on the hand is
f = K (x - y) + B_m v, the slave's force is f = K (y - x) - B_s v. Moving y to the other end's position costs energy,
which the dampers have saved. With P = K |x - y|^2/2, w = f_held dx (at the slave minus that) the work done on this
end over the last tick, S the energy that it has ever sent and S_rx what the other end has, of which `seen` was taken:

    E += w - (P_now - P_before)        what the damper took, in truth: f_held dx is what the motor did
    E += min(S_rx - seen, (E_max - E)+)        only what fits
    y' = x + (x_rx - x) min(1, R/|x_rx - x|), R^2 = |x - y|^2 + 2 E/K        E -= P' - P_now
    what is above E_max then goes into S

The state has T = E + P in place of both: T += w + min(..), and R^2 = 2 T/K. R is one for all axes. S is a sum, so a
packet that is lost, doubled or late loses and makes nothing. Of what comes only what fits is taken, and the rest is
dropped: were it sent on, an energy that none of the ends can keep would circulate in the link for ever.

Books. Each T + S - seen grows by the work done on its end, less what was dropped. Summed over both ends

    E_port = T_m + T_s + under way - 2 E_0 + dropped        under way = (S_m - seen_s) + (S_s - seen_m) >= 0

so with E_law = T_m + T_s + under way, E_port + E_law(0) - E_law is what was dropped, and E_law(0) = 2 E_0 is the seed
energy: with E_0 = 0 the slave would stay until the master's damper has saved more than E_max.

What is below zero is one tick's surprise. y' has P' <= T+, so E = T - P' >= 0 where T >= 0. The force is held over a
motion d that is not yet known, and takes from T at most (sqrt(2 K T+) + B |v|) |d|, which leaves T >= -K d^2/2 - B |v
d|. A body m at rest goes by d = f dt^2/(2 m) and gets no more than there is for K <= m/dt^2. With T < 0 the set point
is x and nothing is left but the damper, which fills T while v keeps its sign over a tick.
Neither B v^2 dt nor the paper's D_min = B d^2/dt is a lower bound of what the held damper took, B v d: both make energy
where v changes in a tick. A watchdog or a cap that lets the device have less than f is in w, so what it keeps back is
not spent. With R a force ends without a jump where the energy runs out.

Claims: E_law >= 0 less one tick's surprise, over any link; E_port >= -2 E_0 with it.
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

TINY = 1e-300  # J, in place of no way at all


class Forth(NamedTuple):
    x: kind.Position  # the master's, m
    S: kind.Total  # energy that the master has sent, J


class Back(NamedTuple):
    x: kind.Position  # the slave's, m
    S: kind.Total  # energy that the slave has sent, J


class PSPMEnd(NamedTuple):
    y: kind.Position  # set point, m
    T: float  # energy kept, that of the spring included, J; the same in each axis, as S and seen are
    S: float  # energy sent, J
    seen: float  # what has been dealt with of the other end's S, J


class PSPMSums(NamedTuple):
    w: float  # work done on this end over the last tick, J
    ee: float  # |x - y|^2, m^2
    aa: float  # |x_rx - x|^2, m^2


@dataclass(frozen=True, kw_only=True)
class PSPM:
    """A spring and a damper at each end, to a set point that energy moves."""

    K: Annotated[float, Knob("N/m", "stiffness to the set point", above=0.0, span=(10.0, 3e4))] = 500.0
    B_m: Annotated[float, Knob("N s/m", "damping of the master", low=0.0, span=(0.1, 200.0))] = 5.0
    B_s: Annotated[float, Knob("N s/m", "damping of the slave", low=0.0, span=(0.1, 1e3))] = 20.0
    E_0: Annotated[float, Knob("J", "energy of each end at the start", low=0.0)] = 0.01
    E_max: Annotated[float, Knob(
        "J", "most energy of an end, that of the spring aside", low=0.0, span=(1e-4, 1.0))] = 0.005

    claims: ClassVar[Mapping[str, str]] = {"E_law": "any link"}
    shows: ClassVar[tuple[str, ...]] = ("T",)

    def __post_init__(self) -> None:
        check_knobs(self)

    def conditions(self, facts: Facts) -> tuple[str, ...]:
        stiffest, *dampers = _greatest(facts)
        spring = (f"a held spring gives a body at rest no more energy than its end has where K <= m/T^2, T the longest "
                  f"tick, which K = {self.K:g} N/m is not; --set law.K={enough(stiffest, least=False)} is the most")
        too_large = [f"a damper that is held from tick to tick takes energy where B <= m/T, T the longest tick, "
                f"which {name} = {B:g} N s/m is not; --set law.{name}={enough(most, least=False)} is the most"
                for name, B, most in zip(("B_m", "B_s"), (self.B_m, self.B_s), dampers, strict=True) if most < B]
        return (*([spring] if stiffest < self.K else []), *too_large)

    def fitted(self, facts: Facts) -> PSPM:
        """The law with both dampers no more than m/T, and K no more than m/T^2."""
        K, B_m, B_s = _greatest(facts)
        return replace(self, K=min(self.K, K), B_m=min(self.B_m, B_m), B_s=min(self.B_s, B_s))

    def master_start(self, at: At) -> tuple[PSPMEnd, Back]:
        return PSPMEnd(at.x, self.E_0, 0.0, 0.0), Back(at.x, 0.0)  # until the first message: stay

    def slave_start(self, at: At) -> tuple[PSPMEnd, Forth]:
        return PSPMEnd(at.x, self.E_0, 0.0, 0.0), Forth(at.x, 0.0)

    def master_stored(self, s: PSPMEnd) -> float:
        return s.T + (s.S - s.seen)

    def slave_stored(self, s: PSPMEnd) -> float:
        return s.T + (s.S - s.seen)

    def master_sums(self, s: PSPMEnd, at: At, rx: Back) -> PSPMSums:
        e, a = at.x - s.y, rx.x - at.x
        return PSPMSums(at.f_held * at.dx, e * e, a * a)

    def master(self, s: PSPMEnd, at: At, rx: Back, over: PSPMSums) -> tuple[float, Forth, PSPMEnd]:
        s = modulate(self.K, self.E_max, s, at.x, rx.x, rx.S, over)
        return self.K * (at.x - s.y) + self.B_m * at.v, Forth(at.x, s.S), s

    def slave_sums(self, s: PSPMEnd, at: At, rx: Forth) -> PSPMSums:
        e, a = at.x - s.y, rx.x - at.x
        return PSPMSums(-at.f_held * at.dx, e * e, a * a)

    def slave(self, s: PSPMEnd, at: At, rx: Forth, over: PSPMSums) -> tuple[float, Back, PSPMEnd]:
        s = modulate(self.K, self.E_max, s, at.x, rx.x, rx.S, over)
        return self.K * (s.y - at.x) - self.B_s * at.v, Back(at.x, s.S), s


def _greatest(facts: Facts) -> tuple[float, float, float]:
    """The greatest K (N/m), B_m and B_s (N s/m) with which a spring and dampers held over T take energy."""
    T = facts.held
    return min(facts.mass_m, facts.mass_s) / (T * T), facts.mass_m / T, facts.mass_s / T


def modulate(K: float, E_max: float, s: PSPMEnd, x: float, x_rx: float, S_rx: float, over: PSPMSums) -> PSPMEnd:
    """The end, its set point moved towards x_rx (m) as far as the energy goes; `S_rx` (J): S of the newest message."""
    T = s.T + over.w
    E = T - 0.5 * K * over.ee
    T = T + min(S_rx - s.seen, max(E_max - E, 0.0))
    go = sqrt(min(2.0 * max(T, 0.0) / max(K * over.aa, TINY), 1.0))  # the share of the way that the set point goes
    gives = max(T - 0.5 * K * (go * go * over.aa) - E_max, 0.0)
    return PSPMEnd(x + go * (x_rx - x), T - gives, s.S + gives, S_rx)
