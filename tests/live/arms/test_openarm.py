"""Damiao motors by python-can, against a stand-in on its virtual bus: frames, timeouts, errors, a run by name."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("can", reason="the extra `openarm` is not installed")

import can

from teleop import DeviceError, Refused, Scene, check_device, load_scene
from teleop.live.devices.arms.openarm import DamiaoArm, DamiaoMotor, MotorState, openarm_device, openarm_robot
from teleop.live.devices.checking import DeviceCheck
from teleop.live.devices.guarded_device import GuardedDevice
from teleop.live.devices.judging import DeviceFault
from teleop.live.devices.opening import find_device
from tests.waiting import until

pytestmark = pytest.mark.live
CHANNELS = count()


def joints(axes: int = 2) -> Scene:
    return load_scene("bench_top", axes=str(axes), units="rad")


PMAX, VMAX, TMAX = 12.5, 30.0, 10.0
INERTIA, DAMPING, FRICTION = 0.1, 0.2, 0.01  # kg m^2, N m s/rad, N m: half a step of the torque moves nothing


class Damiao:
    """Motors 1 to n in a thread. Knobs: ids in `silent`; `errors`: state that a motor reports, by id."""

    def __init__(self, bus: Any, message: Any, ids: tuple[int, ...] = (1, 2)) -> None:
        self.bus, self.message, self.ids = bus, message, ids
        self.registers: dict[tuple[int, int], bytes] = {}
        for each in ids:
            for rid, value in ((21, PMAX), (22, VMAX), (23, TMAX)):
                self.registers[each, rid] = struct.pack("<f", value)
            self.registers[each, 10], self.registers[each, 9] = struct.pack("<I", 2), bytes(4)
        self.x, self.v, self.torque = (dict.fromkeys(ids, 0.0) for _ in range(3))
        self.kd = dict.fromkeys(ids, 0.0)
        self.on = dict.fromkeys(ids, False)
        self.heard = {each: time.monotonic() for each in ids}
        self.silent: set[int] = set()
        self.errors: dict[int, int] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.bus.shutdown()

    def _serve(self) -> None:
        before = time.monotonic()
        while not self._over.is_set():
            message = self.bus.recv(timeout=0.005)
            now = time.monotonic()
            for each in self.ids:
                timeout = struct.unpack("<I", self.registers[each, 9])[0] * 50e-6
                if self.on[each] and timeout and now - self.heard[each] > timeout:
                    self.on[each] = False
                    self.errors.setdefault(each, 13)  # an error that is there stays
                self._move(each, now - before)
            before = now
            if message is not None:
                self._take(message.arbitration_id, bytes(message.data), now)

    def _move(self, each: int, dt: float) -> None:
        torque = self.torque[each] - self.kd[each] * self.v[each] if self.on[each] else 0.0
        v = self.v[each] + dt * (torque - DAMPING * self.v[each]) / INERTIA
        self.v[each] = max(0.0, abs(v) - dt * FRICTION / INERTIA) * (1.0 if v > 0.0 else -1.0)
        self.x[each] += dt * self.v[each]

    def _take(self, arbitration: int, data: bytes, now: float) -> None:
        if arbitration == 0x7FF:
            each, order, rid = data[0] | data[1] << 8, data[2], data[3]
            if each in self.ids and each not in self.silent and order in (0x33, 0x55):
                if order == 0x55:
                    self.registers[each, rid] = data[4:]
                self._send(each, data[:4] + self.registers[each, rid])
            return
        if arbitration not in self.ids:
            return
        self.heard[arbitration] = now
        if data[:7] == b"\xff" * 7:
            self.on[arbitration] = data[7] == 0xFC if data[7] in (0xFC, 0xFD) else self.on[arbitration]
            if data[7] == 0xFB and self.errors.get(arbitration) == 13:
                del self.errors[arbitration]
            if data[7] == 0xFD:
                self.torque[arbitration] = 0.0
        else:
            steps = (data[6] & 0xF) << 8 | data[7]
            self.torque[arbitration] = (steps / 4095 * 2 - 1) * TMAX
            self.kd[arbitration] = (data[5] << 4 | data[6] >> 4) / 4095 * 5
        if arbitration not in self.silent:
            state = self.errors.get(arbitration, 1 if self.on[arbitration] else 0)
            q = round((self.x[arbitration] / PMAX + 1) / 2 * 65535)
            v = round((self.v[arbitration] / VMAX + 1) / 2 * 4095)
            t = round((self.torque[arbitration] / TMAX + 1) / 2 * 4095)
            self._send(arbitration, bytes([
                state << 4 | arbitration & 0xF, q >> 8, q & 0xFF, v >> 4, (v & 0xF) << 4 | t >> 8, t & 0xFF, 40, 45]))

    def _send(self, each: int, data: bytes) -> None:
        self.bus.send(self.message(arbitration_id=each + 0x10, data=data, is_extended_id=False))


@pytest.fixture
def motors() -> Iterator[tuple[Damiao, str]]:
    channel = f"arm{next(CHANNELS)}"
    made = Damiao(can.Bus(channel=channel, interface="virtual"), can.Message)
    yield made, f"{channel}?interface=virtual"
    made.close()


def trouble(arm: DamiaoArm, force: tuple[float, ...] = (0.0, 0.0)) -> str:
    """What a tick with this force says is wrong; "" while it works."""
    time.sleep(0.001)
    try:
        arm.read(0)
        arm.hold(force)
    except DeviceError as error:
        return str(error)
    return ""


def test_a_frame_has_the_bits_that_the_motors_manual_gives() -> None:
    motor = DamiaoMotor(1, 1.0, 0x11, (12.5, 30.0, 10.0))
    assert motor.frame(0.0, 0.0) == bytes([0x80, 0x00, 0x80, 0x00, 0x00, 0x00, 0x08, 0x00])
    assert motor.frame(10.0, 5.0)[5:] == b"\xff\xff\xff"
    assert motor.frame(-99.0, 0.0)[6:] == b"\x00\x00"  # no more than its range
    motor.take(bytes([0x1 << 4 | 1, 0xFF, 0xFF, 0x00, 0x0F, 0xFF, 41, 52]), 7)
    assert (motor.x, motor.v, motor.state, motor.hottest, motor.t) == (12.5, -30.0, MotorState.ON, 52, 7)
    motor.take(bytes([0x70, 0, 0, 0, 0, 0, 0, 0]), 8)
    assert motor.state is MotorState.ON  # 7 is documented nowhere


def test_an_arm_pushes_along_the_scene_and_reads_what_it_moves(
    motors: tuple[Damiao, str], opened: Callable[..., DamiaoArm]
) -> None:
    stand_in, argument = motors
    robot = opened(openarm_robot(joints(), f"{argument}&ids=1,-2&damping=0.5"))
    assert stand_in.registers[1, 10] == bytes([1, 0, 0, 0])  # MIT mode
    assert stand_in.registers[1, 9] == (3000).to_bytes(4, "little")  # of 50 us
    until(lambda: trouble(robot, (0.2, 0.2)) == "" and robot.read(0).x[1] > 0.02)
    reading = robot.read(0)
    assert reading.x[0] > 0.0
    assert reading.v[1] > 0.0
    assert reading.f is None
    assert stand_in.torque[1] == pytest.approx(0.2, abs=10 / 4095)
    assert stand_in.torque[2] == pytest.approx(-0.2, abs=10 / 4095)
    assert stand_in.kd[1] == pytest.approx(0.5, abs=5 / 4095)
    robot.close()
    until(lambda: not any(stand_in.on.values()))
    device = opened(openarm_device(joints(), f"{argument}&limit=0.1,1"))
    until(lambda: trouble(device, (0.5, 0.5)) == "" and stand_in.torque[2] < -0.49)
    assert stand_in.torque[1] == pytest.approx(-0.1, abs=10 / 4095)


def test_a_motor_that_heard_nothing_lets_go_and_is_switched_on_again_without_a_torque(
    motors: tuple[Damiao, str], opened: Callable[..., DamiaoArm]
) -> None:
    stand_in, argument = motors
    robot = opened(openarm_robot(joints(), argument))
    until(lambda: trouble(robot, (0.2, 0.2)) == "" and stand_in.torque[1] > 0.1)
    until(lambda: not any(stand_in.on.values()), "its own timeout never ended its torque")
    words = "was told nothing for too long and let go (45 degrees Celsius)"
    until(lambda: words in trouble(robot))
    with pytest.raises(DeviceError, match="was told nothing"):
        robot.hold((0.2, 0.2))
    assert abs(stand_in.torque[1]) < 0.2
    until(lambda: not trouble(robot), "it was never switched on again")


def test_an_error_of_a_motor_is_one_sentence_and_no_torque(
    motors: tuple[Damiao, str], opened: Callable[..., DamiaoArm]
) -> None:
    stand_in, argument = motors
    robot = opened(openarm_robot(joints(), argument))
    for state, words in ((0xB, "has too hot a driver"), (0xC, "has too hot a coil"), (0xE, "is overloaded"),
                         (0xA, "draws too much current")):
        until(lambda: not trouble(robot, (0.2, 0.2)))
        stand_in.errors[2] = state
        sentence = f"motor 2 on {argument.partition('?')[0]} {words} (45 degrees Celsius)"
        until(lambda sentence=sentence: trouble(robot, (0.2, 0.2)) == sentence)
        with pytest.raises(DeviceError):
            robot.hold((0.2, 0.2))
        until(lambda: abs(stand_in.torque[1]) < 0.01)
        stand_in.errors.clear()


def test_a_motor_that_is_silent_or_another_one_is_named(
    motors: tuple[Damiao, str], opened: Callable[..., DamiaoArm]
) -> None:
    stand_in, argument = motors
    robot = opened(openarm_robot(joints(), argument))
    until(lambda: not trouble(robot))
    stand_in.silent.add(2)
    channel = argument.partition("?")[0]
    until(lambda: trouble(robot) == f"motor 2 on {channel} does not answer; see to its power and its cable")
    stand_in.silent.clear()
    until(lambda: not trouble(robot))
    for text, words in (("&ids=1,3", "motor 3 on .* does not answer from id 0x13"),
                        ("&answers=32", "motor 1 on .* does not answer from id 0x21")):
        with pytest.raises(DeviceError, match=words):
            openarm_robot(joints(), argument + text)
    stand_in.errors[1] = 0xB
    with pytest.raises(DeviceError, match=r"motor 1 on .* has too hot a driver"):
        openarm_robot(joints(), argument)
    stand_in.errors.clear()
    stand_in.registers[1, 23] = bytes(4)
    with pytest.raises(Refused, match="0 N m; set PMAX, VMAX and TMAX"):
        openarm_robot(joints(), argument)


def test_a_bus_that_takes_no_frame_is_a_sentence(motors: tuple[Damiao, str]) -> None:
    class Full:
        """A bus without a cable: the adapter's queue is full."""

        def __init__(self, **options: Any) -> None:
            self.bus, self.is_full = can.Bus(channel=options["channel"], interface="virtual"), False

        def send(self, message: Any) -> None:
            if self.is_full:
                raise can.CanOperationError("Transmit buffer full")
            self.bus.send(message)

        def recv(self, timeout: float) -> Any:
            return self.bus.recv(timeout)

        def shutdown(self) -> None:
            self.bus.shutdown()

    arm = DamiaoArm(joints(), motors[1], 1.0, open_bus=Full)
    until(lambda: not trouble(arm))
    arm._bus.is_full = True
    words = "takes no frame (Transmit buffer full); see to its cable and its termination"
    assert words in trouble(arm)
    with pytest.raises(DeviceError, match="takes no frame"):
        arm.hold((0.0, 0.0))
    with pytest.raises(DeviceError, match="takes no frame"):
        arm.close()


@pytest.mark.parametrize(("text", "error", "words"), [
    ("openarm:can77", DeviceError, r"the CAN bus can77 cannot be opened .*; bring it up with: ip link set can77 up"),
    ("openarm:can77?fd=1", DeviceError, "dbitrate 5000000 fd on"),
    ("openarm:can77?fd=2", Refused, "fd is 0 or 1, not '2'"),
    ("openarm:can77?damping=9", Refused, "damping must be at most 5"),
    ("openarm:can77?limit=1,2,3", Refused, "limit has 3 numbers, and there are 2 joints"),
])
def test_what_cannot_be_opened_says_what_to_type(text: str, error: type[Exception], words: str) -> None:
    with pytest.raises(Refused, match=words):  # a device that does not open is a refusal of the request
        find_device("s", text).open(joints())
    with pytest.raises(error, match=words):
        openarm_robot(joints(), text.removeprefix("openarm:"))


def test_the_check_pushes_it_along_each_joint(motors: tuple[Damiao, str]) -> None:
    found: list[DeviceCheck] = []

    def checked() -> bool:
        """True as soon as the motors' thread was never late on a busy machine."""
        with suppress(DeviceFault, Refused):
            found.append(check_device(f"openarm:{motors[1]}", joints(), push=True, force=0.1, ticks=200))
        return bool(found)

    until(checked)
    result = found[0]
    assert all(by > 0.0 for by in result.moved)
    assert result.deadline == 0.15


def test_more_frames_than_the_bus_carries_in_a_tick_are_a_note() -> None:
    channel = f"arm{next(CHANNELS)}"
    stand_in = Damiao(can.Bus(channel=channel, interface="virtual"), can.Message, tuple(range(1, 8)))
    try:
        for fd, notes in (("0", ["the frames of 7 motors take up to 1.9 ms of the bus and a tick 1 ms: take --rate "
                                 "529, or CAN FD by ?fd=1"]), ("1", [])):
            arm = openarm_robot(load_scene("bench_top", axes="7", units="rad"), f"{channel}?interface=virtual&fd={fd}")
            assert arm.notes == notes
            arm.close()
    finally:
        stand_in.close()


def test_of_motors_on_a_bus_the_weight_is_held_and_gone_when_the_end_lets_go(
    opened: Callable[..., Any], tmp_path: Path
) -> None:
    pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")
    file = tmp_path / "one.urdf"
    file.write_text("<robot name='one'><link name='base'/><link name='link'><inertial><origin xyz='0.2 0 0'/>"
                    "<mass value='0.5'/><inertia ixx='1e-3' iyy='1e-3' izz='1e-3' ixy='0' ixz='0' iyz='0'/></inertial>"
                    "</link><joint name='lift' type='revolute'><parent link='base'/><child link='link'/>"
                    "<axis xyz='0 -1 0'/><limit lower='-2' upper='2' effort='5' velocity='9'/></joint></robot>")
    stand_in = Damiao(can.Bus(channel="weighty", interface="virtual"), can.Message, (1,))
    try:
        of = load_scene("bench_top", axes="1", units="rad", names="lift")
        arm = opened(find_device("s", f"compensated:{file}?ramp=0.05 | openarm:weighty?interface=virtual").open(of))
        guarded = GuardedDevice(arm, 1)
        k = 0

        def ticked() -> bool:
            nonlocal k
            k += 1
            time.sleep(0.001)
            reads = guarded.read(k, 0) is not None
            return guarded.hold((0.0,)) and reads

        weight = 0.5 * 9.81 * 0.2

        def held_in_place() -> bool:
            """True if it is given its weight: the stand-in has none, so what carries one would lift it."""
            stand_in.x[1] = stand_in.v[1] = 0.0
            return ticked() and abs(stand_in.torque[1] - weight) < 0.01

        until(held_in_place, "it never carried the weight")
        assert arm.read(k).f is not None
        stand_in.silent.add(1)
        until(lambda: not ticked() and "does not answer" in str(guarded.trouble))
        for _ in range(150):
            ticked()
        until(lambda: abs(stand_in.torque[1]) < 0.01, "a bus without answers is pressed on")
        stand_in.silent.clear()
        until(held_in_place, "it never carried the weight again")
        assert guarded.let_go()
        until(lambda: abs(stand_in.torque[1]) < 0.01, "let go it presses on")
    finally:
        stand_in.close()
