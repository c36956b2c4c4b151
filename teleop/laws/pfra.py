"""Projection-based force reflection (PFRA).

Source: I. G. Polushin, P. X. Liu and C.-H. Lung, "A force-reflection algorithm for improved
transparency in bilateral teleoperation with communication delay", IEEE/ASME Trans. Mechatronics
12(3), 2007, and "Projection-based force reflection algorithm for stable bilateral teleoperation over
networks", IEEE Trans. Instrumentation and Measurement 57(9), 2008.

The master sends its motion; the slave tracks it with a spring-damper and sends f_env back. The part of
the reflected force (scaled by a gain kf) that the hand already resists is rendered in full; the rest,
which would move the master by itself, is scaled by alpha:

    phi_env = sat[0,1]( <f_env, f_h> / max(|f_h|^2, eps) ) f_h        f_m = alpha f_env + (1 - alpha) phi_env

with sat[a,b]{x} = max(a, min(x, b)), eps = 1e-12 N^2, and f_h from a force sensor or an observer
(teleop.stages.observer). <.,.> runs over all axes, so this end couples them. alpha = 1 is direct force
reflection, bit for bit on finite inputs (up to the sign of a zero).

Claims: nothing of the ledgers. With alpha = 0: <f_m, f_h> >= 0 and |f_m| <= |f_h|, at any gain and any delay, f_h
what the sensor or the observer says. So a master at rest is not moved while that is 0: one that no hand has held yet,
or with a force sensor one that none holds. The observer forgets a hand that has let go within about 1/L, L its
bandwidth (1/s). Until then the reflection may move the master, by an impulse of at most the integral of |f_h_hat|,

    sum |f_m| dt <= |f_h_hat| dt/(1 - exp(-L dt)), near |f_h_hat|/L,

and a master of damping b by at most this over b, however large f_env is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

from teleop.knob import Knob, check_knobs
from teleop.law import At

EPS = 1e-12  # N^2: below this |f_h|^2 the hand's direction means nothing


class Forth(NamedTuple):
    x: float  # the master's position, m
    v: float  # the master's velocity, m/s


class Back(NamedTuple):
    f_env: float  # force of the slave on the environment, N


class Sums(NamedTuple):
    eh: float  # <kf f_env, f_h>, N^2
    hh: float  # |f_h|^2, N^2


@dataclass(frozen=True, kw_only=True)
class PFRA:
    """Force reflection projected on the force of the hand."""

    alpha: Annotated[float, Knob("", "weight of the part that the hand does not resist", low=0.0, high=1.0)] = 0.0
    kf: Annotated[float, Knob("", "gain of the reflected force", low=0.0)] = 1.0
    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0)] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0)] = 20.0

    claims: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_knobs(self)

    def master_start(self, at: At) -> tuple[tuple[()], Back]:
        return (), Back(0.0)

    def slave_start(self, at: At) -> tuple[tuple[()], Forth]:
        return (), Forth(at.x, 0.0)  # until the first message: stay

    def master_sums(self, s: tuple[()], at: At, rx: Back) -> Sums:
        return Sums(self.kf * rx.f_env * at.f, at.f * at.f)

    def master(self, s: tuple[()], at: At, rx: Back, over: Sums) -> tuple[float, Forth, tuple[()]]:
        share = max(0.0, min(over.eh / max(over.hh, EPS), 1.0))
        f_m = self.alpha * (self.kf * rx.f_env) + (1.0 - self.alpha) * (share * at.f)
        return f_m, Forth(at.x, at.v), s

    def slave(self, s: tuple[()], at: At, rx: Forth) -> tuple[float, Back, tuple[()]]:
        f_s = self.K * (rx.x - at.x) + self.B * (rx.v - at.v)
        return f_s, Back(at.f), s
