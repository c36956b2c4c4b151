"""Wave variables whose two ends are matched to the wave impedance: a coupling at either end, its damping b.

Sends a wave each way. Claims E_link over any link; no seed energy.

Source: G. Niemeyer and J.-J. Slotine, "Stable adaptive teleoperation", IEEE J. Oceanic Engineering 16(1), 1991, on
impedance matching. The waves are those of `teleop.laws.wave`. Each end has a commanded point, x_md and x_sd, that the
waves move and that a spring K and a damper b couple to the device:

    f_m = K (x_m - x_md) + b (v_m - v_md) = b v_md - sqrt(2b) w_m
    f_s = K (x_sd - x_s) + b (v_sd - v_s) = sqrt(2b) u_s - b v_sd

solved together with the points that the tick ends with. Behind a wave port a device that is held has then the
impedance b + K/s, so that of a wave that comes it sends back

    w/u = -(K/s)/(2 b + K/s),   |w/u| = K/|2 b s + K|:

all of a steady wave, nothing of a fast one. A steady force stays, K x for an offset x in either coupling; with dampers
alone, K = 0, it could not, and each end's damper halves what goes through: undoing that by playing the waves doubled
sends four times their energy and is active. The spring has to stay soft for the match, K << 2 b (2 pi f): what is
matched in frequency is felt as a spring of K/2 in series with the channel.

An end that lets go. As in `teleop.laws.wave`, at either end, for both have a commanded point: of the force that the
law asks for the device has g f, and a damper b to the ground takes up what is missing, so

    v_sd = (sqrt(2b) u_s - g (K (x_sd - x_s) - b v_s))/((2 - g) b + g (b + K dt))
    v_md = (sqrt(2b) w_m + g (K (x_m - x_md) + b v_m))/((2 - g) b + g (b + K dt)).

With g = 0 nothing is sent back. The slave's point is where its wave takes it; the master's comes to where the hand is,
x_md -= (1 - g) (x_md - x_m), so that the hand is not pulled by a spring that nothing has stretched when the master
takes hold again. What the hand has moved meanwhile stays as an offset of the two ends. Ticks that are left out: each
point has gone on at its last velocity; the held coupling makes no energy as long as the gap is at most 2 b/K, 8 ms
here.

Claims: E_link >= 0 over every link with the playouts of `teleop.laws.wave`. A wave that is missing counts as zero.
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


class WaveMatchedEnd(NamedTuple):
    x_d: kind.Position  # commanded point, m
    v_d: float  # its velocity, m/s


@dataclass(frozen=True, kw_only=True)
class WaveMatched:
    """Wave variables with a coupling at either end, its damping the wave impedance."""

    b: Annotated[float, Knob(
        "N s/m", "wave impedance, and damping of both couplings", above=0.0, span=(0.1, 300.0))] = 2.0
    K: Annotated[float, Knob("N/m", "stiffness of both couplings", low=0.0, span=(10.0, 3e4))] = 500.0

    claims: ClassVar[Mapping[str, str]] = {"E_link": "any link"}

    def __post_init__(self) -> None:
        check_knobs(self)

    def master_start(self, at: At) -> tuple[WaveMatchedEnd, Back]:
        return WaveMatchedEnd(at.x, 0.0), Back(0.0)

    def slave_start(self, at: At) -> tuple[WaveMatchedEnd, Forth]:
        return WaveMatchedEnd(at.x, 0.0), Forth(0.0)

    def master(self, s: WaveMatchedEnd, at: At, rx: Back) -> tuple[float, Forth, WaveMatchedEnd]:
        b, K, x, v, dt, g = self.b, self.K, at.x, at.v, at.dt, at.gain
        w = rx.w * at.fresh
        root = sqrt(2.0 * b)
        x_d = s.x_d + (at.span - dt) * s.v_d
        x_d = x_d - (1.0 - g) * (x_d - x)
        v_d = (root * w + g * (K * (x - x_d) + b * v)) / ((2.0 - g) * b + g * (b + K * dt))
        x_d = x_d + dt * v_d
        return K * (x - x_d) + b * (v - v_d), Forth(root * v_d - w), WaveMatchedEnd(x_d, v_d)

    def slave(self, s: WaveMatchedEnd, at: At, rx: Forth) -> tuple[float, Back, WaveMatchedEnd]:
        b, K, x, v, dt, g = self.b, self.K, at.x, at.v, at.dt, at.gain
        u = rx.u * at.fresh
        root = sqrt(2.0 * b)
        x_d = s.x_d + (at.span - dt) * s.v_d
        v_d = (root * u - g * (K * (x_d - x) - b * v)) / ((2.0 - g) * b + g * (b + K * dt))
        x_d = x_d + dt * v_d
        return K * (x_d - x) + b * (v_d - v), Back(root * v_d - u), WaveMatchedEnd(x_d, v_d)
