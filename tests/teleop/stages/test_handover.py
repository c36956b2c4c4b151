"""Handover to a policy and back: no jump, the promise on its energy, the law's own ledger, who has authority."""

from __future__ import annotations

import random
from array import array
from dataclasses import dataclass, replace
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from channel import LeftOut, parse_link
from master import Grip, Reach, Rest, Sine
from slave import Wall
from teleop import Cap, Handover, MassDamper, Operator, Scene, Watchdog, find_law, load_scene, run, seed_energy
from teleop.simulation.ending import given_out
from teleop.stages.authority import Standing
from teleop.stages.handover import part_of_policy
from tests.teleop.stages.test_operator import Metered

LISTED = ("pp", "p_d", "pd_d", "pspm", "two_layer", "wave", "wave_filter", "wave_matched", "wave_position",
          "wave_scaled")
PASSIVE = ("wave", "wave_filter", "two_layer", "pspm")  # E_port never below 0 over any link here
DELAYS = (0.02, 0.05, 0.1)
FULL = pytest.mark.full
JUMP = 0.012  # N m a tick


def jump(trace: Any, since: float, until: float) -> float:
    """The most change of the handle's force within a tick."""
    change, t = np.abs(np.diff(trace["f_m"])), trace["t"][1:]
    return float(change[(t >= since) & (t < until)].max())


def when(trace: Any, standing: Standing) -> float:
    """The time (s) at which somebody has authority first; inf: never."""
    at = np.flatnonzero(trace["policy_m"] == standing)
    return float(trace["t"][at[0]]) if len(at) else inf


def hard(of: Scene) -> Scene:
    """The same scene with a policy that takes over within a tick, and pulls at once to where it wants to be."""
    assert of.handover is not None
    at_once = replace(of.handover, ramp=1e-3, yields=1e-3, slew=1e9, bandwidth=999.0, most_speed=1e6)
    return replace(of, cap=Cap(f_max=5.0), handover=at_once)


CASES = [pytest.param(law, delay, marks=[FULL] * ((law, delay) not in {("pp", 0.1), ("two_layer", 0.02), ("wave", 0.05),
         ("pspm", 0.1), ("wave_position", 0.02)})) for law in LISTED for delay in DELAYS]


@pytest.mark.parametrize(("law", "delay"), CASES)
def test_the_handles_force_does_not_jump_as_authority_goes_over_and_back(law: str, delay: float) -> None:
    scene = load_scene("handover", law=law, delay=delay)
    trace = run(scene).trace
    assert jump(trace, 1.0, 1.5) < JUMP
    assert jump(trace, 2.9, 3.4) < JUMP
    assert {*trace["policy_m"]} == {Standing.OPERATOR, Standing.POLICY}  # nothing takes it for a hand that resists
    assert np.abs(trace["f_policy_m"][trace["authority_m"] == 0.0]).max() == 0.0
    assert trace["authority_m"][(trace["t"] > 1.2) & (trace["t"] < 2.9)].min() > 0.99
    assert trace["x_s"][2900] > 0.5  # the slave is at the spring
    assert jump(run(hard(scene)).trace, 1.0, 1.5) > 0.99
    small = load_scene("handover", law=law, delay=delay, tank=0.05, tank_power=0.05)
    assert jump(run(small).trace, 1.0, 3.4) < 0.025


@pytest.mark.parametrize(("law", "delay"), CASES)
def test_a_hand_that_pulls_back_takes_over_by_force_and_none_before(law: str, delay: float) -> None:
    result = run(load_scene("handover", law=law, delay=delay, grip=2.0))
    trace, taken = result.trace, when(result.trace, Standing.GRIPPED)
    assert 2.0 < taken < 2.7
    assert any(f"took over by force at t = {taken:.3g} s" in note for note in result.notes)
    after = trace["t"] > 2.9 + 0.01  # ramped out, and it stays the operator's though the switch is on until t = 3
    assert np.abs(trace["f_policy_m"][after]).max() == 0.0
    assert {*trace["policy_m"][(trace["t"] > 2.7) & (trace["t"] < 3.0)]} == {Standing.GRIPPED}
    assert np.abs(np.diff(trace["f_policy_m"], axis=0)).max() < 0.0201  # its slew, at every tick
    # A hand on the move; two_layer's own force leaps by up to 0.087 N m where its tank is empty, its policy's does not.
    assert jump(trace, 2.0, 3.4) < (0.09 if law == "two_layer" else 0.05)


def test_it_is_the_policys_again_once_its_switch_was_off() -> None:
    base = load_scene("handover", grip=1.6, takes=(1.0, 2.5, 3.0, 4.4), duration=4.5)
    had = run(replace(base, handover=replace(base.handover, leap=3.0))).trace["policy_m"]
    assert {*had[2400:2500]} == {Standing.GRIPPED}
    assert {*had[2500:3000]} == {Standing.OPERATOR}
    assert {*had[3001:3050]} == {Standing.POLICY}


def test_without_authority_all_numbers_are_what_they_are_without_the_stage() -> None:
    limited: dict[str, Any] = {"operator": Operator(clutch=((0.5, 0.7),)), "cap": Cap(f_max=2.0, slew=50.0, power=0.05)}
    none_at_all: dict[str, Any] = {}
    for motor, parts in ((True, none_at_all), (True, limited), (False, none_at_all), (False, limited)):
        base = replace(load_scene("canonical", law="pp", duration=2.0, energy=True), **parts)
        with_one, none = run(replace(base, handover=Handover(motor=motor))).trace, run(base).trace
        for name in none:
            if name.startswith("E_port") and not motor:  # summed from what the law was told
                np.testing.assert_allclose(with_one[name], none[name], rtol=1e-12, atol=1e-15)
            else:
                np.testing.assert_array_equal(with_one[name], none[name], err_msg=name)


# Its promise


@dataclass(frozen=True)
class Leaping:
    """A policy that is somewhere else at each action."""

    seed: int
    far: float

    def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> tuple[array[float], ...]:
        draws = np.random.default_rng(self.seed).uniform(-self.far, self.far, (axes, first + count))
        return tuple([array("d", each[first:].tolist()) for each in draws])


def adversary(seed: int, *, slew: bool = False) -> Scene:
    """A scene in which policy, switches, link and caps do what is worst for the promise, as a seed draws them."""
    dice = random.Random(seed)
    axes = dice.choice((1, 1, 3))
    times = sorted(1.5 * dice.random() for _ in range(dice.choice((2, 12, 60))))
    toggled = tuple([(0.002 * i, 0.002 * i + 0.001) for i in range(60)])
    law = find_law(dice.choice(PASSIVE))()
    link = dice.choice(("delay(0.02)", "delay(0.1)", "delay(0.02) | uniform(0.02) | blackout(0.4, 0.3)",
                        "delay(0.005) | bernoulli(0.2)"))
    moves = dice.choice((Leaping(seed, 10.0 ** dice.uniform(-2.0, 0.0)), Sine(
        amplitude=0.3 if axes == 1 else (0.3, 0.1, -0.2), frequency=dice.choice((0.5, 3.0, 10.0)))))
    cap = dice.choice((None, Cap(f_max=dice.uniform(0.3, 5.0)), Cap(f_max=3.0, v_max=0.3), Cap(power=0.05)))
    if slew:
        cap = Cap(f_max=3.0, slew=10.0 ** dice.uniform(1.0, 3.0))
    hand = Grip(mass=0.05, k=10.0 ** dice.uniform(-1.0, 2.0), d=0.1, reference=Sine(
        amplitude=0.1 if axes == 1 else (0.1, 0.0, 0.1), frequency=dice.choice((0.5, 4.0))))
    return Scene(
        law=law, axes=axes, hand=hand, master=MassDamper(mass=dice.choice((0.02, 0.2)), damping=0.05),
        slave=MassDamper(mass=0.1, damping=0.1), link=parse_link(link), environment=Wall(k=300.0, d=1.0, at=0.02),
        watchdog=Watchdog(timeout=0.15) if dice.random() < 0.7 else None, cap=cap, energy=True, duration=1.5,
        operator=Operator(clutch=((0.7, 0.9), (1.0, 1.01))) if dice.random() < 0.3 else None,
        left_out_m=LeftOut(0.1) if dice.random() < 0.2 else None,
        handover=Handover(
            policy=moves, takes=toggled if dice.random() < 0.2 else tuple(zip(times[::2], times[1::2], strict=True)),
            rate=dice.choice((30.0, 60.0, 500.0)), late=dice.choice((0.0, 0.05, 0.4)),
            Kp=10.0 ** dice.uniform(0.0, 3.0),
            Bp=dice.choice((0.0, 0.5, 5.0)), f_max=10.0 ** dice.uniform(-1.0, 1.0), slew=10.0 ** dice.uniform(1.0, 5.0),
            ramp=dice.choice((1e-3, 0.02, 0.2)), energy=10.0 ** dice.uniform(-5.0, 0.0),
            power=dice.choice((0.0, 1e-3, 0.05, 0.6)), soft=dice.choice((None, 1e-6)), leap=1e3 if dice.random() < 0.5
            else 0.2, most_speed=10.0 ** dice.uniform(-1.0, 2.0), grip=dice.choice((0.9, 1.0, 0.05)),
            bandwidth=dice.choice((10.0, 300.0)), yields=dice.choice((1e-3, 0.05))))


def margins(scene: Scene) -> tuple[float, float, float]:
    """How far a run stays within the promise, the least that law and link took up, the policy's work; J."""
    of, trace = scene.handover, run(scene).trace
    assert of is not None
    W, t = trace["E_policy_m"], trace["t"]
    worked = np.diff(W, prepend=0.0)
    assert worked.min() >= 0.0
    most = np.maximum.accumulate(worked) * (1.0 if of.motor else 2.0)  # of one tick, or of two
    seed = seed_energy(scene.laws[0], 1e-3, scene.axes)
    return float((of.energy + of.power * t + most - W).min()), float(trace["E_port"].min()) + seed, float(W[-1])


SEEDS = [pytest.param(range(12)), pytest.param(range(12, 400), marks=FULL)]


@pytest.mark.parametrize("seeds", SEEDS)
def test_the_policys_work_is_paid_for_and_the_laws_ledger_holds_whatever_policy_hand_and_link_do(seeds: range) -> None:
    worked = 0
    for seed in [*seeds, *[-1 - seed for seed in seeds]]:
        scene = adversary(abs(seed))
        if seed < 0:
            scene = replace(scene, handover=replace(scene.handover, motor=False))
        margin, ledger, work = margins(scene)
        assert margin >= -1e-12, seed
        # Where the policy moves the law's end, ticks left out cost up to 2 mJ: see the stage's head.
        assert ledger >= (-1e-9 if seed >= 0 else -5e-3), seed
        worked += work > 0.5 * scene.handover.energy
    assert worked >= 3  # they do press the tank


@pytest.mark.parametrize("seeds", SEEDS)
def test_a_slow_slew_limit_leaves_the_policys_promise_as_it_is(seeds: range) -> None:
    for seed in seeds:
        assert margins(adversary(seed, slew=True))[0] >= -1e-12, seed


# The law's part


def test_the_law_is_told_its_own_part_and_both_ports_add_up_to_the_device() -> None:
    moves = Sine(amplitude=0.1, frequency=1.0)
    for cap, clutch in ((None, ()), (Cap(f_max=0.2), ()), (Cap(f_max=2.0, slew=300.0, v_max=0.2, power=0.05), ()),
                        (None, ((0.6, 0.8),))):
        base = replace(load_scene("canonical", law=Metered(K=100.0, B=2.0), energy=True, duration=1.5),
                       hand=Grip(mass=0.1, k=2.0, d=0.2, reference=Rest()))
        trace = run(replace(base, cap=cap, operator=Operator(clutch=clutch, ramp=0.02) if clutch else None,
                            handover=Handover(policy=moves, takes=((0.3, 1.2),), Kp=100.0, f_max=2.0))).trace
        f, f_p, dx = trace["f_m"], trace["f_policy_m"], np.diff(trace["x_m"])
        assert np.abs(f_p).max() > 0.15
        assert trace["E_policy_m"][-1] > 1e-3
        np.testing.assert_allclose(np.cumsum((f + f_p)[:-1] * dx), trace["E_m"][1:], atol=1e-12)
        np.testing.assert_array_equal(trace["E_port_m"], np.concatenate([[0.0], np.cumsum((f + f_p)[:-1] * dx)]))
        # What a note on a motion that grows says of law and link is theirs alone.
        own = trace["E_port_m"][-1] - (trace["f_s"][:-1] * np.diff(trace["x_s"])).sum()
        assert given_out(trace) == pytest.approx(-own, abs=1e-12)
        paid = np.cumsum(np.maximum(f_p[:-1] * dx, 0.0))
        np.testing.assert_allclose(trace["E_policy_m"][1:], paid, atol=1e-12)
        if cap is None and not clutch:
            np.testing.assert_allclose(trace["held_told_m"][1:], (f + f_p)[:-1], atol=1e-12)


@given(*[st.floats(-10.0, 10.0)] * 2, st.floats(0.0, 10.0))
def test_a_cap_cuts_the_policys_force_first(law: float, policy: float, most: float) -> None:
    f = max(min(law - policy, most), -most)
    held = part_of_policy(law, policy, f)
    assert min(policy, 0.0) <= held <= max(policy, 0.0)
    if abs(law) <= most:  # the law alone is within the cap: all that is cut is the policy's
        assert f + held == pytest.approx(law, abs=1e-12)
    assert part_of_policy(law, 0.0, f) == 0.0
    assert np.isnan(part_of_policy(law, policy, nan))


# Who has authority


@pytest.mark.parametrize("rate", [30.0, 60.0])
def test_a_policy_that_falls_silent_gives_way_within_a_tenth_of_a_second(rate: float) -> None:
    trace = run(load_scene("handover", rate=rate, late=0.05, silent=(2.0, 2.4), to=0.6)).trace
    last = 0.05 + 2.0 - (1.0 / rate) * 0.0
    t, force = trace["t"], np.abs(trace["f_policy_m"])
    assert force[(t > last - 0.05) & (t < last - 0.01)].min() > 0.05
    assert force[(t > last + 0.1) & (t < last + 0.35)].max() == 0.0
    assert {*trace["policy_m"][(t > last + 0.1) & (t < last + 0.35)]} == {Standing.LATE}
    assert {*trace["policy_m"][(t > last + 0.5) & (t < 2.9)]} == {Standing.POLICY}  # and it goes on by itself
    assert jump(trace, 1.9, 2.9) < 0.025


def test_a_policy_that_was_never_there_or_is_behind_an_open_clutch_has_no_authority() -> None:
    base = load_scene("handover")
    trace = run(replace(base, handover=Handover(takes=((0.5, 3.0),)))).trace
    assert {*trace["policy_m"]} == {Standing.OPERATOR, Standing.LATE}
    assert np.abs(trace["f_policy_m"]).max() == 0.0
    base = load_scene("handover", takes=(0.6, 4.2))
    trace = run(replace(base, operator=Operator(clutch=((2.0, 2.5),), ramp=0.05))).trace
    t = trace["t"]
    assert np.abs(trace["f_policy_m"][(t > 2.06) & (t < 2.5)]).max() == 0.0
    assert {*trace["policy_m"][(t >= 2.0) & (t < 2.5)]} == {Standing.PAUSED}
    assert trace["policy_m"][3500] == Standing.POLICY


@dataclass(frozen=True)
class Odd:
    """A policy with one action that is none, or the rest of them from then on."""

    value: float
    last: int

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[list[float], ...]:
        path = [0.2] * count
        path[60:self.last] = [self.value] * (min(self.last, count) - 60)
        return tuple([path] * axes)


@pytest.mark.parametrize("value", [nan, inf, -inf, 1.9, -0.9])
def test_an_action_that_is_no_number_or_leaps_by_a_radian_is_no_action(value: float) -> None:
    base = load_scene("handover", takes=(0.5, 4.0))
    assert base.handover is not None
    count = 1 + round(base.duration * base.handover.rate)
    one, all_of_them = [run(replace(base, handover=replace(base.handover, policy=Odd(value, last)))).trace
                        for last in (61, count)]
    assert one["refused_m"][-1] == 1.0
    assert np.isfinite(one["x_m"]).all()
    assert all_of_them["refused_m"][-1] == count - 62
    t = all_of_them["t"]
    silent = (t > 2.05 + 0.1) & (t < 4.0)
    assert np.abs(all_of_them["f_policy_m"][silent]).max() == 0.0
    assert {*all_of_them["policy_m"][silent]} == {Standing.LATE}


@pytest.mark.parametrize("law", ["pp", "wave", "two_layer"])
def test_an_outage_of_the_link_pauses_the_policy_and_it_goes_on_from_where_the_handle_is(law: str) -> None:
    base = load_scene("handover", law=law, takes=(0.6, 4.2))
    trace = run(replace(base, link=parse_link("delay(0.02) | blackout(1.5, 1.0)"))).trace
    t, share = trace["t"], trace["authority_m"]
    assert {*trace["policy_m"][(t > 1.8) & (t < 2.5)]} == {Standing.PAUSED}
    assert np.abs(trace["f_policy_m"][(t > 1.85) & (t < 2.5)]).max() == 0.0
    assert {*trace["policy_m"][(t > 3.0) & (t < 4.1)]} == {Standing.POLICY}
    rises = np.flatnonzero((share[1:] > 0.0) & (share[:-1] == 0.0))
    assert len(rises) == 2
    assert np.abs(trace["f_policy_m"][rises + 1]).max() < JUMP
    assert np.abs(np.diff(trace["f_policy_m"])).max() < 0.04  # f_max of both ramps of 50 ms at once


def test_three_axes_have_one_authority_and_one_tank() -> None:
    base = load_scene("canonical", law="wave", energy=True, duration=3.0)
    scene = replace(base, axes=3, units=("rad",) * 3, environment=(Wall(k=300.0, d=1.0, at=0.05), None, None),
                    hand=Grip(mass=0.05, k=0.5, d=0.1, reference=Rest()), handover=Handover(
                        policy=Reach(to=(0.1, -0.2, 0.15), start=0.5, duration=1.0), takes=((1.0, 2.0),),
                        f_max=(1.0, 2.0, 0.5), energy=0.02, power=0.05))
    trace = run(scene).trace
    f_p, dx = trace["f_policy_m"], np.diff(trace["x_m"], axis=0)
    assert trace["policy_m"].shape == trace["E_tank_m"].shape == (3000,)
    assert (np.abs(f_p).max(axis=0) <= (1.0, 2.0, 0.5)).all()
    assert np.abs(f_p).max(axis=0).min() > 0.05
    paid = np.cumsum(np.maximum(f_p[:-1] * dx, 0.0).sum(axis=1))
    np.testing.assert_allclose(trace["E_policy_m"][1:], paid, atol=1e-12)
    assert np.abs(np.diff(f_p, axis=0)).max() < 0.025


@pytest.mark.parametrize("law", ["pp", "wave"])
def test_without_a_motor_the_policy_moves_the_laws_end_and_leaves_an_offset(law: str) -> None:
    base = load_scene("handover", law=law)
    scene = replace(base, handover=replace(base.handover, motor=False))
    result = run(scene)
    trace = result.trace
    t, away = trace["t"], trace["offset_policy_m"]
    assert np.abs(trace["f_m"][(t > 1.3) & (t < 2.9)]).max() == 0.0  # nothing of it is on the handle
    assert max(jump(trace, 1.0, 1.5), jump(trace, 2.9, 3.4)) < JUMP
    assert trace["x_s"][2900] > 0.55  # pressed into the spring by what the policy put in
    assert 0.0 < trace["E_policy_m"][-1] <= 0.3 + 0.6 * t[-1]
    assert (away[t < 1.0] == 0.0).all()
    assert np.ptp(away[t > 3.3]) < 1e-12  # and it stays
    assert abs(away[-1]) > 0.02
    assert result.metrics["x_err_rms"] < 0.06  # of what the law was told
