"""Wave variables with a low-pass filter on each received wave, which takes reflections and noise out of them.

Sends a wave each way. Claims E_link over any link; no seed energy.

Source: G. Niemeyer and J.-J. Slotine, "Telemanipulation with time delays", Int. J. Robotics Research 23(9), 2004, on
filters in the waves' path; the sampled form and its energy are derived here. The waves, their two ends and the slave
that lets go are those of `teleop.laws.wave`. In place of the received wave r both ends use

    y' = l (r - y),   F(s) = 1/(1 + s/l),   l = 2 pi f_c;   backward Euler: y = (y' + l dt r)/(1 + l dt)

where y' is y a tick before. So each one-way delay is longer by the lag 1/l. Felt at the master, with the impedance Z_L
behind the slave's wave port, G = (b - Z_L)/(b + Z_L) and T each way,

    Z = b (1 - G F^2 e^(-2 s T))/(1 + G F^2 e^(-2 s T)):   a clamped slave is the spring b/(T + 1/l) at low frequency.

Passive: backward Euler has y - y' = l dt (r - y), and so at each tick

    dt (r^2 - y^2)/2 = (y^2 - y'^2)/(2 l) + (y - y')^2/(2 l) + dt (r - y)^2/2.

The filter keeps y^2/(2 l) J, nothing at the start, and the rest is taken out; what the end does with y it does within
the energy of r. That is so of a filter on a wave alone: on the force instead, outside the waves, its lag is active.

Ticks that are left out. The force is held over g = span - dt, so y' was played for r'. The filter takes in what it is
owed, y' + min(l g, 1) (r' - y'): up to g = 1/l the integral of y is that of r less y/l, as it is with every tick, so
there is no drift, and the energy of r' covers it. What is held longer is forgotten and not covered: at most
(g - 1/l) (y'^2 - r'^2)/2.

Claims: E_link >= 0 over every link with the playouts of `teleop.laws.wave`. A wave that is missing counts as zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi, sqrt
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.knob import Knob, check_knobs
from teleop.law import At


class Forth(NamedTuple):
    u: kind.Wave  # forward, sqrt(W)


class Back(NamedTuple):
    w: kind.Wave  # returning, sqrt(W)


class WaveFilterMaster(NamedTuple):
    y: float  # the filtered wave, sqrt(W)
    r: float  # the received one, sqrt(W)


class WaveFilterSlave(NamedTuple):
    y: float  # the filtered wave, sqrt(W)
    r: float  # the received one, sqrt(W)
    x_d: kind.Position  # commanded point, m
    v_d: float  # its velocity, m/s


@dataclass(frozen=True, kw_only=True)
class WaveFilter:
    """Wave variables, each received wave through a one-pole low-pass filter."""

    b: Annotated[float, Knob("N s/m", "wave impedance", above=0.0, span=(0.1, 300.0))] = 2.0
    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.1, 500.0))] = 20.0
    f_c: Annotated[float, Knob(
        "Hz", "cut-off of the filter on each received wave", above=0.0, span=(1.0, 400.0))] = 20.0

    claims: ClassVar[Mapping[str, str]] = {"E_link": "any link"}

    def __post_init__(self) -> None:
        check_knobs(self)

    def master_start(self, at: At) -> tuple[WaveFilterMaster, Back]:
        return WaveFilterMaster(0.0, 0.0), Back(0.0)

    def slave_start(self, at: At) -> tuple[WaveFilterSlave, Forth]:
        return WaveFilterSlave(0.0, 0.0, at.x, 0.0), Forth(0.0)

    def master(self, s: WaveFilterMaster, at: At, rx: Back) -> tuple[float, Forth, WaveFilterMaster]:
        r = rx.w * at.fresh
        w = low_pass(s.y, s.r, r, 2.0 * pi * self.f_c, at.dt, at.span - at.dt)
        root = sqrt(2.0 * self.b)
        return self.b * at.v - root * w, Forth(root * at.v - w), WaveFilterMaster(w, r)

    def slave(self, s: WaveFilterSlave, at: At, rx: Forth) -> tuple[float, Back, WaveFilterSlave]:
        b, K, B, x, v, dt, g = self.b, self.K, self.B, at.x, at.v, at.dt, at.gain
        r = rx.u * at.fresh
        u = low_pass(s.y, s.r, r, 2.0 * pi * self.f_c, dt, at.span - dt)
        root = sqrt(2.0 * b)
        x_d = s.x_d + (at.span - dt) * s.v_d
        v_d = (root * u - g * (K * (x_d - x) - B * v)) / ((2.0 - g) * b + g * (B + K * dt))
        x_d = x_d + dt * v_d
        f_s = K * (x_d - x) + B * (v_d - v)
        w = u - 2.0 / root * (g * f_s + (1.0 - g) * b * v_d)
        return f_s, Back(w), WaveFilterSlave(u, r, x_d, v_d)


def low_pass(y: float, r_was: float, r: float, l: float, dt: float, gap: float) -> float:  # noqa: E741 - the book's name
    """The filtered wave: `y` and `r_was` of the last tick held over `gap` s, then `r` for `dt`; `l` in rad/s.

    Half a tick of a step towards a steady wave:

    >>> low_pass(0.0, 0.0, 1.0, 1000.0, 1e-3, 0.0)
    0.5
    """
    y = y + min(l * gap, 1.0) * (r_was - y)
    return (y + l * dt * r) / (1.0 + l * dt)
