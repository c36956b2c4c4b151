"""Direct position-force control: the honest unstable baseline.

The master sends its motion; the slave tracks it with a spring-damper and sends back the force that it
exerts on the environment, which the master renders to the hand, scaled by a reflection gain kf:

    f_s = K (x_d - x_s) + B (v_d - v_s)        f_m = kf f_env

Source: the position-force architecture, e.g. B. Hannaford, "A design framework for teleoperators with
kinesthetic feedback", IEEE Trans. Robotics and Automation 5(4), 1989; unstable for any delay against a
wall stiff enough.

Claims: nothing. It sends no waves, and its two-port generates energy as soon as there is a delay. Seed energy: none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.knob import Knob, check_knobs
from teleop.law import At


class Forth(NamedTuple):
    x: kind.Position  # the master's, m
    v: float  # the master's velocity, m/s


class Back(NamedTuple):
    f_env: float  # force of the slave on the environment, N


@dataclass(frozen=True, kw_only=True)
class Direct:
    """Position forth, measured force back, nothing in between."""

    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.1, 500.0))] = 20.0
    kf: Annotated[float, Knob("", "gain of the reflected force", low=0.0, span=(0.03, 3.0))] = 1.0

    claims: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_knobs(self)

    def master_start(self, at: At) -> tuple[tuple[()], Back]:
        return (), Back(0.0)

    def slave_start(self, at: At) -> tuple[tuple[()], Forth]:
        return (), Forth(at.x, 0.0)  # until the first message: stay

    def master(self, s: tuple[()], at: At, rx: Back) -> tuple[float, Forth, tuple[()]]:
        return self.kf * rx.f_env, Forth(at.x, at.v), s

    def slave(self, s: tuple[()], at: At, rx: Forth) -> tuple[float, Back, tuple[()]]:
        f_s = self.K * (rx.x - at.x) + self.B * (rx.v - at.v)
        return f_s, Back(at.f), s
