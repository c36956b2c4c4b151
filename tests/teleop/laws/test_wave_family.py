"""Waves that are filtered, matched at their ends, or have a spring between the positions beside them."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from channel import Delay
from teleop import At, Facts, MassDamper, Scene, Watchdog, Wave, WaveFilter, WaveMatched, Zero, load_scene, run
from teleop.analysis.passivity.two_port import continuous_two_port, sampled_two_port
from teleop.law.offers import AgeRange as Ages
from teleop.laws import wave as plain
from teleop.laws import wave_filter, wave_matched, wave_position
from teleop.laws.wave_filter import WaveFilterSlave, low_pass
from teleop.laws.wave_matched import WaveMatchedEnd
from teleop.laws.wave_position import WavePosition, WavePositionSlave

NAN = float("nan")


def at(x: float = 0.0, v: float = 0.0, dt: float = 1e-3, *, gap: int = 0, gain: float = 1.0) -> At:
    return At(x, v, NAN, NAN, NAN, True, 0.05, dt, dt * (1 + gap), gain)


def bodies(law: Any, T: float = 0.05, *, b_m: float = 0.5, b_s: float = 1.0) -> Scene:
    return Scene(law=law, master=MassDamper(mass=0.1, damping=b_m), slave=MassDamper(mass=0.5, damping=b_s),
                 link=Delay(T), observer=None, duration=1.0)


@pytest.mark.parametrize(("law", "magnitudes"), [
    (WaveFilter(f_c=20.0), [3.103925, 10.200876, 3.545182]), (WaveMatched(), [3.032083, 9.537353, 3.182653]),
    (WavePosition(K_p=20.0, B_p=1.0), [6.236082, 9.174489, 2.777847])])
def test_what_a_hand_feels_of_it_is_the_law_books(law: Any, magnitudes: list[float]) -> None:
    h11 = continuous_two_port(bodies(law), np.array([0.5, 1.0, 5.0])).h[:, 0, 0]
    assert abs(h11) == pytest.approx(magnitudes, abs=5e-7)


@pytest.mark.parametrize(("law", "error", "force", "end"), [  # mm, N, mm
    (WaveFilter(), 8.259487, 0.862727, -9.750218), (WaveMatched(), 7.814372, None, None),
    (WavePosition(), 3.775699, 1.230377, None)])
def test_free_motion_has_the_law_books_figures(law: Any, error: float, force: float | None, end: float | None) -> None:
    result = run(replace(load_scene("free_motion", law=law, delay=0.05), observer=None))
    assert 1e3 * result.metrics["x_err_rms"] == pytest.approx(error, abs=5e-7)
    assert force is None or result.metrics["f_m_max"] == pytest.approx(force, abs=5e-7)
    assert end is None or 1e3 * result.trace["x_s"][-1] == pytest.approx(end, abs=5e-7)
    assert not law.claims or result.metrics["E_link_min"] >= 0.0


# Filtered


def test_a_clamped_slave_is_felt_as_a_spring_that_the_lag_softens() -> None:
    """b/(T + 1/l): a master that is moved by 1 mm and held, 50 ms each way, b = 2, f_c = 20 Hz."""
    law, dt, delay = WaveFilter(f_c=20.0, K=1e12, B=1e12), 1e-3, 50
    m, back = law.master_start(at())
    s, forth = law.slave_start(at())
    sent, returned, f_m = [forth] * delay, [back] * delay, 0.0
    for k in range(24_000):  # 0.1 s around the loop, of which the filter takes 5 %
        v = 2e-3 * (k < 500)
        f_m, u, m = law.master(m, at(v=v), returned[k])
        _, w, s = law.slave(s, at(), sent[k])
        sent.append(u)
        returned.append(w)
    stiffness = f_m / (500 * dt * 2e-3)
    assert stiffness == pytest.approx(34.507898, abs=5e-7)
    assert stiffness == pytest.approx(2.0 / (0.05 + 1.0 / (2.0 * pi * 20.0)), rel=1e-9)


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
    _, back, _ = law.slave(WaveFilterSlave(1.0, 1.0, 0.1, 0.0), at(v=0.2, gain=0.0), wave_filter.Forth(1.5))
    assert back.w == pytest.approx(0.0, abs=1e-15)


def test_a_missing_wave_counts_as_zero_and_the_filter_runs_out() -> None:
    law = WaveFilter()
    s, _ = law.master_start(at())
    _, _, s = law.master(s, at(), wave_filter.Back(1.0))
    forces = []
    for _ in range(200):
        f, _, s = law.master(s, at()._replace(fresh=False), wave_filter.Back(1.0))
        forces.append(abs(f))
    assert forces == sorted(forces, reverse=True)
    assert forces[-1] < 1e-9


# Matched


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
        rx = wave_matched.Back(wave) if end == "master" else wave_matched.Forth(wave)
        _, tx, s = getattr(law, end)(WaveMatchedEnd(x_d, 0.0), at(dt=dt), rx)
        return s.x_d, tx[0]

    (a, c), (b, d) = tick(1.0, 0.0), tick(0.0, 1.0)
    z = np.exp(1j * w * dt)
    return complex(d + c * b / (z - a))


@pytest.mark.parametrize("end", ["master", "slave"])
@given(b=st.floats(0.1, 100.0), K=st.floats(0.0, 1e4), x=st.floats(-0.01, 0.01), v=st.floats(-1.0, 1.0),
       wave=st.floats(-5.0, 5.0), gain=st.sampled_from([0.0, 0.3, 1.0]))
def test_the_power_of_an_ends_waves_is_that_of_its_point_whatever_it_holds(
        end: str, b: float, K: float, x: float, v: float, wave: float, gain: float) -> None:
    """f of the channel and v_d: (u^2 - w^2)/2 = f v_d, f the device's g f and a damper's (1 - g) b v_d."""
    law = WaveMatched(b=b, K=K)
    rx = wave_matched.Back(wave) if end == "master" else wave_matched.Forth(wave)
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
        rx = (wave_matched.Back if end == "master" else wave_matched.Forth)(sqrt(law.b / 2.0) * v)
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
        _, _, s = law.master(WaveMatchedEnd(0.0, 0.0), at(0.02, gain=gain), wave_matched.Back(0.0))
        assert abs(0.02 - s.x_d) <= gain * 0.02 + 1e-12


# Beside a spring between the positions


def test_an_offset_that_waves_alone_keep_for_ever_is_gone() -> None:
    """Waves that are lost leave the slave behind, 10 % played as zero; at rest again the positions meet."""
    scene = load_scene("free_motion", link="delay(0.05) | bernoulli(0.2)", playout=Zero(), duration=12.0)
    reach = replace(load_scene("hard_wall").hand, reference=replace(  # type: ignore[type-var]  # a grip
        load_scene("hard_wall").hand.reference, to=0.05))  # type: ignore[union-attr]
    ends = {}
    for law in (Wave(), WavePosition()):
        trace = run(replace(scene, hand=reach, law=law), seed=1).trace
        ends[type(law).__name__] = abs(trace["x_m"][-1] - trace["x_s"][-1])
    assert ends["Wave"] > 2e-3
    assert ends["WavePosition"] < 1e-5


@pytest.mark.parametrize(("T", "K_p", "b"), [(0.02, 20.0, 2.0), (0.05, 10.0, 1.0), (0.03, 50.0, 5.0)])
def test_of_a_start_apart_what_waves_hold_against_the_spring_stays(T: float, K_p: float, b: float) -> None:
    """Without loss the waves carry the spring's force at rest: the coupling gives by f/K, the link by f T/b."""
    law = WavePosition(b=b, K_p=K_p, B_p=10.0 * K_p * T)
    trace = run(replace(bodies(law, T), start_m=0.02, duration=8.0)).trace
    e = 0.02 / (1.0 + K_p * (1.0 / law.K + T / b))
    assert trace["x_m"][-1] - trace["x_s"][-1] == pytest.approx(e, rel=1e-3)
    assert abs(trace["f_m"][-1]) < 1e-3


def facts(T: float, b_m: float, b_s: float) -> Facts:
    """Of a constant delay each way."""
    return Facts(1e-3, 1, 0.1, b_m, 0.5, b_s, Ages(T, T), Ages(T, T), False, "zero", 1e-3)


@pytest.mark.parametrize("b_m", [0.0, 0.5, NAN])
@pytest.mark.parametrize("T", [0.001, 0.05, 0.4])
def test_the_note_names_the_least_damping_that_ends_it(T: float, b_m: float) -> None:
    of = facts(T, b_m, 1.0)
    (note,) = WavePosition(K_p=2000.0, B_p=0.0).conditions(of)
    named = float(note.partition("--set law.B_p=")[2].split()[0])
    assert WavePosition(K_p=2000.0, B_p=named).conditions(of) == ()
    assert WavePosition(K_p=2000.0, B_p=0.998 * named).conditions(of) != ()
    assert WavePosition(K_p=2000.0, B_p=0.0).fitted(of).B_p == pytest.approx(named, rel=2e-3)
    assert WavePosition(K_p=2000.0, B_p=2.0 * named).fitted(of).B_p == 2.0 * named


def test_a_run_says_so() -> None:
    scene = load_scene("canonical", law=WavePosition(K_p=50.0), duration=0.3)
    assert any("--set law.B_p=1.813 is the least" in note for note in run(scene).notes)


def passive(law: WavePosition, T: float, b_m: float, b_s: float) -> bool:
    """Raisbeck's condition of the sampled two-port, below half the rate, with the coupling as good as rigid."""
    frequency = np.geomspace(0.05, 50.0, 400)
    ports = sampled_two_port(bodies(law, T, b_m=b_m, b_s=b_s), frequency)
    return bool((ports.raisbeck >= -1e-9 * np.abs(ports.h[:, 0, 0] * ports.h[:, 1, 1])).all())


@pytest.mark.parametrize(("T", "b_m", "b_s"), [(0.05, 0.0, 0.0), (0.05, 0.5, 1.0), (0.02, 0.1, 2.0)])
def test_with_the_damping_of_its_condition_the_two_port_is_passive_and_with_much_less_it_is_not(
        T: float, b_m: float, b_s: float) -> None:
    K_p, dt = 50.0, 1e-3
    reach = K_p * (2.0 * T + dt)
    B_p = (sqrt((b_m - b_s) ** 2 + reach * reach) - b_m - b_s + K_p * dt) / 2.0
    assert WavePosition(K_p=K_p, B_p=0.0).fitted(facts(T, b_m, b_s)).B_p == pytest.approx(B_p, rel=1e-9)
    assert (2.0 * (B_p + b_m) - K_p * dt) * (2.0 * (B_p + b_s) - K_p * dt) == pytest.approx(reach * reach, rel=1e-12)
    assert passive(WavePosition(K_p=K_p, B_p=B_p), T, b_m, b_s)
    assert not passive(WavePosition(K_p=K_p, B_p=0.0), T, b_m, b_s)


@given(x=st.floats(-0.1, 0.1), v=st.floats(-1.0, 1.0), other=st.floats(-0.1, 0.1), wave=st.floats(-5.0, 5.0))
def test_it_is_the_wave_law_and_springs_and_dampers_beside_it(x: float, v: float, other: float, wave: float) -> None:
    law, wave_law = WavePosition(K_p=30.0, B_p=2.0), Wave()
    beside = 30.0 * (x - other) + 2.0 * v
    f_m, forth, _ = law.master((), at(x, v), wave_position.Back(wave, other))
    f, sent, _ = wave_law.master((), at(x, v), plain.Back(wave))
    assert f_m == pytest.approx(f + beside, abs=1e-12)
    assert (forth.u, forth.x) == (sent.u, x)
    f_s, back, s = law.slave(WavePositionSlave(0.01, 0.0), at(x, v), wave_position.Forth(wave, other))
    f, returned, same = wave_law.slave(plain.WaveSlave(0.01, 0.0), at(x, v), plain.Forth(wave))
    assert f_s == pytest.approx(f - beside, abs=1e-12)
    assert (back.w, back.x, tuple(s)) == (returned.w, x, tuple(same))


def test_it_starts_without_a_pull_wherever_the_two_are() -> None:
    law = WavePosition()
    for x in (0.3, -0.2):
        here = at(x)._replace(fresh=False)
        s, held = law.slave_start(here)
        assert law.slave(s, here, held)[0] == 0.0
        m, back = law.master_start(here)
        assert law.master(m, here, back)[0] == 0.0
