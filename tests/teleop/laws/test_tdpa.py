"""Time-domain passivity: what each end may give out, step by step, and the figures of the law book."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from channel import Delay, GilbertElliott
from teleop import At, Watchdog, facts_of, load_scene, run, seed_energy
from teleop.checks.trials import capped_scene
from teleop.laws.tdpa import PAYS, TDPA, Back, Forth, TDPAMaster, TDPAMasterSums, TDPASlave, TDPASlaveSums
from tests.teleop.laws.printed import assert_printed, printed, tracking_mm

DT = 1e-3
ENOUGH = 1e3  # J
speed = st.floats(-1.0, 1.0).map(lambda value: round(value, 9))
place = st.floats(-0.1, 0.1).map(lambda value: round(value, 9))


def at(x: float = 0.0, v: float = 0.0, f_held: float = 0.0, dx: float = 0.0, gain: float = 1.0) -> At:
    return At(x, v, float("nan"), f_held, dx, True, 0.0, DT, DT, gain)


def began(G: float, x_d: float) -> TDPASlave:
    """A slave with G (J) to give out, a commanded point (m) that does not move, and a coupling that burned enough."""
    return TDPASlave(G, 0.0, 0.0, x_d, 0.0, 0.0, ENOUGH)


def slave(law: TDPA, s: TDPASlave, here: At, rx: Forth) -> tuple[float, Back, TDPASlave]:
    return law.slave(s, here, rx, law.slave_sums(s, here, rx))


def master(law: TDPA, s: TDPAMaster, here: At, rx: Back) -> tuple[float, Forth, TDPAMaster]:
    return law.master(s, here, rx, law.master_sums(s, here, rx))


@pytest.mark.parametrize(("scene", "wanted"), [
    ("free_motion", ("0.00291242", "2.65465", "0.00300096")), ("canonical", ("0.0457398", "8.71231", "0.0162988")),
])
def test_two_seconds_over_50_ms(scene: str, wanted: tuple[str, ...]) -> None:
    assert_printed(TDPA(), scene, 0.05, *wanted)


@pytest.mark.full
@pytest.mark.parametrize(("scene", "wanted"), [("canonical", "46.6"), ("soft_tissue", "21.7"), ("free_motion", "2.6")])
def test_tracking_of_ten_seconds_over_50_ms(scene: str, wanted: str) -> None:
    assert printed(tracking_mm(TDPA(), scene)[0], wanted) == wanted


@pytest.mark.full
def test_tracking_against_a_hard_wall_is_within_what_chattering_changes() -> None:
    """Printed is 8.0 mm; from 0.5 s on G stays about 0, and the last bit decides whether a tick is paid for."""
    assert tracking_mm(TDPA(), "hard_wall")[0] == pytest.approx(8.0, abs=0.2)


def test_one_step_of_the_slave() -> None:
    f_s, back, after = slave(TDPA(), began(0.0, 0.01), at(0.0, 0.1), Forth(0.05, 0.2, 1e-4))
    assert (f"{after.v_d:.7f}", f"{f_s:.5f}") == ("0.0279826", "3.57364")
    assert f_s * after.v_d * DT == pytest.approx(1e-4, rel=1e-12)  # all that may be given out
    assert back == Back(f_s, 0.0)


def test_one_step_of_the_master_that_is_pushed() -> None:
    for G, wanted in ((1e-4, "2.00000"), (-1e-4, "-2.00000")):
        assert f"{master(TDPA(), TDPAMaster(G, 0.0, 0.0), at(v=-0.05), Back(4.0, 0.0))[0]:.5f}" == wanted


@given(G=st.floats(-1e-3, 1e-2), x_d=place, x=place, v=speed, x_rx=place, v_rx=speed)
def test_in_one_axis_the_command_is_clipped_between_two_roots(
        G: float, x_d: float, x: float, v: float, x_rx: float, v_rx: float) -> None:
    """The roots of z v^2 + f_0 v = G/dt, by numpy; where there are none the least that the slave can ask for."""
    law = TDPA()
    f_s, _, after = slave(law, began(G, x_d), at(x, v), Forth(x_rx, v_rx, 0.0))
    z, f_0 = law.B + law.K * DT, law.K * (x_d - x) - law.B * v
    low, high = sorted(np.roots([z, f_0, -G / DT]).real)
    wanted = np.clip(v_rx + law.drift * (x_rx - x_d), low, high)
    assert after.v_d == pytest.approx(wanted, rel=1e-6, abs=1e-6)  # two equal roots have half the digits
    assert f_s == pytest.approx(law.K * (after.x_d - x) + law.B * (after.v_d - v), abs=1e-9)
    least = -DT * f_0 * f_0 / (4.0 * z)
    assert f_s * after.v_d * DT <= max(G, least) + 1e-12 * (1.0 + f_0 * f_0)


@given(G=st.floats(0.0, 1e-2), axes=st.lists(st.tuples(place, place, speed, place, speed), min_size=3, max_size=3))
def test_three_axes_ask_for_no_more_than_there_is(
        G: float, axes: list[tuple[float, float, float, float, float]]) -> None:
    law = TDPA()
    given_to = [(began(G, x_d), at(x, v), Forth(x_rx, v_rx, 0.0)) for x_d, x, v, x_rx, v_rx in axes]
    over = TDPASlaveSums(*np.sum([law.slave_sums(*each) for each in given_to], axis=0).tolist())
    asked = [(f_s, after.v_d) for f_s, _, after in (law.slave(*each, over) for each in given_to)]
    size = sum(f * f for f, _ in asked)
    assert DT * sum(f * v for f, v in asked) <= G + 1e-12 * (1.0 + size)


def test_a_master_that_owes_no_longer_resists_with_more_than_a_damper() -> None:
    """At 10 mm/s a force of 35 N turned a light handle round in every tick and pushed it: 29 mJ in 0.2 s."""
    law, rx, here = TDPA(alpha_max=40.0), Back(35.0, 0.0), at(v=0.01)
    assert master(law, TDPAMaster(-1e-4, 0.0, 0.0), here, rx)[0] == pytest.approx(35.0 + 40.0 * 0.01)
    assert master(law, TDPAMaster(-1e-3, 0.0, 0.0), here, rx)[0] == pytest.approx(2.0 * 40.0 * 0.01)  # and what it owes


@given(G=st.floats(-1e-3, 1e-3), forces=st.lists(st.tuples(st.floats(-9.0, 9.0), speed), min_size=3, max_size=3))
def test_a_master_is_pushed_by_no_more_than_there_is(G: float, forces: list[tuple[float, float]]) -> None:
    law = TDPA(alpha_max=0.0, debt=1.0)
    given_to = [(TDPAMaster(G, 0.0, 0.0), at(v=v), Back(f, 0.0)) for f, v in forces]
    over = TDPAMasterSums(*np.sum([law.master_sums(*each) for each in given_to], axis=0).tolist())
    power = sum(law.master(*each, over)[0] * each[1].v for each in given_to)
    assert -DT * power <= max(G, 0.0) + 1e-12
    if sum(f * v for f, v in forces) >= 0.0:
        assert [law.master(*each, over)[0] for each in given_to] == [f for f, _ in forces]  # resisting is free


def test_what_comes_in_pays_the_debt_first_and_the_rest_is_told() -> None:
    """w = 5 mJ on an end that owes 2 mJ: 3 mJ are told. The debt's part is spent, so the other end may not have it."""
    _, forth, after = master(TDPA(), TDPAMaster(-2e-3, 1e-3, 0.0), at(f_held=5.0, dx=1e-3), Back(0.0, 0.0))
    assert (pytest.approx(0.0, abs=1e-18), pytest.approx(4e-3)) == (after.G, forth.E)
    _, forth, after = master(TDPA(), TDPAMaster(2e-3, 1e-3, 0.0), at(f_held=-5.0, dx=1e-3), Back(0.0, 1e-3))
    assert (pytest.approx(-2e-3), 1e-3) == (after.G, forth.E)


def test_the_power_based_variant_lends_nothing_of_the_past() -> None:
    for store, wanted in ((1.0, 3e-3), (0.0, 1e-3), (1e-3, 2e-3)):
        _, _, after = master(TDPA(store=store), TDPAMaster(2e-3, 0.0, 4e-3), at(), Back(0.0, 5e-3))
        assert pytest.approx(wanted) == after.G
    _, _, kept = slave(TDPA(store=0.0), began(0.05, 0.0), at(), Forth(0.0, 0.0, 0.0))
    assert kept.G == 0.05  # E0 stays, or nothing would ever move
    full, power = (run(load_scene("canonical", law=law, duration=2.0)).trace for law in (TDPA(), TDPA(store=0.0)))
    assert np.abs(power["x_s"]).max() > 0.01
    assert not np.array_equal(full["x_s"], power["x_s"])


def test_the_greater_of_the_asked_and_the_held_force_is_booked() -> None:
    s = began(0.01, 0.0)._replace(v_d=0.1, f_d=4.0)
    for f_held, work in ((4.0, 4e-4), (1.0, 4e-4), (6.0, 6e-4)):
        _, _, after = slave(TDPA(), s, at(f_held=f_held), Forth(0.0, 0.0, 0.0))
        assert pytest.approx(0.01 - work) == after.G


def test_a_slave_that_lets_go_brings_its_commanded_point_along_and_spends_nothing() -> None:
    s = began(0.05, 0.03)
    f_s, back, after = slave(TDPA(), s, at(0.01, gain=0.0), Forth(0.2, 0.5, 0.0))
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
    given = [law.master(owes, at(v=v), Back(f, 0.0), over)[0] for v, f in ((along, 6.0), (across, 190.0))]
    damped = law.alpha_max
    assert given == pytest.approx([6.0 + damped * along, damped * across + damped * across])


def test_an_end_that_overspent_is_damped_until_it_is_paid_and_no_faster_than_alpha_max() -> None:
    law = TDPA()
    f_m, _, _ = master(law, TDPAMaster(-1.0, 0.0, 0.0), at(v=0.2), Back(0.0, 0.0))
    assert f_m == pytest.approx(law.alpha_max * 0.2)
    f_m, _, _ = master(law, TDPAMaster(-1e-6, 0.0, 0.0), at(v=0.2), Back(0.0, 0.0))
    assert f_m * 0.2 * DT == pytest.approx(1e-6)
    f_m, _, _ = master(law, TDPAMaster(-1e-9, 0.0, 0.0), at(v=1e-5), Back(0.0, 0.0))
    assert f_m == pytest.approx(1e-9 / (DT * law.v_min**2) * 1e-5)


def test_a_cap_in_three_axes_gives_no_energy_out() -> None:
    """The cap turns the held force out of the direction of the asked one: -1.5 J in 1 s, when G < 0 asked for no more
    than what was owed, of a force that was not held, and with the coupling booked twice the work of a tick."""
    trace = run(replace(capped_scene(TDPA()), duration=1.0)).trace
    one_tick = sum(abs(np.diff(trace[f"E_port_{e}"])).max() for e in "ms")
    assert trace["E_law"].min() >= -one_tick
    assert one_tick < 0.1


def test_conditions_name_what_is_enough() -> None:
    facts = facts_of(load_scene("canonical", law=TDPA(K=1500.0, B=0.5, alpha_max=300.0)))
    coupling, damper = TDPA(K=1500.0, B=0.5, alpha_max=300.0).conditions(facts)
    assert "B >= 0.5224 K dt, which B = 0.5 N s/m is not; --set law.B=0.7837 is the least" in coupling
    assert "alpha_max = 300 N s/m is not; --set law.alpha_max=50 is the most" in damper
    assert TDPA().conditions(facts) == ()


def test_a_coupling_that_is_too_stiff_a_damper_for_its_slave_is_told() -> None:
    facts = facts_of(load_scene("canonical", law=TDPA()))
    most = facts.mass_s / facts.dt
    (held,) = TDPA(B=1.01 * most).conditions(facts)
    assert f"--set law.B={most:.4g} is the most" in held
    assert TDPA(B=0.99 * most).conditions(facts) == ()


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


def test_the_seed_is_the_slaves_and_what_the_master_may_owe() -> None:
    assert seed_energy(TDPA(E0=0.03, debt=1e-4), axes=3) == pytest.approx(0.0301)
