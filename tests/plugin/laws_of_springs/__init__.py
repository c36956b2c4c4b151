"""A law of a package of its own: direct position-force reflection, in a plug-in's own lines.

It sends and answers what `teleop.laws.direct` does: the tests hold each way of running it to that law's bits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

from teleop import At, Knob, check_knobs


class Forth(NamedTuple):
    x: float  # m
    v: float  # m/s


class Back(NamedTuple):
    f_env: float  # N


@dataclass(frozen=True, kw_only=True)
class Springs:
    """Reflection of the slave's force, the slave on a spring and a damper."""

    kf: Annotated[float, Knob("", "gain of the reflected force")] = 1.0
    K: Annotated[float, Knob("N/m", "stiffness of the spring", low=0.0)] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the damper", low=0.0)] = 20.0

    claims: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_knobs(self)

    def master_start(self, at: At) -> tuple[tuple[()], Back]:
        return (), Back(0.0)

    def slave_start(self, at: At) -> tuple[tuple[()], Forth]:
        return (), Forth(at.x, 0.0)

    def master(self, s: tuple[()], at: At, rx: Back) -> tuple[float, Forth, tuple[()]]:
        return self.kf * rx.f_env, Forth(at.x, at.v), s

    def slave(self, s: tuple[()], at: At, rx: Forth) -> tuple[float, Back, tuple[()]]:
        return self.K * (rx.x - at.x) + self.B * (rx.v - at.v), Back(at.f), s
