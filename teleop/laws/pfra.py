"""Projection-based force reflection (PFRA): the slave's force is felt as far as the hand resists it.

Sends position and velocity forth, the force on the environment back. Claims no ledger; no seed energy.

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

Weights per direction. I. G. Polushin, P. X. Liu and C.-H. Lung, "Human dynamics and stability of teleoperator systems
with generalized projection-based force reflection algorithms", IFAC World Congress 2011, prove stability for a broad
class of projections. Taken from there is that the part in phi_env needs no bound, and that what is rendered beside it
enters a small-gain condition; the parts and the conditions below are derived here. With F = kf f_env, q = <F,
f_h>/max(|f_h|^2, eps)

    F - phi_env = max(q - 1, 0) f_h + min(q, 0) f_h + (F - q f_h):   pushes the hand back, pulls it on, acts across,

and each part has a weight of its own, `push`, `pull` and `across`, on top of alpha, together at most 1. To a hand that
exerts nothing all of F acts across.

Small gain. M_m a_m + b_m v_m = f_h - f_m with f_m = s f_h + e, s in [0,1]: the hand's part takes energy from nothing
but the hand, the master from e to v_m has the gain 1/b_m (in L2), and it moves the slave, whose force is in e, of the
gain gamma. So weight gamma/b_m < 1 is enough at any delay, constant or not; gamma is the environment's, and has no
bound beforehand. `rest_gain` bounds the other factor: of the rest R that the weights leave out,

    f_m += min(1, rest_gain |v_m|/|R|) R   with   rest_gain < b_m

is felt. It gives the master at most rest_gain |v_m|^2 of power and the damping takes b_m |v_m|^2, so this part moves
nothing at rest and speeds up nothing by itself, over any link and at any stiffness. Held for a tick too: the master
goes from v to e v - (1 - e) f_m/b_m with e = exp(-b_m dt/M_m), no faster than |v| where |f_m| <= b_m |v|.

Claims: nothing of the ledgers. With all weights 0: <f_m, f_h> >= 0 and |f_m| <= |f_h|, at any gain and any delay, f_h
what the sensor or the observer says. So a master at rest is not moved while that is 0: one that no hand has held yet,
or with a force sensor one that none holds. The observer forgets a hand that has let go within about 1/L, L its
bandwidth (1/s). Until then the reflection may move the master, by an impulse of at most the integral of |f_h_hat|,

    sum |f_m| dt <= |f_h_hat| dt/(1 - exp(-L dt)), near |f_h_hat|/L,

and a master of damping b by at most this over b, however large f_env is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isnan, sqrt
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.knob import Knob, check_knobs
from teleop.law import At
from teleop.law.offers import Facts

EPS = 1e-12  # N^2: below this |f_h|^2 the hand's direction means nothing
TINY = 1e-150  # N, in place of no force under a fraction


class Forth(NamedTuple):
    x: kind.Position  # the master's, m
    v: float  # the master's velocity, m/s


class Back(NamedTuple):
    f_env: float  # force of the slave on the environment, N


class PFRASums(NamedTuple):
    eh: float  # <F, f_h>, N^2
    hh: float  # |f_h|^2, N^2
    ee: float  # |F|^2, N^2
    vv: float  # |v_m|^2, (m/s)^2


@dataclass(frozen=True, kw_only=True)
class PFRA:
    """Force reflection projected on the force of the hand."""

    alpha: Annotated[float, Knob(
        "", "weight of the part that the hand does not resist", low=0.0, high=1.0, span=(0.0, 1.0))] = 0.0
    kf: Annotated[float, Knob("", "gain of the reflected force", low=0.0, span=(0.03, 3.0))] = 1.0
    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.1, 500.0))] = 20.0
    push: Annotated[float, Knob(
        "", "weight, beside alpha, of what exceeds the hand's force", low=0.0, high=1.0, span=(0.0, 1.0))] = 0.0
    pull: Annotated[float, Knob(
        "", "weight, beside alpha, of what pulls the hand on", low=0.0, high=1.0, span=(0.0, 1.0))] = 0.0
    across: Annotated[float, Knob(
        "", "weight, beside alpha, of what acts across the hand", low=0.0, high=1.0, span=(0.0, 1.0))] = 0.0
    rest_gain: Annotated[float, Knob(
        "N s/m", "gain from the master's speed to the rest that is felt", low=0.0, span=(0.0, 5.0))] = 0.0

    claims: ClassVar[Mapping[str, str]] = {}
    linear_at: ClassVar[Mapping[str, float]] = {"alpha": 1.0}

    def __post_init__(self) -> None:
        check_knobs(self)

    def fitted(self, facts: Facts) -> PFRA:
        """The law with no more of the rest that is lent than the master's own damping, where that is known."""
        return self if isnan(facts.damping_m) else replace(self, rest_gain=min(self.rest_gain, facts.damping_m))

    def master_start(self, at: At) -> tuple[tuple[()], Back]:
        return (), Back(0.0)

    def slave_start(self, at: At) -> tuple[tuple[()], Forth]:
        return (), Forth(at.x, 0.0)  # until the first message: stay

    def master_sums(self, s: tuple[()], at: At, rx: Back) -> PFRASums:
        F = self.kf * rx.f_env
        return PFRASums(F * at.f, at.f * at.f, F * F, at.v * at.v)

    def master(self, s: tuple[()], at: At, rx: Back, over: PFRASums) -> tuple[float, Forth, tuple[()]]:
        alpha, F = self.alpha, self.kf * rx.f_env
        q = over.eh / max(over.hh, EPS)
        share = max(0.0, min(q, 1.0))
        f_m = alpha * F + (1.0 - alpha) * (share * at.f)
        left = 1.0 - alpha  # the weight that each part may still have
        push, pull, across = min(self.push, left), min(self.pull, left), min(self.across, left)
        along = q - share  # of F, in units of f_h; the rest is across
        f_m = f_m + (push * max(along, 0.0) + pull * min(along, 0.0)) * at.f + across * (F - q * at.f)
        along = (left - push) * max(along, 0.0) + (left - pull) * min(along, 0.0)
        beside = left - across
        size = along * along * over.hh + beside * beside * max(over.ee - q * (2.0 * over.eh - q * over.hh), 0.0)
        felt = min(1.0, self.rest_gain * sqrt(over.vv) / max(sqrt(size), TINY))
        return f_m + felt * (along * at.f + beside * (F - q * at.f)), Forth(at.x, at.v), s

    def slave(self, s: tuple[()], at: At, rx: Forth) -> tuple[float, Back, tuple[()]]:
        f_s = self.K * (rx.x - at.x) + self.B * (rx.v - at.v)
        return f_s, Back(at.f), s

    def conditions(self, facts: Facts) -> tuple[str, ...]:
        """The bound on the rest that is felt, where it is above the master's damping."""
        if not self.rest_gain > facts.damping_m:  # NaN: a master whose damping is not known here
            return ()
        return ("the rest that is lent moves nothing by itself where rest_gain <= b_m, the master's damping; with "
                f"law.rest_gain={self.rest_gain:g} it may: --set law.rest_gain={facts.damping_m:g} is the most",)
