"""A scale that is changed while it runs, a clutch of some axes, an arm that is aligned: energy, bounds, what moves."""

# ruff: noqa: ARG005 - an end takes what it is given, used or not

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from channel import LeftOut, parse_link
from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import Cap, Device, Encoder, Frame, MassDamper, Operator, Reading, Refused, Scene, Watchdog, load_scene, run
from teleop.laws.pp import PositionPosition
from teleop.protocol.guard import ForceGuard
from teleop.stages.scaling import check_scale
from tests.fakes import law_of
from tests.teleop.protocol.ends import met
from tests.teleop.stages.test_operator import Back, Metered, bouncing, driven, scene


class Spring(NamedTuple):
    E: float  # what the law's own force took in over the motion that it was told, J
    push: float  # that force, N


OfItsForce = law_of(  # as `Metered`, by the force that it answered and not by the one that it is told was held
    name="OfItsForce", shows=("E",), master=lambda self, s, at, rx: (
        self.K * (at.x - rx.x) + self.B * at.v, Back(at.x),
        Spring(s.E + s.push * at.dx, self.K * (at.x - rx.x) + self.B * at.v)),
    master_start=lambda self, at: (Spring(0.0, 0.0), Back(at.x)),
    slave_start=lambda self, at: ((), Back(at.x)),
    slave=lambda self, s, at, rx: (self.K * (rx.x - at.x) - self.B * at.v, Back(at.x), ()))
OUTAGE = "delay(0.01) | uniform(0.005) | blackout(0.7, 0.4)"


def toggles(seed: int, count: int = 64) -> tuple[tuple[float, float], ...]:
    """A scale that is set anew at random times, between 1/10 and 10."""
    dice = np.random.default_rng(seed)
    times = np.unique(np.round(2.0 * dice.random(count), 3))
    return tuple([(float(at), float(10.0 ** dice.uniform(-1.0, 1.0))) for at in times])


EACH_TICK = tuple([(0.4 + 0.001 * n, (0.1, 10.0)[n % 2]) for n in range(64)])


# Energy


@pytest.mark.parametrize("scales", [EACH_TICK, pytest.param(toggles(1), marks=pytest.mark.full)],
                         ids=["each tick", "random"])
@pytest.mark.parametrize("parts", [
    {}, {"cap": Cap(f_max=2.0, slew=50.0)}, {"device_m": Device(delay=7, every=3)},
    {"watchdog": Watchdog(timeout=0.004, ramp=0.02, settle=0.01)}, {"left_out_m": LeftOut(0.2)},
    {"link": parse_link(OUTAGE), "axes": 3},
], ids=["bare", "cap and slew", "late and slow force", "watchdog", "ticks left out", "three axes and an outage"])
def test_the_work_at_the_device_is_that_at_the_laws_port_however_the_scale_is_toggled(
        scales: Any, parts: dict[str, Any]) -> None:
    for ramp in (0.001, 0.2):
        trace = run(scene(Operator(clutch=bouncing(1), ramp=0.03, scales=scales, scale_ramp=ramp), **parts)).trace
        device, law = trace["E_port_m"], trace["E_m"].reshape(len(trace["t"]), -1).sum(axis=1)
        size = 1e-13 * np.abs(device).max()  # of a run that a late force at ten times the scale has diverge
        assert len(np.unique(trace["scale_m"])) > 5
        assert np.ptp(device) > 1e-3, "there was work"
        assert np.abs(np.diff(device) - np.diff(law)).max() <= 1e-14 + size
        assert np.abs(device - law).max() <= 1e-12 + 10.0 * size


def test_the_motion_of_a_tick_has_the_scale_that_its_force_was_held_with() -> None:
    """So the law's own force does the work of the device's, tick by tick, in three axes with a clutch that bounces."""
    each_tick = tuple([(0.01 + 0.001 * n, (0.5, 2.0)[n % 2]) for n in range(64)])
    of = scene(Operator(clutch=bouncing(1), ramp=0.03, scales=each_tick, scale_ramp=0.001),
               OfItsForce(K=100.0, B=0.5), axes=3, hand=None, environment=None, start_m=(0.05, -0.02, 0.03))
    trace = run(of).trace
    assert np.ptp(trace["E_port_m"]) > 1e-3
    assert trace["E_m"].sum(axis=1) == pytest.approx(trace["E_port_m"], abs=1e-12)


@pytest.mark.parametrize("law", ["wave", *[pytest.param(law, marks=pytest.mark.full)
                                            for law in ("wave_filter", "two_layer", "pspm")]])
def test_no_toggling_of_the_scale_makes_energy_of_a_law_that_makes_none(law: str) -> None:
    """A search over seeds: each tick or at random, with an outage in the middle, a clutch that bounces, three axes.

    What the hold of a damper's force over a tick makes (see teleop.law) grows with the square of the scale, so the
    ledger is held against that of the greatest scale, which stays.
    """
    of = replace(load_scene("recorded_reach", law=law, duration=2.0, energy=True), link=parse_link(OUTAGE))

    def least(seed: int, operator: Operator) -> float:
        trace = run(replace(of, operator=operator), seed=seed).trace
        assert "E_link" not in trace or trace["E_link"].min() >= -1e-12
        return float(trace["E_port"].min())

    for seed in range(3):
        stays = least(seed, Operator(scales=((0.0, 10.0),)))
        for scales in (EACH_TICK, toggles(10 + seed)):
            for spans in ((), bouncing(seed, 4)):
                assert least(seed, Operator(clutch=spans, ramp=0.01, scales=scales, scale_ramp=0.01)) >= (
                    1.02 * stays - 1e-4), (seed, spans, scales[:2])


# What the scale does


def test_a_scale_of_two_makes_the_slave_go_twice_as_far_with_twice_the_force_felt_and_turn_no_further() -> None:
    of = load_scene("soft_tissue", law=PositionPosition(K=200.0, B=5.0), duration=8.0, delay=0.001, energy=True)
    plain, scaled = run(of).trace, run(replace(of, operator=Operator(scales=((0.0, 2.0),)))).trace
    assert scaled["scale_m"][-1] == 2.0
    late = slice(-200, None)
    for trace, s in ((plain, 1.0), (scaled, 2.0)):
        x_law = trace["x_m"][late] - trace.get("offset_m", np.zeros(len(trace["t"])))[late]
        assert x_law == pytest.approx(s * trace["x_m"][late], rel=1e-9)
    ratio = scaled["f_m"] / np.where(scaled["f_s"] == 0.0, np.nan, scaled["f_s"])
    assert np.nanmedian(ratio[late]) == pytest.approx(2.0, rel=0.05)
    of = load_scene("pose", law="pp", duration=1.5)
    trace = run(replace(of, operator=Operator(scales=((0.0, 0.5),)))).trace
    assert np.abs(trace["offset_m"][:, 3:]).max() == 0.0
    assert np.abs(trace["offset_m"][-1, :2]).max() > 0.01


def test_the_scale_is_ramped_and_neither_position_nor_force_jumps() -> None:
    trace = run(scene(Operator(scales=((0.5, 4.0),), scale_ramp=0.1), Metered(K=300.0, B=20.0))).trace
    steps = np.diff(np.log2(trace["scale_m"]))
    assert steps.max() == pytest.approx(0.001 / 0.1, rel=1e-9)
    assert trace["scale_m"][498] == 1.0
    assert trace["scale_m"][-1] == 4.0
    moved = np.abs(np.diff(trace["x_told_m"]))
    assert (moved <= 4.0 * np.abs(np.diff(trace["x_m"])) + 1e-12).all()
    at_once = run(scene(Operator(scales=((0.5, 4.0),), scale_ramp=1e-3), Metered(K=300.0, B=20.0))).trace
    jump = [np.abs(np.diff(each["f_m"][498:520])).max() for each in (trace, at_once)]
    assert jump[0] < 0.2 * jump[1]


# A clutch of some axes


def test_a_clutch_of_the_rotation_lets_the_wrist_turn_alone_and_counts_it_anew() -> None:
    of = load_scene("pose", law="pp", duration=4.0, energy=True)
    opened = replace(of, operator=Operator(clutch_rotation=((1.8, 2.6),), ramp=0.02))
    trace = run(opened).trace
    still = slice(1830, 2600)
    assert set(trace["clutch_m"].tolist()) == {0.0, 3.0}
    assert (trace["g_turn_m"][still] == 0.0).all()
    assert (trace["g_clutch_m"] == 1.0).all()
    assert not trace["f_m"][still, 3:].any()
    assert np.abs(trace["f_m"][still, :3]).max() > 0.1
    assert np.ptp(trace["x_m"][still, 3:], axis=0).max() > 0.5, "the hand turns on"
    assert np.ptp(trace["x_s"][2200:2600, 3:], axis=0).max() < 0.02, "the tool does not"
    assert np.abs(trace["offset_m"][-1, 3:]).max() > 0.5
    assert np.abs(trace["offset_m"][-1, :3]).max() == 0.0
    moved = run(replace(of, operator=Operator(clutch_translation=((0.5, 1.0),)))).trace
    assert np.abs(moved["offset_m"][-1, :2]).max() > 0.01
    assert np.abs(moved["offset_m"][-1, 3:]).max() == 0.0


def test_clutches_of_parts_and_a_scale_that_bounce_at_random_make_no_energy() -> None:
    of = load_scene("pose", law=Metered(K=10.0, B=0.2), duration=2.0, energy=True, observer=None)
    for seed in range(3):
        trace = run(replace(of, operator=Operator(
            clutch=bouncing(seed, 5), clutch_rotation=bouncing(20 + seed), clutch_translation=bouncing(40 + seed),
            absent=bouncing(60 + seed, 3), ramp=0.02, scales=toggles(seed), scale_ramp=0.01))).trace
        assert {0.0, 1.0, 2.0, 3.0} == set(trace["clutch_m"].tolist())
        assert np.abs(np.diff(trace["E_port_m"]) - np.diff(trace["E_m"].sum(axis=1))).max() <= 1e-14


# An arm that is aligned

POSE = (0.03, -0.02, 0.01, 0.3, -0.2, 0.5)
SPEEDS = (0.05, 0.05, 0.05, 0.4, 0.4, 0.4)


def apart(operator: Operator, law: Any = None, **parts: Any) -> Scene:
    """A tool that stands elsewhere than the handle, which nobody moves."""
    of = load_scene("pose", law=law or "pp", duration=3.0, energy=True, delay=0.02)
    return replace(of, start_s=POSE, hand=None, environment=None, operator=operator, **parts)


def test_an_arm_is_brought_to_the_handle_slowly_before_the_force_is_on_and_the_clutch_closes() -> None:
    trace = run(apart(Operator(align=SPEEDS, clutch=((0.0, 0.2),)))).trace
    closes = int(np.argmax((trace["g_clutch_m"] > 0.0) & (trace["g_turn_m"] > 0.0)))
    assert trace["x_s"][:210] == pytest.approx(np.tile(POSE, (210, 1)), abs=1e-5), "while the clutch is open it stands"
    assert not trace["f_m"][:, 3:][:closes - 1].any()
    assert np.abs(trace["v_s"][:closes]).max(axis=0)[:3].max() < 2.0 * 0.05
    assert np.abs(trace["v_s"][:closes]).max(axis=0)[3:].max() < 2.0 * 0.4
    assert np.linalg.norm(trace["way_m"][closes, 3:]) < 0.02
    slowest = np.linalg.norm(POSE[3:]) / 0.4
    assert 0.2 + 0.9 * slowest < 0.001 * closes < 0.2 + 1.1 * slowest
    assert np.abs(trace["x_s"][closes, :3]).max() < 5e-3
    assert trace["E_align_m"][closes] > 1e-3, "which somebody puts in"


def test_the_wrist_is_realigned_on_closing_by_the_least_turn_while_the_translation_counts_anew() -> None:
    of = load_scene("pose", law="pp", duration=6.5, turns=1.0)
    speeds = (0.0, 0.0, 0.0, 2.0, 2.0, 2.0)
    trace = run(replace(of, environment=None, operator=Operator(
        clutch=((0.6, 1.1),), clutch_rotation=((2.0, 3.0),), align=speeds))).trace
    closed = int(np.flatnonzero(np.diff(trace["g_turn_m"]) > 0.0)[-1])
    hand = np.array([trace[f"q{part}_m"][closed] for part in "wxyz"])
    assert np.linalg.norm(trace["way_m"][closed, 3:]) <= 2.0 * 0.02 + 0.01
    assert np.linalg.norm(trace["way_m"][3000, 3:]) > 1.0
    assert np.abs(trace["offset_m"][-1, :2]).max() > 5e-3, "this is not brought back"
    assert np.linalg.norm(hand) == pytest.approx(1.0)


def test_what_an_alignment_puts_in_is_what_the_laws_port_takes_beyond_the_device() -> None:
    of = apart(Operator(align=SPEEDS, clutch=((0.0, 0.2), (0.5, 0.6))), Metered(K=100.0, B=2.0), observer=None)
    trace = run(of).trace
    held = np.vstack([np.zeros(6), trace["f_m"][:-1]])
    device = np.cumsum((held * np.diff(trace["x_m"], axis=0, prepend=trace["x_m"][:1])).sum(axis=1))
    assert trace["E_align_m"][-1] > 1e-3
    assert trace["E_port_m"] == pytest.approx(trace["E_m"].sum(axis=1), abs=1e-12)
    assert trace["E_port_m"] - trace["E_align_m"] == pytest.approx(device, abs=1e-12)


@pytest.mark.parametrize("law", ["wave_position", pytest.param("two_layer", marks=pytest.mark.full)])
def test_an_alignment_that_is_stopped_and_begun_again_through_an_outage_leaves_the_ledgers_of_a_passive_law(
        law: str) -> None:
    for seed in range(3):
        of = apart(Operator(align=SPEEDS, clutch=bouncing(seed, 10), clutch_rotation=bouncing(9 + seed, 5), ramp=0.01),
                   law, link=parse_link("delay(0.01) | uniform(0.005) | blackout(0.7, 0.4)"))
        trace = run(of, seed=seed).trace
        assert "E_link" not in trace or trace["E_link"].min() >= -1e-12
        assert trace["E_port"].min() >= -1e-4


def test_an_alignment_stops_where_it_is_when_the_operator_lets_go() -> None:
    trace = run(apart(Operator(align=SPEEDS, clutch=((0.0, 0.2), (0.4, 3.0))))).trace
    assert np.ptp(trace["way_m"][420:], axis=0).max() == 0.0
    assert np.ptp(trace["x_s"][1500:], axis=0).max() < 1e-4
    assert not trace["f_m"].any()
    absent = run(apart(Operator(align=SPEEDS, clutch=((0.0, 0.2),), absent=((0.4, 3.0),)))).trace
    assert np.array_equal(absent["x_s"], trace["x_s"])


def test_an_arm_that_cannot_follow_is_waited_for_and_a_way_that_is_too_long_is_not_begun() -> None:
    held = MassDamper(mass=0.5, damping=1e6)
    of = apart(Operator(align=SPEEDS), PositionPosition(K=100.0, B=2.0), slave=held)
    trace = run(of).trace
    assert np.abs(trace["f_s"][:, :3]).max() <= 100.0 * (0.5 * 0.05) + 100.0 * 0.05 * 0.03 + 0.2
    assert not trace["f_m"].any()
    assert (trace["g_clutch_m"] == 0.0).all()
    trace = run(apart(Operator(align=SPEEDS, align_most=(0.1, 0.1, 0.1, 0.2, 0.2, 0.2)))).trace
    assert (trace["g_turn_m"] == 0.0).all()
    assert np.ptp(trace["x_s"][:, 3:], axis=0).max() < 1e-9
    assert (trace["g_clutch_m"][-100:] == 1.0).all(), "the translation is within its own"


def test_a_turned_base_aligns_the_arm_in_the_directions_of_the_handle() -> None:
    frame = Frame(rotation=(0.0, 0.0, np.pi / 2.0), scale=0.5)
    trace = run(apart(Operator(align=SPEEDS), frame=frame)).trace
    assert trace["way_m"][0, :3] == pytest.approx([0.04, 0.06, -0.02], abs=1e-3)
    closes = int(np.argmax(trace["g_clutch_m"] > 0.0))
    assert np.abs(trace["x_s"][closes, :3]).max() < 5e-3


# Live


class WithSwitch(SimulatedMaster):
    """A master whose clutch of the rotation is open for a time."""

    def read(self, k: int) -> Reading:
        return super().read(k)._replace(clutch="rotation" if 100 <= k < 300 else False)


def test_a_devices_clutch_of_the_rotation_and_an_order_do_what_schedules_do_to_the_bit() -> None:
    plan = Operator(clutch_rotation=((0.1, 0.3),), scales=((0.2, 0.5),), ramp=0.02)
    of = replace(load_scene("pose", law="pp", duration=0.6), link=None, operator=Operator(ramp=0.02))
    got, events = driven(of, WithSwitch(of), act=lambda k, ends: k == 200 and ends["m"].set_scale(k, 0.5))
    assert got["f_m"].tobytes() == run(replace(of, operator=plan)).trace["f_m"].tobytes()
    told = [why for _, what, why, _ in events if what in ("clutch", "scale")]
    assert [each[:31] for each in told] == [
        "the operator holds the clutch o", "the scale is set to 0.5: a metr", "the clutch is closed: positions"]


@pytest.mark.parametrize("device", [None, (Device(encoder=Encoder(step=1e-6)),) * 6], ids=["read", "encoders"])
def test_a_live_master_is_silent_until_it_knows_where_the_arm_stands_and_then_brings_it(device: Any) -> None:
    """The arm is not where the scene has it: positions are the devices' own, and the first message tells where."""
    of = replace(load_scene("pose", law="pp", duration=0.8), link=None, hand=None, environment=None,
                 operator=Operator(align=SPEEDS), device_s=device)
    got, events = driven(of, SimulatedMaster(of), SimulatedSlave(replace(of, start_s=POSE)))
    k = int(np.flatnonzero(got["f_m"].any(axis=1))[0])
    assert 0.5 < 0.001 * k < 0.7, "the translation closes first, after 0.6 s"
    assert got["x_s"][0] == pytest.approx(POSE)
    assert np.abs(np.diff(got["x_s"][:k + 1], axis=0)).max(axis=0)[:3].max() < 2.5 * 0.05 * 1e-3
    assert np.abs(got["x_s"][k, :3]).max() < 5e-3
    assert any("is brought to the handle" in why for _, _, why, _ in events)


def test_events_say_that_a_way_is_too_long_and_that_an_arm_does_not_follow() -> None:
    far = replace(apart(Operator(align=SPEEDS, align_most=0.2), duration=0.3), link=None)
    told = [why for _, what, why, _ in driven(far, SimulatedMaster(far))[1] if what == "clutch"]
    assert any("align_most is 0.2 rad" in why for why in told), told
    held = replace(apart(Operator(align=SPEEDS), slave=MassDamper(mass=0.5, damping=1e6), duration=1.5), link=None)
    told = [why for _, what, why, _ in driven(held, SimulatedMaster(held))[1] if what == "clutch"]
    assert any("the alignment waits for the arm" in why for why in told), told


@pytest.mark.parametrize("wrong", [0.0, -1.0, 1e-3, 1e3, float("nan"), float("inf")])
def test_a_scale_that_is_none_is_refused_and_the_last_one_stays(wrong: float) -> None:
    end = met(scene(Operator()))["m"]
    end.set_scale(1, 2.0)
    with pytest.raises(Refused, match="scale"):
        end.set_scale(2, wrong)
    assert end.scale == 2.0
    assert check_scale(3) == 3.0
    assert isinstance(end.guard, ForceGuard)
