"""Position-position: each end is drawn to where the other was by a spring-damper.

Source: the position-error architecture, e.g. D. A. Lawrence, "Stability and transparency in bilateral teleoperation",
IEEE Trans. Robotics and Automation 9(5), 1993. With x' and v' the other end's newest position and velocity,

    f_m = K (x_m - x_s') + B (v_m - v_s')        f_s = K (x_m' - x_s) + B (v_m' - v_s).

Sent both ways: position and velocity. Without delay this is one spring-damper between the ends: a wall k_e is felt as
k_e K/(k_e + K), and in free space both ends' inertia and damping. Over a delay the spring asks each
end for a damper of K (T1 + T2)/2. B over the link is worth part of it, the rest is left to the ends' own damping: the
condition in `teleop.law.injection`, with B for K_d and no damping injected. `p_d` and `pd_d` inject it.

Claims: nothing. Seed energy: none.

Where a watchdog lets go of an end (`at.gain` below 1), its coupling goes slack at the distance that there is, and
this offset dies away at the rate `rejoin`. So an end that takes hold again is drawn to the other over 1/rejoin seconds,
and not by the whole stretch of the silence at once. Without a watchdog, and before it lets go, the offset is 0. The
linear analyses take the law without this memory (`linear`).
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


class PositionPositionEnd(NamedTuple):
    offset: float  # x_m - x_s at which the coupling is slack, m


@dataclass(frozen=True, kw_only=True)
class PositionPosition:
    """Spring-damper from each end to the other's delayed position and velocity."""

    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 400.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.1, 500.0))] = 4.0
    rejoin: Annotated[float, Knob(
        "1/s", "rate at which an end that was let go is drawn back", low=0.0, span=(0.1, 50.0))] = 2.0

    claims: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_knobs(self)

    def conditions(self, facts: Facts) -> tuple[str, ...]:
        cure = f"--set law=pd_d --set law.K={self.K:g} --set law.K_d={self.B:g} --set law.B={{:g}}"
        return injection.conditions("position-position, its B as K_d,", facts, self.K, self.B, 0.0, cure)

    def linear(self) -> PositionPosition:
        return replace(self, rejoin=AT_ONCE)

    def master_start(self, at: At) -> tuple[PositionPositionEnd, Back]:
        return PositionPositionEnd(0.0), Back(at.x, 0.0)  # until the first message: no force

    def slave_start(self, at: At) -> tuple[PositionPositionEnd, Forth]:
        return PositionPositionEnd(0.0), Forth(at.x, 0.0)

    def master(self, s: PositionPositionEnd, at: At, rx: Back) -> tuple[float, Forth, PositionPositionEnd]:
        apart = at.x - rx.x
        offset = (s.offset + (1.0 - at.gain) * (apart - s.offset)) * max(1.0 - self.rejoin * at.span, 0.0)
        return self.K * (apart - offset) + self.B * (at.v - rx.v), Forth(at.x, at.v), PositionPositionEnd(offset)

    def slave(self, s: PositionPositionEnd, at: At, rx: Forth) -> tuple[float, Back, PositionPositionEnd]:
        apart = rx.x - at.x
        offset = (s.offset + (1.0 - at.gain) * (apart - s.offset)) * max(1.0 - self.rejoin * at.span, 0.0)
        return self.K * (apart - offset) + self.B * (rx.v - at.v), Back(at.x, at.v), PositionPositionEnd(offset)
