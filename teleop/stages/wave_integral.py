"""Playout of waves by their integral, within their energy, both of which are sent along with every wave.

With each wave an end sends, for each axis, what its waves have come to so far: T, the time (s); U, the integral of the
wave; E, its energy (J). With `span` the time since its last tick, dt its tick, q the wave of this tick and q' the one
before, which was held over ticks that were left out:

    T += span        U += (span - dt) q' + dt q        E += (span - dt) q'^2/2 + dt q^2/2

The receiver keeps P and G, the same of the wave p that it plays; C, how much of the sender's time it has played; and
M, the least that the queue was. At each of its ticks, p' being the wave that it played last, and T, U, E those of the
newest message, all zero before the first:

    P += (span - dt) p'        G += (span - dt) p'^2/2        C += span - dt
    D = U - P        the integral that is owed
    S = max(E - G, 0)        the energy that is left for it
    L = T - C        the queue: the time that is owed
    H = D^2/(2 S)        the shortest time over which the energy lets D be played evenly
    M = max(0, min(M + (L - M) dt/memory, L - dt))
    h = max(dt, L - min(M, L - keep) dt/settle, min(H, L)) where L >= dt/2, else dt        the time for it
    p = D/max(h, H) where L >= dt/2, else p' limited to +-sqrt(S/dt)
    P += dt p        G += dt p^2/2        C = max(C, T - (h - dt))
    C += max(0, dt + L dt/ahead) where L < dt/2, no newer message is played, and p' was not limited

Passive, whatever comes: out of order, lost, doubled, of a peer with another tick. Where L >= dt/2,

    dt p^2/2 <= max(h, H) p^2/2 <= D^2/(2 H) = S

and elsewhere dt p^2/2 <= S/2. So G <= E of a message that was sent, at every tick, for every h >= dt. Only what is held
over ticks that are left out is booked when it has been played: G may pass E by one such wait, and nothing is played
until that is paid.

No fade: by Cauchy-Schwarz a wave that was sent over a time L has D^2 <= 2 S L. The points (D, S, L) that fulfil it are
a convex cone. Sending adds a point of the cone, and playing D/h for a tick, h >= min(H, L), leaves one: so H <= L
always, and a wave that stays the same is played exactly as it was sent through every gap that the queue is as long as.
A gap that is longer is bridged by p' as far as there is energy over, of which a steady wave leaves none and a varying
one some; that counts as time that was played, so C runs ahead of T by at most `ahead`, and the next message, which
brings what was held, brings that energy back. Where the energy ends, the gap is felt as a dip towards zero, and the
queue is longer by it afterwards. (Only without a newer message and for a whole wave: else a delay that rises by a tick
within a gap would leave the queue at zero with a part of D unplayed for good, and a run would never begin.)

No drift: nothing that was sent is forgotten. x_m - x_d is the waves under way and in the queues over sqrt(2b), and
comes to rest where they do.

The queue follows the gaps of the link. M falls with it in a gap and rises towards it within `memory`, so M is what no
gap of that time has needed; that alone is released, with the time constant `settle`, and never below `target`: keep is
target + dt, since L is the queue before the tick is played, and nothing where nothing is to be kept. A
steady wave cannot give any of it back: to play u (t + d) within a time t takes an energy u^2 (t + d)^2/(2 t) at least,
by Cauchy-Schwarz, and u^2 (t + d)/2 was sent. So no passive rule that forgets nothing shortens the queue of a steady
wave. It shortens by what varying waves leave over, and in full where the hand lets go.

Statics. A hand of stiffness k_h that is moved by `push` beyond the surface of a wall k_e, over a coupling K, delays T1
and T2, queues L1 and L2 and a wave impedance b, presses with

    f = push/(1/k_h + 1/K + 1/k_e + (T1 + T2 + L1 + L2)/(2b))

Source of sending the integral of a wave and of its energy: G. Niemeyer and J.-J. E. Slotine, "Towards force-reflecting
teleoperation over the Internet", IEEE ICRA 1998. The rule of release is derived here.

`Energy` plays what is owed at once within the energy, p = D/max(dt, H): passive likewise, and each late packet is a
short burst. `Scaled` plays the newest wave, and in gaps again, times sqrt(1 - rate).
"""

from __future__ import annotations

from math import sqrt
from typing import Any, ClassVar, NamedTuple

from teleop.stages.end import Axis, Column, End, Places, Record, Run, Stage, elapsed, per_axis

TINY = 5e-324  # in place of no energy: D^2/(2 S) is infinite then, and nothing is played


class Integrals(NamedTuple):
    """Integrals of an end's waves in one axis."""

    T: float  # the time since it began, s
    U: float  # the integral of the wave
    E: float  # its energy, J


class AxisWaves(Record):
    """The waves of one axis: those that were sent, and those that were played."""

    q: float  # the wave that was sent at the last tick, sqrt(W)
    p: float  # the wave that was played last
    P: float  # its integral
    G: float  # its energy, J
    C: float  # how much of the sender's time it was, s
    D: float  # the integral that is owed
    S: float  # the energy that is left for it, J
    L: float  # the queue: the time that is owed, s
    M: float  # the least that it was, s
    spare: float  # what may be released of it, s
    credit: float  # what is held in a gap and counts as played, s
    H: float  # the shortest time over which the energy lets it be played, s
    h: float  # the time over which it is played, s
    most: float  # what the energy allows of a wave in this tick
    queue: float  # after it, s
    held: float  # how long the last wave was held over ticks that were left out, s


class WaveIntegralStage(Stage):
    """The wave p in place of the received one. Recorded is the queue, `queue_m` or `queue_s` (s)."""

    name: ClassVar[str] = "wave_integral"
    axis_kind: ClassVar[type[Record]] = AxisWaves
    target: float  # the least queue that is left after a tick, s
    keeps: float  # the same before it, which is longer by the tick
    settles: float  # the share of what is spare that is released in a tick
    recalls: float  # the share of the way from M to L
    leads: float  # dt, or 0 where what is held in a gap does not count as played
    returns: float  # dt/ahead
    spared: float  # dt, or 0 where M is L

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        wave = scene.wave_playout
        remembered = (min(1.0, dt / wave.memory), dt) if wave.memory else (1.0, 0.0)
        ahead = (dt, dt / wave.ahead) if wave.ahead else (0.0, 0.0)
        keeps = wave.target + dt if wave.target else 0.0
        return wave.target, keeps, min(1.0, dt / wave.settle), *remembered, *ahead

    def columns(self, e: End) -> tuple[Column, ...]:
        return (per_axis(f"queue_{e.name}", self.axes, "queue"),)

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.target, self.keeps, self.settles, self.recalls, self.spared, self.leads, self.returns = numbers
        for a, wave in zip(e.axes, self.axes, strict=True):
            wave.q = wave.p = wave.P = wave.G = wave.M = wave.queue = 0.0
            wave.C = 0.0 - self.target
            a.heard = a.sent = Integrals(0.0, 0.0, 0.0)

    def receive(self, run: Run, e: End) -> None:
        for a, wave in zip(e.axes, self.axes, strict=True):
            owed(run, e, a, wave)
            self.release(run, e, a, wave)
            play(run, e, a, wave)

    def release(self, run: Run, e: End, a: Axis, wave: AxisWaves) -> None:
        """Release part of what is owed in this tick: the wave p, and the credit."""
        wave.M = wave.M + (wave.L - wave.M) * self.recalls
        if wave.L - self.spared < wave.M:  # noqa: PLR1730 - a call costs more
            wave.M = wave.L - self.spared
        if wave.M < 0.0:  # noqa: PLR1730
            wave.M = 0.0
        wave.h = run.dt
        wave.credit = 0.0
        if run.half_dt <= wave.L:
            wave.H = wave.D * wave.D / (2.0 * wave.S if 2.0 * wave.S > TINY else TINY)
            wave.spare = wave.M if wave.L - self.keeps > wave.M else wave.L - self.keeps
            if wave.L - self.settles * wave.spare > wave.h:  # noqa: PLR1730
                wave.h = wave.L - self.settles * wave.spare
            if wave.h < wave.H and wave.h < wave.L:
                wave.h = wave.H if wave.H < wave.L else wave.L
            wave.p = wave.D / (wave.H if wave.h < wave.H else wave.h)
        else:
            wave.most = sqrt(wave.S / run.dt)
            if not -wave.most < wave.p < wave.most:
                if not -wave.most <= wave.p <= wave.most:  # minus nothing stays minus nothing
                    wave.p = -wave.most if wave.p < 0.0 else wave.most
            elif not e.got and self.leads + wave.L * self.returns > 0.0:
                wave.credit = self.leads + wave.L * self.returns
        if a.heard.T - (wave.h - run.dt) > wave.C and a.heard.T > 0.0:
            wave.C = a.heard.T - (wave.h - run.dt)
        wave.C = wave.C + wave.credit

    def act(self, run: Run, e: End, k: int) -> None:
        for a, wave in zip(e.axes, self.axes, strict=True):
            send_along(run, e, a, wave)


class WaveEnergyStage(WaveIntegralStage):
    """The same of all that is owed, at once within the energy."""

    name: ClassVar[str] = "wave_energy"

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # it has no times

    def receive(self, run: Run, e: End) -> None:
        for a, wave in zip(e.axes, self.axes, strict=True):
            owed(run, e, a, wave)
            wave.p = wave.D / max(run.dt, wave.D * wave.D / max(2.0 * wave.S, TINY))
            wave.C = max(wave.C, a.heard.T)
            play(run, e, a, wave)


def owed(run: Run, e: End, a: Axis, wave: AxisWaves) -> None:
    """Book what is owed of the other end's waves at this tick, and the energy that is left for it."""
    if e.has.leaves_out:
        wave.held = elapsed(run, e) - run.dt
        wave.P = wave.P + wave.held * wave.p
        wave.G = wave.G + wave.held * (0.5 * (wave.p * wave.p))
        wave.C = wave.C + wave.held
    wave.D = a.heard.U - wave.P
    wave.S = a.heard.E - wave.G if a.heard.E > wave.G else 0.0
    wave.L = a.heard.T - wave.C


def play(run: Run, e: End, a: Axis, wave: AxisWaves) -> None:
    """Book the wave p of this tick, and let the law have it."""
    wave.P = wave.P + run.dt * wave.p
    wave.G = wave.G + run.half_dt * (wave.p * wave.p)
    wave.queue = a.heard.T - wave.C
    a.rx = with_wave(e, a, wave.p)


def send_along(run: Run, e: End, a: Axis, wave: AxisWaves) -> None:
    """Integrals of the waves that this end sends, with that of this tick."""
    T, U, E = a.sent
    q = getattr(a.tx, e.tx_wave)
    if e.has.leaves_out:
        wave.held = elapsed(run, e) - run.dt
        T, U, E = T + wave.held, U + wave.held * wave.q, E + wave.held * (0.5 * (wave.q * wave.q))
        wave.q = q
    a.sent = Integrals(T + run.dt, U + run.dt * q, E + run.half_dt * (q * q))


class WaveScalingStage(Stage):
    """The received wave, once it has come, times sqrt(1 - rate)."""

    name: ClassVar[str] = "wave_scaling"
    gain: float

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return sqrt(1.0 - scene.wave_playout.rate)

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.gain = numbers

    def receive(self, run: Run, e: End) -> None:
        for a in e.axes:
            a.rx = with_wave(e, a, (self.gain if e.got else 1.0) * getattr(a.rx, e.rx_wave))


def with_wave(e: End, a: Axis, wave: Any) -> Any:
    """The received message with this wave in place of its own."""
    return e.Message(*[wave if field == e.rx_wave else getattr(a.rx, field) for field in e.rx_fields])
