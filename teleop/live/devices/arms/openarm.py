"""Damiao motors on a CAN bus, as in an OpenArm, by python-can: `openarm:can0`, a torque for each joint.

    python -m slave bench_top --set axes=7 --set units=rad --robot "openarm:can0?fd=1" --listen 0.0.0.0:9001

A frame of the MIT mode goes to each motor with each force, and each motor answers with its state: no call waits, so
there is no thread. Position, velocity and torque are scaled by PMAX, VMAX and TMAX, which are read from each motor. The
motor's own timeout (register 9) ends its torque when nothing has come for 0.15 s.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from time import monotonic_ns, sleep
from typing import Any

try:
    import can
except ModuleNotFoundError as error:
    raise ImportError("Damiao motors are reached by python-can, which is not installed; type pip install "
                      "'bilateral-teleop[openarm]', or pip install python-can") from error
from teleop.errors import DeviceError, Refused, number_of
from teleop.live.devices.arms.sdk_chain import bus_ids
from teleop.live.devices.settings import for_each, ids_of, numbers, one_of, settings_of, whole, within
from teleop.protocol.endpoint import Axes, Reading
from teleop.protocol.guard import DEADLINE
from teleop.scene.scene import Scene

EXAMPLE = "openarm:can0?fd=1"
READERS = {"ids": ids_of, "fd": one_of("0", "1"), "limit": numbers, "damping": within(0.0, 5.0),
           "interface": one_of("socketcan", "virtual"), "answers": whole}
ANSWERS = 0x10  # an answer has this more than the id of its motor
TABLE = 0x7FF  # of reading and writing registers
READ, WRITE, REFRESH = 0x33, 0x55, 0xCC
TIMEOUT, MODE, PMAX, VMAX, TMAX = 9, 10, 21, 22, 23  # registers
MIT = 1
TIMEOUT_UNIT = 50e-6  # s
KD_MOST = 5.0  # N m s/rad
ENABLE, DISABLE, CLEAR = 0xFC, 0xFD, 0xFB
SILENT_NS = 34_000_000  # without an answer a motor is lost
OPEN_S = 0.1  # for an answer before the run
RETRY_NS = 250_000_000  # between two attempts to switch a motor on again
MOST_FRAMES = 64  # at one tick
FRAME_S = {False: 135e-6, True: 60e-6}  # on the bus at 1 Mbit/s, all bits stuffed; as CAN FD with 5 Mbit/s of data


class MotorState(IntEnum):
    """Upper half of the first byte of an answer."""

    OFF = 0
    ON = 1
    OVERVOLTAGE = 8
    UNDERVOLTAGE = 9
    OVERCURRENT = 10
    DRIVER_HOT = 11
    COIL_HOT = 12
    SILENCE = 13
    OVERLOAD = 14


TEXT = {
    MotorState.OFF: "is switched off", MotorState.ON: "works", MotorState.OVERVOLTAGE: "has too high a supply voltage",
    MotorState.UNDERVOLTAGE: "has too low a supply voltage", MotorState.OVERCURRENT: "draws too much current",
    MotorState.DRIVER_HOT: "has too hot a driver", MotorState.COIL_HOT: "has too hot a coil",
    MotorState.SILENCE: "was told nothing for too long and let go", MotorState.OVERLOAD: "is overloaded",
}
AGAIN = (MotorState.OFF, MotorState.SILENCE)  # a motor in one of these is switched on again


@dataclass
class DamiaoMotor:
    """State of one motor. Its ranges are those of its registers PMAX (rad), VMAX (rad/s) and TMAX (N m)."""

    id: int
    sign: float
    answers: int  # arbitration id of its answers
    ranges: tuple[float, float, float] = (0.0, 0.0, 0.0)
    x: float = 0.0
    v: float = 0.0
    state: MotorState = MotorState.OFF
    hottest: int = 0  # degrees Celsius
    t: int = 0  # ns, of its newest answer

    def frame(self, torque: float, damping: float) -> bytes:
        """Pack a command of the MIT mode: 16 bits of position, 12 each of velocity, kp, kd and torque."""
        p, v, t = self.ranges
        kd = _scale(damping, 0.0, KD_MOST, 12)
        fields = ((_scale(0.0, -p, p, 16), 16), (_scale(0.0, -v, v, 12), 12), (0, 12), (kd, 12),
                  (_scale(torque, -t, t, 12), 12))
        packed = 0
        for value, bits in fields:
            packed = packed << bits | value
        return packed.to_bytes(8, "big")

    def take(self, data: bytes, now: int) -> None:
        """Take an answer: state, position, velocity and temperatures."""
        p, v, _ = self.ranges
        packed = int.from_bytes(data[1:6], "big")
        self.x = self.sign * _unscale(packed >> 24, -p, p, 16)
        self.v = self.sign * _unscale(packed >> 12 & 0xFFF, -v, v, 12)
        self.hottest, self.t = max(data[6], data[7]), now
        with suppress(ValueError):  # a state that is not documented changes nothing
            self.state = MotorState(data[0] >> 4)


class DamiaoArm:
    """Motors on a CAN bus that take a torque each. `push`: 1.0 at the slave, -1.0 at the master, against the hand.

    A motor that let go in a silence is switched on again every 0.25 s; one that reports an error stays off.
    """

    deadline = DEADLINE
    senses = False

    def __init__(self, scene: Scene, argument: str, push: float, *, clock: Callable[[], int] = monotonic_ns,
                 open_bus: Callable[..., Any] = can.Bus) -> None:
        """Raises `Refused` for what it cannot drive, `DeviceError` if a motor does not answer."""
        self.channel, settings = settings_of("openarm", argument, READERS, EXAMPLE)
        ids = bus_ids(scene, settings, "openarm")
        above = settings.get("answers", ANSWERS)
        self._motors = [DamiaoMotor(each, sign, each + above) for each, sign in ids]
        self._by_answer = {motor.answers: motor for motor in self._motors}
        self._damping: float = settings.get("damping", 0.0)
        self._limits: tuple[float, ...] | None = None
        if "limit" in settings:
            self._limits = for_each("openarm's limit", settings["limit"], len(ids))
        self._fd, self._push, self._clock = settings.get("fd") == "1", push, clock
        self._torques = (0.0,) * len(ids)
        self.notes = []
        if (takes := 2 * len(ids) * FRAME_S[self._fd]) > scene.dt:
            self.notes.append(f"the frames of {number_of(len(ids), 'motor')} take up to {takes * 1e3:.2g} ms of the "
                              f"bus and a tick {scene.dt * 1e3:g} ms: take --rate {int(1 / takes)}"
                              f"{'' if self._fd else ', or CAN FD by ?fd=1'}")
        self._sent = False  # since the last reading
        self._retry = 0
        self._why: str | None = None
        try:
            self._bus = open_bus(channel=self.channel, interface=settings.get("interface", "socketcan"), fd=self._fd)
        except (can.CanError, OSError, ValueError) as error:
            more_bits = " dbitrate 5000000 fd on" if self._fd else ""
            raise DeviceError(f"the CAN bus {self.channel} cannot be opened ({error}); bring it up with: ip link set "
                              f"{self.channel} up type can bitrate 1000000{more_bits}") from error
        try:
            for motor in self._motors:
                self._set_up(motor)
        except BaseException:
            self._bus.shutdown()
            raise

    def read(self, k: int) -> Reading:
        """Newest state of each motor. Raises `DeviceError` for one that is silent, or reports an error."""
        if not self._sent:
            self._command()  # an answer comes to a command alone
        self._sent = False
        self._receive()
        now = self._clock()
        if self._why is not None:
            raise DeviceError(self._why)
        for motor in self._motors:
            if now - motor.t > SILENT_NS:
                raise DeviceError(f"motor {motor.id} on {self.channel} does not answer; see to its power and its cable")
            if motor.state is not MotorState.ON:
                if motor.state in AGAIN:
                    self._switch_on(now)
                raise DeviceError(self._report(motor))
        return Reading(tuple([motor.x for motor in self._motors]), tuple([motor.v for motor in self._motors]))

    def hold(self, force: Axes) -> None:
        """Hold these torques (N m) from now on; zero, while a motor is off. Raises `DeviceError` if it holds others."""
        off = [motor for motor in self._motors if motor.state is not MotorState.ON]
        limits = self._limits or tuple([motor.ranges[2] for motor in self._motors])
        self._torques = tuple([0.0 if off else max(-most, min(most, self._push * each)) for each, most in
                               zip(force, limits, strict=True)])
        self._command()
        self._sent = True
        if self._why is not None:
            raise DeviceError(self._why)
        if off and any(force):
            raise DeviceError(self._report(off[0]))

    def close(self) -> None:
        """Switch the motors off."""
        try:
            for motor in self._motors:
                self._send(motor.id, bytes([0xFF] * 7 + [DISABLE]))
            if self._why is not None:
                raise DeviceError(self._why)
        finally:
            self._bus.shutdown()

    def _report(self, motor: DamiaoMotor) -> str:
        return f"motor {motor.id} on {self.channel} {TEXT[motor.state]} ({motor.hottest} degrees Celsius)"

    def _command(self) -> None:
        for motor, torque in zip(self._motors, self._torques, strict=True):
            self._send(motor.id, motor.frame(motor.sign * torque, self._damping))

    def _send(self, arbitration: int, data: bytes) -> None:
        try:
            self._bus.send(can.Message(arbitration_id=arbitration, data=data, is_extended_id=False, is_fd=self._fd,
                                       bitrate_switch=self._fd))
            self._why = None
        except (can.CanError, OSError) as error:
            self._why = f"the CAN bus {self.channel} takes no frame ({error}); see to its cable and its termination"

    def _receive(self) -> None:
        """Take all that has come, without waiting."""
        try:
            for _ in range(MOST_FRAMES * len(self._motors)):
                message = self._bus.recv(timeout=0.0)
                if message is None:
                    return
                motor = self._by_answer.get(message.arbitration_id)
                if motor is None or len(message.data) < 8 or message.is_error_frame:
                    continue
                if message.data[0] & 0xF == motor.id & 0xF:
                    motor.take(bytes(message.data), self._clock())
        except (can.CanError, OSError) as error:
            self._why = f"the CAN bus {self.channel} cannot be read ({error})"

    def _switch_on(self, now: int) -> None:
        if now < self._retry:
            return
        self._retry = now + RETRY_NS
        for motor in self._motors:
            if motor.state in AGAIN:
                for order in (CLEAR, ENABLE):
                    self._send(motor.id, bytes([0xFF] * 7 + [order]))

    def _set_up(self, motor: DamiaoMotor) -> None:
        """Read a motor's ranges, set its mode and its timeout, and switch it on without a torque."""
        p, v, t = (self._register(motor, each, "<f") for each in (PMAX, VMAX, TMAX))
        motor.ranges = p, v, t
        if not all(0.0 < each < 1e4 for each in motor.ranges):
            raise Refused(f"motor {motor.id} on {self.channel} has ranges {p:g} rad, {v:g} rad/s, {t:g} N m; set PMAX, "
                          "VMAX and TMAX with the vendor's tool")
        if self._register(motor, MODE, "<I") != MIT:
            self._register(motor, MODE, "<I", MIT)
        self._register(motor, TIMEOUT, "<I", round(DEADLINE / TIMEOUT_UNIT))
        for order in (CLEAR, ENABLE):
            self._send(motor.id, bytes([0xFF] * 7 + [order]))
        until = self._clock() + round(OPEN_S * 1e9)
        while motor.state is not MotorState.ON and self._clock() < until:
            self._send(motor.id, motor.frame(0.0, self._damping))
            sleep(0.001)
            self._receive()
        if motor.state is not MotorState.ON:
            raise DeviceError(self._report(motor))

    def _register(self, motor: DamiaoMotor, register: int, form: str, value: int | None = None) -> Any:
        """Read a register, or write `value` to it, and return what the motor answers. Raises `DeviceError`."""
        data = struct.pack("<HBB", motor.id, READ if value is None else WRITE, register) + (
            bytes(4) if value is None else struct.pack(form, value))
        for _ in range(MOST_FRAMES):  # what came before
            if self._bus.recv(timeout=0.0) is None:
                break
        self._send(TABLE, data)
        if self._why is not None:
            raise DeviceError(self._why)
        until = self._clock() + round(OPEN_S * 1e9)
        while self._clock() < until:
            message = self._bus.recv(timeout=0.0)
            if message is None:
                sleep(0.0005)
            elif message.arbitration_id == motor.answers and bytes(message.data[:4]) == data[:4]:
                answer = struct.unpack(form, bytes(message.data[4:8]))[0]
                if value is not None and answer != value:
                    raise DeviceError(f"motor {motor.id} on {self.channel} has {answer} in its register {register}, "
                                      f"and does not take {value}; see to its firmware")
                return answer
        raise DeviceError(f"motor {motor.id} on {self.channel} does not answer from id {motor.answers:#x}; see to its "
                          "power and its cable, and name the motors by ?ids= (and what their answers' ids have more by "
                          "?answers=)")


def openarm_device(scene: Scene, channel: str) -> DamiaoArm:
    """Damiao motors, as of an OpenArm, at the master's end, openarm:can0; see teleop/live/devices/arms/README.md."""
    return DamiaoArm(scene, channel, -1.0)


def openarm_robot(scene: Scene, channel: str) -> DamiaoArm:
    """Damiao motors, as of an OpenArm, at the slave's end, openarm:can0; see teleop/live/devices/arms/README.md."""
    return DamiaoArm(scene, channel, 1.0)


def _scale(value: float, low: float, high: float, bits: int) -> int:
    """Map a number of a range to the steps of so many bits, to the nearest."""
    top = (1 << bits) - 1
    return round((min(max(value, low), high) - low) / (high - low) * top)


def _unscale(steps: int, low: float, high: float, bits: int) -> float:
    return low + steps * (high - low) / ((1 << bits) - 1)
