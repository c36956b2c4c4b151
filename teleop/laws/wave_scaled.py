"""Wave variables over a delay that varies: each received wave is held through gaps and scaled by the rate of arrival.

Sends a wave each way. Claims E_link over any link; no seed energy.

Source: R. Lozano, N. Chopra and M. W. Spong, "Passivation of force reflecting bilateral teleoperators with time
varying delay", Mechatronics 2002: with a delay T that varies a wave is played for longer, or shorter, than it was sent
for, and

    u_s(t) = g u_m(t - T(t)),   g^2 <= 1 - dT/dt,

plays at most the energy that was sent: substitute t - T. Sampled here, with the age A of the newest message at a tick
and the span since the last: 1 - (A - A')/span is the share of the span that the messages that came were sent for; it
is at most 1 in a single wave, for what newer messages overtook was never known here. So packet by packet

    n = max(0, min(1 - (A - A')/span, 1)) = 1 at a tick with a message, 0 without:

the rule is the null rule, and with n in place of g^2 nothing is gained. With tau > 0 g^2 is n within about tau,

    g^2 = g'^2 + span/(tau + span) (n - g'^2),   p = g r limited to p^2 <= 2 S/dt,   S += dt (n r^2 - p^2)/2

where r is the newest wave, played again in gaps, and S the energy that came and is not played yet. dt p^2/2 <= S at
each tick, and each message is counted once, so no more is played than was sent, over any link; without loss and jitter
g = 1 once tau has passed, to the last bit of it. Of a share q of ticks without a message g^2 is 1 - q.

A steady force still fades. Lost with q each way, a wave comes back from a held slave h = (1 - q)^2 times with the null
rule, in the mean, and up to h = 1 - q times scaled: what is felt is the damper b (1 + h)/(1 - h) in place of a spring,
with q = 0.1 and b = 2 of 19 N s/m, and of 35 N s/m scaled (38 would be the bound; measured at tau = 0.05). Only
`integral` keeps it (`teleop.stages.wave_integral`), and with that playout, which has a wave at each tick, n = 1 and
this is `teleop.laws.wave`. Both ends and the slave that lets go are as there.

Ticks that are left out. p' was played for the gap, and r' came for it if it was a message's: S has both, and what is
overdrawn is paid before anything more is played.

Claims: E_link >= 0 over every link with the playouts `zero`, `integral`, `energy` and `fixed` with one of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, Any, ClassVar, NamedTuple

from teleop import kind
from teleop.knob import Knob, check_knobs
from teleop.law import At, find_law


class Forth(NamedTuple):
    u: kind.Wave  # forward, sqrt(W)


class Back(NamedTuple):
    w: kind.Wave  # returning, sqrt(W)


class ScaledWave(NamedTuple):
    g2: float  # square of the scale
    S: float  # energy that came and is not played yet, J
    p: float  # the wave that is played, sqrt(W)
    r: float  # the wave that came with the last tick, zero without one, sqrt(W)


class WaveScaledSlave(NamedTuple):
    g2: float  # square of the scale
    S: float  # energy that came and is not played yet, J
    p: float  # the wave that is played, sqrt(W)
    r: float  # the wave that came with the last tick, zero without one, sqrt(W)
    x_d: kind.Position  # commanded point, m
    v_d: float  # its velocity, m/s


@dataclass(frozen=True, kw_only=True)
class WaveScaled:
    """Wave variables, each wave held in gaps and scaled by the rate at which messages come."""

    b: Annotated[float, Knob("N s/m", "wave impedance", above=0.0, span=(0.1, 300.0))] = 2.0
    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.1, 500.0))] = 20.0
    tau: Annotated[float, Knob(
        "s", "time in which the scale follows arrivals; 0: null rule", low=0.0, span=(2e-3, 1.0))] = 0.05

    claims: ClassVar[Mapping[str, str]] = {"E_link": "any link"}

    def __post_init__(self) -> None:
        check_knobs(self)

    def master_start(self, at: At) -> tuple[ScaledWave, Back]:
        return ScaledWave(1.0, 0.0, 0.0, 0.0), Back(0.0)

    def slave_start(self, at: At) -> tuple[WaveScaledSlave, Forth]:
        return WaveScaledSlave(1.0, 0.0, 0.0, 0.0, at.x, 0.0), Forth(0.0)

    def master(self, s: ScaledWave, at: At, rx: Back) -> tuple[float, Forth, ScaledWave]:
        now = scale_wave(s.g2, s.S, s.p, s.r, rx.w, at.fresh, at.age, self.tau, at.dt, at.span)
        root = sqrt(2.0 * self.b)
        return self.b * at.v - root * now.p, Forth(root * at.v - now.p), now

    def slave(self, s: WaveScaledSlave, at: At, rx: Forth) -> tuple[float, Back, WaveScaledSlave]:
        b, K, B, x, v, dt, g = self.b, self.K, self.B, at.x, at.v, at.dt, at.gain
        now = scale_wave(s.g2, s.S, s.p, s.r, rx.u, at.fresh, at.age, self.tau, dt, at.span)
        u = now.p
        root = sqrt(2.0 * b)
        x_d = s.x_d + (at.span - dt) * s.v_d
        v_d = (root * u - g * (K * (x_d - x) - B * v)) / ((2.0 - g) * b + g * (B + K * dt))
        x_d = x_d + dt * v_d
        f_s = K * (x_d - x) + B * (v_d - v)
        w = u - 2.0 / root * (g * f_s + (1.0 - g) * b * v_d)
        return f_s, Back(w), WaveScaledSlave(now.g2, now.S, u, now.r, x_d, v_d)

    def linear(self) -> Any:
        """The wave law, which it is over a constant delay: scales are for links that vary."""
        return find_law("wave")(b=self.b, K=self.K, B=self.B)


def scale_wave(g2: float, S: float, p: float, r: float, newest: float, fresh: bool, age: float,
           tau: float, dt: float, span: float) -> ScaledWave:
    """The scale, the energy that is left and the wave to play; `newest`: the last wave that came, `fresh`: just now."""
    gap = span - dt
    n = 1.0 * fresh
    arrived = n * newest
    g2 = g2 + span / (tau + span) * (max(n, 1.0 * (age > 1e300)) - g2)  # nothing is late before the first
    S = S + gap * (0.5 * (r * r - p * p)) + dt * (0.5 * (arrived * arrived))
    most = sqrt(2.0 * max(S, 0.0) / dt)
    p = max(-most, min(sqrt(g2) * newest, most))
    return ScaledWave(g2, S - dt * (0.5 * (p * p)), p, arrived)
