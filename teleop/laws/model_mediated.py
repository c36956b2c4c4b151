"""Model-mediated: the slave sends what it touches as a model, k and x_0, and the master renders it without delay.

Source: B. Hannaford, "A design framework for teleoperators with kinesthetic feedback", IEEE Trans. Robotics and
Automation 5(4), 1989; P. Mitra and G. Niemeyer, "Model-mediated telemanipulation", Int. J. Robotics Research 27(2),
2008. Sent forth: position and velocity, which the slave tracks, f_s = K (x_m' - x_s) + B (v_m' - v_s). Sent back: the
model, a spring k (N/m) that begins at x_0 on one side, positive or negative.

The slave's estimate is that of recursive least squares of f_env = k (x - x_c) + c about the place x_c where it touched
first, with forgetting lambda: with a = (x - x_c, 1) and P = diag(1e6, 1e2) to begin with,

    theta += P a (f_env - a theta)/(lambda + a P a)        P = (P - P a a P/(lambda + a P a))/lambda,

which is written by det P, so that rounding leaves P positive. Without a bound P would grow for ever in a steady push.
Where k's or c's entry exceeds ten times its beginning, its row and column are scaled down. (P scaled as a whole, by its
trace, would lose the forgetting of what is seen: c stood still after half a minute's push.) The estimate itself is not
clipped: a k cut off in the state sends c, and x_0 = x_c - c/k, away for ever.

The master renders f_m = k' p + B_m v_m with p the depth x_m - x_0 on the model's side. A model that changes under the
hand would give it energy, k p^2/2 from nothing. E is the work that the port took in, that of the damper too, less what
is dropped above E_max; it is the spring's energy V and a tank. A model gets no more than that,

    k' = min(k, 2 (V + tank)/p^2) = min(k, 2 E/p^2).

So k'p^2/2 <= E at every tick. Held over a tick with the motion dx, the spring gives at most k'p^2/2 + k'dx^2/2, after
which E may be below zero, and k' = 0 until the damper has paid. With velocities from v to v', linear in the tick, the
damper takes B_m dt (v + v')^2/4 and B_m dt (v^2 - v'^2)/4; the second telescopes. So the port never gives more than it
took but for k' dx^2/2 + B_m v^2 dt/4 of one tick, under every link and every model that comes.

Before the first contact: k' = 0, the hand feels B_m, and the tank fills. At a touch, |f_env| > touch, the estimate
begins anew at the place, with the last k (k_0 at first). After contact the model stays: the wall is felt where it was
left, at once. Where the slave passes the model's place and feels nothing, that counts as a sample of 0: the model goes.

Claims: nothing, for E_port counts the slave's port too. Seed energy: none, the tank begins empty.

The analyses take the model held at k_0 on both sides (`linear`). A slave that was let go (`rejoin`): `teleop.laws.pp`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.knob import Knob, check_knobs
from teleop.law import At

P_K, P_C = 1e6, 1e2  # P of the two parameters at a touch
MOST = 10.0  # times these, which P does not exceed
LEAST_K = 1.0  # N/m: below this a place x_0 means nothing
TINY = 1e-300  # under a denominator that may be zero


class Forth(NamedTuple):
    x: kind.Position  # the master's, m
    v: float  # the master's velocity, m/s


class Back(NamedTuple):
    k: float  # stiffness of the model, N/m
    x_0: float  # where it begins, m
    side: float  # 1 or -1: the direction in which it is pressed; 0 before the first contact


class ModelMediatedMaster(NamedTuple):
    stored: float  # energy of the spring and of the tank, J
    k: float  # stiffness as rendered, N/m


class ModelMediatedSlave(NamedTuple):
    touching: float  # 1 in contact, else 0
    x_c: float  # place of contact, m
    k: float  # N/m
    c: float  # N, force at x_c
    side: float
    p11: float
    p12: float
    p22: float
    offset: float  # x_m - x_s at which the coupling is slack, m


@dataclass(frozen=True, kw_only=True)
class ModelMediated:
    """Spring estimated at the slave and rendered at the master."""

    K: Annotated[float, Knob("N/m", "stiffness of the slave's coupling", low=0.0, span=(10.0, 3e4))] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the slave's coupling", low=0.0, span=(0.1, 500.0))] = 20.0
    B_m: Annotated[float, Knob(
        "N s/m", "damping at the master, which fills the tank", low=0.0, span=(0.03, 100.0))] = 1.0
    k_0: Annotated[float, Knob("N/m", "stiffness assumed at the first touch", low=0.0, span=(0.0, 5e3))] = 0.0
    forget: Annotated[float, Knob(
        "", "weight of the past at each sample, lambda", above=0.0, high=1.0, span=(0.9, 1.0))] = 0.998
    touch: Annotated[float, Knob("N", "force above which the slave is in contact", low=0.0, span=(3e-3, 3.0))] = 0.1
    E_max: Annotated[float, Knob("J", "energy that the tank keeps", low=0.0, span=(1e-3, 3.0))] = 0.1
    rejoin: Annotated[float, Knob(
        "1/s", "rate at which a slave that was let go is drawn back", low=0.0, span=(0.1, 50.0))] = 2.0

    claims: ClassVar[Mapping[str, str]] = {}
    shows: ClassVar[tuple[str, ...]] = ("k", "stored")
    no_rotation: ClassVar[str] = "its model is a spring from a place on each axis by itself, which no orientation has"

    def __post_init__(self) -> None:
        check_knobs(self)

    def linear(self) -> ModelHeld:
        return ModelHeld(K=self.K, B=self.B, B_m=self.B_m, k=self.k_0)

    def master_start(self, at: At) -> tuple[ModelMediatedMaster, Back]:
        return ModelMediatedMaster(0.0, 0.0), Back(0.0, at.x, 0.0)

    def slave_start(self, at: At) -> tuple[ModelMediatedSlave, Forth]:
        return ModelMediatedSlave(0.0, at.x, self.k_0, 0.0, 0.0, P_K, 0.0, P_C, 0.0), Forth(at.x, 0.0)

    def master(self, s: ModelMediatedMaster, at: At, rx: Back) -> tuple[float, Forth, ModelMediatedMaster]:
        E = s.stored + at.f_held * at.dx
        p = max(rx.side * (at.x - rx.x_0), 0.0)
        k = min(rx.k, 2.0 * max(E, 0.0) / max(p * p, TINY))
        E = min(E, 0.5 * k * p * p + self.E_max)
        return rx.side * k * p + self.B_m * at.v, Forth(at.x, at.v), ModelMediatedMaster(E, k)

    def slave(self, s: ModelMediatedSlave, at: At, rx: Forth) -> tuple[float, Back, ModelMediatedSlave]:
        x, f, lam = at.x, at.f, self.forget
        now = 1.0 * (max(f, -f) > self.touch)
        begin = now * (1.0 - s.touching)
        x_c = begin * x + (1.0 - begin) * s.x_c
        c = (1.0 - begin) * s.c
        p11, p12 = begin * P_K + (1.0 - begin) * s.p11, (1.0 - begin) * s.p12
        p22 = begin * P_C + (1.0 - begin) * s.p22
        side = now * ((f > 0.0) * 1.0 - (f < 0.0) * 1.0) + (1.0 - now) * s.side
        d = x - x_c
        felt = s.k * d + c
        use = max(now, 1.0 * (side * felt > self.touch))  # in contact, or where the model says so
        a1, a2 = p11 * d + p12, p12 * d + p22
        q = lam + a1 * d + a2
        k = s.k + use * (a1 / q * (f - felt))
        c = c + use * (a2 / q * (f - felt))
        det = max(p11 * p22 - p12 * p12, 0.0)
        n11, n12, n22 = (p11 + det / lam) / q, (p12 - d * det / lam) / q, (p22 + d * d * det / lam) / q
        r, t = sqrt(min(1.0, MOST * P_K / max(n11, TINY))), sqrt(min(1.0, MOST * P_C / max(n22, TINY)))
        p11, p12 = p11 + use * (r * r * n11 - p11), p12 + use * (r * t * n12 - p12)
        p22 = p22 + use * (t * t * n22 - p22)
        apart = rx.x - x
        offset = (s.offset + (1.0 - at.gain) * (apart - s.offset)) * max(1.0 - self.rejoin * at.span, 0.0)
        f_s = self.K * (apart - offset) + self.B * (rx.v - at.v)
        sent = Back(max(k, 0.0), x_c - c / max(k, LEAST_K), side)
        return f_s, sent, ModelMediatedSlave(now, x_c, k, c, side, p11, p12, p22, offset)


@dataclass(frozen=True, kw_only=True)
class ModelHeld:
    """A model that stays as it is: what the linear analyses take in place of `ModelMediated`, in contact."""

    K: float
    B: float
    B_m: float
    k: float

    claims: ClassVar[Mapping[str, str]] = {}

    def master_start(self, at: At) -> tuple[tuple[()], Back]:
        return (), Back(self.k, 0.0, 1.0)

    def slave_start(self, at: At) -> tuple[tuple[()], Forth]:
        return (), Forth(at.x, 0.0)

    def master(self, s: tuple[()], at: At, rx: Back) -> tuple[float, Forth, tuple[()]]:
        return self.k * at.x + self.B_m * at.v, Forth(at.x, at.v), s

    def slave(self, s: tuple[()], at: At, rx: Forth) -> tuple[float, Back, tuple[()]]:
        return self.K * (rx.x - at.x) + self.B * (rx.v - at.v), Back(0.0, 0.0, 0.0), s
