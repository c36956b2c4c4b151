"""Two endpoints stepped in one process: with the simulated devices the run of virtual time, to the last bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from channel import LeftOut
from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import Deadband, DeviceError, Integral, Operator, Reading, Refused, Scene, load_scene, run
from teleop.law import find_law
from teleop.laws.direct import Direct
from teleop.live.in_process import run_stepped
from teleop.stages.watchdog import Watchdog
from tests.live.test_stepped import DIVERGING, OVERFLOW, ROUGH, SCENES, SEED, TWO_PORT, equal, in_three_axes, scene

SIMULATED: dict[str, Any] = {"m": SimulatedMaster, "s": SimulatedSlave}


def same(of: Scene) -> None:
    """It is the run of virtual time: status, figures, arrays, packets and notes."""
    ours, virtual = run_stepped(of, SIMULATED, seed=SEED), run(of, seed=SEED)
    equal(ours, virtual)
    assert (ours.mode, ours.packets, ours.notes, ours.extra) == (
        "virtual", virtual.packets, virtual.notes, {k: v for k, v in virtual.extra.items() if k != "integration"})


@pytest.mark.parametrize("name", SCENES)
def test_the_run_of_two_ends_in_one_process_is_the_virtual_run(name: str) -> None:
    same(SCENES[name])


@pytest.mark.parametrize("name", [
    name if name in ("wave", "four_channel") else pytest.param(name, marks=pytest.mark.full) for name in TWO_PORT])
def test_of_every_law_in_three_axes_over_a_rough_link_with_a_watchdog(name: str) -> None:
    from channel.link import parse_link

    same(in_three_axes(find_law(name)(), link=parse_link(ROUGH), duration=0.1,
                       watchdog=Watchdog(timeout=0.02, ramp=0.02)))


@pytest.mark.parametrize("of", [*DIVERGING.values(), OVERFLOW], ids=[*DIVERGING, "overflow"])
def test_a_run_that_diverges_does_so_at_the_same_tick_and_says_the_same(of: Scene) -> None:
    assert run(of, seed=SEED).status == "diverged"
    same(of)


def test_of_scenes_with_more_parts() -> None:
    """Over another link, of six joints, with an operator's clutch."""
    same(load_scene("jittery_wan", duration=1.0, law="tdpa"))
    same(load_scene("leader_follower", duration=0.2, law="four_channel"))
    same(scene(operator=Operator(clutch=((0.05, 0.1),), absent=((0.2, 0.25),), ramp=0.02)))


class Robot(SimulatedSlave):
    """A slave of another kind: it senses its force, and fails at a tick if it is told to."""

    scene_body = False
    fails = -1

    def __init__(self, of: Scene) -> None:
        super().__init__(of, senses=True)
        self.closed = 0
        made.append(self)

    def read(self, k: int) -> Reading:
        if k == self.fails:
            raise DeviceError("the motor is off")
        return super().read(k)

    def close(self) -> None:
        self.closed += 1


class Pushed(SimulatedMaster):
    """A master that something else moves, a recording for example, of whose force nothing is known."""

    scene_body = False
    simulated = True


class Broken(Robot):
    fails = 30


class Dead(Robot):
    fails = 0


made: list[Robot] = []


def test_what_a_robot_senses_is_what_is_recorded_and_it_is_closed_in_the_end() -> None:
    of = SCENES["wave, constant"]
    ours, virtual = run_stepped(of, {**SIMULATED, "s": Robot}, seed=SEED, named={"robot": "mine"}), run(of, seed=SEED)
    assert ours.trace["f_env"].tobytes() == virtual.trace["f_env"].tobytes()
    assert np.abs(ours.trace["f_env"]).max() > 1.0
    assert ours.extra == {"robot": "mine"}
    assert made[-1].closed == 1


class Blind(Robot):
    def __init__(self, of: Scene) -> None:
        super().__init__(of)
        self._sensor = False


def test_of_a_robot_that_senses_no_force_there_is_none_and_a_note_says_so() -> None:
    ours = run_stepped(SCENES["wave, constant"], {**SIMULATED, "s": Blind}, seed=SEED)
    assert "f_env" not in ours.trace
    assert "f_err_rms" not in ours.metrics
    assert [note for note in ours.notes if note.startswith("slave: the device has no force sensor")]


def test_a_law_that_reads_a_force_which_nothing_senses_is_refused() -> None:
    with pytest.raises(Refused, match="reads the force on the environment"):
        run_stepped(scene(law=find_law("pfra")()), {**SIMULATED, "s": Blind}, seed=SEED)


def test_a_device_that_fails_stops_the_run_and_is_closed() -> None:
    ours = run_stepped(SCENES["wave, constant"], {**SIMULATED, "s": Broken}, seed=SEED)
    assert (ours.status, ours.ticks) == ("stopped", 30)
    assert ours.sentence == "stopped at t = 0.030 s: the slave's device fails: the motor is off"
    assert made[-1].closed == 1


def test_a_device_that_cannot_be_read_at_all_is_refused_and_closed() -> None:
    with pytest.raises(Refused, match=r"the slave's device cannot be read: the motor is off; .* --robot out"):
        run_stepped(SCENES["wave, constant"], {**SIMULATED, "s": Dead}, seed=SEED)
    assert made[-1].closed == 1


def test_of_what_moves_by_itself_no_limit_cycle_is_told() -> None:
    swings = replace(SCENES["swings to its end"], duration=2.0)
    assert run(swings, seed=SEED).status == "unstable"
    ours = run_stepped(swings, {**SIMULATED, "s": Robot}, seed=SEED)
    assert ours.trace["x_s"].tobytes() == run(swings, seed=SEED).trace["x_s"].tobytes()
    assert (ours.status, ours.sentence) == ("ok", "ran to its end, 2000 ticks of 0.001 s")


class Arm(Robot):
    """One that nothing moves but its motor."""

    passive = True


def test_of_a_robot_that_nothing_else_moves_it_is_told_but_no_analysis_of_other_bodies_is_advised() -> None:
    swings = replace(SCENES["swings to its end"], duration=2.0)
    ours, virtual = run_stepped(swings, {**SIMULATED, "s": Arm}, seed=SEED), run(swings, seed=SEED)
    assert ours.status == "unstable"
    assert virtual.sentence == f"{ours.sentence}; to see what becomes of it: {virtual.sentence.rpartition(': ')[2]}"


def test_a_motion_that_grows_under_a_hand_of_which_nothing_is_known_is_no_fault() -> None:
    """What the hand's reference puts in was asked of a force that nobody had sensed."""
    of = load_scene("beating_heart", law="direct", delay=0.1)
    ours = run_stepped(of, {**SIMULATED, "m": Pushed}, seed=SEED)
    assert [note for note in run(of, seed=SEED).notes if "still grows" in note]
    assert "f_h" not in ours.trace
    assert ours.status == "ok"


def test_what_no_schedule_can_step_is_refused_in_one_sentence() -> None:
    for of, says in (
        (load_scene("virtual_wall"), "has no slave, .* leave --device and --robot out"),
        (scene(deadband=Deadband(k=0.1, keep_alive=0.01), playout=Integral()), "a deadband leaves packets out"),
        (scene(law=Direct(), left_out_s=LeftOut(0.2)), "ticks are left out by order .* leave --device and --robot out"),
    ):
        with pytest.raises(Refused, match=says):
            run_stepped(of, SIMULATED)
