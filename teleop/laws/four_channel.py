"""Four channels: motion and force both ways, with local force feedback at each end.

Source: D. A. Lawrence, "Stability and transparency in bilateral teleoperation", IEEE Trans. Robotics and Automation
9(5), 1993; local force feedback: K. Hashtrudi-Zaad and S. E. Salcudean, "Transparency in time-delayed systems and the
effect of local force feedback for transparent teleoperation", IEEE Trans. Robotics and Automation 18(1), 2002.
With C = K/s + B on velocities, ' for what came over the link,

    f_m = C_m v_m + C4 v_s' + C2 f_env' - C6 f_h        f_s = C1 v_m' - C_s v_s + C3 f_h' - C5 f_env
    C_m = C_s = C,   C1 = C_s,   C4 = -C_m,   C2 = 1 + C6,   C3 = 1 + C5,

the gains of full transparency but for the ends' own inertia: for C1 and C4 to cancel it would take accelerations.
Sent both ways: position, velocity and the force at that end, which both ends read (sensor or observer). Without delay
motion and force agree at both ends, and the impedance of free motion is the sum of both ends' over 2 + C5 + C6: the
local feedback C5 = C6 divides it by 1 + C6 exactly.

Active with delay, whatever the gains: forces pass at full strength both ways, and nothing takes up what the delay makes
of them. Without delay it is passive between equal ends alone; with others, C1 and C4 without their inertia, it is not.
A sensor that feels the hand's own mass makes a loop of gain C6 m_h/(M_m + m_h) from tick to tick, which has to stay
below 1; an observer slows it.

Claims: nothing. Seed energy: none.

What an end does when its watchdog has let go (`rejoin`) is that of `teleop.laws.pp`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.knob import Knob, check_knobs
from teleop.law import At
from teleop.law.offers import Facts

AT_ONCE = 1e12  # 1/s


class Forth(NamedTuple):
    x: kind.Position  # the master's, m
    v: float  # the master's velocity, m/s
    f_h: float  # force of the hand, N


class Back(NamedTuple):
    x: kind.Position  # the slave's, m
    v: float  # the slave's velocity, m/s
    f_env: float  # force of the slave on the environment, N


class FourChannelEnd(NamedTuple):
    offset: float  # x_m - x_s at which the coupling is slack, m


@dataclass(frozen=True, kw_only=True)
class FourChannel:
    """Motion and force both ways, with local force feedback."""

    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 200.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.1, 500.0))] = 4.0
    C5: Annotated[float, Knob("", "local force feedback at the slave", low=0.0, span=(0.0, 1.0))] = 0.0
    C6: Annotated[float, Knob("", "local force feedback at the master", low=0.0, span=(0.0, 1.0))] = 0.0
    rejoin: Annotated[float, Knob(
        "1/s", "rate at which an end that was let go is drawn back", low=0.0, span=(0.1, 50.0))] = 2.0

    claims: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_knobs(self)

    def conditions(self, facts: Facts) -> tuple[str, ...]:
        ages = [way.greatest for way in (facts.fwd, facts.bwd) if way is not None]
        equal = (facts.mass_m, facts.damping_m) == (facts.mass_s, facts.damping_s)
        if equal and len(ages) == 2 and max(ages) <= 1.5 * facts.dt:
            return ()
        delay = f"T1 + T2 = {sum(ages):g} s" if len(ages) == 2 else "one way no message was played"
        ends = "equal ends" if equal else (f"{facts.mass_m:g} kg, {facts.damping_m:g} N s/m and {facts.mass_s:g} kg, "
                                           f"{facts.damping_s:g} N s/m at its ends")
        return ("four channels are passive between equal ends without delay alone, whatever their gains; with "
                f"{delay} and {ends} they are not: --set delay=0 is the most that is, or take --set law=wave",)

    def linear(self) -> FourChannel:
        return replace(self, rejoin=AT_ONCE)

    def master_start(self, at: At) -> tuple[FourChannelEnd, Back]:
        return FourChannelEnd(0.0), Back(at.x, 0.0, 0.0)  # until the first message: nothing of the coupling

    def slave_start(self, at: At) -> tuple[FourChannelEnd, Forth]:
        return FourChannelEnd(0.0), Forth(at.x, 0.0, 0.0)

    def master(self, s: FourChannelEnd, at: At, rx: Back) -> tuple[float, Forth, FourChannelEnd]:
        apart = at.x - rx.x
        offset = (s.offset + (1.0 - at.gain) * (apart - s.offset)) * max(1.0 - self.rejoin * at.span, 0.0)
        motion = self.K * (apart - offset) + self.B * (at.v - rx.v)
        return motion + (1.0 + self.C6) * rx.f_env - self.C6 * at.f, Forth(at.x, at.v, at.f), FourChannelEnd(offset)

    def slave(self, s: FourChannelEnd, at: At, rx: Forth) -> tuple[float, Back, FourChannelEnd]:
        apart = rx.x - at.x
        offset = (s.offset + (1.0 - at.gain) * (apart - s.offset)) * max(1.0 - self.rejoin * at.span, 0.0)
        motion = self.K * (apart - offset) + self.B * (rx.v - at.v)
        return motion + (1.0 + self.C5) * rx.f_h - self.C5 * at.f, Back(at.x, at.v, at.f), FourChannelEnd(offset)
