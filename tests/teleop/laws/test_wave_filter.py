"""Filtered waves: the numbers of the law book, the filter's own energy, and its lag as a longer delay."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from channel.delay import Delay
from teleop import At, MassDamper, Scene, Wave, load_scene, run
from teleop.analysis.passivity.two_port import continuous_two_port
from teleop.laws.wave_filter import Back, Forth, WaveFilter, WaveFilterSlave, low_pass

NAN = float("nan")


@pytest.mark.parametrize(("frequency", "magnitude"), [(0.5, 3.103925), (1.0, 10.200876), (5.0, 3.545182)])
def test_what_a_hand_feels_of_it_is_the_law_books(frequency: float, magnitude: float) -> None:
    scene = Scene(law=WaveFilter(f_c=20.0), master=MassDamper(mass=0.1, damping=0.5), duration=1.0,
                  slave=MassDamper(mass=0.5, damping=1.0), link=Delay(0.05), observer=None)
    h11 = continuous_two_port(scene, np.array([frequency])).h[0, 0, 0]
    assert abs(h11) == pytest.approx(magnitude, abs=5e-7)


def test_free_motion_has_the_law_books_figures() -> None:
    result = run(replace(load_scene("free_motion", law=WaveFilter(), delay=0.05), observer=None))
    assert 1e3 * result.metrics["x_err_rms"] == pytest.approx(8.259487, abs=5e-7)
    assert result.metrics["f_m_max"] == pytest.approx(0.862727, abs=5e-7)
    assert 1e3 * result.trace["x_s"][-1] == pytest.approx(-9.750218, abs=5e-7)
    assert result.metrics["E_link_min"] >= 0.0


def test_a_clamped_slave_is_felt_as_a_spring_that_the_lag_softens() -> None:
    """b/(T + 1/l): a master that is moved by 1 mm and held, 50 ms each way, b = 2, f_c = 20 Hz."""
    law, dt, delay = WaveFilter(f_c=20.0, K=1e12, B=1e12), 1e-3, 50
    m, back = law.master_start(at(0.0))
    s, forth = law.slave_start(at(0.0))
    sent, returned, f_m = [forth] * delay, [back] * delay, 0.0
    for k in range(24_000):  # 0.1 s around the loop, of which the filter takes 5 %
        v = 2e-3 * (k < 500)
        f_m, u, m = law.master(m, at(v), returned[k])
        _, w, s = law.slave(s, at(0.0), sent[k])
        sent.append(u)
        returned.append(w)
    stiffness = f_m / (500 * dt * 2e-3)
    assert stiffness == pytest.approx(34.507898, abs=5e-7)
    assert stiffness == pytest.approx(2.0 / (0.05 + 1.0 / (2.0 * pi * 20.0)), rel=1e-9)


def at(v: float, dt: float = 1e-3, *, gap: int = 0, gain: float = 1.0) -> At:
    return At(0.0, v, NAN, NAN, NAN, True, 0.05, dt, dt * (1 + gap), gain)


waves = st.lists(st.tuples(st.floats(-5.0, 5.0), st.integers(0, 3)), min_size=1, max_size=60)


@given(received=waves, l=st.floats(1.0, 300.0))
def test_the_filter_gives_no_more_energy_than_it_got_and_keeps_its_square(
    received: list[tuple[float, int]], l: float  # noqa: E741
) -> None:
    """At every tick, ticks left out among them, of gaps up to 1/l, what it got is what it gave, keeps and burns."""
    dt = 1e-3
    y = r = stored = 0.0
    for wave, gap in received:
        held = dt * gap
        stored += held * (r * r - y * y) / 2.0
        y, r = low_pass(y, r, wave, l, dt, held), wave
        stored += dt * (r * r - y * y) / 2.0
        assert stored >= y * y / (2.0 * l) - 1e-12


@given(received=waves, l=st.floats(1.0, 300.0))
def test_the_integral_of_a_filtered_wave_lags_by_what_the_filter_holds_and_so_nothing_drifts(
    received: list[tuple[float, int]], l: float  # noqa: E741
) -> None:
    dt = 1e-3
    y = r = owed = 0.0
    for wave, gap in received:
        owed += dt * gap * (r - y)
        y, r = low_pass(y, r, wave, l, dt, dt * gap), wave
        owed += dt * (r - y)
        assert owed == pytest.approx(y / l, abs=1e-12)


def test_without_a_lag_it_is_the_wave_law() -> None:
    fast = run(load_scene("canonical", law=WaveFilter(f_c=1e9), duration=2.0)).trace
    plain = run(load_scene("canonical", law=Wave(), duration=2.0)).trace
    assert np.abs(fast["f_m"] - plain["f_m"]).max() < 1e-4
    assert np.abs(fast["x_s"] - plain["x_s"]).max() < 1e-6


def test_a_slave_that_may_hold_no_force_returns_nothing_of_what_it_filtered() -> None:
    law = WaveFilter()
    _, back, _ = law.slave(WaveFilterSlave(1.0, 1.0, 0.1, 0.0), at(0.2, gain=0.0), Forth(1.5))
    assert back.w == pytest.approx(0.0, abs=1e-15)


def test_a_missing_wave_counts_as_zero_and_the_filter_runs_out() -> None:
    law = WaveFilter()
    s, _ = law.master_start(at(0.0))
    _, _, s = law.master(s, at(0.0), Back(1.0))
    forces = []
    for _ in range(200):
        f, _, s = law.master(s, at(0.0)._replace(fresh=False), Back(1.0))
        forces.append(abs(f))
    assert forces == sorted(forces, reverse=True)
    assert forces[-1] < 1e-9
