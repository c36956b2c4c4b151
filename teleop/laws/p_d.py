"""P+d: each end is drawn to where the other was by a spring, and damped where it is.

Source: E. Nuno, R. Ortega, N. Barabanov and L. Basanez, "A globally stable PD controller for bilateral teleoperators",
IEEE Trans. Robotics 24(3), 2008, and E. Nuno, L. Basanez and R. Ortega, "Passivity-based control for bilateral
teleoperation: a tutorial", Automatica 47(3), 2011. With x' the other end's newest position,

    f_m = K (x_m - x_s') + B v_m        f_s = K (x_m' - x_s) - B v_s.

Sent both ways: the position. The two ends with their own damping, B_m = B + b_m and B_s = B + b_s, are passive iff

    4 B_m B_s >= K^2 (T1 + T2)^2,

with the greatest ages, gaps among them, also where the delay varies or packets are lost; sampled with T + dt for T
(`teleop.law.injection` derives it). `conditions` names the least B, `fitted` raises B to it. The damping is the drag in
free space: 2 B at low frequency for a hand that moves both ends, about K (T1 + T2).

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


class Back(NamedTuple):
    x: kind.Position  # the slave's, m


class PDampedEnd(NamedTuple):
    offset: float  # x_m - x_s at which the coupling is slack, m


@dataclass(frozen=True, kw_only=True)
class PDamped:
    """Spring from each end to the other's delayed position, and a damper at each."""

    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 1e4))] = 100.0
    B: Annotated[float, Knob("N s/m", "damping injected at each end", low=0.0, span=(0.1, 500.0))] = 5.0
    rejoin: Annotated[float, Knob(
        "1/s", "rate at which an end that was let go is drawn back", low=0.0, span=(0.1, 50.0))] = 2.0

    claims: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_knobs(self)

    def conditions(self, facts: Facts) -> tuple[str, ...]:
        return injection.conditions("P+d", facts, self.K, 0.0, self.B)

    def fitted(self, facts: Facts) -> PDamped:
        return replace(self, B=max(self.B, injection.needed(facts, self.K, 0.0) or 0.0))

    def linear(self) -> PDamped:
        return replace(self, rejoin=AT_ONCE)

    def master_start(self, at: At) -> tuple[PDampedEnd, Back]:
        return PDampedEnd(0.0), Back(at.x)  # until the first message: no spring force

    def slave_start(self, at: At) -> tuple[PDampedEnd, Forth]:
        return PDampedEnd(0.0), Forth(at.x)

    def master(self, s: PDampedEnd, at: At, rx: Back) -> tuple[float, Forth, PDampedEnd]:
        apart = at.x - rx.x
        offset = (s.offset + (1.0 - at.gain) * (apart - s.offset)) * max(1.0 - self.rejoin * at.span, 0.0)
        return self.K * (apart - offset) + self.B * at.v, Forth(at.x), PDampedEnd(offset)

    def slave(self, s: PDampedEnd, at: At, rx: Forth) -> tuple[float, Back, PDampedEnd]:
        apart = rx.x - at.x
        offset = (s.offset + (1.0 - at.gain) * (apart - s.offset)) * max(1.0 - self.rejoin * at.span, 0.0)
        return self.K * (apart - offset) - self.B * at.v, Back(at.x), PDampedEnd(offset)
