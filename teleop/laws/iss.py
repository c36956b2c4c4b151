"""Force and its derivative back, position less a share of it forth: named after input-to-state stability.

Source: after I. G. Polushin and H. J. Marquez, "Stabilization of bilaterally controlled teleoperators with
communication delay: an ISS approach", Int. J. Control 76(8), 2003. Here:

    f_m = f_s' + tau df_s'        v_d = v_m' - df_s/mu        f_s = K (x_d - x_s) + B (v_d - v_s),

' for what came over the link, df_s the derivative of f_s. It is taken at the slave, from one tick to the next, and sent
beside the force: differences of what arrives would be those of the network's jitter. x_d = x_m' - f_s/mu needs f_s at
the same instant; taken from the tick before, as published, the loop of gain 2 B/(mu dt) + K/mu diverges above 1. Solved
together with df_s = (f_s - f_s0)/dt, f_s0 the force of the tick before (backward Euler on the coupling),

    f_s = (K (x_m' - x_s) + B (v_m' - v_s) + B f_s0/(mu dt)) / (1 + K/mu + B/(mu dt)).

What it is: a lead of time constant tau on the reflected force, and a spring mu in series with the coupling. Sent forth:
position and velocity; back: force and its derivative. Neither bounds the energy that a delay makes: the lead takes a
few milliseconds out of the round trip, the spring lowers the gain.

Claims: nothing. Seed energy: none.

The slave tells of the force that its watchdog lets it have, and takes the stretch out of the coupling as it lets go,
see `teleop.laws.pp`. Over ticks that were left out the derivative is that over `at.span`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.knob import Knob, check_knobs
from teleop.law import At

AT_ONCE = 1e12  # 1/s


class Forth(NamedTuple):
    x: kind.Position  # the master's, m
    v: float  # the master's velocity, m/s


class Back(NamedTuple):
    f_s: float  # force of the slave's motor, N
    df_s: float  # its derivative, N/s


class ISSSlave(NamedTuple):
    f_s: float  # N, of the last tick
    offset: float  # x_m - x_s at which the coupling is slack, m


@dataclass(frozen=True, kw_only=True)
class ISS:
    """Lead on the reflected force and a spring in series with the coupling."""

    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.1, 500.0))] = 20.0
    tau: Annotated[float, Knob("s", "lead of the reflected force", low=0.0, span=(1e-4, 0.2))] = 0.005
    mu: Annotated[float, Knob("N/m", "stiffness in series with the coupling", above=0.0, span=(10.0, 3e4))] = 1000.0
    rejoin: Annotated[float, Knob(
        "1/s", "rate at which a slave that was let go is drawn back", low=0.0, span=(0.1, 50.0))] = 2.0

    claims: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_knobs(self)

    def linear(self) -> ISS:
        return replace(self, rejoin=AT_ONCE)

    def master_start(self, at: At) -> tuple[tuple[()], Back]:
        return (), Back(0.0, 0.0)

    def slave_start(self, at: At) -> tuple[ISSSlave, Forth]:
        return ISSSlave(0.0, 0.0), Forth(at.x, 0.0)  # until the first message: stay

    def master(self, s: tuple[()], at: At, rx: Back) -> tuple[float, Forth, tuple[()]]:
        return rx.f_s + self.tau * rx.df_s, Forth(at.x, at.v), s

    def slave(self, s: ISSSlave, at: At, rx: Forth) -> tuple[float, Back, ISSSlave]:
        K, mu, span, apart = self.K, self.mu, at.span, rx.x - at.x
        offset = (s.offset + (1.0 - at.gain) * (apart - s.offset)) * max(1.0 - self.rejoin * span, 0.0)
        B = self.B / (mu * span)
        f_s = (K * (apart - offset) + self.B * (rx.v - at.v) + B * s.f_s) / (1.0 + K / mu + B)
        return f_s, Back(at.gain * f_s, at.gain * ((f_s - s.f_s) / span)), ISSSlave(f_s, offset)
