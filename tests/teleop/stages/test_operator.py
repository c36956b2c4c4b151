"""The operator's clutch and the operator-present switch: lossless at any switching, nothing jumps, positions anew."""

# ruff: noqa: ARG005 - an end takes what it is given, used or not

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from channel import LeftOut
from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import At, Cap, Device, MassDamper, Operator, Reading, Refused, Scene, Watchdog, kind, load_scene, run
from teleop.analysis.models.linear import linear_scene
from teleop.laws.four_channel import FourChannel
from teleop.laws.pp import PositionPosition
from teleop.protocol.guard import Event, ForceGuard
from teleop.protocol.switches import MOST, SwitchEvents
from teleop.simulation.prepared import prepare
from teleop.simulation.trace import EndRecord, end_columns
from teleop.stages.operator import scheduled
from tests.fakes import law_of
from tests.teleop.protocol.ends import MS, START, met


class Back(NamedTuple):
    x: kind.Position


class Port(NamedTuple):
    E: float  # what the law's port took in, J
    x_told: float  # where the law is told to be, m
    v_told: float
    f_told: float  # the hand's force, N
    dx_told: float
    held_told: float = 0.0  # the force that was held, N


def metered(self: Any, s: Port, at: At, rx: Back) -> tuple[float, Back, Port]:
    told = Port(s.E + at.f_held * at.dx, at.x, at.v, at.f, at.dx, at.f_held)
    return self.K * (at.x - rx.x) + self.B * at.v, Back(at.x), told


Metered = law_of(  # a spring and a damper between the ends, with the ledger of its own port; it shows what it is told
    name="Metered", shows=("E", "x_told", "v_told", "f_told", "dx_told", "held_told"), master=metered,
    master_start=lambda self, at: (Port(0.0, at.x, 0.0, 0.0, 0.0), Back(at.x)),
    slave_start=lambda self, at: ((), Back(at.x)),
    slave=lambda self, s, at, rx: (self.K * (rx.x - at.x) - self.B * at.v, Back(at.x), ()))


def bouncing(seed: int, spans: int = 30) -> tuple[tuple[float, float], ...]:
    """A switch that is opened so many times in two seconds, at random."""
    times = sorted(2.0 * one for one in np.random.default_rng(seed).random(2 * spans).tolist())
    return tuple(zip(times[::2], times[1::2], strict=True))


def scene(operator: Operator | None, law: Any = None, **parts: Any) -> Scene:
    """A hand that swings a master by 5 cm, and a slave before a wall."""
    of = load_scene("canonical", law=law or Metered(K=300.0, B=20.0), duration=2.0, delay=0.005)
    return replace(of, **{"operator": operator, "energy": True, "observer": None, **parts})


OPENED = Operator(clutch=((0.5, 1.0),), ramp=0.05)


# Energy


@pytest.mark.parametrize("parts", [
    {}, {"cap": Cap(f_max=2.0, slew=50.0)},  # so slow that force is left when the modulus has come to 0
    {"device_m": Device(delay=7, every=3)}, {"watchdog": Watchdog(timeout=0.004, ramp=0.02, settle=0.01)},
    {"left_out_m": LeftOut(0.2)},
], ids=["bare", "cap and slew", "late and slow force", "watchdog", "ticks left out"])
def test_the_work_at_the_device_is_that_at_the_laws_port_whatever_the_switches_do(parts: dict[str, Any]) -> None:
    trace = run(scene(Operator(clutch=bouncing(1), absent=bouncing(2, 10), ramp=0.03), **parts)).trace
    device, law = trace["E_port_m"], trace["E_m"]
    assert ((trace["g_clutch_m"] > 0.0) & (trace["g_clutch_m"] < 1.0)).sum() > 200
    assert np.ptp(device) > 1e-3, "there was work"
    assert np.abs(np.diff(device) - np.diff(law)).max() <= 1e-16
    assert np.abs(device - law).max() <= 1e-14


# What the law is told, and what the device holds


def test_while_it_is_open_there_is_no_force_and_the_law_is_told_of_no_motion() -> None:
    trace = run(scene(OPENED)).trace
    still = slice(552, 1000)  # the ramp is over from tick 550 on, and the motion before a tick is that of the last
    assert trace["clutch_m"].tolist() == [0.0] * 500 + [1.0] * 500 + [0.0] * 1000
    for name in ("f_m", "v_told_m", "f_told_m", "dx_told_m"):
        assert not np.any(trace[name][still]), name
    assert np.ptp(trace["x_told_m"][still]) == 0.0
    assert np.ptp(trace["x_m"][still]) > 0.02, "the hand goes on"
    assert np.abs(trace["f_h"][still]).max() > 0.1, "and what it does is not fed forward"
    assert np.ptp(trace["x_s"][900:1000]) < 1e-5, "the slave holds"


def test_on_closing_positions_count_anew_and_the_force_fades_in() -> None:
    opened = run(scene(OPENED))
    trace = opened.trace
    told, f = trace["x_told_m"], trace["f_m"]
    assert np.abs(np.diff(told)).max() <= 1.001 * np.abs(np.diff(trace["x_m"])).max(), "the law's position never jumps"
    assert np.abs(trace["offset_m"][-1]) > 0.005
    assert np.array_equal(trace["g_clutch_m"][999:1052], [0.0, *np.arange(1, 51) / 50, 1.0, 1.0])
    assert np.abs(f[1000:1005]).max() < 0.1 * np.abs(f[1100:]).max()
    away = run(scene(None)).metrics["x_err_max"]
    assert opened.metrics["x_err_max"] < 1.2 * away, "the tracking error is of what the law was told"


def test_a_small_slew_limit_holds_no_force_for_more_than_a_second_after_the_clutch_opened() -> None:
    """The same bits live; in each engine: `tests/engines`."""
    plan, law = Operator(clutch=((2.5, 4.0),), ramp=0.05), PositionPosition(K=1000.0)
    swung = load_scene("canonical", law=law, frequency=0.1, duration=4.0)
    slow = replace(swung, operator=plan, energy=True, observer=None, link=None, playout=None,
                   cap=Cap(f_max=20.0, slew=0.2))
    trace = run(slow).trace
    size = np.abs(trace["f_m"])
    last = np.flatnonzero(size).max()
    assert 3545 < last < 2500 + 50 + 1000, "the ramp and a second"
    assert size[last] > 0.01, "which the slew limit still held"
    by_device, events = driven(slow, SimulatedMaster(slow))
    assert by_device["f_m"].tobytes() == trace["f_m"].tobytes()
    assert any(event.what == "zero" for event in events)


def test_an_absent_operator_is_an_open_clutch_and_what_is_open_at_the_start_begins_without_force() -> None:
    clutch = run(scene(Operator(clutch=((0.0, 0.2),)), start_s=0.02)).trace
    absent = run(scene(Operator(absent=((0.0, 0.2),)), start_s=0.02)).trace
    switches = ("clutch_m", "present_m")
    assert all(np.array_equal(clutch[name], absent[name]) for name in clutch if name not in switches)
    assert absent["present_m"].tolist() == (1.0 - clutch["clutch_m"]).tolist()
    assert not clutch["f_m"][:200].any()
    assert clutch["f_m"][200:].any()


def test_one_that_is_never_opened_changes_no_bit_and_the_eigenvalues_are_those_with_the_clutch_closed() -> None:
    law, of = FourChannel(), load_scene("soft_tissue", law="direct", delay=0.005)
    with_one, none = run(scene(Operator(), law)).trace, run(scene(None, law)).trace
    assert all(with_one[name].tobytes() == none[name].tobytes() for name in none)
    assert repr(linear_scene(replace(of, operator=OPENED))) == repr(linear_scene(of))


# Ends that are far apart


FAR = Operator(clutch=((0.0, 0.1),), closes_within=0.01)


def test_it_closes_once_the_slave_has_come_near_enough_and_not_before_or_where_it_is_held_back() -> None:
    """The slave begins 5 cm away, and its law draws it to where the master is told to be."""
    trace = run(scene(FAR, PositionPosition(), start_s=0.05)).trace
    closes = int(np.argmax(trace["g_clutch_m"] > 0.0))
    assert closes > 110, "it is asked to from tick 100 on"
    assert np.abs(trace["apart_m"][100:closes - 1]).min() > 0.01 >= abs(trace["apart_m"][closes - 1])
    assert not trace["f_m"][:closes].any()
    assert np.array_equal(trace["g_clutch_m"][closes:closes + 50], np.arange(1, 51) / 50), "and then it goes on closing"
    held = MassDamper(mass=0.5, damping=1e6)
    assert not run(scene(FAR, PositionPosition(), start_s=0.05, slave=held)).trace["f_m"].any()
    freely = replace(FAR, closes_within=None)
    assert run(scene(freely, PositionPosition(), start_s=0.05, slave=held)).trace["f_m"].any()


# Live


class Switched(SimulatedMaster):
    """A simulated master whose switches follow the schedule of an operator."""

    def __init__(self, of: Scene, operator: Operator) -> None:
        super().__init__(of)
        self._spans = operator.limits(of.dt)

    def read(self, k: int) -> Reading:
        clutch, absent = scheduled(self._spans.clutch, k), scheduled(self._spans.absent, k)
        return super().read(k)._replace(clutch=clutch > 0.0, present=absent == 0.0)


def driven(of: Scene, master: Any, slave: Any = None, act: Callable[[int, Any], object] = lambda k, ends: None
           ) -> tuple[dict[str, np.ndarray], list[Event]]:
    """Both records and the master's events, of two ends that are driven by hand without a link; `act` comes first."""
    ends, devices = met(of), {"m": master, "s": slave or SimulatedSlave(of)}
    rows: dict[str, list[float]] = {"m": [], "s": []}
    aligns = of.operator is not None and of.operator.align is not None
    for k in range(of.ticks):
        now = START + k * MS
        act(k, ends)
        outs = {e: ends[e].tick(k, now, devices[e].read(k)) for e in "ms"}
        for e, other in ("ms", "sm"):
            devices[e].hold(outs[e].force)
            datagram = outs[e].datagram
            assert (datagram is None) is (aligns and k == 0 and e == "m")  # silent until it knows where the arm stands
            ends[other].receive(datagram or b"", now)
            rows[e].extend(outs[e].row)
    records = [end_columns(prepare(of), e, EndRecord(range(of.ticks), rows[e], None)) for e in "sm"]
    return {name: column for record in records for name, column in record.items()}, ends["m"].guard.events


def test_the_switches_of_a_live_device_do_what_a_schedule_does_in_virtual_time_to_the_bit() -> None:
    plan = Operator(clutch=bouncing(5), absent=bouncing(6, 6), ramp=0.02)
    law = PositionPosition()
    expected = run(scene(plan, law, link=None, playout=None)).trace
    of = scene(Operator(ramp=0.02), law, link=None)
    by_device, _ = driven(of, Switched(of, plan))
    by_schedule, _ = driven(replace(of, operator=plan), SimulatedMaster(of))
    for name in ("f_m", "x_m", "clutch_m", "present_m", "g_clutch_m", "offset_m", "E_port_m"):
        assert by_device[name].tobytes() == expected[name].tobytes(), name
        assert by_schedule[name].tobytes() == expected[name].tobytes(), name


def told(of: Scene, master: Any) -> list[tuple[int, str, str]]:
    """The events of a live master's switches."""
    return [(k, what, why) for k, what, why, _ in driven(of, master)[1] if what in ("clutch", "present")]


def test_events_tell_of_the_switches_and_of_a_clutch_that_stays_open() -> None:
    plan = Operator(clutch=((0.0, 0.1),), absent=((0.6, 0.7),), closes_within=0.01)
    of = scene(plan, PositionPosition(), link=None, start_s=0.05, duration=0.8)
    (first, *_), (closed, _, _), (far, _, why), (gone, *_), (back, *_) = events = told(of, SimulatedMaster(of))
    assert [first, closed, far, gone, back] == [0, 100, 100, 600, 700]
    assert [name for _, name, _ in events] == ["clutch"] * 3 + ["present"] * 2
    assert "on axis x, and it closes within 0.01 m; free the slave" in why


def test_a_switch_that_bounces_for_hours_does_not_fill_the_record_of_events() -> None:
    guard = ForceGuard(None, 1e-3)
    events = SwitchEvents(scene(Operator()), ["clutch_m", "present_m", "g_clutch_m"])
    for k in range(0, 10**6, 3):
        events.update(k, (float(k % 2), 1.0, 1.0), guard)
    assert len(guard.events) == MOST
    assert np.diff([one.k for one in guard.events]).min() >= 100


@pytest.mark.parametrize(("e", "operator", "has", "why"), [
    ("m", Operator(needs=("present",)), ("clutch",), "needs the switch present"),
    ("m", None, ("present",), "--set clutch_ramp=0.05"), ("s", Operator(), ("clutch",), "are the master's"),
])
def test_a_device_whose_switches_do_not_go_with_the_scene_is_refused(
        e: str, operator: Operator | None, has: tuple[str, ...], why: str) -> None:
    with pytest.raises(Refused, match=why):
        met(scene(operator))[e].senses(sensor=True, switches=has)
    met(scene(Operator()))["m"].senses(sensor=True, switches=has)
