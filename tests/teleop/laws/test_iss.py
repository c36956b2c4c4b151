"""ISS: its two ends, the numbers of the law book, where the published order of steps diverges."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.hand import Grip, Rest
from slave.tissue import Tissue
from teleop import MassDamper, Scene, load_scene, run
from teleop.analysis.stability.assess import stability
from teleop.laws.iss import ISS, Back, Forth, ISSSlave
from tests.teleop.laws.test_p_d import at

BARE = ISS(tau=0.0, mu=1e12)  # position and force, nothing between


@given(K=st.floats(1.0, 1e4), B=st.floats(0.0, 100.0), mu=st.floats(1.0, 1e5), x=st.floats(-0.1, 0.1),
       v=st.floats(-1.0, 1.0), f=st.floats(-10.0, 10.0), ticks=st.integers(1, 20))
def test_force_and_commanded_motion_solve_their_equations_together(
        K: float, B: float, mu: float, x: float, v: float, f: float, ticks: int) -> None:
    """f_s = K (x_d - x) + B (v_d - v) with x_d = x_m - f_s/mu and v_d = v_m - df_s/mu, over the span of the tick."""
    span = ticks * 1e-3
    f_s, back, after = ISS(K=K, B=B, mu=mu).slave(ISSSlave(f, 0.0), at(x, v, span=span), Forth(0.02, 0.3))
    x_d, v_d = 0.02 - f_s / mu, 0.3 - back.df_s / mu
    size = K * (abs(x_d) + abs(x)) + B * (abs(v_d) + abs(v) + (abs(f_s) + abs(f)) / (mu * span)) + abs(f_s)
    assert f_s == pytest.approx(K * (x_d - x) + B * (v_d - v), abs=1e-12 * size)
    assert back == Back(f_s, (f_s - f) / span)
    assert after == ISSSlave(f_s, 0.0)


def test_the_hand_feels_the_force_with_its_lead() -> None:
    assert ISS(tau=0.01).master((), at(0.1, 0.2), Back(3.0, 40.0)) == (3.4, Forth(0.1, 0.2), ())


@pytest.mark.parametrize(("scene", "delay", "error", "peak", "energy"), [
    ("soft_tissue", 0.0, 0.00817240, 3.87951, 0.0149105), ("canonical", 0.01, 0.00493085, 8.90747, 0.0397960),
])
def test_two_seconds_of_a_scene_have_the_numbers_of_the_law_book(
        scene: str, delay: float, error: float, peak: float, energy: float) -> None:
    got = run(replace(load_scene(scene, law=ISS(), delay=delay), duration=2.0, energy=True))
    assert got.metrics["x_err_rms"] == pytest.approx(error, abs=5e-9)
    assert got.metrics["f_m_max"] == pytest.approx(peak, abs=5e-6)
    assert got.trace["E_port"][-1] == pytest.approx(energy, abs=5e-8)


@pytest.mark.parametrize(("law", "environment", "ticks"), [
    (ISS(), None, 31), (ISS(), Tissue(k=200.0, d=2.0), 35), (ISS(), Tissue(k=5000.0, d=5.0), 30),
    (BARE, None, 45), (BARE, Tissue(k=200.0, d=2.0), 71), (BARE, Tissue(k=5000.0, d=5.0), 25),
])
def test_the_first_unstable_round_trip_is_that_of_the_law_book(law: ISS, environment: Any, ticks: int) -> None:
    """The plants of `canonical`. The lead and the spring cost margin in free space, and win some on a hard wall."""
    hand = Grip(mass=0.4, k=200.0, d=5.0, reference=Rest())
    scene = Scene(law=law.linear(), master=MassDamper(mass=0.1, damping=0.5), hand=hand, duration=1.0,
                  slave=MassDamper(mass=0.5, damping=1.0), environment=environment)
    assert stability(scene).critical_round_trip == ticks


@pytest.mark.parametrize(("mu", "grows"), [(1e5, False), (1e3, True)])
def test_with_the_force_of_the_tick_before_it_diverges_beyond_a_loop_gain_of_one(mu: float, grows: bool) -> None:
    """2 B/(mu dt) + K/mu: 0.405 and 40.5, the published order of steps at a slave that does not move. Ours never."""
    law, dt = ISS(K=500.0, B=20.0, mu=mu), 1e-3
    f = df = 0.0
    s = ISSSlave(0.0, 0.0)
    for _ in range(400):
        new = law.K * (0.01 - f / mu) - law.B * df / mu
        f, df = new, (new - f) / dt
        f_s, _, s = law.slave(s, at(0.0, 0.0), Forth(0.01, 0.0))
    assert (abs(f) > 1e6) == grows
    assert f_s == pytest.approx(0.01 / (1.0 / law.K + 1.0 / mu), rel=1e-6)


def test_a_slave_that_was_let_go_tells_of_no_force_and_takes_hold_slack() -> None:
    f_s, back, s = ISS().slave(ISSSlave(2.0, 0.0), at(0.0, 0.0, gain=0.0), Forth(0.2, 0.0))
    assert back == Back(0.0, 0.0)
    assert s.offset == pytest.approx(0.2, rel=3e-3)
    assert abs(f_s) < 2.0
