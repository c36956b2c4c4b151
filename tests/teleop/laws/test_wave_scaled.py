"""Scaled waves: the law book's energies over a delay that varies, the null rule as a damper, and no energy made."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import At, Wave, Zero, load_scene, run
from teleop.laws.wave_scaled import Back, ScaledWave, WaveScaled, scale_wave

NAN = float("nan")


def u(t: np.ndarray) -> np.ndarray:
    found: np.ndarray = np.sin(6.0 * np.pi * t) + 0.5 * np.sin(14.6 * np.pi * t + 1.0)
    return found


def triangle(t: np.ndarray, slope: float) -> np.ndarray:
    """A delay between 50 and 90 ms, s."""
    phase = np.mod(t * slope, 0.08)
    found: np.ndarray = 0.05 + np.minimum(phase, 0.08 - phase)
    return found


@pytest.mark.parametrize(("slope", "least", "end"), [
    (0.1, -0.009328, 0.003620), (0.25, -0.013166, 0.038207), (0.5, -0.094636, 0.003620)])
def test_over_a_triangle_of_delays_waves_make_energy_and_scaled_ones_do_not(
        slope: float, least: float, end: float) -> None:
    """The law book's figures, in continuous time: steps of 10 us, in the middle of each."""
    dt = 1e-5
    t = (np.arange(400_000) + 0.5) * dt
    sent_at = t - triangle(t, slope)
    played = np.where(sent_at >= 0.0, u(sent_at), 0.0)
    rate = np.where(np.mod(t * slope, 0.08) < 0.04, slope, -slope)  # dT/dt
    unscaled = np.cumsum(0.5 * dt * (u(t) ** 2 - played**2))
    by_rate = np.cumsum(0.5 * dt * (u(t) ** 2 - (1.0 - rate) * played**2))
    assert unscaled.min() == pytest.approx(least, abs=5e-7)
    assert by_rate.min() >= 0.0
    assert by_rate[-1] == pytest.approx(end, abs=5e-7)


@pytest.mark.parametrize(("slope", "tau"), [(0.1, 0.0), (0.25, 0.02), (0.5, 0.1)])
def test_so_it_is_packet_by_packet_with_the_newest_at_every_tick(slope: float, tau: float) -> None:
    """At 1 kHz. In the end it has kept the energy of what newer waves overtook: g^2 is 1, and not 1 + slope."""
    dt, count = 1e-3, 4000
    k = np.arange(count)
    sent = u(k * dt)
    newest = np.floor(k - triangle(k * dt, slope) / dt + 1e-9).astype(int)  # its delay is that of the tick it comes at
    played, unscaled, s, last = [], [], ScaledWave(1.0, 0.0, 0.0, 0.0), -1
    for now in k:
        at_hand = int(newest[now])
        age = (now - at_hand) * dt if at_hand >= 0 else float("inf")
        s = scale_wave(s.g2, s.S, s.p, s.r, sent[at_hand] if at_hand >= 0 else 0.0, at_hand > last, age, tau, dt, dt)
        played.append(s.p)
        unscaled.append(sent[at_hand] if at_hand >= 0 else 0.0)
        last = max(last, at_hand)
    link = np.cumsum(0.5 * dt * (sent**2 - np.array(played) ** 2))
    assert np.cumsum(0.5 * dt * (sent**2 - np.array(unscaled) ** 2)).min() < -0.009
    assert link.min() >= 0.0
    kept = {0.1: 0.066631, 0.25: 0.188832, 0.5: 0.318196}[slope]  # in continuous time with min(1 - dT/dt, 1)
    assert link[-1] == pytest.approx(kept, rel=0.25)


waves = st.lists(st.tuples(st.floats(-5.0, 5.0), st.booleans(), st.integers(0, 3)), min_size=1, max_size=80)


@given(came=waves, tau=st.sampled_from([0.0, 0.003, 0.05, 1.0]))
def test_what_is_played_is_never_more_than_came(came: list[tuple[float, bool, int]], tau: float) -> None:
    """Ticks left out among them: what a wave held over them overdraws is paid before anything more is played."""
    dt, s, newest = 1e-3, ScaledWave(1.0, 0.0, 0.0, 0.0), 0.0
    for wave, fresh, gap in came:
        newest = wave if fresh else newest
        overdrawn = min(s.S + dt * gap * (s.r**2 - s.p**2) / 2.0, 0.0)
        s = scale_wave(s.g2, s.S, s.p, s.r, newest, fresh, 0.05, tau, dt, dt * (1 + gap))
        assert 0.0 <= s.g2 <= 1.0
        assert abs(s.p) <= abs(newest) * (1.0 + 1e-15)
        assert overdrawn - 1e-15 <= s.S
        if overdrawn < 0.0 and s.S < -1e-15:
            assert s.p == 0.0


def test_without_smoothing_it_is_the_wave_law_with_zero_for_a_missing_wave() -> None:
    scene = load_scene("canonical", link="delay(0.03) | uniform(0.01) | bernoulli(0.1)", playout=Zero(), duration=2.0)
    null, plain = (run(load_scene("canonical", law=law, link=scene.link, playout=Zero(), duration=2.0), seed=3).trace
                   for law in (WaveScaled(tau=0.0), Wave()))
    for name in ("f_m", "x_s", "f_s"):
        assert null[name] == pytest.approx(plain[name], abs=1e-9)


def test_over_a_constant_delay_it_is_the_wave_law() -> None:
    scaled_by, plain = (run(load_scene("canonical", law=law, duration=2.0)).trace for law in (WaveScaled(), Wave()))
    assert scaled_by["f_m"] == pytest.approx(plain["f_m"], abs=1e-9)


@pytest.mark.parametrize(("law", "p", "damping"), [
    (Wave(b=2.0), 0.05, 39.025641), pytest.param(Wave(b=2.0), 0.1, 19.052632, marks=pytest.mark.full),
    pytest.param(WaveScaled(b=2.0), 0.05, 78.0, marks=pytest.mark.full), (WaveScaled(b=2.0), 0.1, 38.0)])
def test_against_a_held_slave_lost_waves_leave_a_damper(law: Wave | WaveScaled, p: float, damping: float) -> None:
    """b (1 + h)/(1 - h): h = (1 - p)^2 with the null rule, 1 - p scaled; a master that moves at 0.1 m/s, in the mean.

    Scaled it is at most that, and 0.9 of it here: nearly twice that of the null rule.
    """
    dice = np.random.default_rng(5)
    h = (1.0 - p) ** 2 if isinstance(law, Wave) else 1.0 - p
    assert law.b * (1.0 + h) / (1.0 - h) == pytest.approx(damping, abs=5e-7)
    forces = mean_force(law, p, dice)
    low = 0.96 if isinstance(law, Wave) else 0.88  # g^2 follows the rate within tau, and S cuts what it runs ahead
    assert low <= forces / 0.1 / damping <= 1.04


def mean_force(law: Wave | WaveScaled, p: float, dice: np.random.Generator) -> float:
    """N, behind one tick each way, over the second half of 60,000 ticks."""
    rigid = type(law)(b=law.b, K=1e12, B=1e12)
    count, v, total = 60_000, 0.1, 0.0
    kept = dice.random((2, count)) >= p
    (m, back), (s, forth) = rigid.master_start(here(0.0)), rigid.slave_start(here(0.0))
    for k in range(count):
        f, sent, m = rigid.master(m, here(v, fresh=bool(kept[0, k])), back)  # type: ignore[arg-type]
        _, returned, s = rigid.slave(s, here(0.0, fresh=bool(kept[1, k])), forth)  # type: ignore[arg-type]
        back = returned if k + 1 < count and kept[0, k + 1] else back  # type: ignore[assignment]
        forth = sent if k + 1 < count and kept[1, k + 1] else forth  # type: ignore[assignment]
        total += f * (k >= count // 2)
    return 2.0 * total / count


def here(v: float, *, fresh: bool = True) -> At:
    return At(0.0, v, NAN, NAN, NAN, fresh, 1e-3, 1e-3, 1e-3)


def test_a_held_wave_is_scaled_by_the_root_of_the_rate() -> None:
    """Nine messages of ten: g^2 comes to 0.9 around, and the wave in the gap is the last one so scaled."""
    law, s = WaveScaled(tau=0.1), ScaledWave(1.0, 0.0, 0.0, 0.0)
    for k in range(4000):
        f, _, s = law.master(s, here(0.0, fresh=k % 10 != 0), Back(1.0))
    assert s.g2 == pytest.approx(0.9, abs=0.01)
    assert f == pytest.approx(-sqrt(2.0 * law.b * s.g2), rel=1e-12)
