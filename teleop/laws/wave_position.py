"""Wave variables with the difference of the two positions fed to either end, which draws an offset between them back.

Sends a wave and a position each way. Claims no ledger; with enough damping at both ends the two-port is passive; no
seed energy.

Source: N. Chopra and M. W. Spong with S. Hirche and M. Buss, "Bilateral teleoperation over the internet: the time
varying delay problem", American Control Conf. 2003. To the waves of `teleop.laws.wave` either end adds a spring to the
place that it last heard of the other, and a damper to the ground beside it:

    f_m = b v_m - sqrt(2b) w_m + K_p (x_m - x_s(t - T2)) + B_p v_m
    f_s = K (x_d - x_s) + B (v_d - v_s) + K_p (x_m(t - T1) - x_s) - B_p v_s

What is left of an offset. Where waves are lost and zero is played, no steady wave stays, and at rest the positions
meet. Where each wave is played, they carry a steady force, and coupling and link are a spring against K_p: of ends that
start o apart, or are so when the slave takes hold again, at rest

    e = o/(1 + K_p (1/K + (T1 + T2)/(2 b)))

stays, 16 mm of 20 with the gains below and 20 ms each way. With delay, a small b or more of K_p it is less.

Condition. The waves are lossless at best, so none of b, K and B counts. With the energy V = K_p (x_m - x_s)^2/2 of the
spring that the two positions would have without delay, and B_m = B_p + master's damping, B_s likewise, the powers into
the two ports are

    d/dt V + B_m v_m^2 + B_s v_s^2 + K_p v_m (x_s - x_s(t - T2)) + K_p v_s (x_m - x_m(t - T1)),

and each of the last two is at most K_p T |v_m| |v_s| in the mean. So the two-port is passive if

    4 B_m B_s >= K_p^2 (T1 + T2)^2,

for a varying delay with the greatest age of the positions that are used. Sampled, with each force held for dt, the same
sums over dx in place of v dt have V's own second difference beside them, -K_p (dx_m - dx_s)^2/2, and ask for

    (2 B_m - K_p dt) (2 B_s - K_p dt) >= K_p^2 (T1 + T2 + dt)^2,   equal ends: B_m >= K_p (T + dt),

up to the change of velocity within a tick, as with any damper that is held; `teleop.law.injection` comes to the same by
frequencies. `conditions` names the least B_p, `fitted` raises B_p to it.

Claims: nothing. The springs and dampers stand beside the waves, so an end may give its port more than its waves
brought; what is passive is the two-port with the dampings of both devices, and only where the condition holds. A slave
that lets go sends the waves of the force that it holds, as in `teleop.laws.wave`; a wave that is missing counts as
zero, and the last position stands. Before the first one the spring is at rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import sqrt
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.knob import Knob, check_knobs
from teleop.law import At, injection
from teleop.law.offers import Facts


class Forth(NamedTuple):
    u: kind.Wave  # forward, sqrt(W)
    x: kind.Position  # the master's, m


class Back(NamedTuple):
    w: kind.Wave  # returning, sqrt(W)
    x: kind.Position  # the slave's, m


class WavePositionSlave(NamedTuple):
    x_d: kind.Position  # commanded point, m
    v_d: float  # its velocity, m/s


@dataclass(frozen=True, kw_only=True)
class WavePosition:
    """Wave variables with a spring between the two positions and a damper at either end."""

    b: Annotated[float, Knob("N s/m", "wave impedance", above=0.0, span=(0.1, 300.0))] = 2.0
    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.1, 500.0))] = 20.0
    K_p: Annotated[float, Knob("N/m", "stiffness between the two positions", low=0.0, span=(0.5, 1e3))] = 20.0
    B_p: Annotated[float, Knob("N s/m", "damping to the ground at either end", low=0.0, span=(0.03, 300.0))] = 1.0

    claims: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_knobs(self)

    def master_start(self, at: At) -> tuple[tuple[()], Back]:
        return (), Back(0.0, at.x)  # until the first message: the other end is where this one is

    def slave_start(self, at: At) -> tuple[WavePositionSlave, Forth]:
        return WavePositionSlave(at.x, 0.0), Forth(0.0, at.x)

    def master(self, s: tuple[()], at: At, rx: Back) -> tuple[float, Forth, tuple[()]]:
        x, v = at.x, at.v
        w = rx.w * at.fresh
        root = sqrt(2.0 * self.b)
        f_m = self.b * v - root * w + (self.K_p * (x - rx.x) + self.B_p * v)
        return f_m, Forth(root * v - w, x), s

    def slave(self, s: WavePositionSlave, at: At, rx: Forth) -> tuple[float, Back, WavePositionSlave]:
        b, K, B, x, v, dt, g = self.b, self.K, self.B, at.x, at.v, at.dt, at.gain
        u = rx.u * at.fresh
        root = sqrt(2.0 * b)
        x_d = s.x_d + (at.span - dt) * s.v_d
        v_d = (root * u - g * (K * (x_d - x) - B * v)) / ((2.0 - g) * b + g * (B + K * dt))
        x_d = x_d + dt * v_d
        f_c = K * (x_d - x) + B * (v_d - v)
        w = u - 2.0 / root * (g * f_c + (1.0 - g) * b * v_d)
        return f_c + (self.K_p * (rx.x - x) - self.B_p * v), Back(w, x), WavePositionSlave(x_d, v_d)

    def conditions(self, facts: Facts) -> tuple[str, ...]:
        return injection.conditions(
            "the spring K = K_p between the positions", facts, self.K_p, 0.0, self.B_p, "--set law.B_p={:g}")

    def fitted(self, facts: Facts) -> WavePosition:
        return replace(self, B_p=max(self.B_p, injection.needed(facts, self.K_p, 0.0) or 0.0))
