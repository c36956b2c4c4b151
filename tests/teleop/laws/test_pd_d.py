"""PD+d: its two ends, its condition, the critical damping of two free masses."""

from __future__ import annotations

import pytest

from teleop import Refused
from teleop.analysis.models.continuous import continuous
from teleop.law.offers import AgeRange
from teleop.laws import p_d
from teleop.laws.p_d import PDamped
from teleop.laws.pd_d import Back, Forth, PDDamped, PDDampedEnd
from tests.teleop.law.test_injection import CONSTANT
from tests.teleop.laws.test_p_d import at, masses

SLACK = PDDampedEnd(0.0)


def test_each_end_is_drawn_to_the_others_motion_and_damped_where_it_is() -> None:
    law = PDDamped(K=100.0, K_d=2.0, B=5.0)
    f_m, forth, _ = law.master(SLACK, at(0.03, 0.2), Back(0.01, -0.1))
    assert f_m == pytest.approx(100.0 * 0.02 + 2.0 * 0.3 + 5.0 * 0.2, rel=1e-15)
    assert forth == Forth(0.03, 0.2)
    f_s, back, _ = law.slave(SLACK, at(0.01, 0.2), Forth(0.04, -0.1))
    assert f_s == pytest.approx(100.0 * 0.03 - 2.0 * 0.3 - 5.0 * 0.2, rel=1e-15)
    assert back == Back(0.01, 0.2)


@pytest.mark.parametrize("gain", [1.0, 0.4, 0.0])
def test_without_a_damper_over_the_link_it_is_p_d(gain: float) -> None:
    here = at(0.03, 0.2, gain=gain)
    both, alone = PDDamped(K=80.0, K_d=0.0, B=3.0), PDamped(K=80.0, B=3.0)
    assert both.master(SLACK, here, Back(-0.01, 7.0))[0] == alone.master(p_d.PDampedEnd(0.0), here, p_d.Back(-0.01))[0]
    assert both.slave(SLACK, here, Forth(0.05, 7.0))[0] == alone.slave(p_d.PDampedEnd(0.0), here, p_d.Forth(0.05))[0]


@pytest.mark.parametrize(("K_d", "B"), [(0.0, 4.351309), (1.0, 2.709457), (2.5, 0.350966)])
def test_two_free_masses_are_critically_damped_at_the_numbers_of_the_law_book(K_d: float, B: float) -> None:
    """0.5 kg, 100 N/m, 50 ms each way."""
    found = continuous(masses(PDDamped(K=100.0, K_d=K_d, B=B), 0.5)).round_trip
    assert found == pytest.approx(0.1, rel=2e-6)


def test_fitted_it_has_the_least_damping_that_its_condition_takes() -> None:
    fitted = PDDamped(K=400.0, K_d=8.0, B=0.0).fitted(CONSTANT)
    assert fitted.conditions(CONSTANT) == ()
    assert fitted.K_d == 8.0
    (told,) = PDDamped(K=400.0, K_d=8.0, B=0.99 * fitted.B).conditions(CONSTANT)
    assert "(K_d + B_m)(K_d + B_s)" in told


def test_where_the_delay_varies_the_damper_over_the_link_goes() -> None:
    ragged = CONSTANT._replace(fwd=AgeRange(0.02, 0.05))
    law = PDDamped(K=400.0, K_d=8.0, B=0.0)
    assert "constant delay" in law.conditions(ragged)[0]
    fitted = law.fitted(ragged)
    assert (fitted.K_d, fitted.conditions(ragged)) == (0.0, ())
    assert pytest.approx(400.0 * 0.051, rel=1e-12) == fitted.B


@pytest.mark.parametrize(("knob", "value"), [("K", -1.0), ("K_d", -1.0), ("B", -1.0), ("K_d", float("nan"))])
def test_knobs_out_of_range_are_refused(knob: str, value: float) -> None:
    with pytest.raises(Refused, match=knob):
        PDDamped(**{knob: value})
