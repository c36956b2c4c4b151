"""The energy of a wave link: what delay, loss, jitter, copies and the filling of gaps make of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from channel import Bernoulli, Delay, Duplicate, UniformJitter
from master.hand import Grip, Sine
from slave.wall import Wall
from teleop import Fixed, Hold, MassDamper, Playout, Scene, Wave, Zero, run
from teleop.scene.parts import LinkLike
from teleop.simulation.plan import plan

MS = 1_000_000
NO_REPEATS = Zero()


def spread(low: float, high: float) -> st.SearchStrategy[float]:
    """Values between low and high, evenly in the logarithm."""
    return st.floats(0.0, 1.0).map(lambda part: low * (high / low) ** part)


def scene(law: Wave, link: LinkLike | None, playout: Playout = NO_REPEATS, **other: float) -> Scene:
    """A hand that swings a master, and a slave that strikes a wall."""
    knobs = {"m_m": 0.1, "m_s": 0.5, "k_h": 200.0, "k_e": 5000.0, "wall": 0.01, "rate": 2.0, "duration": 0.8} | other
    return Scene(
        law=law, link=link, playout=playout, energy=True, duration=knobs["duration"], observer=None,
        master=MassDamper(mass=knobs["m_m"], damping=0.2), slave=MassDamper(mass=knobs["m_s"], damping=0.1),
        hand=Grip(mass=0.1, k=knobs["k_h"], d=1.0, reference=Sine(amplitude=0.05, frequency=knobs["rate"])),
        environment=Wall(k=knobs["k_e"], d=1.0, at=knobs["wall"]),
    )


def lowest(scene: Scene, seed: int = 0) -> float:
    """The smallest E_link of a run, J, rounding of what went through taken off."""
    trace = run(scene, seed=seed).trace
    through = float(trace["E_in_fwd"].max() + trace["E_in_bwd"].max())
    return float(trace["E_link"].min()) + 1e-13 * through


bodies = {
    "b": spread(1e-3, 1e3), "m_m": spread(0.01, 5.0), "m_s": spread(0.05, 5.0), "k_h": spread(1.0, 2000.0),
    "k_e": st.one_of(st.just(0.0), spread(10.0, 1e6)), "wall": st.floats(-0.03, 0.03), "rate": spread(0.3, 20.0),
}


@given(delay=st.floats(0.0, 0.5), **bodies)
@settings(max_examples=25)
def test_the_link_never_gives_more_than_it_got_at_any_constant_delay(delay: float, b: float, **other: float) -> None:
    assert lowest(scene(Wave(b=b), Delay(delay), **other)) >= -1e-9


@given(delay=st.floats(0.0, 0.2), loss=st.floats(0.0, 0.9), jitter=st.floats(0.0, 0.05),
       copies=st.floats(0.0, 1.0), seed=st.integers(0, 2**64 - 1),
       gaps=st.sampled_from([Zero(), Fixed(0.03), Fixed(0.15)]), **bodies)
@settings(max_examples=25)
def test_nor_with_random_loss_jitter_and_copies_if_the_gaps_are_zero(
    delay: float, loss: float, jitter: float, copies: float, seed: int, gaps: Playout, b: float, **other: float
) -> None:
    link = Delay(delay) | UniformJitter(jitter) | Bernoulli(loss) | Duplicate(copies, after=0.003)
    assert lowest(scene(Wave(b=b), link, gaps, **other), seed) >= -1e-9


def test_holding_the_last_wave_makes_energy_in_the_whole_scene() -> None:
    link = Delay(0.01) | UniformJitter(0.02)
    held = run(scene(Wave(b=2.0), link, Hold(), duration=4.0), seed=1)
    assert held.metrics["E_link_min"] < -1e-3
    assert any("E_link may fall below zero" in note for note in held.notes)
    zero = run(scene(Wave(b=2.0), link, Zero(), duration=4.0), seed=1)
    assert zero.metrics["E_link_min"] >= 0.0
    assert not any("E_link" in note for note in zero.notes)


def stored(link: LinkLike, wave: Sequence[float], playout: Playout, seed: int) -> float:
    """The smallest energy stored in one direction of a link at 1 kHz, into which `wave` is sent."""
    u, count = np.asarray(wave), len(wave)
    arrived = link.arrivals(0, count, MS, seed, 100)
    played = np.array(plan(playout, arrived.packet, arrived.time_ns, count, MS).play)
    fresh = played >= 0
    newest = np.maximum.accumulate(played)
    taken = np.where(fresh if playout == Zero() else newest >= 0, u[newest], 0.0)
    return float(np.cumsum(0.5e-3 * (u * u - taken * taken)).min())


TWO_TONES = [0.5 * (np.sin(2.0 * pi * 5.0 * t) + np.sin(2.0 * pi * 6.0 * t)) for t in np.arange(20_000) * 1e-3]


@pytest.mark.parametrize("link", [
    Delay(0.05) | Bernoulli(0.1), Delay(0.05) | UniformJitter(0.02) | Bernoulli(0.1)
], ids=["loss", "loss and jitter"])
def test_zero_for_a_lost_wave_is_passive_and_holding_the_last_one_is_not(link: LinkLike) -> None:
    """Known numbers: 10 % loss, 50 ms, a two-tone wave at 1 kHz, 20 s; its signs."""
    held = [stored(link, TWO_TONES, Hold(), seed) for seed in range(8)]
    assert min(held) < 0.0
    assert min(stored(link, TWO_TONES, Zero(), seed) for seed in range(8)) >= 0.0


@dataclass(frozen=True)
class Echo:
    """Every packet arrives at once, and again `after` ticks later."""

    after: int

    def arrivals(self, direction: int, count: int, dt_ns: int, seed: int, size: int) -> Echo.Twice:
        first = np.arange(count)
        time = np.concatenate([first, first + self.after]) * dt_ns
        order = np.argsort(time, kind="stable")
        return self.Twice(np.concatenate([first, first])[order], time[order])

    @dataclass(frozen=True)
    class Twice:
        packet: np.ndarray
        time_ns: np.ndarray


def test_a_copy_is_played_once_on_a_wave_made_to_be_told_twice() -> None:
    """One wave in each ten ticks, doubled: a copy counted as fresh would give twice what was sent."""
    wave = np.array([float(k % 10 == 0) for k in range(1000)])
    link = Echo(after=4)
    assert stored(link, wave, Zero(), 0) >= 0.0
    arrived = link.arrivals(0, len(wave), MS, 0, 100)
    told_twice = np.cumsum(0.5e-3 * wave**2)[-1] - 0.5e-3 * (wave[arrived.packet] ** 2).sum()
    assert told_twice < -0.04
