"""Laws that keep accounts of energy (TDPA, PSPM, two layers): what each end may give out, keeps and takes in."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from channel import Bernoulli, Delay, GilbertElliott, UniformJitter
from teleop import At, Watchdog, facts_of, load_scene, run, seed_energy
from teleop.checks.trials import capped_scene
from teleop.law import start_at
from teleop.laws import pspm, tdpa, two_layer
from teleop.laws.pspm import PSPM, PSPMEnd, PSPMSums
from teleop.laws.tdpa import PAYS, TDPA, TDPAMaster, TDPAMasterSums, TDPASlave, TDPASlaveSums
from teleop.laws.two_layer import Tank, TwoLayer, TwoLayerSums

DT = 1e-3
ENOUGH = 1e3  # J
speed = st.floats(-1.0, 1.0).map(lambda value: round(value, 9))
place = st.floats(-0.1, 0.1).map(lambda value: round(value, 9))


def at(x: float = 0.0, v: float = 0.0, f_held: float = 0.0, dx: float = 0.0, gain: float = 1.0,
       ticks: int = 1) -> At:
    return At(x, v, float("nan"), f_held, dx, True, 0.0, DT, ticks * DT, gain)


def began(G: float, x_d: float) -> TDPASlave:
    """A slave with G (J) to give out, a commanded point (m) that does not move, and a coupling that burned enough."""
    return TDPASlave(G, 0.0, 0.0, x_d, 0.0, 0.0, ENOUGH)


def slave(law: TDPA, s: TDPASlave, here: At, rx: tdpa.Forth) -> tuple[float, tdpa.Back, TDPASlave]:
    return law.slave(s, here, rx, law.slave_sums(s, here, rx))


def master(law: TDPA, s: TDPAMaster, here: At, rx: tdpa.Back) -> tuple[float, tdpa.Forth, TDPAMaster]:
    return law.master(s, here, rx, law.master_sums(s, here, rx))


def test_one_step_of_the_slave_and_of_a_master_that_is_pushed() -> None:
    f_s, back, after = slave(TDPA(), began(0.0, 0.01), at(0.0, 0.1), tdpa.Forth(0.05, 0.2, 1e-4))
    assert (f"{after.v_d:.7f}", f"{f_s:.5f}") == ("0.0279826", "3.57364")
    assert f_s * after.v_d * DT == pytest.approx(1e-4, rel=1e-12)  # all that may be given out
    assert back == tdpa.Back(f_s, 0.0)
    for G, wanted in ((1e-4, "2.00000"), (-1e-4, "-2.00000")):
        assert f"{master(TDPA(), TDPAMaster(G, 0.0, 0.0), at(v=-0.05), tdpa.Back(4.0, 0.0))[0]:.5f}" == wanted


@given(G=st.floats(-1e-3, 1e-2), x_d=place, x=place, v=speed, x_rx=place, v_rx=speed)
def test_in_one_axis_the_command_is_clipped_between_two_roots(
        G: float, x_d: float, x: float, v: float, x_rx: float, v_rx: float) -> None:
    """The roots of z v^2 + f_0 v = G/dt, by numpy; where there are none the least that the slave can ask for."""
    law = TDPA()
    f_s, _, after = slave(law, began(G, x_d), at(x, v), tdpa.Forth(x_rx, v_rx, 0.0))
    z, f_0 = law.B + law.K * DT, law.K * (x_d - x) - law.B * v
    low, high = sorted(np.roots([z, f_0, -G / DT]).real)
    wanted = np.clip(v_rx + law.drift * (x_rx - x_d), low, high)
    assert after.v_d == pytest.approx(wanted, rel=1e-6, abs=1e-6)  # two equal roots have half the digits
    assert f_s == pytest.approx(law.K * (after.x_d - x) + law.B * (after.v_d - v), abs=1e-9)
    least = -DT * f_0 * f_0 / (4.0 * z)
    assert f_s * after.v_d * DT <= max(G, least) + 1e-12 * (1.0 + f_0 * f_0)


@given(G=st.floats(0.0, 1e-2), axes=st.lists(st.tuples(place, place, speed, place, speed), min_size=3, max_size=3))
def test_three_axes_of_a_slave_ask_for_no_more_than_there_is(
        G: float, axes: list[tuple[float, float, float, float, float]]) -> None:
    law = TDPA()
    given_to = [(began(G, x_d), at(x, v), tdpa.Forth(x_rx, v_rx, 0.0)) for x_d, x, v, x_rx, v_rx in axes]
    over = TDPASlaveSums(*np.sum([law.slave_sums(*each) for each in given_to], axis=0).tolist())
    asked = [(f_s, after.v_d) for f_s, _, after in (law.slave(*each, over) for each in given_to)]
    size = sum(f * f for f, _ in asked)
    assert DT * sum(f * v for f, v in asked) <= G + 1e-12 * (1.0 + size)


def test_a_master_that_owes_no_longer_resists_with_more_than_a_damper() -> None:
    """At 10 mm/s a force of 35 N turned a light handle round in every tick and pushed it: 29 mJ in 0.2 s."""
    law, rx, here = TDPA(alpha_max=40.0), tdpa.Back(35.0, 0.0), at(v=0.01)
    assert master(law, TDPAMaster(-1e-4, 0.0, 0.0), here, rx)[0] == pytest.approx(35.0 + 40.0 * 0.01)
    assert master(law, TDPAMaster(-1e-3, 0.0, 0.0), here, rx)[0] == pytest.approx(2.0 * 40.0 * 0.01)  # and what it owes


@given(G=st.floats(-1e-3, 1e-3), forces=st.lists(st.tuples(st.floats(-9.0, 9.0), speed), min_size=3, max_size=3))
def test_a_master_is_pushed_by_no_more_than_there_is(G: float, forces: list[tuple[float, float]]) -> None:
    law = TDPA(alpha_max=0.0, debt=1.0)
    given_to = [(TDPAMaster(G, 0.0, 0.0), at(v=v), tdpa.Back(f, 0.0)) for f, v in forces]
    over = TDPAMasterSums(*np.sum([law.master_sums(*each) for each in given_to], axis=0).tolist())
    power = sum(law.master(*each, over)[0] * each[1].v for each in given_to)
    assert -DT * power <= max(G, 0.0) + 1e-12
    if sum(f * v for f, v in forces) >= 0.0:
        assert [law.master(*each, over)[0] for each in given_to] == [f for f, _ in forces]  # resisting is free


def test_what_comes_in_pays_the_debt_first_and_the_rest_is_told() -> None:
    """w = 5 mJ on an end that owes 2 mJ: 3 mJ are told. The debt's part is spent, so the other end may not have it."""
    _, forth, after = master(TDPA(), TDPAMaster(-2e-3, 1e-3, 0.0), at(f_held=5.0, dx=1e-3), tdpa.Back(0.0, 0.0))
    assert (pytest.approx(0.0, abs=1e-18), pytest.approx(4e-3)) == (after.G, forth.E)
    _, forth, after = master(TDPA(), TDPAMaster(2e-3, 1e-3, 0.0), at(f_held=-5.0, dx=1e-3), tdpa.Back(0.0, 1e-3))
    assert (pytest.approx(-2e-3), 1e-3) == (after.G, forth.E)


def test_the_power_based_variant_lends_nothing_of_the_past() -> None:
    for store, wanted in ((1.0, 3e-3), (0.0, 1e-3), (1e-3, 2e-3)):
        _, _, after = master(TDPA(store=store), TDPAMaster(2e-3, 0.0, 4e-3), at(), tdpa.Back(0.0, 5e-3))
        assert pytest.approx(wanted) == after.G
    _, _, kept = slave(TDPA(store=0.0), began(0.05, 0.0), at(), tdpa.Forth(0.0, 0.0, 0.0))
    assert kept.G == 0.05  # E0 stays, or nothing would ever move
    full, power = (run(load_scene("canonical", law=law, duration=2.0)).trace for law in (TDPA(), TDPA(store=0.0)))
    assert np.abs(power["x_s"]).max() > 0.01
    assert not np.array_equal(full["x_s"], power["x_s"])


def test_the_greater_of_the_asked_and_the_held_force_is_booked() -> None:
    s = began(0.01, 0.0)._replace(v_d=0.1, f_d=4.0)
    for f_held, work in ((4.0, 4e-4), (1.0, 4e-4), (6.0, 6e-4)):
        _, _, after = slave(TDPA(), s, at(f_held=f_held), tdpa.Forth(0.0, 0.0, 0.0))
        assert pytest.approx(0.01 - work) == after.G


def test_a_slave_that_lets_go_brings_its_commanded_point_along_and_spends_nothing() -> None:
    s = began(0.05, 0.03)
    f_s, back, after = slave(TDPA(), s, at(0.01, gain=0.0), tdpa.Forth(0.2, 0.5, 0.0))
    assert (after.x_d, after.v_d, f_s, back.f_s) == pytest.approx((0.01, 0.0, 0.0, 0.0), abs=1e-12)
    assert after.G == 0.05


def test_a_watchdog_that_lets_go_and_takes_hold_again_gives_out_no_more_than_the_seed() -> None:
    """By the held force alone, and its commanded point left where it was, 226 mJ were given out."""
    scene = replace(load_scene("soft_tissue", law=TDPA(), duration=4.0), watchdog=Watchdog(timeout=0.03),
                    link=Delay(0.005) | GilbertElliott(0.01, 0.01))
    assert run(scene, seed=1).trace["E_port"].min() >= -TDPA().E0


def test_a_master_that_owes_resists_in_each_axis_by_no_more_than_its_own_motion() -> None:
    """193 N were held against 0.025 m/s of one axis, for the motion of another: a light master turned round."""
    law, along, across = TDPA(), 0.8, 0.02
    over = TDPAMasterSums(0.0, 6.0 * along + 190.0 * across, along**2 + across**2)
    owes = TDPAMaster(-0.5, 0.0, 0.0)
    given = [law.master(owes, at(v=v), tdpa.Back(f, 0.0), over)[0] for v, f in ((along, 6.0), (across, 190.0))]
    damped = law.alpha_max
    assert given == pytest.approx([6.0 + damped * along, damped * across + damped * across])


def test_an_end_that_overspent_is_damped_until_it_is_paid_and_no_faster_than_alpha_max() -> None:
    law = TDPA()
    f_m, _, _ = master(law, TDPAMaster(-1.0, 0.0, 0.0), at(v=0.2), tdpa.Back(0.0, 0.0))
    assert f_m == pytest.approx(law.alpha_max * 0.2)
    f_m, _, _ = master(law, TDPAMaster(-1e-6, 0.0, 0.0), at(v=0.2), tdpa.Back(0.0, 0.0))
    assert f_m * 0.2 * DT == pytest.approx(1e-6)
    f_m, _, _ = master(law, TDPAMaster(-1e-9, 0.0, 0.0), at(v=1e-5), tdpa.Back(0.0, 0.0))
    assert f_m == pytest.approx(1e-9 / (DT * law.v_min**2) * 1e-5)


def test_a_cap_in_three_axes_gives_no_energy_out() -> None:
    """The cap turns the held force out of the direction of the asked one: -1.5 J in 1 s, when G < 0 asked for no more
    than what was owed, of a force that was not held, and with the coupling booked twice the work of a tick."""
    trace = run(replace(capped_scene(TDPA()), duration=1.0)).trace
    one_tick = sum(abs(np.diff(trace[f"E_port_{e}"])).max() for e in "ms")
    assert trace["E_law"].min() >= -one_tick
    assert one_tick < 0.1


def test_conditions_of_tdpa_name_what_is_enough() -> None:
    facts = facts_of(load_scene("canonical", law=TDPA(K=1500.0, B=0.5, alpha_max=300.0)))
    coupling, damper = TDPA(K=1500.0, B=0.5, alpha_max=300.0).conditions(facts)
    assert "B >= 0.5224 K dt, which B = 0.5 N s/m is not; --set law.B=0.7837 is the least" in coupling
    assert "alpha_max = 300 N s/m is not; --set law.alpha_max=50 is the most" in damper
    most = facts.mass_s / facts.dt
    (held,) = TDPA(B=1.01 * most).conditions(facts)
    assert f"--set law.B={most:.4g} is the most" in held
    assert TDPA(B=0.99 * most).conditions(facts) == TDPA().conditions(facts) == ()


HOLD = {"K": 20000.0, "B": 12.0, "drift": 100.0}
SHAKEN = {"delay": 0.005, "frequency": 20.0, "amplitude": 0.2, "duration": 2.0}


@pytest.mark.parametrize(("B", "axes"), [
    (12.0, 1), (10.5, 3), *[pytest.param(*each, marks=pytest.mark.full) for each in (
        (10.5, 1), (50.0, 1), (20.0, 3), (100.0, 3))]])
def test_a_shaken_master_with_a_stiff_coupling_gets_no_more_than_the_seed(B: float, axes: int) -> None:
    """The hold of the coupling was not booked: 401 mJ came out at B = 12 N s/m, 2.7 J at 10.5 in one axis or three."""
    law = TDPA(**{**HOLD, "B": B})
    trace = run(replace(load_scene("free_motion", law=law, **SHAKEN), axes=axes)).trace
    assert trace["E_port"].min() >= -law.E0
    assert (law.E0 - trace["E_port_s"] - trace["E_law_s"]).min() >= -1e-9 * abs(trace["E_port_s"]).max()


def test_a_slave_that_owes_takes_energy_whatever_it_is_moved_by() -> None:
    """The quadratic form of the docstring in m and v, by numpy; a little less damping and it is below zero."""
    def least(b: float) -> float:
        off = -0.25 * (b - 1.0)
        return float(np.linalg.eigvalsh([[b + 0.75, off], [off, 0.5 * b - 0.25]])[0])

    assert min(map(least, (PAYS * 1.001, 1.0, 20.0))) > 0.0 > least(0.99 * PAYS)


def test_the_seed_of_tdpa_is_the_slaves_and_what_the_master_may_owe() -> None:
    assert seed_energy(TDPA(E0=0.03, debt=1e-4), axes=3) == pytest.approx(0.0301)


# PSPM


def set_point(law: PSPM, s: PSPMEnd, here: At, rx: pspm.Back) -> tuple[float, PSPMEnd]:
    """Force and state after one tick in one axis."""
    f_m, _, after = law.master(s, here, rx, law.master_sums(s, here, rx))
    return f_m, after


def test_a_set_point_goes_as_far_as_the_energy_does_and_without_any_stays_at_its_end() -> None:
    """A worked example: y' at x 0.02, y 0.015, E 1e-3 and the other end at 0.05."""
    law = PSPM()
    s = PSPMEnd(0.015, 1e-3 + 0.5 * law.K * 0.005**2, 0.0, 0.0)
    _, after = set_point(law, s, at(0.02), pspm.Back(0.05, 0.0))
    assert f"{after.y:.7f}" == "0.0253852"
    assert after.y - 0.02 == pytest.approx(sqrt(0.005**2 + 2e-3 / law.K), rel=1e-12)
    law = PSPM()
    f_m, after = set_point(law, PSPMEnd(0.1, -1e-3, 0.0, 0.0), at(0.02, v=0.3), pspm.Back(0.5, 0.0))
    assert (after.y, f_m) == (0.02, pytest.approx(law.B_m * 0.3))


@given(x=place, y=place, other=place, T=st.floats(-0.01, 0.1), came=st.floats(0.0, 0.1), w=st.floats(-1e-3, 1e-3))
def test_the_energy_of_the_spring_is_never_more_than_the_end_keeps(
        x: float, y: float, other: float, T: float, came: float, w: float) -> None:
    law = PSPM()
    _, after = set_point(law, PSPMEnd(y, T, 0.0, 0.0), at(x, f_held=1.0, dx=w), pspm.Back(other, came))
    spring = 0.5 * law.K * (x - after.y) ** 2
    assert spring <= max(after.T, 0.0) * (1.0 + 1e-9) + 1e-18
    assert min(x, other) - 1e-15 <= after.y <= max(x, other) + 1e-15
    assert after.T - spring <= law.E_max + 1e-15  # the rest is sent on
    taken = after.T + after.S - (T + w)
    room = law.E_max - (T + w - 0.5 * law.K * (x - y) ** 2)
    assert taken == pytest.approx(min(came, max(room, 0.0)), abs=1e-15)  # and of what came only what fits is taken


def test_set_points_of_three_axes_share_one_radius() -> None:
    law, s, rest = PSPM(), PSPMEnd(0.0, 1e-3, 0.0, 0.0), at()
    others = (0.06, -0.03, 0.02)
    over = PSPMSums(*np.sum([law.master_sums(s, rest, pspm.Back(x, 0.0)) for x in others], axis=0).tolist())
    ends = [law.master(s, rest, pspm.Back(x, 0.0), over)[2] for x in others]
    points = np.array([end.y for end in ends])
    assert np.linalg.norm(points) == pytest.approx(sqrt(2e-3 / law.K))
    assert points / points[0] == pytest.approx(np.array(others) / others[0])
    assert len({end[1:] for end in ends}) == 1


def test_a_device_that_is_let_have_less_force_keeps_what_it_did_not_spend() -> None:
    """The motor held a quarter of f = K (y - x) over a motion towards y: three quarters of the spring's are left."""
    law, T = PSPM(E_max=1.0), 0.5 * 500.0 * 0.01**2
    f, d = 0.25 * 500.0 * 0.01, -1e-4
    _, after = set_point(law, PSPMEnd(0.0, T, 0.0, 0.0), at(0.01 + d, f_held=f, dx=d), pspm.Back(0.01 + d, 0.0))
    assert pytest.approx(T + f * d, rel=1e-12) == after.T


def test_what_the_books_lack_is_what_did_not_fit() -> None:
    """E_port = T_m + T_s + under way - 2 E_0 + dropped, and with room for all that comes nothing is dropped."""
    for room in (10.0, 0.005):
        trace = run(load_scene("soft_tissue", law=PSPM(E_max=room), duration=1.0)).trace
        dropped = trace["E_port"] + 0.02 - trace["E_law"]
        assert np.diff(dropped).min() > -1e-12
        assert (dropped.max() < 1e-12) == (room == 10.0)
    assert seed_energy(PSPM()) == 0.02


def test_a_spring_or_a_damper_that_is_too_much_for_a_body_in_a_tick_is_told_of() -> None:
    facts = facts_of(load_scene("canonical", law=PSPM()))
    most = min(facts.mass_m, facts.mass_s) / facts.dt**2
    told, = PSPM(K=1.01 * most).conditions(facts)
    assert f"--set law.K={most:.6g} is the most" in told
    told, = PSPM(B_m=250.0).conditions(facts)
    assert "B <= m/T, T the longest tick, which B_m = 250 N s/m is not; --set law.B_m=100 is the most" in told
    assert PSPM(K=0.99 * most).conditions(facts) == ()


# Two layers


def tank(law: TwoLayer, H: float, f_s: float, v: float, **more: Any) -> tuple[float, Tank]:
    """Force and tank after one tick in one axis."""
    s, here, rx = Tank(H, 0.0, 0.0), at(v=v, **more), two_layer.Back(f_s, 0.0)
    f_m, _, after = law.master(s, here, rx, law.master_sums(s, here, rx))
    return f_m, after


@pytest.mark.parametrize(("fwd", "bwd", "wanted"), [(10, 200, 0.0242647), (50, 50, 0.0332215), (1, 1, 0.0495000)])
def test_tanks_that_nobody_moves_share_evenly(fwd: int, bwd: int, wanted: float) -> None:
    """In ticks; a message without a delay comes at the next. The closed form is that of the law's docstring."""
    law = TwoLayer(H_0=0.05, H_d=0.0)
    here = start_at(0.0, 0.0, float("nan"), DT)
    (s_m, back), (s_s, forth) = law.master_start(here), law.slave_start(here)
    forths, backs = [forth] * fwd, [back] * bwd
    for _ in range(8000):
        f_m, sent, s_m = law.master(s_m, at(), backs[0], law.master_sums(s_m, at(), backs[0]))
        f_s, answer, s_s = law.slave(s_s, at(), forths[0], law.slave_sums(s_s, at(), forths[0]))
        forths, backs = [*forths[1:], sent], [*backs[1:], answer]
        assert (f_m, f_s) == (0.0, 0.0)
    kept = (1.0 - law.beta) * 0.1 / (2.0 * (1.0 - law.beta) + law.beta * (fwd + bwd))
    assert (round(s_m.H, 7), round(s_s.H, 7)) == (wanted, wanted)
    assert pytest.approx(kept, rel=1e-9) == s_m.H
    assert law.master_stored(s_m) + law.slave_stored(s_s) == pytest.approx(0.1, rel=1e-12)  # with what is under way


@given(H=st.floats(-1.0, 2.0), f=st.floats(-100.0, 100.0), v=st.floats(-2.0, 2.0), d=st.floats(-1e-2, 1e-2))
def test_a_tank_falls_below_zero_by_the_surprise_of_one_tick_at_most(H: float, f: float, v: float, d: float) -> None:
    """Whatever motion d follows: H >= -k d^2/2 by the upper layer's force, from a tank that was not empty."""
    law = TwoLayer(beta=0.0, d_max=0.0)
    f_m, s = tank(law, H, f, v)
    assert abs(f_m) <= min(abs(f), law.f_max, sqrt(2.0 * law.k * max(s.H, 0.0))) * (1.0 + 1e-12)
    assert abs(f_m * v) * DT <= max(s.H, 0.0) * (1.0 + 1e-12)
    here = at(f_held=f_m, dx=d)
    _, _, after = law.master(s, here, two_layer.Back(0.0, 0.0), law.master_sums(s, here, two_layer.Back(0.0, 0.0)))
    assert min(s.H, 0.0) - 0.5 * law.k * d * d - 1e-15 <= after.H


def test_a_tank_gives_a_force_by_what_it_has_is_filled_by_the_hand_and_gives_over_ticks_that_were_left_out() -> None:
    law = TwoLayer(H_d=0.0, beta=0.0)
    assert tank(law, 0.0, 10.0, 0.0)[0] == 0.0
    assert tank(law, -1e-3, 10.0, 0.0)[0] == 0.0
    assert tank(law, 1e-9, 10.0, 0.0)[0] == pytest.approx(sqrt(2.0 * 500.0 * 1e-9), rel=1e-12)
    law = TwoLayer(beta=0.0)
    assert tank(law, 0.03, 0.0, 0.1)[0] == pytest.approx(500.0 * 0.02 * 0.1)
    assert tank(law, -1.0, 0.0, 0.1)[0] == pytest.approx(20.0 * 0.1)  # d_max
    assert tank(law, 0.2, 0.0, 0.1)[0] == 0.0
    assert pytest.approx(0.99) == tank(TwoLayer(), 1.0, 0.0, 0.0, ticks=1)[1].H
    assert pytest.approx(0.93) == tank(TwoLayer(), 1.0, 0.0, 0.0, ticks=7)[1].H
    assert tank(TwoLayer(), 1.0, 0.0, 0.0, ticks=500)[1].H == 0.0


def test_what_three_axes_ask_for_is_scaled_by_one_share() -> None:
    law = TwoLayer(beta=0.0, H_d=0.0)
    forces, s, rest = (6.0, -3.0, 2.0), Tank(0.01, 0.0, 0.0), at()
    over = TwoLayerSums(*np.sum([law.master_sums(s, rest, two_layer.Back(f, 0.0)) for f in forces], axis=0).tolist())
    got = [law.master(s, rest, two_layer.Back(f, 0.0), over)[0] for f in forces]
    assert np.linalg.norm(got) == pytest.approx(sqrt(2.0 * 500.0 * 0.01))
    assert np.array(got) / got[0] == pytest.approx(np.array(forces) / forces[0])


def test_a_slave_of_two_layers_that_lets_go_tells_of_the_force_that_it_has() -> None:
    law, s, here = TwoLayer(H_0=1.0), Tank(1.0, 0.0, 0.0), at()._replace(gain=0.25)
    rx = two_layer.Forth(0.01, 0.0, 0.0)
    f_s, back, _ = law.slave(s, here, rx, law.slave_sums(s, here, rx))
    assert (f_s, back.f_s) == (pytest.approx(5.0), pytest.approx(1.25))


def test_the_books_of_two_tanks_are_exact_where_none_is_full() -> None:
    """E_port = H_m + H_s + under way - 2 H_0, tick by tick, through loss and jitter."""
    link = Delay(0.02) | UniformJitter(0.02) | Bernoulli(0.2)
    trace = run(replace(load_scene("soft_tissue", law=TwoLayer(H_0=0.02), duration=1.0), link=link), seed=2).trace
    assert np.abs(trace["E_port"] + 0.04 - trace["E_law"]).max() < 1e-12
    assert trace["E_law"].min() >= 0.0
    assert seed_energy(TwoLayer(H_0=0.02)) == 0.04


def test_a_share_that_suits_the_link_falls_with_its_delay() -> None:
    for delay, wanted in ((0.0, 0.01), (0.05, 0.01), (0.2, 0.0025)):
        scene = load_scene("free_motion", law=TwoLayer(), delay=delay)
        facts = facts_of(scene)
        suits = TwoLayer().fitted(facts)
        assert suits.beta == pytest.approx(wanted)
        assert suits.conditions(facts) == ()
    told, = TwoLayer().conditions(facts)
    assert "beta <= dt/(T1 + T2), which beta = 0.01 is not; --set law.beta=0.0025 is the most" in told
