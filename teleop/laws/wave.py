"""Wave variables.

Source: G. Niemeyer and J.-J. Slotine, "Stable adaptive teleoperation", IEEE J. Oceanic Engineering
16(1), 1991. With wave impedance b, velocity v and force f,

    u = (b v + f)/sqrt(2b)    w = (b v - f)/sqrt(2b)    (u^2 - w^2)/2 = f v
    v = (u + w)/sqrt(2b)      f = sqrt(b/2) (u - w)

The master knows v_m and receives w_m; the slave receives u_s and tracks a commanded point x_d with a
spring-damper, f_s = K (x_d - x_s) + B (v_d - v_s). Since v_d and f_s need each other at the same
instant they are solved together, with the x_d that the tick ends with (backward Euler on the
coupling): inserting x_d' = x_d + dt v_d into f_s = sqrt(2b) u_s - b v_d gives

    v_d = (sqrt(2b) u_s - K (x_d - x_s) + B v_s) / (b + B + K dt).

A slave that lets go. Of the force f_s that the law asks for, the watchdog lets the device have g f_s. The waves are
those of the force that there is, and of a damper b in place of what is missing of it, which takes up what comes:

    sqrt(2b) u_s = b v_d + g f_s + (1 - g) b v_d
    v_d = (sqrt(2b) u_s - g (K (x_d - x_s) - B v_s)) / ((2 - g) b + g (B + K dt)).

With g = 1 that is the law above. With g = 0 nothing comes back, w_s = 0, so the hand feels b, and no wall that nobody
presses; v_d = sqrt(2b) u_s/(2b) is the master's velocity, so the commanded point is where the master is when the slave
takes hold again. g is that of the last tick. Both terms take power out of the waves: E_link is kept.

Ticks that are left out. The force is held over them, and with it the waves that it stands for, so the commanded point
has gone on at its last velocity: x_d += (span - dt) v_d before the tick is done as ever. Otherwise each such tick of a
motion would leave it v_d dt behind, and nothing brings it back. Over a gap of g seconds, with e' = v_d - v_s, the held
coupling takes in f_s e' g = K e e' g + B e'^2 g and its spring stores K e e' g + K e'^2 g^2/2, so it makes no energy as
long as g <= 2 B/K.

Claims: E_link >= 0 to rounding over every link, with the playouts that play no more energy than was
sent: `integral` and `energy`, which play what is owed of the waves within the energy that came with
them (`teleop.stages.wave_integral`), and `zero`, with which the waves taken out are a subset of the
waves put in; each alone or in the gaps of `fixed`. With `zero` a steady force fades, by one wave with
each gap. Holding a wave in the gaps (`hold`) plays it twice and is active. A constant delay of whole
ticks keeps E_link equal to the waves under way. Nothing is claimed of E_port, which contains the
hold's own leak.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.knob import Knob, check_knobs
from teleop.law import At


class Forth(NamedTuple):
    u: kind.Wave  # forward, sqrt(W)


class Back(NamedTuple):
    w: kind.Wave  # returning, sqrt(W)


class WaveSlave(NamedTuple):
    x_d: kind.Position  # commanded point, m
    v_d: float = 0.0  # its velocity, m/s


@dataclass(frozen=True, kw_only=True)
class Wave:
    """Wave variables with a spring-damper slave solved in closed form."""

    b: Annotated[float, Knob("N s/m", "wave impedance", above=0.0, span=(0.1, 300.0))] = 2.0
    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.1, 500.0))] = 20.0

    claims: ClassVar[Mapping[str, str]] = {"E_link": "any link"}

    def __post_init__(self) -> None:
        check_knobs(self)

    def master_start(self, at: At) -> tuple[tuple[()], Back]:
        return (), Back(0.0)

    def slave_start(self, at: At) -> tuple[WaveSlave, Forth]:
        return WaveSlave(at.x, 0.0), Forth(0.0)  # compiled code fills in no default

    def master(self, s: tuple[()], at: At, rx: Back) -> tuple[float, Forth, tuple[()]]:
        v = at.v
        w = rx.w * at.fresh  # zero in place of a missing wave is passive
        root = sqrt(2.0 * self.b)
        return self.b * v - root * w, Forth(root * v - w), s

    def slave(self, s: WaveSlave, at: At, rx: Forth) -> tuple[float, Back, WaveSlave]:
        b, K, B, x, v, dt = self.b, self.K, self.B, at.x, at.v, at.dt
        u = rx.u * at.fresh
        root = sqrt(2.0 * b)
        x_d = s.x_d + (at.span - dt) * s.v_d
        g = at.gain
        v_d = (root * u - g * (K * (x_d - x) - B * v)) / ((2.0 - g) * b + g * (B + K * dt))
        x_d = x_d + dt * v_d
        f_s = K * (x_d - x) + B * (v_d - v)
        # The force is the same as root*u - b*v_d, which cancels at large K.
        return f_s, Back(u - 2.0 / root * (g * f_s + (1.0 - g) * b * v_d)), WaveSlave(x_d, v_d)
