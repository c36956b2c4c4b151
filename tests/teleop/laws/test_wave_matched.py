"""Matched ends: the numbers of the law book, the reflection of a held end, and the energy of both couplings."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from channel.delay import Delay
from teleop import At, MassDamper, Scene, Watchdog, load_scene, run
from teleop.analysis.passivity.two_port import continuous_two_port
from teleop.laws.wave_matched import Back, Forth, WaveMatched, WaveMatchedEnd

NAN = float("nan")


def at(x: float = 0.0, v: float = 0.0, dt: float = 1e-3, *, gap: int = 0, gain: float = 1.0) -> At:
    return At(x, v, NAN, NAN, NAN, True, 0.05, dt, dt * (1 + gap), gain)


@pytest.mark.parametrize(("frequency", "magnitude"), [(0.5, 3.032083), (1.0, 9.537353), (5.0, 3.182653)])
def test_what_a_hand_feels_of_it_is_the_law_books(frequency: float, magnitude: float) -> None:
    scene = Scene(law=WaveMatched(), master=MassDamper(mass=0.1, damping=0.5), duration=1.0,
                  slave=MassDamper(mass=0.5, damping=1.0), link=Delay(0.05), observer=None)
    h11 = continuous_two_port(scene, np.array([frequency])).h[0, 0, 0]
    assert abs(h11) == pytest.approx(magnitude, abs=5e-7)


def test_free_motion_has_the_law_books_figure() -> None:
    result = run(replace(load_scene("free_motion", law=WaveMatched(), delay=0.05), observer=None))
    assert 1e3 * result.metrics["x_err_rms"] == pytest.approx(7.814372, abs=5e-7)
    assert result.metrics["E_link_min"] >= 0.0


@pytest.mark.parametrize("end", ["master", "slave"])
@pytest.mark.parametrize(("frequency", "share"), [(1.0, 0.998739), (5.0, 0.969839), (50.0, 0.369698)])
def test_a_held_end_sends_back_the_law_books_share_of_a_wave(end: str, frequency: float, share: float) -> None:
    """K/|2 b s + K| by the tick itself, at ticks of 0.5 us: backward Euler comes to it with the tick."""
    law, dt = WaveMatched(K=500.0, b=2.0), 5e-7
    got = abs(reflected(law, end, 2.0 * pi * frequency, dt))
    assert got == pytest.approx(share, abs=2e-4 * frequency / 50.0 + 1e-6)
    assert 500.0 / abs(4.0j * 2.0 * pi * frequency + 500.0) == pytest.approx(share, abs=5e-7)


def reflected(law: WaveMatched, end: str, w: float, dt: float) -> complex:
    """Wave sent over wave received of a held device, at w rad/s, from the tick as a linear map of (x_d, wave)."""
    def tick(x_d: float, wave: float) -> tuple[float, float]:
        rx = Back(wave) if end == "master" else Forth(wave)
        _, tx, s = getattr(law, end)(WaveMatchedEnd(x_d, 0.0), at(dt=dt), rx)
        return s.x_d, tx[0]

    (a, c), (b, d) = tick(1.0, 0.0), tick(0.0, 1.0)
    z = np.exp(1j * w * dt)
    return complex(d + c * b / (z - a))


@pytest.mark.parametrize("end", ["master", "slave"])
@given(b=st.floats(0.1, 100.0), K=st.floats(0.0, 1e4), x=st.floats(-0.01, 0.01), v=st.floats(-1.0, 1.0),
       wave=st.floats(-5.0, 5.0), gain=st.sampled_from([0.0, 0.3, 1.0]))
def test_the_power_of_an_ends_waves_is_that_of_its_point_whatever_it_holds(
    end: str, b: float, K: float, x: float, v: float, wave: float, gain: float
) -> None:
    """f of the channel and v_d: (u^2 - w^2)/2 = f v_d, f the device's g f and a damper's (1 - g) b v_d."""
    law = WaveMatched(b=b, K=K)
    rx = Back(wave) if end == "master" else Forth(wave)
    force, (sent,), s = getattr(law, end)(WaveMatchedEnd(0.0, 0.0), at(x, v, gain=gain), rx)
    into = gain * force - (1.0 - gain) * b * s.v_d if end == "master" else gain * force + (1.0 - gain) * b * s.v_d
    u, w = (sent, wave) if end == "master" else (wave, sent)
    size = 1e-11 * (1.0 + u * u + w * w + K * x * x + b * v * v) * (1.0 + K * 1e-3 / b)
    assert (u * u - w * w) / 2.0 == pytest.approx(into * s.v_d, abs=size)
    assert sqrt(2.0 * b) * s.v_d == pytest.approx(u + w, abs=size)
    if gain == 0.0:
        assert sent == pytest.approx(0.0, abs=size)


def test_a_steady_force_stays_and_is_the_offset_of_either_coupling() -> None:
    """A master pressed onto a held slave: force on both equal, and each coupling K deep in it."""
    result = run(load_scene("hard_wall", law=WaveMatched(b=20.0, K=1000.0), duration=10.0))
    f_m, f_s = result.trace["f_m"][-1], result.trace["f_s"][-1]
    assert f_m > 2.0
    assert f_m == pytest.approx(f_s, rel=1e-3)
    t_half = result.trace["f_m"][len(result.trace["t"]) // 2]
    assert f_m == pytest.approx(t_half, rel=2e-2)


@given(v=st.floats(-1.0, 1.0), gap=st.integers(1, 30))
def test_a_steady_motion_goes_on_after_ticks_that_were_left_out(v: float, gap: int) -> None:
    law, dt = WaveMatched(), 1e-3
    for end in ("master", "slave"):  # v_d = v and no force: both waves are sqrt(b/2) v
        rx = (Back if end == "master" else Forth)(sqrt(law.b / 2.0) * v)
        here = at((gap + 1) * dt * v, v, gap=gap)
        force, (sent,), s = getattr(law, end)(WaveMatchedEnd(0.0, v), here, rx)
        assert force == pytest.approx(0.0, abs=1e-9)
        assert s.x_d == pytest.approx((gap + 1) * dt * v, abs=1e-12)
        assert sent == pytest.approx(sqrt(law.b / 2.0) * v, abs=1e-9)


def test_a_master_that_took_hold_again_pulled_the_hand_by_a_spring_that_nobody_had_stretched() -> None:
    """An outage of 1.5 s in which the watchdog lets go; the ports got 35 mJ more than they had given."""
    scene = load_scene("free_motion", law=WaveMatched(), link="delay(0.02) | blackout(1.0, 1.5)", duration=4.0)
    trace = run(replace(scene, watchdog=Watchdog(timeout=0.1))).trace
    assert trace["E_port"].min() >= -1e-4
    law = WaveMatched()
    for gain in (0.0, 0.5):
        _, _, s = law.master(WaveMatchedEnd(0.0, 0.0), at(0.02, gain=gain), Back(0.0))
        assert abs(0.02 - s.x_d) <= gain * 0.02 + 1e-12
