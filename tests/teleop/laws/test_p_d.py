"""P+d: its two ends, its condition on a scene, the critical damping of two free masses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from channel.delay import Delay
from teleop import Refused, Scene, Watchdog, load_scene, run
from teleop.analysis.models.continuous import continuous
from teleop.analysis.stability.assess import critical, is_stable
from teleop.law import At, start_at
from teleop.law.offers import AgeRange as Age
from teleop.laws.p_d import Back, Forth, PDamped, PDampedEnd
from teleop.physics.plant import MassDamper
from tests.teleop.law.test_injection import CONSTANT

SLACK = PDampedEnd(0.0)


def at(x: float, v: float, gain: float = 1.0, span: float = 1e-3) -> At:
    nan = float("nan")
    return At(x, v, nan, nan, nan, True, nan, 1e-3, span, gain)


def masses(law: Any, M: float, T: float = 0.05) -> Scene:
    """Two free masses, and the law over a link."""
    body = MassDamper(mass=M)
    return Scene(law=law.linear(), master=body, slave=body, link=Delay(T), duration=0.5)


def test_each_end_is_drawn_to_where_the_other_was_and_damped_where_it_is() -> None:
    law = PDamped(K=100.0, B=5.0)
    assert law.master(SLACK, at(0.03, 0.2), Back(0.01)) == (100.0 * (0.03 - 0.01) + 5.0 * 0.2, Forth(0.03), SLACK)
    assert law.slave(SLACK, at(0.01, 0.2), Forth(0.04)) == (100.0 * (0.04 - 0.01) - 5.0 * 0.2, Back(0.01), SLACK)


def test_until_the_first_message_there_is_no_spring() -> None:
    law, here = PDamped(), start_at(0.4, 0.0, 0.0, 1e-3)
    (s, held), (m, none) = law.slave_start(here), law.master_start(here)
    assert law.slave(s, at(0.4, 0.0), held)[0] == 0.0
    assert law.master(m, at(0.4, 0.0), none)[0] == 0.0


@pytest.mark.parametrize(("M", "K", "B"), [(5.0, 400.0, 18.806530), (0.5, 100.0, 4.351309)])
def test_two_free_masses_are_critically_damped_at_the_numbers_of_the_law_book(M: float, K: float, B: float) -> None:
    found = continuous(masses(PDamped(K=K, B=B), M)).round_trip
    assert found == pytest.approx(0.1, rel=1e-6)  # six digits of B


def test_sampled_at_1_khz_the_first_of_them_takes_19_17() -> None:
    """The law book has 19.1710; a damper held by the law gives 19.17092, one in the bodies 19.1728."""
    found = critical(lambda B: masses(PDamped(K=400.0, B=B), 5.0), "B", low=18.0, high=20.0, tol=1e-5, places=3)
    assert found.value == pytest.approx(19.1710, abs=1.5e-4)
    assert found.stable == "above"


def test_the_weaker_condition_in_circulation_is_met_and_two_free_masses_grow() -> None:
    """B = 15: 4 B^2 = 900 >= K^2 (T1^2 + T2^2) = 800, but < K^2 (T1 + T2)^2 = 1600."""
    weak = PDamped(K=400.0, B=15.0)
    assert not is_stable(masses(weak, 5.0))
    assert "law.B=20.4 is the least" in weak.conditions(CONSTANT)[0]
    assert is_stable(masses(weak.fitted(CONSTANT), 5.0))


@pytest.mark.parametrize("changes", [
    {}, {"lossy": True, "fwd": Age(0.05, 0.3)}, {"damping_m": 3.0, "damping_s": float("nan")},
])
def test_fitted_to_the_facts_it_breaks_no_condition_and_never_loses_damping(changes: Any) -> None:
    facts = CONSTANT._replace(**changes)
    fitted = PDamped(K=400.0, B=5.0).fitted(facts)
    assert fitted.conditions(facts) == ()
    assert fitted.B > 5.0
    assert PDamped(K=400.0, B=0.999 * fitted.B).conditions(facts)
    assert PDamped(K=400.0, B=500.0).fitted(facts).B == 500.0
    silent = facts._replace(fwd=None)
    assert PDamped().fitted(silent) == PDamped()


def test_an_end_that_was_let_go_goes_slack_and_is_drawn_back_slowly() -> None:
    """Its watchdog had let go while the other end went 0.2 m on: no force at once, then K 0.2 (1 - exp(-2 t))."""
    law, s = PDamped(K=100.0, B=0.0, rejoin=2.0), SLACK
    f_s, _, s = law.slave(s, at(0.0, 0.0, gain=0.0), Forth(0.2))
    assert f_s == pytest.approx(100.0 * 0.2 * 2e-3)  # what a tick of rejoining makes
    for _ in range(500):
        f_s, _, s = law.slave(s, at(0.0, 0.0), Forth(0.2))
    assert f_s == pytest.approx(100.0 * 0.2 * (1.0 - 2.718281828 ** -1.0), rel=2e-3)
    late = law.slave(SLACK._replace(offset=0.2), at(0.0, 0.0, span=0.5), Forth(0.2))[2]
    assert late.offset == 0.0  # half a second of ticks left out


def test_a_blackout_does_not_pay_out_the_stretch_of_the_silence_at_once() -> None:
    """The slave's greatest force within 0.1 s of taking hold again, against a law that rejoins at once."""
    def after(rejoin: float) -> float:
        law = PDamped(K=100.0, B=5.0, rejoin=rejoin)
        scene = load_scene("free_motion", law=law, link="delay(0.01) | blackout(0.3, 0.7)")
        trace = run(replace(scene, duration=1.6, watchdog=Watchdog(timeout=0.02, ramp=0.01, settle=0.02))).trace
        taken = int((trace["g_s"] < 1.0).nonzero()[0].max())
        return float(abs(trace["f_s"][taken:taken + 100]).max())

    assert after(2.0) < 0.5 * after(1e6)


@pytest.mark.parametrize(("knob", "value"), [("K", -1.0), ("B", -1.0), ("rejoin", -1.0), ("K", float("nan"))])
def test_knobs_out_of_range_are_refused(knob: str, value: float) -> None:
    with pytest.raises(Refused, match=knob):
        PDamped(**{knob: value})
