"""PD+d: each end is drawn to where the other was by a spring-damper, and damped where it is.

Source: E. Nuno, L. Basanez and R. Ortega, "Passivity-based control for bilateral teleoperation: a tutorial", Automatica
47(3), 2011, and D. Lee and M. W. Spong, "Passive bilateral teleoperation with constant time delay", IEEE Trans.
Robotics 22(2), 2006. With x' and v' the other end's newest position and velocity,

    f_m = K (x_m - x_s') + K_d (v_m - v_s') + B v_m        f_s = K (x_m' - x_s) + K_d (v_m' - v_s) - B v_s.

Sent both ways: position and velocity. The two ends with their own damping, B_m = B + b_m and B_s = B + b_s, are passive
over a constant delay iff

    (K_d + B_m) (K_d + B_s) >= max over phi of (K_d cos phi - c sin phi/phi)^2,   c = K (T1 + T2)/2,

sampled with T + dt for T in the main (`teleop.law.injection` derives it). For equal ends and small K_d that is
B >= c - 2 K_d: the damper over the link saves twice what it is, up to B = 0.24 c at K_d = 0.4 c. Where the delay varies
or packets are lost it takes K_d = 0, which is P+d (`p_d`). `conditions` names what is broken and the least B, `fitted`
raises B to it, and sets K_d = 0 where the delay varies.

Claims: nothing; the ends' own damping is in the condition, and no ledger has it. Seed energy: none.

What an end does when its watchdog has let go (`rejoin`) is that of `teleop.laws.pp`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.knob import Knob, check_knobs
from teleop.law import At, injection
from teleop.law.offers import Facts

AT_ONCE = 1e12  # 1/s


class Forth(NamedTuple):
    x: kind.Position  # the master's, m
    v: float  # the master's velocity, m/s


class Back(NamedTuple):
    x: kind.Position  # the slave's, m
    v: float  # the slave's velocity, m/s


class PDDampedEnd(NamedTuple):
    offset: float  # x_m - x_s at which the coupling is slack, m


@dataclass(frozen=True, kw_only=True)
class PDDamped:
    """Spring-damper from each end to the other's delayed motion, and a damper at each."""

    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 1e4))] = 100.0
    K_d: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.05, 100.0))] = 2.0
    B: Annotated[float, Knob("N s/m", "damping injected at each end", low=0.0, span=(0.1, 500.0))] = 2.0
    rejoin: Annotated[float, Knob(
        "1/s", "rate at which an end that was let go is drawn back", low=0.0, span=(0.1, 50.0))] = 2.0

    claims: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_knobs(self)

    def conditions(self, facts: Facts) -> tuple[str, ...]:
        return injection.conditions("PD+d", facts, self.K, self.K_d, self.B)

    def fitted(self, facts: Facts) -> PDDamped:
        K_d = 0.0 if injection.varies(facts) else self.K_d
        return replace(self, K_d=K_d, B=max(self.B, injection.needed(facts, self.K, K_d) or 0.0))

    def linear(self) -> PDDamped:
        return replace(self, rejoin=AT_ONCE)

    def master_start(self, at: At) -> tuple[PDDampedEnd, Back]:
        return PDDampedEnd(0.0), Back(at.x, 0.0)  # until the first message: no spring force

    def slave_start(self, at: At) -> tuple[PDDampedEnd, Forth]:
        return PDDampedEnd(0.0), Forth(at.x, 0.0)

    def master(self, s: PDDampedEnd, at: At, rx: Back) -> tuple[float, Forth, PDDampedEnd]:
        apart = at.x - rx.x
        offset = (s.offset + (1.0 - at.gain) * (apart - s.offset)) * max(1.0 - self.rejoin * at.span, 0.0)
        f_m = self.K * (apart - offset) + self.K_d * (at.v - rx.v) + self.B * at.v
        return f_m, Forth(at.x, at.v), PDDampedEnd(offset)

    def slave(self, s: PDDampedEnd, at: At, rx: Forth) -> tuple[float, Back, PDDampedEnd]:
        apart = rx.x - at.x
        offset = (s.offset + (1.0 - at.gain) * (apart - s.offset)) * max(1.0 - self.rejoin * at.span, 0.0)
        f_s = self.K * (apart - offset) + self.K_d * (rx.v - at.v) - self.B * at.v
        return f_s, Back(at.x, at.v), PDDampedEnd(offset)
