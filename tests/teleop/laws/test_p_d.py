"""P+d, PD+d and position-position: their ends, their conditions on a scene, the critical damping of two free masses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from channel import Delay
from master.hand import Grip, Rest
from slave.tissue import Tissue
from teleop import MassDamper, PDamped, PDDamped, PositionPosition, Scene, Watchdog, load_scene, run
from teleop.analysis.models.continuous import continuous
from teleop.analysis.passivity.judge import two_ports
from teleop.analysis.stability.assess import critical, is_stable, stability
from teleop.law import At, start_at
from teleop.law.offers import AgeRange as Age
from teleop.laws import p_d, pd_d, pp
from tests.teleop.law.test_injection import CONSTANT

SLACK, TIED, DRAWN = p_d.PDampedEnd(0.0), pd_d.PDDampedEnd(0.0), pp.PositionPositionEnd(0.0)
HANDLE = MassDamper(mass=0.04, damping=0.8)


def at(x: float, v: float, gain: float = 1.0, span: float = 1e-3) -> At:
    nan = float("nan")
    return At(x, v, nan, nan, nan, True, nan, 1e-3, span, gain)


def masses(law: Any, M: float, T: float = 0.05) -> Scene:
    """Two free masses, and the law over a link."""
    body = MassDamper(mass=M)
    return Scene(law=law.linear(), master=body, slave=body, link=Delay(T), duration=0.5)


def test_each_end_of_p_d_is_drawn_to_where_the_other_was_and_damped_where_it_is() -> None:
    law = PDamped(K=100.0, B=5.0)
    assert law.master(SLACK, at(0.03, 0.2), p_d.Back(0.01)) == (
        100.0 * (0.03 - 0.01) + 5.0 * 0.2, p_d.Forth(0.03), SLACK)
    assert law.slave(SLACK, at(0.01, 0.2), p_d.Forth(0.04)) == (
        100.0 * (0.04 - 0.01) - 5.0 * 0.2, p_d.Back(0.01), SLACK)


def test_until_the_first_message_there_is_no_spring() -> None:
    law, here = PDamped(), start_at(0.4, 0.0, 0.0, 1e-3)
    (s, held), (m, none) = law.slave_start(here), law.master_start(here)
    assert law.slave(s, at(0.4, 0.0), held)[0] == 0.0
    assert law.master(m, at(0.4, 0.0), none)[0] == 0.0


@pytest.mark.parametrize(("M", "law"), [
    (5.0, PDamped(K=400.0, B=18.806530)), (0.5, PDamped(K=100.0, B=4.351309)),
    *[(0.5, PDDamped(K=100.0, K_d=K_d, B=B)) for K_d, B in ((0.0, 4.351309), (1.0, 2.709457), (2.5, 0.350966))]])
def test_two_free_masses_are_critically_damped_at_the_numbers_of_the_law_book(M: float, law: Any) -> None:
    """50 ms each way; six digits of B."""
    assert continuous(masses(law, M)).round_trip == pytest.approx(0.1, rel=2e-6)


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
    f_s, _, s = law.slave(s, at(0.0, 0.0, gain=0.0), p_d.Forth(0.2))
    assert f_s == pytest.approx(100.0 * 0.2 * 2e-3)  # what a tick of rejoining makes
    for _ in range(500):
        f_s, _, s = law.slave(s, at(0.0, 0.0), p_d.Forth(0.2))
    assert f_s == pytest.approx(100.0 * 0.2 * (1.0 - 2.718281828 ** -1.0), rel=2e-3)
    late = law.slave(SLACK._replace(offset=0.2), at(0.0, 0.0, span=0.5), p_d.Forth(0.2))[2]
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


# PD+d


def test_each_end_of_pd_d_is_drawn_to_the_others_motion_and_damped_where_it_is() -> None:
    law = PDDamped(K=100.0, K_d=2.0, B=5.0)
    f_m, forth, _ = law.master(TIED, at(0.03, 0.2), pd_d.Back(0.01, -0.1))
    assert f_m == pytest.approx(100.0 * 0.02 + 2.0 * 0.3 + 5.0 * 0.2, rel=1e-15)
    assert forth == pd_d.Forth(0.03, 0.2)
    f_s, back, _ = law.slave(TIED, at(0.01, 0.2), pd_d.Forth(0.04, -0.1))
    assert f_s == pytest.approx(100.0 * 0.03 - 2.0 * 0.3 - 5.0 * 0.2, rel=1e-15)
    assert back == pd_d.Back(0.01, 0.2)


def test_without_a_damper_over_the_link_pd_d_is_p_d() -> None:
    both, alone = PDDamped(K=80.0, K_d=0.0, B=3.0), PDamped(K=80.0, B=3.0)
    for gain in (1.0, 0.4, 0.0):
        here = at(0.03, 0.2, gain=gain)
        f_m, f_s = (both.master(TIED, here, pd_d.Back(-0.01, 7.0))[0], both.slave(TIED, here, pd_d.Forth(0.05, 7.0))[0])
        assert f_m == alone.master(SLACK, here, p_d.Back(-0.01))[0]
        assert f_s == alone.slave(SLACK, here, p_d.Forth(0.05))[0]


def test_fitted_it_has_the_least_damping_that_its_condition_takes() -> None:
    fitted = PDDamped(K=400.0, K_d=8.0, B=0.0).fitted(CONSTANT)
    assert fitted.conditions(CONSTANT) == ()
    assert fitted.K_d == 8.0
    (told,) = PDDamped(K=400.0, K_d=8.0, B=0.99 * fitted.B).conditions(CONSTANT)
    assert "(K_d + B_m)(K_d + B_s)" in told


def test_where_the_delay_varies_the_damper_over_the_link_goes() -> None:
    ragged = CONSTANT._replace(fwd=Age(0.02, 0.05))
    law = PDDamped(K=400.0, K_d=8.0, B=0.0)
    assert "constant delay" in law.conditions(ragged)[0]
    fitted = law.fitted(ragged)
    assert (fitted.K_d, fitted.conditions(ragged)) == (0.0, ())
    assert pytest.approx(400.0 * 0.051, rel=1e-12) == fitted.B


# Position-position


def test_each_end_of_pp_is_drawn_to_the_others_motion() -> None:
    law, f = PositionPosition(K=100.0, B=4.0), 100.0 * (0.03 - 0.01) + 4.0 * (0.2 - 0.1)
    assert law.master(DRAWN, at(0.03, 0.2), pp.Back(0.01, 0.1)) == (f, pp.Forth(0.03, 0.2), DRAWN)
    assert law.slave(DRAWN, at(0.01, 0.1), pp.Forth(0.03, 0.2)) == (f, pp.Back(0.01, 0.1), DRAWN)


@pytest.mark.parametrize(("T", "free"), [(0.0, "1.680"), (0.05, "40.975")])
def test_two_handles_feel_the_known_numbers(T: float, free: str) -> None:
    """0.04 kg, 0.8 N s/m, coupling and wall of 400 N/m: 200 N/m are felt; |Z| in free space at 1 Hz."""
    law = PositionPosition(K=400.0, B=4.0).linear()
    scene = Scene(law=law, master=HANDLE, slave=HANDLE, environment=Tissue(k=400.0, d=0.0), duration=1.0,
                  link=Delay(T) if T else None)
    got = two_ports(scene).continuous
    assert got is not None
    assert got.felt == pytest.approx(200.0, abs=0.01)
    assert f"{got.free:.3f}" == free
    assert got.absolutely_stable == (T == 0.0)


def test_the_delay_it_stands_is_the_known_one() -> None:
    """Hand 100 N/m and 2 N s/m, coupling 2000 and 8, wall 2000 N/m: 14.840 ms, first unstable at 11 ticks of 1 ms."""
    hand = Grip(mass=0.0, k=100.0, d=2.0, reference=Rest())
    scene = Scene(law=PositionPosition(K=2000.0, B=8.0).linear(), master=HANDLE, slave=HANDLE, hand=hand, duration=1.0,
                  environment=Tissue(k=2000.0, d=0.0))
    found = continuous(scene).round_trip
    assert found is not None
    assert round(found * 1e3, 3) == 14.840
    assert stability(scene).critical_round_trip == 11


def test_over_a_delay_it_takes_the_ends_own_damping_or_a_law_that_injects_it() -> None:
    near = CONSTANT._replace(fwd=Age(1e-3, 1e-3), bwd=Age(1e-3, 1e-3), damping_m=0.5, damping_s=1.0)
    assert PositionPosition().conditions(near) == ()
    (told,) = PositionPosition(K=400.0, B=4.0).conditions(CONSTANT)
    assert "--set law=pd_d --set law.K=400 --set law.K_d=4 --set law.B=" in told
    (varies,) = PositionPosition(K=400.0, B=4.0).conditions(CONSTANT._replace(lossy=True))
    assert "--set law=p_d --set law.K=400 --set law.B=20.4" in varies
