"""Trials of a law's claims for `check_law`: closed loops of hands, bodies, walls and links drawn at random.

The hands, walls and links are written out here, on `teleop.physics` alone: `teleop` imports neither `master` nor
`slave` nor `channel`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import inf, sin
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop import kind
from teleop.errors import Refused
from teleop.law import At, Law, messages, start_at
from teleop.law.offers import claims_of, seeds
from teleop.physics.contact import wall
from teleop.physics.plant import MassDamper, Plant
from teleop.scene.parts import Reference
from teleop.scene.playout import Fixed, Hold, Integral, Playout, Zero, gaps_of
from teleop.scene.scene import Scene
from teleop.simulation.virtual import run
from teleop.stages.force_cap import Cap
from teleop.stages.watchdog import Watchdog

LOW = 1e-9  # J, and 1e-12 of the energy that went through: what rounding may take a ledger below zero
LOOPS = 24
DURATION = 0.4  # s


def try_claims(law: Law) -> None:
    """Raise `Refused` if a ledger that the law claims is not kept in one of the trials that its condition admits."""
    name, claims = type(law).__name__, claims_of(law)
    if not claims:
        return
    if "E_link" in claims:
        _waves_balance(law, name)
    scenes = [*trials(law, spread(name)), *(events(law, spread(f"{name} late")) if "E_law" in claims else ())]
    for i, scene in enumerate(scenes):
        tried = [ledger for ledger, condition in sorted(claims.items())
                 if admits(condition, scene) and (i < LOOPS or ledger == "E_law")]
        if tried:
            refuse_broken(law, scene, run(scene).trace, tried)


def refuse_broken(law: Any, scene: Scene, trace: Mapping[str, Any], claimed: Iterable[str]) -> None:
    """Refuse a law if one of the `claimed` ledgers is not kept in its run of `scene`."""
    name = type(law).__name__
    through = max(float(abs(trace[column]).max()) for column in trace if column.startswith("E_"))
    for ledger in claimed:
        if ledger == "E_law":
            _try_books(law, scene, trace)
            continue
        least = float(trace[ledger].min())
        if not least >= -max(LOW, 1e-12 * through):
            raise Refused(f"{name} claims {ledger}, which fell to {least:.3g} J {_where(scene)}; mend the law, or "
                          f"leave {ledger} out of its claims")


def admits(condition: str, scene: Scene) -> bool:
    """True if a claim with this condition holds for a trial."""
    link, gaps = scene.link, gaps_of(scene.played_as)
    if condition == "constant delay":
        return isinstance(link, RandomLink) and not (link.loss or link.jitter or link.copies or link.blackout)
    return condition == "any link" or isinstance(gaps, Zero)


def _try_books(law: Any, scene: Scene, trace: Mapping[str, Any]) -> None:
    """Refuse a law that keeps more energy than came in by its ports, or less than none (`teleop.law.offers`)."""
    name, E_law = type(law).__name__, trace["E_law"]
    works = works_of(trace)
    rounding = LOW + 1e-12 * np.cumsum(sum(works))
    for end, books in books_of(law, scene, trace).items():
        if not (wrong := books >= -rounding).all():
            k = int(np.argmin(wrong))
            raise Refused(f"{name} claims E_law, but at tick {k} its {end} keeps {-books[k]:.3g} J more than "
                          f"came in by its port {_where(scene)}; count the work of the force that was held, "
                          f"at.f_held*at.dx, and count it once")
    owed = E_law + greatest_work(works)
    if not (wrong := owed >= -rounding).all():
        k = int(np.argmin(wrong))
        raise Refused(f"{name} claims E_law, which fell to {E_law[k]:.3g} J at tick {k}, below zero by more than the "
                      f"work of one tick {_where(scene)}; mend the law, or leave E_law out of its claims")


def works_of(trace: Mapping[str, Any]) -> list[NDArray[np.float64]]:
    """The size of the work at the port of each end in each tick, J: master, and slave if there is one."""
    return [np.abs(np.diff(trace[f"E_port_{e}"], prepend=0.0)) for e in ("m", "s") if f"E_port_{e}" in trace]


def greatest_work(works: list[NDArray[np.float64]]) -> Any:
    """Depth below zero that E_law may have by each tick, J: the greatest work of one tick so far, of both ends."""
    return sum(np.maximum.accumulate(work) for work in works)


def books_of(law: Any, scene: Scene, trace: Mapping[str, Any]) -> dict[str, Any]:
    """Books by end: seed energy and energy in by the port less the energy kept, J a tick; below zero some is made."""
    took = {"master": trace["E_port_m"] - trace["E_law_m"], "slave": -trace["E_port_s"] - trace["E_law_s"]}
    return {end: books + seed for (end, books), seed in
            zip(took.items(), seeds(law, scene.dt, scene.axes), strict=True)}


def _where(scene: Scene) -> str:
    """A trial, as the end of a clause."""
    link = [f"over {scene.link} with {scene.played_as}"] if scene.slave is not None else []
    parts = [scene.hand, scene.master, scene.slave, scene.environment, scene.watchdog, scene.cap, scene.scaling,
             scene.left_out_m, scene.left_out_s, scene.law]
    *before, last = [*link, *[str(part) for part in parts if part is not None]]
    return f"{', '.join(before)} and {last}" if link else f"with {', '.join(before)} and {last}"


def _waves_balance(law: Any, name: str) -> None:
    """Refuse an end that gives its port more energy than the waves brought it, in one of `MOTIONS`.

    Playout that plays a wave at most once keeps the link's ledger from going below zero by itself. The law's own part
    is that it works with the ledger's waves, zero in place of a missing one: the sum of f_m v + (w^2 - u^2)/2 at the
    master, and of (u^2 - w^2)/2 - f_s v at the slave, is never below zero. The motion is
    x(k) = x(k-1) + dt v(k), for which a spring-damper taken at the end of its tick is passive.
    """
    forth, back = messages(law)
    u, w = kind.wave(forth), kind.wave(back)
    if u is None or w is None:
        raise Refused(f"{name} claims E_link, but its messages carry no waves; write `u: kind.Wave` for the field that "
                      "is one, in each direction, with `from teleop import kind`")
    for motion in MOTIONS:
        dice = spread(name)
        _one_end_balances(law, name, motion, dice, ("master", 1.0, back, w, u))
        _one_end_balances(law, name, motion, dice, ("slave", -1.0, forth, u, w))
    _loop_balances(law, name, (forth, u), (back, w))


MOTIONS = ("any", "still", "still, with gaps", "yielding")  # of a device that an end holds a force against


def _one_end_balances(law: Any, name: str, motion: str, dice: Iterator[float],
                      way: tuple[str, float, type[Any], str, str]) -> None:
    """Balance of one end, for `_waves_balance`. Under any motion the waves are any too.

    Of a device that is still a steady wave comes back whole, in gaps as nothing; one that yields takes energy out. So
    coupling and filter burn next to nothing of it, behind which too much energy could hide.
    """
    end, sign, rx_type, rx_wave, tx_wave = way
    dt = 1e-3
    tick, sums = getattr(law, end), getattr(law, f"{end}_sums", None)
    s, _ = getattr(law, f"{end}_start")(start_at(0.0, 0.0, 0.0, dt))
    x = f = v = stored = through = 0.0
    rx = rx_type(*[0.0 for _ in rx_type._fields])
    for k in range(500):
        fresh, touch = True, 0.0
        if motion == "any":
            v, touch = 2.0 * next(dice) - 1.0, 20.0 * next(dice) - 10.0
            fresh = next(dice) < 0.7
            rx = rx_type(*[4.0 * next(dice) - 2.0 for _ in rx_type._fields])
        else:
            v = max(-1.0, min(-0.2 * sign * f, 1.0)) if motion == "yielding" else 0.0
            fresh = motion != "still, with gaps" or next(dice) < 0.7
            rx = rx._replace(**{rx_wave: 1.5})
        x += dt * v
        at = At(x, v, touch, f, dt * v, fresh, 1e-3, dt, dt)
        f, tx, s = tick(s, at, rx, *([sums(s, at, rx)] if sums else []))
        wave_in, wave_out = getattr(rx, rx_wave) * at.fresh, getattr(tx, tx_wave)
        stored += dt * (sign * f * v + 0.5 * (wave_in * wave_in - wave_out * wave_out))
        through += dt * (abs(f * v) + 0.5 * (wave_in * wave_in + wave_out * wave_out))
        if not stored >= -1e-9 - 1e-6 * through:
            raise Refused(f"{name} claims E_link, but by tick {k} its {end} gave its port {-stored:.3g} J "
                          "more than the waves brought; put zero for a wave that is not fresh, solve "
                          "force and velocity together, or leave E_link out of its claims")


def _loop_balances(law: Any, name: str, fwd: tuple[type[Any], str], bwd: tuple[type[Any], str]) -> None:
    """Balance of both ends at once, 40 ms apart: an end that gets answers to its own waves may behave otherwise.

    The master is swung, and the slave is a mass of 0.5 kg in free space.
    """
    dt, lag = 1e-3, 40
    ends = {"master": 1.0, "slave": -1.0}
    states, sent, f, v, x, stored, through = {}, {}, {}, {}, {}, {}, {}
    for end in ends:
        states[end], held = getattr(law, f"{end}_start")(start_at(0.0, 0.0, 0.0, dt))
        sent[end] = [held] * lag  # what this end receives
        f[end] = v[end] = x[end] = stored[end] = through[end] = 0.0
    for k in range(600):
        v["slave"] = max(-1.0, min(v["slave"] + dt / 0.5 * (f["slave"] - v["slave"]), 1.0))
        v["master"] = 0.2 * sin(0.02 * k) + 0.1 * sin(0.0523 * k)
        messages_out = {}
        for end, sign in ends.items():
            (_, rx_wave), (_, tx_wave) = (bwd, fwd) if end == "master" else (fwd, bwd)
            x[end] += dt * v[end]
            at = At(x[end], v[end], 0.0, f[end], dt * v[end], k >= lag, lag * dt if k >= lag else inf, dt, dt)
            rx, sums = sent[end][k], getattr(law, f"{end}_sums", None)
            s, tick = states[end], getattr(law, end)
            f[end], messages_out[end], states[end] = tick(s, at, rx, *([sums(s, at, rx)] if sums else []))
            r, q, work = getattr(rx, rx_wave) * at.fresh, getattr(messages_out[end], tx_wave), f[end] * v[end]
            stored[end] += dt * (sign * work + 0.5 * (r * r - q * q))
            through[end] += dt * (abs(work) + 0.5 * (r * r + q * q))
            if not stored[end] >= -1e-9 - 1e-6 * through[end]:
                raise Refused(f"{name} claims E_link, but by tick {k} of a swing in free space its {end} gave its port "
                              f"{-stored[end]:.3g} J more than the waves brought; play no more energy than came, or "
                              "leave E_link out of its claims")
        sent["slave"].append(messages_out["master"])
        sent["master"].append(messages_out["slave"])


def trials(law: Law, dice: Iterator[float]) -> Iterator[Scene]:
    """Scenes with energy ledgers: constant delays at first, then loss, jitter and copies.

    Playout is zero, integral and fixed by turns. It never holds a wave in a gap, which is active whatever the law does.
    """
    def between(low: float, high: float) -> float:
        """Evenly spread in the logarithm."""
        return float(low * (high / low) ** next(dice))

    for i in range(LOOPS):
        rough = i >= LOOPS // 3
        plain: Playout = Integral() if i % 4 == 1 else Zero()
        playout = Fixed(0.01 + 0.1 * next(dice)) if i % 4 == 3 else plain
        yield Scene(
            law=law, playout=playout, energy=True, duration=DURATION, x_limit=1e3,
            axes=3 if i % 6 == 5 else 1, observer=None if i % 2 else 200.0,
            master=MassDamper(mass=between(0.02, 2.0), damping=2.0 * next(dice)),
            hand=Swing(mass=next(dice), k=between(10.0, 1000.0), d=between(0.1, 20.0),
                       reference=Tones(amplitude=0.05, rate=between(3.0, 60.0))),
            slave=MassDamper(mass=between(0.05, 5.0), damping=2.0 * next(dice)),
            environment=Block(k=between(10.0, 1e5), d=10.0 * next(dice), at=0.03 * (next(dice) - 0.5)),
            link=RandomLink(ticks=int(100 * next(dice)), loss=0.5 * next(dice) * rough, jitter=int(20 * rough),
                       copies=0.2 * rough, key=next(dice)),
        )


def events(law: Law, dice: Iterator[float]) -> Iterator[Scene]:
    """Scenes as `trials` has them, with what changes a force behind the law: ticks left out, a watchdog, a force cap.

    A law without waves has its last message played again in gaps by turns. The ends start apart.
    """
    waves = all(map(kind.waves, messages(law)))
    for i, scene in enumerate(trials(law, dice)):
        yield replace(
            scene, start_m=0.02 * next(dice), start_s=-0.02 * next(dice),
            playout=Hold() if not waves and i % 3 == 0 else scene.playout,
            left_out_m=LostTicks(share=0.3 * next(dice), key=next(dice)) if i % 4 < 2 else None,
            left_out_s=LostTicks(share=0.3 * next(dice), key=next(dice)) if i % 4 > 0 else None,
            watchdog=Watchdog(timeout=0.03, ramp=0.02) if i % 2 else None,
            cap=Cap(f_max=0.5 + 5.0 * next(dice)) if i % 3 == 1 else None)
    yield capped_scene(law)


def capped_scene(law: Law) -> Scene:
    """Three axes with a wall in one of them and a force cap, which turns the held force to another direction."""
    return Scene(
        law=law, playout=Zero(), energy=True, duration=DURATION, x_limit=1e3, axes=3, cap=Cap(f_max=3.0),
        master=MassDamper(mass=0.3, damping=1.5), slave=MassDamper(mass=3.3, damping=2.0),
        hand=Swing(mass=0.0, k=8000.0, d=16.0, reference=Tones(amplitude=0.16, rate=26.0)),
        environment=Block(k=1400.0, d=0.0, at=-0.044), observer=None,
        link=RandomLink(ticks=31, loss=0.0, jitter=0, copies=0.0, key=0.3))


@dataclass(frozen=True, kw_only=True)
class Tones:
    """Two tones that repeat no pattern within the run; `amplitude` in m, `rate` in rad/s."""

    amplitude: float
    rate: float

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[list[float], ...]:
        """Positions (m) per axis."""
        return tuple(
            [self.amplitude * (sin(self.rate * t + i) + 0.5 * sin(2.618 * self.rate * t)) / 1.5
             for t in (k * dt_ns / 1e9 for k in range(count))]
            for i in range(axes)
        )


@dataclass(frozen=True, kw_only=True)
class Swing:
    """A grip that follows a reference."""

    mass: float
    k: float
    d: float
    reference: Reference


@dataclass(frozen=True, kw_only=True)
class Block:
    """A wall that fills x > at, or with side=-1.0 x < at."""

    k: float
    d: float
    at: float
    side: float = 1.0

    def plant(self, body: MassDamper, dt: float) -> Plant:
        """`body` beside this wall."""
        return wall(body, dt, k=self.k, d=self.d, at=self.at, side=self.side)


@dataclass(frozen=True, kw_only=True)
class LostTicks:
    """Ticks that an end leaves out: a `share` of them, scattered by `key`."""

    share: float
    key: float

    def left_out(self, end: int, count: int, seed: int) -> NDArray[np.bool_]:
        """See `teleop.scene.parts`. The seed makes no difference: a trial is one fixed case."""
        del seed
        out: NDArray[np.bool_] = _hash(np.arange(count), self.key + end / 3.0) < self.share
        return out


class RandomArrivals(NamedTuple):
    """Packets in the order in which they come out of the link."""

    packet: NDArray[np.int64]
    time_ns: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class RandomLink:
    """A link with a delay of whole `ticks` and up to `jitter` more; `loss` and `copies` are probabilities."""

    ticks: int
    loss: float
    jitter: int
    copies: float
    key: float
    blackout: int = 0  # ticks of silence after as many in which packets come; 0: none

    def arrivals(self, direction: int, count: int, dt_ns: int, seed: int, size: int) -> RandomArrivals:
        """See `teleop.scene.Link`. The seed and the size make no difference: a trial is one fixed case."""
        del seed, size

        packets = np.arange(count)
        drawn = [_hash(packets, self.key + direction + place / 7.0) for place in range(4)]
        passed = (drawn[0] >= self.loss) & (packets // max(self.blackout, 1) % 2 * min(self.blackout, 1) == 0)
        copied = passed & (drawn[1] < self.copies)
        packet = np.concatenate([packets[passed], packets[copied]])
        late = np.concatenate([drawn[2][passed], drawn[3][copied]]) * self.jitter
        time_ns = ((packet + self.ticks + late) * dt_ns).astype(np.int64)
        order = np.argsort(time_ns, kind="stable")
        return RandomArrivals(packet[order], time_ns[order])


def _hash(packets: NDArray[np.int64], key: float) -> NDArray[np.float64]:
    """Numbers in [0, 1), one a packet, that scatter losses; they are too plain for statistics."""
    turned: NDArray[np.float64] = (np.sin((packets + 1.0) * (12.9898 + key)) * 43758.5453) % 1.0
    return turned


def spread(name: str) -> Iterator[float]:
    """An endless fixed sequence of numbers in [0, 1): a 64-bit congruential generator (Knuth, MMIX)."""
    n = int.from_bytes(name.encode()[-8:], "little")
    while True:
        n = (n * 6364136223846793005 + 1442695040888963407) % (1 << 64)
        yield (n >> 11) / (1 << 53)
