"""Waves with a spring between the positions: the law book's numbers, no drift, and the damping that it asks for."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from channel.delay import Delay
from teleop import At, MassDamper, Scene, Wave, Zero, load_scene, run
from teleop.analysis.passivity.two_port import continuous_two_port, sampled_two_port
from teleop.law.offers import AgeRange as Ages
from teleop.law.offers import Facts
from teleop.laws.wave_position import Back, Forth, WavePosition, WavePositionSlave

NAN = float("nan")


def at(x: float = 0.0, v: float = 0.0, *, gain: float = 1.0) -> At:
    return At(x, v, NAN, NAN, NAN, True, NAN, 1e-3, 1e-3, gain)


def bodies(law: WavePosition, T: float = 0.05, *, b_m: float = 0.5, b_s: float = 1.0) -> Scene:
    return Scene(law=law, master=MassDamper(mass=0.1, damping=b_m), slave=MassDamper(mass=0.5, damping=b_s),
                 link=Delay(T), observer=None, duration=1.0)


@pytest.mark.parametrize(("frequency", "magnitude"), [(0.5, 6.236082), (1.0, 9.174489), (5.0, 2.777847)])
def test_what_a_hand_feels_of_it_is_the_law_books(frequency: float, magnitude: float) -> None:
    h11 = continuous_two_port(bodies(WavePosition(K_p=20.0, B_p=1.0)), np.array([frequency])).h[0, 0, 0]
    assert abs(h11) == pytest.approx(magnitude, abs=5e-7)


def test_free_motion_has_the_law_books_figures() -> None:
    result = run(replace(load_scene("free_motion", law=WavePosition(), delay=0.05), observer=None))
    assert 1e3 * result.metrics["x_err_rms"] == pytest.approx(3.775699, abs=5e-7)
    assert result.metrics["f_m_max"] == pytest.approx(1.230377, abs=5e-7)


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
    T: float, b_m: float, b_s: float
) -> None:
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
    from teleop.laws import wave as plain

    beside = 30.0 * (x - other) + 2.0 * v
    f_m, forth, _ = law.master((), at(x, v), Back(wave, other))
    f, sent, _ = wave_law.master((), at(x, v), plain.Back(wave))
    assert f_m == pytest.approx(f + beside, abs=1e-12)
    assert (forth.u, forth.x) == (sent.u, x)
    f_s, back, s = law.slave(WavePositionSlave(0.01, 0.0), at(x, v), Forth(wave, other))
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
