"""Joints on a bus of positions: the bits of virtual time, a bus that is lost, numbers from a routine, and live runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from master import SimulatedMaster
from slave import Wall
from teleop import DeviceError, Refused, Scene, Servo, load_result, load_scene, run, servos_of_file
from teleop.__main__ import main
from teleop.live.devices.identify import NOTHING, Identified, JointRecord, fit_servo, goals, record, toml_of
from teleop.live.devices.position_servo import PositionServo, position_arm
from teleop.live.in_process import run_stepped
from teleop.physics.servo import encoded, turn
from teleop.protocol.endpoint import Axes, Reading
from tests.live.arms.servo_stand_in import Feetech, Physics
from tests.waiting import until


class SteppedBus:
    """Servos of a scene's slave in what they touch, on a late bus, moved tick by tick. `lost`: no call arrives."""

    def __init__(self, scene: Scene) -> None:
        dt = scene.dt_ns / 1e9
        self.servos: tuple[Servo, ...] = scene.per_axis("slave")
        self.plants = [servo.slave_plant(dt, None if one is None else one.resistance())  # each of them has one
                       for servo, one in zip(self.servos, scene.environments, strict=True)]
        starts = [servo.start(dt, at) for servo, at in zip(
            self.servos, scene.vector("start_s", scene.start_s), strict=True)]
        self.shafts = [start[0] for start in starts]
        self.goals = tuple([start[2] for start in starts])
        self.sent, self.taken = [list(start[3]) for start in starts], [list(start[4]) for start in starts]
        self.newest = tuple([start[1][0] for start in starts])
        self.lost, self.rate = False, 0.0
        self.closed = 0

    def tick(self) -> None:
        newest = []
        for i, (servo, plant) in enumerate(zip(self.servos, self.plants, strict=True)):
            self.sent[i].append(self.goals[i])
            self.shafts[i] = turn(*plant.c[:2], self.shafts[i], self.sent[i].pop(0), 0.0, 0.0)
            self.taken[i].append(encoded(self.shafts[i][0], servo.step))
            newest.append(self.taken[i].pop(0))
        self.newest = tuple(newest)

    def read(self) -> Axes:
        if self.lost:
            raise DeviceError("the bus is lost")
        return self.newest

    def goal(self, x: Axes) -> None:
        if self.lost:
            raise DeviceError("the bus is lost")
        self.goals = x

    def close(self) -> None:
        self.closed += 1


class SteppedArm(PositionServo):
    """The device with its bus, each moved on by the tick that is read."""

    def __init__(self, scene: Scene) -> None:
        self.stepped = SteppedBus(scene)
        super().__init__(self.stepped, self.stepped.servos, scene.dt_ns / 1e9, unwatched=True)

    def read(self, k: int) -> Reading:
        for _ in range(k - self._k):
            self.stepped.tick()
        return super().read(k)


@pytest.mark.parametrize("knobs", [
    {}, {"drive_s": "mass", "law": "wave"},
    {"dt": 1e-3, "every": 5, "bus": 0.003, "drive_m": "mass", "link": "delay(0.02)"}])
def test_a_device_on_a_stepped_bus_has_the_bits_of_virtual_time(knobs: dict[str, Any]) -> None:
    scene = load_scene("servo_arm", duration=1.5, **knobs)
    live, virtual = run_stepped(scene, {"m": SimulatedMaster, "s": SteppedArm}, seed=1), run(scene, seed=1)
    assert (live.status, live.metrics) == (virtual.status, virtual.metrics)
    assert max(abs(live.trace["f_s"].ravel())) > 0.1
    for name, column in live.trace.items():
        assert column.tobytes() == virtual.trace[name].tobytes(), name


def joint(drive: str = "offset") -> tuple[SteppedBus, PositionServo]:
    scene = load_scene("servo_arm", drive_s=drive, counts=0, friction=0.0, dead=0.0, bus=0.0)
    arm = SteppedArm(scene)
    return arm.stepped, arm


@pytest.mark.parametrize("drive", ["offset", "mass"])
def test_after_a_lost_bus_a_drive_begins_where_the_joints_are(drive: str) -> None:
    bus, arm = joint(drive)
    for k in range(40):
        arm.read(k)
        arm.hold((1.0,) * 6)
    bus.lost = True
    for k in range(40, 44):
        with pytest.raises(DeviceError, match="the bus is lost"):
            arm.read(k)
        arm.hold((0.0,) * 6)  # as the guard does: it says no more than that
    bus.lost = False
    reading = arm.read(44)
    assert reading.x == bus.newest
    assert reading.v == (0.0,) * 6
    arm.hold((0.0,) * 6)
    assert bus.goals == bus.newest
    assert arm.read(80).v == (0.0,) * 6  # after 0.1 s without a tick too


def test_a_bus_that_carries_too_few_exchanges_is_driven_no_more_until_it_does() -> None:
    bus, arm = joint()
    bus.rate = 200.0
    arm.read(0)
    bus.rate = 9.0  # 0.217 K d is 0.86 N m s/rad then, above 0.6
    with pytest.raises(DeviceError, match=r"carries 9 exchanges a second: .* late makes energy at its shaft"):
        arm.read(100)
    with pytest.raises(DeviceError):
        arm.read(101)
    bus.rate = 200.0
    assert arm.read(201).x == bus.newest


def test_a_zero_between_two_exchanges_waited_for_the_next_and_left_a_killed_arm_pressing() -> None:
    """Offset drive: when it is let go of, the force is zero at once."""
    bus, arm = joint()
    for k in range(40):
        arm.read(k)
        arm.hold((1.0,) * 6)
    arm.read(40)
    arm.hold((0.0,) * 6)
    assert bus.goals == bus.newest
    arm = SteppedArm(load_scene("servo_arm", dt=1e-3, every=5, bus=0.0))
    for k in range(38):
        arm.read(k)
        arm.hold((1.0,) * 6)
    assert arm.stepped.goals[0] > arm.stepped.newest[0]
    arm.hold((0.0,) * 6)  # 3 ticks after an exchange
    assert arm.stepped.goals == tuple([state[0] for state in arm._states or ()])


def test_a_bus_without_a_watchdog_and_wrong_servos_are_refused() -> None:
    scene = load_scene("servo_arm")
    bus = SteppedBus(scene)
    with pytest.raises(Refused, match=r"presses on when its end is killed; give it watchdog=Dev.* unwatched"):
        PositionServo(bus, bus.servos, scene.dt)
    with pytest.raises(Refused, match="the bus has 6 joints, and was given 2 servos"):
        PositionServo(bus, bus.servos[:2], scene.dt, unwatched=True)
    with pytest.raises(Refused, match="s late makes energy at its shaft"):
        PositionServo(bus, Servo(K=500.0, damping=0.1), scene.dt, unwatched=True)
    opened: list[SteppedBus] = []
    with pytest.raises(Refused, match=r"the slave of scene bench_top is no Servo; take .* servo_arm, or turn it round"):
        position_arm(load_scene("bench_top"), "s", lambda: opened.append(bus) or bus, "turn it round")
    assert not opened
    with pytest.raises(Refused, match="has no watchdog"):
        position_arm(scene, "s", lambda: bus, "")
    assert bus.closed == 1
    assert isinstance(scene.environments[5], Wall)


# Live, over a pseudo terminal

SCENE = """
from channel import Delay
from master import Grip, Reach
from slave import Wall
from teleop import Law, MassDamper, PDamped, Scene, Servo, Watchdog


def scene(*, law: Law = PDamped(K=10.0, B=0.4), drive: str = "mass", duration: float = 6.0) -> Scene:
    return Scene(
        law=law, units=("rad",), master=MassDamper(mass=0.01, damping=0.05), link=Delay(0.05), observer=None,
        hand=Grip(mass=0.02, k=15.0, d=0.5, reference=Reach(to=(0.5,), start=0.5, duration=1.0)), duration=duration,
        slave=Servo(K=17.8, damping=0.6, friction=0.05, stall=2.94, counts=4096, bus=(0.005, 0.005), every=5,
                    drive=drive), environment=Wall(k=2000.0, d=5.0, at=0.25), watchdog=Watchdog(timeout=0.3))
"""


@pytest.fixture
def pressing(opened: Callable[..., Any], command: Callable[..., Any], tmp_path: Path) -> Callable[..., Any]:
    """`pressing(law, drive, folder)`: a joint of a stand-in before a wall, and both ends of a live run."""
    pytest.importorskip("scservo_sdk", reason="the extra `feetech` is not installed")
    (tmp_path / "one.py").write_text(SCENE)

    def start(law: str, drive: str, folder: str, duration: float = 4.0) -> tuple[Physics, Any, Any]:
        scene = load_scene(str(tmp_path / "one.py"), law=law, drive=drive)
        servos = opened(Feetech((1,)))
        physics = opened(Physics(servos, (scene.slave,), (scene.environment,)))
        knobs = (str(tmp_path / "one.py"), "--set", f"law={law}", "--set", f"drive={drive}", "--set",
                 f"duration={duration}", "--json")
        slave = command("slave", *knobs, "--listen", "127.0.0.1:0", "--out", f"{folder}/slave", "--robot",
                        f"feetech:{servos.port}?timeout=80")
        master = command("master", *knobs, "--peer", f"127.0.0.1:{slave.port()}", "--out", f"{folder}/master")
        return physics, master, slave

    return start


@pytest.mark.parametrize(("law", "drive"), [("p_d(K=10.0, B=0.4)", "mass"), ("wave(b=0.5, K=10.0, B=0.4)", "mass"),
                                            ("pp(K=10.0, B=0.4)", "offset")])
def test_what_a_servo_touches_is_felt_live(
    law: str, drive: str, pressing: Callable[..., Any], tmp_path: Path
) -> None:
    tried = []
    for attempt in "abcde":  # on a busy machine a bus is late, and an end leaves or its arm lags
        physics, master, slave = pressing(law, drive, attempt)
        touches = []
        while master.process.poll() is None:
            touches.append(physics.touch(0))
            time.sleep(0.01)
        codes = [end.end()[0] for end in (master, slave)]
        felt = load_result(tmp_path / attempt / "master").trace["f_m"][-1500:]
        # Medians, for the arm moves at first and when it is let go.
        pressed = float(np.median([each for each in touches if each > 0.3] or [0.0]))
        if codes == [0, 0] and min(felt) > 0.3 and abs(np.median(felt) - pressed) < 0.08:
            return  # friction, and one count of 0.027 N m, lie between them
        tried.append((codes, min(felt), np.median(felt), pressed))
    pytest.fail(f"exit codes, least force that was felt, its median and what was touched: {tried}")


def test_a_servo_whose_end_is_killed_in_contact_presses_on_no_more(pressing: Callable[..., Any]) -> None:
    for attempt in "abcde":  # an end may leave on a busy machine, for its bus is late
        physics, master, slave = pressing("pp(K=10.0, B=0.4)", "offset", attempt, 20.0)
        until(lambda physics=physics, slave=slave: physics.touch(0) > 0.5 or slave.process.poll() is not None)
        slave.process.kill()
        if physics.touch(0) > 0.5:
            break
        master.process.kill()
    else:
        pytest.fail("it never pressed")
    until(lambda: physics.touch(0) < 0.05, "it pressed on")


class TimedBus:
    """One servo on a bus that is late, moved by the time that its caller waits."""

    def __init__(self, servo: Servo) -> None:
        self.servo, self.c = servo, servo.slave_plant(1e-3, None).c[0]
        self.ticks, self.state, self.wanted = 0, (0.0,) * 5, [0.0]
        self.sent, self.places = [0.0], [0.0]
        self.most = 0.0

    def clock(self) -> float:
        return 1e-3 * self.ticks

    def sleep(self, seconds: float) -> None:
        to_servo, _ = self.servo.ticks(1e-3)
        for _ in range(round(seconds / 1e-3)):
            self.sent.append(self.wanted[-1])
            self.state = turn(self.c, NOTHING, self.state, self.sent[max(0, len(self.sent) - 1 - to_servo)], 0.0, 0.0)
            self.places.append(encoded(self.state[0], self.servo.step))
            self.ticks += 1

    def read(self) -> Axes:
        return (self.places[max(0, len(self.places) - 1 - self.servo.ticks(1e-3)[1])],)

    def goal(self, x: Axes) -> None:
        self.wanted.append(x[0])
        self.most = max(self.most, abs(x[0]))

    def close(self) -> None:
        pass


@pytest.mark.parametrize("numbers", [
    {"K": 17.8, "damping": 0.6, "friction": 0.15, "bus": (0.005, 0.005)},
    pytest.param({"K": 50.0, "damping": 1.2, "friction": 0.05, "bus": (0.008, 0.004)}, marks=pytest.mark.full)])
def test_the_numbers_of_a_servo_are_found_within_their_uncertainty_and_its_reach(numbers: dict[str, Any]) -> None:
    bus = TimedBus(Servo(**numbers, inertia=0.028, link=0.01, counts=4096))
    found = fit_servo(record(bus, 0, 0.1, clock=bus.clock, sleep=bus.sleep), 0.038)
    assert bus.most <= 0.1
    for name, true in {**numbers, "lateness": sum(numbers["bus"])}.items():
        if name != "bus":
            assert found.values[name] == pytest.approx(true, abs=found.errors[name]), name
        if name in ("K", "damping"):
            assert found.errors[name] < 0.05 * true, name


def test_a_joint_that_is_stuck_is_no_servo() -> None:
    wanted = goals(0.1, 0.0)
    dice = np.random.Generator(np.random.Philox(1))
    with pytest.raises(Refused, match=r"it does not move as a position servo: .* type a smaller or larger --reach"):
        fit_servo(JointRecord(0.005 * np.arange(len(wanted)), wanted, dice.normal(0.0, 1e-3, len(wanted))), 0.04)


def test_the_command_writes_a_file_that_the_scene_reads_and_another_arm_refuses(
    opened: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("scservo_sdk", reason="the extra `feetech` is not installed")
    (tmp_path / "one.py").write_text(SCENE)
    scene, file = load_scene(str(tmp_path / "one.py")), tmp_path / "arm.toml"
    servos = opened(Feetech((1,)))
    opened(Physics(servos, (scene.slave,), (None,)))
    asked = ["identify", "robot", f"feetech:{servos.port}?timeout=80", str(tmp_path / "one.py"), "--reach", "0.1",
             "--inertia", "0.038", "--out", str(file)]

    def measured() -> bool:
        """True of a record that no busy machine made late: each is fitted anew."""
        file.unlink(missing_ok=True)
        return main(asked) == 0 and pytest.approx(17.8, rel=0.25) == servos_of_file(file, 1, drive="mass")[0].K

    until(measured, "the stiffness of the stand-in was never found")
    assert "N m/rad" in capsys.readouterr().out
    servo, = servos_of_file(file, 1, drive="mass")
    assert servo.lateness(1e-3) > 0.0
    assert main(asked) != 0
    assert "is there already" in capsys.readouterr().err
    with pytest.raises(Refused, match=r"of another arm: it has 1 joint, and 6 are needed"):
        load_scene("servo_arm", servo=str(file))


def test_a_file_that_identify_did_not_write_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "arm.toml"
    for text, words in (("[[joint]]\nK = 1.0\n", "joint 1 of .* has no damping; write it anew with teleop identify"),
                        ("[[joint]]\nK = 1.0\nDs = 2\n", "has no key 'Ds'"),
                        ("joint = 1", "it has 0 joints, and 1 are"),
                        ("[[joint]\n", "cannot be read .*; give a file that teleop identify wrote")):
        file.write_text(text)
        with pytest.raises(Refused, match=words):
            servos_of_file(file, 1)
    joint = Identified({"K": 2.0, "damping": 1.0, "friction": 0.0, "lateness": 0.01, "inertia": 0.04}, {"K": 0.1})
    file.write_text(toml_of("arm", 0.1, [joint, joint]))
    assert [each.K for each in servos_of_file(file, 2)] == [2.0, 2.0]
