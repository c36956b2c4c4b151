"""The predicted wave: what it is worth in free space, that it is the wave law in contact, and no energy made."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import At, Integral, Wave, Zero, load_scene, run
from teleop.law.offers import AgeRange, Facts
from teleop.laws.wave_prediction import Back, Forth, WavePrediction, WavePredictionMaster, WavePredictionSlave

NAN = float("nan")


def at(v: float, *, fresh: bool = True, gap: int = 0) -> At:
    return At(0.0, v, NAN, NAN, NAN, fresh, NAN, 1e-3, 1e-3 * (1 + gap))


def felt(trace: Any, frequency: float) -> complex:
    """F_m/V_m at a frequency, over whole periods of the second half, N s/m."""
    count = len(trace["t"])
    period = round(1000.0 / frequency)
    last = slice(count - count // 2 // period * period, count)
    turn = np.exp(-2j * np.pi * frequency * trace["t"][last])
    return complex((turn @ trace["f_m"][last]) / (turn @ trace["v_m"][last]))


@pytest.mark.parametrize(("delay", "predicted", "plain"), [(0.05, 1.82, 7.26), (0.2, 2.69, 44.07)])
def test_in_free_space_it_tracks_and_feels_as_its_head_says(delay: float, predicted: float, plain: float) -> None:
    """Tracking in mm; and the hand feels the slave's own mass of 0.5 kg and drag of 1 N s/m, nearly."""
    errors, felts = [], []
    for law in (WavePrediction(), Wave()):
        result = run(replace(load_scene("free_motion", law=law, delay=delay), observer=None))
        errors.append(1e3 * result.metrics["x_err_rms"])
        felts.append(felt(result.trace, 0.5))
        assert result.metrics["E_link_min"] >= 0.0
    assert errors == pytest.approx([predicted, plain], abs=0.01)
    assert abs(felts[0] - (1.0 + 0.5j * np.pi)) < 0.12
    assert abs(felts[1] - (1.0 + 0.5j * np.pi)) > 0.5


def test_in_contact_it_is_nearly_the_wave_law() -> None:
    """The model of a free slave explains nothing of what a wall returns, so nothing is predicted."""
    results = [run(load_scene("hard_wall", law=law(b=20.0, K=1000.0), duration=6.0)) for law in (WavePrediction, Wave)]
    ends = [result.metrics["f_m_end"] for result in results]
    assert ends == pytest.approx([3.49, 3.51], abs=0.01)


def test_without_a_share_of_the_prediction_it_is_the_wave_law() -> None:
    for link, playout in (("delay(0.05)", Zero()), ("delay(0.03) | bernoulli(0.2)", Zero()),
                          ("delay(0.03) | uniform(0.01)", Integral())):
        none, plain = (run(load_scene("canonical", law=law, link=link, playout=playout, duration=1.0), seed=2).trace
                       for law in (WavePrediction(lead=0.0), Wave()))
        assert none["f_m"] == pytest.approx(plain["f_m"], abs=1e-9)


ticks = st.lists(st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-1.0, 1.0), st.booleans(),
                           st.integers(0, 3)), min_size=1, max_size=80)


@given(came=ticks, mass=st.floats(0.01, 10.0), damping=st.floats(0.0, 50.0), tau=st.floats(1e-3, 1.0))
def test_no_more_is_played_than_came_whatever_the_model_says(
        came: list[tuple[float, float, float, bool, int]], mass: float, damping: float, tau: float) -> None:
    """And the port has what the books say: f v = (u^2 - p^2)/2. Ticks left out are paid before anything more is."""
    law, dt = WavePrediction(mass=mass, damping=damping, tau=tau), 1e-3
    s, _ = law.master_start(at(0.0))
    for wave, guess, v, fresh, gap in came:
        overdrawn = min(s.S + dt * gap * (s.r**2 - s.p**2) / 2.0, 0.0)
        f, sent, s = law.master(s, at(v, fresh=fresh, gap=gap), Back(wave, guess))
        assert overdrawn - 1e-13 <= s.S
        assert f * v == pytest.approx((sent.u**2 - s.p**2) / 2.0, abs=1e-9)
        assert s.r == wave * fresh


def test_the_model_is_a_slave_behind_the_laws_own_coupling() -> None:
    """Against another law's slave and a body stepped by backward Euler, together: the guess is its answer."""
    law, dt, b, K, B, M, D = WavePrediction(), 1e-3, 2.0, 500.0, 20.0, 0.5, 1.0
    s, _ = law.master_start(at(0.0))
    z = v_p = 0.0
    for k in range(400):
        _, sent, s = law.master(s, at(0.2 * np.sin(0.05 * k), fresh=False), Back(0.0, 0.0))
        # v_d and v_p: f = sqrt(2b) u - b v_d = K z' + B (v_d - v_p), M (v_p' - v_p)/dt = f - D v_p'.
        C = B + K * dt
        v_d, after = np.linalg.solve([[b + C, -C], [-C, M / dt + D + C]], [2.0 * sent.u - K * z, M / dt * v_p + K * z])
        f = 2.0 * sent.u - b * v_d
        z, v_p = z + dt * (v_d - after), after
        assert sent.guess == pytest.approx(sent.u - f, abs=1e-12)
        assert (s.z, s.v_p) == pytest.approx((z, v_p), abs=1e-12)


def test_what_was_held_back_is_made_up_for_and_no_offset_stays_after_a_motion_in_free_space() -> None:
    """A reach of 60 mm in free space, 0.1 s each way, and ten seconds to come to rest."""
    scene = load_scene("free_motion", law=WavePrediction(), delay=0.1, duration=20.0)
    reach = load_scene("hard_wall").hand
    trace = run(replace(scene, hand=reach, observer=None)).trace
    assert trace["x_m"][-1] > 0.05
    assert abs(trace["x_m"][-1] - trace["x_s"][-1]) < 2e-3


def test_the_slave_returns_the_guess_that_came_and_the_wave_laws_answer() -> None:
    from teleop.laws import wave as plain

    for gain in (0.0, 0.4, 1.0):
        here = at(0.3)._replace(gain=gain)
        f_s, back, s = WavePrediction().slave(WavePredictionSlave(0.01, 0.1), here, Forth(1.2, -0.7))
        f, answer, same = Wave().slave(plain.WaveSlave(0.01, 0.1), here, plain.Forth(1.2))
        assert (f_s, tuple(s), back.guess) == (f, tuple(same), -0.7)
        assert back.w == pytest.approx(answer.w, abs=1e-12)


def test_it_starts_at_rest_with_nothing_to_spend() -> None:
    s, held = WavePrediction().master_start(at(0.0))
    assert (s, held) == (WavePredictionMaster(*[0.0] * len(WavePredictionMaster._fields)), Back(0.0, 0.0))


def facts(mass: float, damping: float, T: float = 0.08) -> Facts:
    return Facts(1e-3, 1, 0.1, 0.5, mass, damping, AgeRange(T, T), AgeRange(0.01, 0.01), False, "zero", 1e-3)


def test_fitted_to_a_slave_it_models_that_slave_and_takes_its_time_from_the_link() -> None:
    law = WavePrediction(b=3.0).fitted(facts(2.0, 4.0))
    assert (law.mass, law.damping, law.tau, law.b) == (2.0, 4.0, 0.08, 3.0)
    unknown = WavePrediction().fitted(facts(NAN, NAN)._replace(fwd=None, bwd=None))
    assert unknown == WavePrediction()


@pytest.mark.parametrize(("mass", "damping", "told"), [
    (0.5, 1.0, False), (0.55, 1.1, False), (1.0, 1.0, True), (0.5, 3.0, True), (0.5, 0.0, True), (NAN, NAN, False)])
def test_a_run_says_where_the_model_is_of_another_slave(mass: float, damping: float, told: bool) -> None:
    of = facts(mass, damping)
    notes = WavePrediction().conditions(of)
    assert bool(notes) is told
    assert not told or f"set law.mass to {mass:g} and law.damping to {damping:g}" in notes[0]
    assert WavePrediction().fitted(of).conditions(of) == ()
