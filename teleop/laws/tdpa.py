"""Time-domain passivity over a delay: an end gives out no more energy than it has heard that the other took in.

Source: J.-H. Ryu, J. Artigas and C. Preusche, "A passive bilateral control scheme for a teleoperator with time-varying
communication delay", Mechatronics 20(7), 2010 (observers and controllers); J. Artigas, J.-H. Ryu and C. Preusche,
"Position drift compensation in time domain passivity based teleoperation", IEEE/RSJ IROS 2010.

The master sends its motion; the slave tracks a commanded point x_d with a spring-damper and sends its force, times the
watchdog's gain g. Each end sends E, the energy that it has ever taken in, and keeps G, what is left of the other's.
With w the work done on it over the last tick:

    G -= (-w)+        G = min(G, store, and E0 at the slave)        G += E_rx - seen
    paid = min((-G)+, w+)        G += paid        E += w+ - paid

What comes in pays this end's debt first; the rest is told. `store` bounds what stays unspent from tick to tick: 0 is
the power-based observer. E0 is the slave's to begin with: no energy comes before a force, and no force before a motion.

Slave (admittance): its port is (f_s, v_d). f_s = f_0 + z v_d with f_0 = K (x_d - x) - B v, z = B + K dt, so it asks for
f_s v_d dt, and f_s changes with v_d. That is at most G in a ball about m = -f_0/(2 z), two roots in one axis,

    z v_d^2 + f_0 v_d <= G/dt        |v_d - m|^2 <= |m|^2 + G/(z dt)

into which the command g (v_rx + drift (x_rx - x_d)) is taken towards m. Booked is the greater of the work that was
asked for and that of the held force, over v_d dt. A slave that lets go takes x_d back to itself, x_d -= (1 - g) (x_d -
x), so no coupling that was stretched for nothing is paid out later. Over ticks that are left out x_d goes along with
it.

Master (impedance): a reflected force that pushes, <f, v> < 0, is scaled by min(1, G+/(dt |<f, v>|)). What was overspent
is taken back by a damper min(-G/(dt max(v^2, v_min^2)), alpha_max). One that owes more than `debt` also resists with no
more than alpha_max v, and in each axis by itself: else a strong force turns a slow master round within each tick, and
pushes though it resisted.

The coupling. The slave's books are of v_d dt, its port is of dx. With the spring's energy P = K (x_d - x)^2/2 and dx =
v dt the coupling between them burns over a tick

    h = f_s (v_d dt - dx) - dP = K dt^2/2 (v_d^2 - v^2) + B dt (v_d - v)^2

since the hold plays f_s half a tick late. No damping keeps h from going below zero: with beta = 2 B/(K dt) it does for
v_d/v between (beta - 1)/(beta + 1) and 1, down to -K dt^2 v^2/(2 (1 + beta)). So C counts what went into the coupling
and has not come out of it, G pays what is missing, and (P - C - least h)+ of G is kept back when the slave spends:

    C += max(desired, held) - f_held dx        G += min(C, 0)        C = min(C+, store + P)

Books. Each G + E - seen grows by the work w, less what `store` drops. Summed, with under way the E not yet seen,

    E_law = G_m + debt + G_s + under way        E_port = E_law - E_law(0) + dropped + C >= E_law - E_law(0)

whatever K, B, dt and the bodies are.

What is below zero. The slave knows f_s and v_d before it spends, and the least that h can be for the v that it reads.
So G_s < 0 only by what it cannot know: by dx - v dt, and by a held force over ticks that are left out, which does more
than the one that was asked for; waits that follow each other add up until they are paid. While it owes, v_d = m. Then
f_s = f_0/2, and with the storage Q = P/2

    -f_s dx - dQ = dt ((B + 3 K dt/4) m^2 - (B - K dt) m v/2 + (B - K dt/2) v^2/2)

is never below zero for B >= 0.5224 K dt (with b = B/(K dt) the root of 7 b^2 + 4 b = 4), so the debt does not grow;
what B holds against a slave takes energy for B <= m/T, m its mass and T the longest tick (`teleop.law.offers`).
A cap turns what is held of a force of several axes to another direction, in which it may push: where it did more than
was asked for and G_s < 0, v_d = m, in which each axis takes energy, capped or not.
The master spends f v dt and pays -f d, for the motion d that follows: from G_m >= -debt one tick leaves G_m >= -debt -
|f| |d - v dt|, and below that it only damps, with 2 alpha_max at most, which takes energy for 2 alpha_max <= m/T. So
`debt` is energy that the ports may get, and in the books it is given to the master to begin with.

Claims: E_law >= 0 less one tick's surprise, over any link; E_port >= -E0 - debt with it. E_law(0) = E0 + debt, the
seed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.errors import enough
from teleop.knob import Knob, check_knobs
from teleop.law import At
from teleop.law.offers import Facts

PAYS = (sqrt(8.0) - 1.0) / 3.5  # B/(K dt) from which on the coupling of a slave that owes takes energy
TINY = 1e-300  # in place of nothing below a fraction
FREE = 1e300  # J or N, where nothing limits
NEARLY = 1e-9  # of the work that was asked for: a held force that did no more than that is the one that was asked for


class Forth(NamedTuple):
    x: kind.Position  # the master's, m
    v: float  # the master's velocity, m/s
    E: kind.Total  # energy that the master has taken in, J


class Back(NamedTuple):
    f_s: float  # the slave's force, N
    E: kind.Total  # energy that the slave has taken in, J


class TDPAMaster(NamedTuple):
    G: float  # energy that may be given out, J; the same in each axis, as the others are
    E: float  # energy taken in, J
    seen: float  # the other end's E so far, J


class TDPASlave(NamedTuple):
    G: float
    E: float
    seen: float
    x_d: kind.Position  # commanded point, m
    v_d: float  # its velocity, m/s
    f_d: float  # the force that was asked for, N
    C: float  # energy that went into the coupling and has not come out of it, J; the same in each axis


class TDPAMasterSums(NamedTuple):
    w: float  # work done on the master over the last tick, J
    fv: float  # power that the reflected force would take out, less than 0 where it pushes, W
    vv: float  # the square of the velocity, m^2/s^2


class TDPASlaveSums(NamedTuple):
    desired: float  # work of the force that was asked for on the commanded point's way, over the last tick, J
    held: float  # of the force that was held, J
    out: float  # of the force that was held on the slave's own way, J
    P: float  # energy of the coupling's spring, J
    ff: float  # the square of f_0, of 2 z m, N^2
    cc: float  # that of f_0 + 2 z c, the command's way to m times 2 z, N^2
    vv: float  # that of the velocity, m^2/s^2


@dataclass(frozen=True, kw_only=True)
class TDPA:
    """Position-force control with passivity observers and controllers at both ends, and drift compensation."""

    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", above=0.0, span=(0.1, 1e3))] = 20.0
    drift: Annotated[float, Knob(
        "1/s", "rate at which the commanded point goes to the master", low=0.0, span=(0.1, 1e3))] = 10.0
    E0: Annotated[float, Knob("J", "energy of the slave at the start", low=0.0)] = 0.05
    alpha_max: Annotated[float, Knob(
        "N s/m", "most damping that takes back what was overspent", low=0.0, span=(1.0, 500.0))] = 50.0
    v_min: Annotated[float, Knob(
        "m/s", "speed below which that damping grows no more", above=0.0, span=(1e-5, 0.1))] = 1e-3
    debt: Annotated[float, Knob(
        "J", "what the master owes at most and still resists with more", low=0.0, span=(1e-6, 0.01))] = 2e-4
    store: Annotated[float, Knob(
        "J", "most energy that stays unspent (0: the power-based variant)", low=0.0, span=(1e-3, 30.0))] = 1.0

    claims: ClassVar[Mapping[str, str]] = {"E_law": "any link"}
    shows: ClassVar[tuple[str, ...]] = ("G",)

    def __post_init__(self) -> None:
        check_knobs(self)

    def conditions(self, facts: Facts) -> tuple[str, ...]:
        least, most = PAYS * self.K * facts.dt, 0.5 * facts.mass_m / facts.held
        coupling = (f"the coupling of a slave that owes energy takes it back where B >= {PAYS:.4f} K dt, which "
                    f"B = {self.B:g} N s/m is not; --set law.B={enough(least, least=True)} is the least")
        damper = (f"the master's damper takes energy where 2 alpha_max <= m/T, T the longest tick, which "
                  f"alpha_max = {self.alpha_max:g} N s/m is not; --set law.alpha_max={enough(most, least=False)} "
                  "is the most")
        held = (f"the coupling takes energy while it is held from tick to tick where B <= m/T of the slave, which "
                f"B = {self.B:g} N s/m is not; --set law.B={enough(facts.mass_s / facts.held, least=False)} is "
                f"the most")
        return (*([coupling] if least > self.B else []), *([damper] if self.alpha_max > most else []),
                *([held] if self.B * facts.held > facts.mass_s else []))

    def master_start(self, at: At) -> tuple[TDPAMaster, Back]:
        return TDPAMaster(0.0, 0.0, 0.0), Back(0.0, 0.0)

    def slave_start(self, at: At) -> tuple[TDPASlave, Forth]:
        return TDPASlave(self.E0, 0.0, 0.0, at.x, 0.0, 0.0, 0.0), Forth(at.x, 0.0, 0.0)  # until the first message: stay

    def master_stored(self, s: TDPAMaster) -> float:
        return s.G + self.debt + (s.E - s.seen)

    def slave_stored(self, s: TDPASlave) -> float:
        return s.G + (s.E - s.seen)

    def master_sums(self, s: TDPAMaster, at: At, rx: Back) -> TDPAMasterSums:
        return TDPAMasterSums(at.f_held * at.dx, rx.f_s * at.v, at.v * at.v)

    def master(self, s: TDPAMaster, at: At, rx: Back, over: TDPAMasterSums) -> tuple[float, Forth, TDPAMaster]:
        G, E = observe(s.G, s.E, rx.E - s.seen, over.w, self.store)
        dt = at.dt
        takes = min(max(-G, 0.0) / (dt * max(over.vv, self.v_min * self.v_min)), self.alpha_max)
        paid = (over.fv < 0.0) * max(G, 0.0) + (over.fv >= 0.0) * FREE
        f = rx.f_s * min(paid / max(dt * abs(over.fv), TINY), 1.0)
        most, owes_little = self.alpha_max * at.v, FREE * (self.debt + G >= 0.0)
        f_m = max(min(most, 0.0) - owes_little, min(f, max(most, 0.0) + owes_little)) + takes * at.v
        return f_m, Forth(at.x, at.v, E), TDPAMaster(G, E, rx.E)

    def slave_sums(self, s: TDPASlave, at: At, rx: Forth) -> TDPASlaveSums:
        dt, step, along = at.dt, at.dt * s.v_d, at.dx * (1.0 - at.dt / at.span)
        x_d, f_0, c = commanded(self.K, self.B, self.drift, s.x_d + along, at.x, at.v, rx.x, rx.v, at.gain)
        off, e, done = f_0 + 2.0 * (self.B + self.K * dt) * c, x_d - at.x, at.f_held * along
        return TDPASlaveSums(s.f_d * step + done, at.f_held * step + done, at.f_held * at.dx, 0.5 * self.K * e * e,
                         f_0 * f_0, off * off, at.v * at.v)

    def slave(self, s: TDPASlave, at: At, rx: Forth, over: TDPASlaveSums) -> tuple[float, Back, TDPASlave]:
        spent = max(over.desired, over.held)
        C = s.C + (spent - over.out)
        G, E = observe(s.G, s.E, rx.E - s.seen, min(C, 0.0) - spent, self.store + self.E0)
        C = min(max(C, 0.0), self.store + over.P)
        dt, z = at.dt, self.B + self.K * at.dt
        x_d = s.x_d + at.dx * (1.0 - dt / at.span)
        x_d, f_0, c = commanded(self.K, self.B, self.drift, x_d, at.x, at.v, rx.x, rx.v, at.gain)
        K_dt = self.K * dt
        worst = 0.5 * dt * over.vv * (K_dt * K_dt / (K_dt + 2.0 * self.B))  # of what the hold may give, J
        left = G - max(worst + over.P - C, 0.0)
        beyond = 1.0 - sqrt(min(max(over.ff * dt + 4.0 * z * left, 0.0) / max(over.cc * dt, TINY), 1.0))
        beyond = max(beyond, (G < 0.0) * (over.held > over.desired + NEARLY * abs(over.desired)))
        v_d = c - beyond * (c + 0.5 * f_0 / z)
        f_s = f_0 + z * v_d
        return f_s, Back(at.gain * f_s, E), TDPASlave(G, E, rx.E, x_d + dt * v_d, v_d, f_s, C)


def observe(G: float, E: float, arrived: float, w: float, most: float) -> tuple[float, float]:
    """Energy that may be given out and energy taken in (J), after the work w and with the other end's `arrived`."""
    G = min(G - max(-w, 0.0), most) + arrived
    paid = min(max(-G, 0.0), max(w, 0.0))
    return G + paid, E + (max(w, 0.0) - paid)


def commanded(K: float, B: float, drift: float, x_d: float, x: float, v: float, x_rx: float, v_rx: float,
              gain: float) -> tuple[float, float, float]:
    """The commanded point (m), the force where it stays (N), and the velocity that is asked of it (m/s)."""
    x_d = x_d - (1.0 - gain) * (x_d - x)
    return x_d, K * (x_d - x) - B * v, gain * (v_rx + drift * (x_rx - x_d))
