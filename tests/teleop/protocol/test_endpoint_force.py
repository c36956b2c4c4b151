"""The force of a live end: watchdog and cap; without a reading, and at the end of a run, it falls and never jumps."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop import Cap, Direct, Fixed, Watchdog, Zero, load_scene
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.guard import Event
from teleop.protocol.states import Cause
from teleop.stages.force_cap import LONGEST
from tests.teleop.protocol.ends import MS, START, Both, met, reading, scene


def blind_in(end: Endpoint, ticks: int) -> list[float]:
    """The forces of an end with 2 N held whose device cannot be read from tick 30 on."""
    held = [end.tick(k, START + k * MS, reading(-0.01 if k else 0.0)).force[0] for k in range(30)]
    assert held[-1] == 2.0
    return [2.0, *[end.left_out(k, "the device: it is gone")[0] for k in range(30, 30 + ticks)]]


def test_a_single_reading_that_fails_makes_the_force_jump_neither_down_nor_back() -> None:
    """It was at zero in one tick, 20 times what the slew limit allows."""
    end = met(scene(Direct(K=200.0, B=0.0), cap=Cap(f_max=5.0, slew=100.0)))["s"]
    force = blind_in(end, 1)
    force += [end.tick(k, START + k * MS, reading(-0.01)).force[0] for k in range(31, 200)]
    assert np.abs(np.diff(force)).max() <= 0.1 + 1e-12
    assert force[1] < force[0], "on its way down"
    assert min(force) == 0.0
    assert end.guard.safe
    assert "it is gone" in end.guard.events[0].why


def test_without_a_reading_the_force_falls_along_the_ramp_and_there_is_none_after_a_tenth_of_a_second() -> None:
    """Whatever ramp and slew ask, and of a stepped end without a watchdog too. The guard counts such a tick as any."""
    quick, slow = (met(scene(Direct(K=200.0, B=0.0), watchdog=Watchdog(ramp=ramp)))["s"] for ramp in (0.02, 10.0))
    other = met(scene(Direct(K=200.0, B=0.0), cap=Cap(f_max=5.0, slew=1.0)))["s"]
    other.tick(29, START + 29 * MS, reading(0.0))
    other.held.force = (2.0,)
    assert blind_in(quick, 21) == pytest.approx([*np.linspace(2.0, 0.0, 21), 0.0])
    assert quick.guard.gain == 0.0
    assert quick.guard.events == [Event(30, "safe", "the device: it is gone", Cause.DEVICE)]
    for force in (blind_in(slow, 110), [2.0, *[other.left_out(k, "gone")[0] for k in range(30, 140)]]):
        assert force[100] > 1.8
        assert force[102:] == [0.0] * 9
    stepped = met(scene(Direct(K=200.0, B=0.0)), is_stepped=True)["s"]
    stepped.tick(0, START, reading(-0.01))
    stepped.held.force = (2.0,)
    assert [stepped.left_out(k, "gone")[0] for k in range(1, 60)][49:] == [0.0] * 10


@given(st.floats(-20.0, 20.0), st.floats(-1.0, 1.0), st.sampled_from("ms"), st.floats(0.0, 0.2),
       st.sampled_from([None, 50.0, 1000.0]), st.sampled_from([None, 0.2]))
@settings(max_examples=80)
def test_the_force_of_a_run_that_is_over_falls_to_zero_and_never_turns_or_jumps(
    f: float, v: float, e: str, ramp: float, slew: float | None, v_max: float | None
) -> None:
    named = scene(watchdog=Watchdog(ramp=ramp), cap=Cap(f_max=20.0, slew=slew, v_max=v_max))
    end = met(named)[e]
    end.held.force = (f,)
    force = [f, *[end.held.over((v,))[0] for _ in range(round(1e3 * max(ramp, 20.0 / (slew or 1e9))) + 2)]]
    assert force[-1] == 0.0
    amount = np.abs(force)
    assert (np.diff(amount) <= 0.0).all()
    assert (np.array(force) * np.sign(f) >= 0.0).all()
    if slew is not None:
        assert np.abs(np.diff(force)).max() <= slew * 1e-3 + 1e-9
    drives = f * (v if e == "s" else -v) > 0.0
    if v_max is not None and drives and abs(v) >= v_max and slew is None:
        assert force[1] == 0.0, "the velocity cap holds to the end"
    elif slew is None and not (v_max is not None and drives) and ramp > 0.0:
        assert amount[1] == pytest.approx(amount[0] * max(0.0, 1.0 - 1e-3 / ramp), abs=1e-9)


def test_a_force_that_is_not_finite_is_not_the_one_from_which_the_held_one_falls() -> None:
    """It is if its parts are, whatever their sum is."""
    end = met(scene(Direct(K=200.0, B=0.0), cap=Cap(f_max=5.0, slew=100.0)))["s"]
    blind_in(end, 0)
    end.tick(30, START + 30 * MS, reading(nan))
    assert end.force_failed == "f_s"
    assert end.held.force == (2.0,)
    assert end.held.over(None)[0] == pytest.approx(1.96)
    held = met(scene(Direct(K=200.0, B=0.0)))["s"].held
    assert held.take(0, (1.7e308, 1.7e308))
    assert not held.take(1, (1.0, nan))
    assert not held.take(2, (inf, -inf))
    assert held.force == (1.7e308, 1.7e308)


def test_after_a_stall_on_its_way_the_force_is_where_the_ramp_has_come_to_or_at_zero_if_the_device_let_go() -> None:
    for stall, deadline, left in ((5, 0.15, 0.88), (40, 0.15, 0.18), (200, 0.5, 0.0), (40, 0.03, 0.0)):
        end = met(scene())["s"]
        end.guard.lapse_after(deadline)
        end.held.force = (2.0,)
        end.held.over(None)
        assert end.held.over(None, stall)[0] == pytest.approx(2.0 * left)


@pytest.mark.parametrize("held", [15.5, 6062.0])
def test_a_small_slew_limit_holds_no_force_for_more_than_a_second_after_the_ramp_of_a_silent_peer(held: float) -> None:
    """15.5 N at 5 N/s were held for 2.9 s after the peer had died, in the safe state as at the end of a run."""
    ramp, dog = 0.05, Watchdog(timeout=0.1, ramp=0.05)
    silent, over = (met(scene(Direct(K=0.0, B=0.0), watchdog=dog, cap=Cap(f_max=1e4, slew=5.0)))["s"] for _ in range(2))
    for end in (silent, over):
        end.tick(0, START, reading(0.0))
        end.held.force = (held,)
    most = round((ramp + LONGEST) / 1e-3) + 2
    first = [each.why for each in silent.guard.events]
    force = [silent.tick(k, START + k * MS, reading(0.0)).force[0] for k in range(1, 110 + most)]
    assert first == []
    assert min(force[:1000]) > held - 5.01
    assert force[-10:] == [0.0] * 10
    steps = np.abs(np.diff([held, *force]))
    assert np.count_nonzero(steps > 5e-3 + 1e-9) == 1, "one step"
    assert [event.what for event in silent.guard.events] == ["safe", "zero"]
    assert f"{steps.max():.3g} N set to zero in one step" in silent.guard.events[1].why

    ticks = 0
    while not over.guard.overdue:
        assert over.held.over((0.0,))[0] > 0.0
        ticks += 1
    assert ticks <= most


@pytest.mark.parametrize(("playout", "played"), [(Zero(), 0.0), (Fixed(0.5), 0.5), (Fixed(2.0), 2.0)])
def test_a_session_is_renewed_only_after_the_watchdog_has_let_go(playout: Any, played: float) -> None:
    """With a fixed playout the last messages act for that long: a new session would have cut their force off."""
    dog = Watchdog(timeout=0.4, ramp=0.3)
    end = met(scene(playout=playout, watchdog=dog))["s"]
    assert end.session.liveness.renew_ns >= (played + dog.timeout + dog.ramp) * 1e9
    assert end.session.liveness.renew_ns <= max(1.0, played + dog.timeout + dog.ramp + 0.1) * 1e9


@pytest.mark.parametrize("seen", [True, False])
def test_a_device_that_is_not_where_the_scene_begins_is_taken_up_where_it_is_and_from_zero_force(seen: bool) -> None:
    """As after both ends were started anew: 15 cm apart and a stiff coupling.

    `seen`: before tick 0. If nobody could read it then, where it is at the first tick counts.
    """
    stiff = scene(Direct(K=500.0, B=5.0), duration=0.5, link=None)
    ends, force = met(stiff), []
    if seen:
        ends["m"].place((0.15,))
        ends["s"].place((0.0,))
    else:
        ends["m"].left_out(-1, "the device: its bus is not up yet")
    for k in range(400):
        now = START + k * MS
        forth = ends["m"].tick(k, now, reading(0.15)).datagram
        out = ends["s"].tick(k, now, reading(0.0 if k < 200 else -0.002))
        assert forth is not None
        assert out.datagram is not None
        ends["s"].receive(forth, now + 1)
        ends["m"].receive(out.datagram, now + 1)
        force.append(out.force[0])
        assert out.row[0] == (0.0 if k < 200 else -0.002), "the record is of the device"
    assert max(map(abs, force[:200])) < 1e-9
    assert force[-1] == pytest.approx(1.0)
    assert [event.what for event in ends["m"].guard.events][-1] == "released"
    assert {event.what for event in ends["m"].guard.events} == {"session", "safe", "released"}
    assert ends["s"].guard.events == []


# A slave that may hold no force: its waves are those of the force that it holds, not of the one that its law asks

FROM, UNTIL = 2200, 3400  # ticks at which the slave's device is in trouble


@pytest.mark.parametrize("playout", ["zero", "integral"])
def test_a_hand_feels_no_wall_of_a_slave_that_has_let_go_of_it_and_feels_it_again_by_no_jump(playout: str) -> None:
    """Up to 16.6 N came back from a slave without force, and 0.58 J: its law sent what it would have pressed with."""
    again = playout == "zero"
    of = load_scene("hard_wall", playout=playout, duration=4.6 if again else 3.4, link="delay(0.02) ; delay(0.02)")
    stuck = Both(of, trouble=lambda e, k: "the device: it is stuck" if e == "s" and FROM <= k < UNTIL else None)
    trace = stuck.run().trace()
    assert trace["f_m"][FROM] > 3.0
    assert (trace["f_s"][UNTIL - 400:UNTIL] == 0.0).all()
    assert abs(trace["f_m"][UNTIL - 200:UNTIL]).max() < 0.3
    assert trace["E_port"][:UNTIL].min() > -1e-3
    assert trace["E_link"][:UNTIL].min() > -1e-9
    if again:
        calm = Both(of).run().trace()
        assert trace["f_m"][-1] == pytest.approx(calm["f_m"][-1], abs=0.2)
        assert np.abs(np.diff(trace["f_s"][FROM:])).max() < 2.0
