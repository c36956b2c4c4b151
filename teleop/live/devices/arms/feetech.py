"""Feetech STS and SMS servos by the vendor's SDK: `feetech:PORT`, positions of a chain such as an SO-101.

    python -m slave servo_arm --robot "feetech:/dev/ttyACM0?ids=1-6&limit=0.5" --listen 0.0.0.0:9001

Numbers of the servos' table as the vendor documents it for STS and SMS. What a servo has in its permanent memory is
read and never written: its mode, its limits of the position, its delay before an answer.
"""

from __future__ import annotations

try:
    import scservo_sdk
except ModuleNotFoundError as error:
    raise ImportError("Feetech servos are reached by the vendor's SDK, which is not installed; type pip install "
                      "'bilateral-teleop[feetech]', or pip install feetech-servo-sdk") from error
from teleop.errors import DeviceError, Refused
from teleop.live.devices.arms.sdk_chain import SdkChain, SdkDriver
from teleop.live.devices.arms.servo_bus import (
    COUNTS,
    MOST_TIMEOUT_MS,
    RADIANS,
    TIMEOUT_MS,
    ZERO,
    LetsGo,
    ServoFault,
)
from teleop.live.devices.guarded_device import LiveDevice
from teleop.live.devices.settings import for_each, ids_of, numbers, one_of, positive, settings_of, whole, within
from teleop.protocol.endpoint import Axes
from teleop.scene.scene import Scene

EXAMPLE = "feetech:/dev/ttyACM0?ids=1-6"
READERS = {"ids": ids_of, "baud": whole, "rate": positive, "timeout": within(1.0, MOST_TIMEOUT_MS),
           "lets_go": one_of(*LetsGo), "limit": within(0.01, 1.0), "mode": one_of("position", "pwm"), "stall": numbers}
FAMILIES = (8, 9)  # low byte of the model number: SMS and STS
MODEL, RETURN_DELAY, LEAST, MODE = (3, 2), (7, 1), (9, 4), (33, 1)  # addresses and bytes of permanent numbers
TORQUE, ACCELERATION, GOAL, PWM, LIMIT, PRESENT = (40, 1), (41, 1), (42, 2), (44, 2), (48, 2), (56, 8)
POSITION_MODE, PWM_MODE = 0, 2
FASTEST = 254  # acceleration: the servo itself smooths no goal
FULL = 1000  # PWM, and limit of the torque, of 100 %
SIGN, PWM_SIGN = 1 << 15, 1 << 10  # bits
HOT = 4
FLAGS = {1: "its supply voltage is out of range", 2: "its angle sensor fails", HOT: "it is too hot",
         8: "its current is too high", 32: "it is overloaded"}
SLOW_US = 100  # that a servo waits before it answers


class FeetechChain(SdkChain):
    """A chain of STS or SMS servos. `stall`: N m at full PWM, in the servos' PWM mode; None: positions.

    `limit`: the part of its torque that a servo uses at most; None: as it is set.
    """

    def __init__(self, port: str, ids: tuple[tuple[int, float], ...], *, baud: int = 1_000_000,
                 timeout: float = TIMEOUT_MS,
                 limit: float | None = None, stall: tuple[float, ...] | None = None) -> None:
        super().__init__(scservo_sdk, scservo_sdk.PacketHandler(0), "feetech", port, baud, ids, timeout)
        self.notes: list[str] = []
        self._limit = limit
        self._stall = None if stall is None else for_each("feetech's stall", stall, len(ids))
        self._is_on = False
        self._range = [(0, COUNTS - 1)] * len(ids)  # counts that each goal may have
        self._counts: list[int] = []  # that were read last

    def open(self) -> None:
        """Open the port, and see that each servo answers, of which kind it is and in which mode. Moves nothing."""
        self.connect()
        self.find()
        mode = POSITION_MODE if self._stall is None else PWM_MODE
        self._range, self.notes, self._is_on = [], [], False
        delay = 0
        for each in self.ids:
            model = self.read_register(each, *MODEL)
            if model & 0xFF not in FAMILIES:
                raise Refused(f"servo {each} on {self.port} is of model {model}, and this driver knows the STS and SMS "
                              "series, whose positions have 4096 steps a turn; take those")
            if (has := self.read_register(each, *MODE)) != mode:
                raise Refused(f"servo {each} on {self.port} is in mode {has}, and mode {mode} is needed; set it with "
                              "the vendor's tool (Operating_Mode, address 33)")
            limits = self.read_register(each, *LEAST)
            least, most = limits & 0xFFFF, limits >> 16
            self._range.append((least, most) if least < most else (0, COUNTS - 1))
            delay = max(delay, 2 * self.read_register(each, *RETURN_DELAY))
            self.write_register(each, *ACCELERATION, FASTEST)
            if self._limit is not None:
                self.write_register(each, *LIMIT, round(FULL * self._limit))
        if delay > SLOW_US:
            self.notes.append(f"its servos wait {delay} us before they answer; set Return_Delay_Time (address 7) to 0 "
                              "with the vendor's tool for a higher rate")

    def read(self) -> Axes:
        """Read each joint's position, rad. Raises `DeviceError` where one passed the seam of its encoder."""
        counts = [_signed(int.from_bytes(each[:2], "little"), SIGN) for each in self.read_block(*PRESENT)]
        for servo, now, before in zip(self.ids, counts, self._counts, strict=False):
            if abs(now - before) > COUNTS // 2:
                raise DeviceError(f"servo {servo} on {self.port} went over the seam of its encoder, from {before} to "
                                  f"{now} of {COUNTS}; move it back, and calibrate its middle ({ZERO}) to where the "
                                  "joint is in the middle of its range")
        self._counts = counts
        return tuple([sign * (each - ZERO) * RADIANS for sign, each in zip(self.signs, counts, strict=True)])

    def write(self, values: Axes) -> None:
        """Give goals, within the limits of each servo, and switch the torque on if it is off."""
        self._give(values)
        if not self._is_on:
            self.write_all(*TORQUE, [1] * len(self.ids))
            self._is_on = True

    def _give(self, values: Axes) -> None:
        if self._stall is None:
            self.write_all(*GOAL, [_pack(max(low, min(high, ZERO + round(sign * x / RADIANS))), SIGN) for x, sign, (
                low, high) in zip(values, self.signs, self._range, strict=True)])
        else:
            self.write_all(*PWM, [_pack(round(FULL * max(-1.0, min(1.0, sign * each / stall))), PWM_SIGN)
                                for each, sign, stall in zip(values, self.signs, self._stall, strict=True)])

    def rest(self, how: LetsGo, at: Axes | None = None) -> Axes | None:
        """Give each servo its own position, or `at`, as its goal, or switch its torque off; a PWM becomes 0."""
        if self._stall is not None:
            self.write_all(*PWM, [0] * len(self.ids))
        elif how is LetsGo.HOLD:
            at = self.read() if at is None else at
            self._give(at)
            return at
        self.write_all(*TORQUE, [0] * len(self.ids))
        self._is_on = False
        return None

    def rearm(self) -> None:
        """Nothing: these servos have no watchdog of their line."""

    def length_of(self, packet: list[int]) -> int:
        """Return how many bytes an answer brings, beside its error and its checksum."""
        return packet[3] - 2

    def check_flags(self, servo: int, flags: int, data: bytes) -> None:
        """Raise `ServoFault` for what a servo reports of itself."""
        words = [text for bit, text in FLAGS.items() if flags & bit]
        if flags & HOT and len(data) == PRESENT[1]:
            words[-1] += f" ({data[-1]} degrees Celsius)"
        if words:
            raise ServoFault(f"servo {servo} on {self.port} reports: {' and '.join(words)}; all torques are off until "
                             "it reports nothing")


def _signed(number: int, sign: int) -> int:
    """Undo sign and magnitude."""
    return -(number & ~sign) if number & sign else number


def _pack(number: int, sign: int) -> int:
    return -number | sign if number < 0 else number


def feetech_device(scene: Scene, port: str) -> LiveDevice:
    """Feetech STS or SMS servos at the master's end, feetech:PORT; see teleop/live/devices/arms/README.md."""
    return DRIVER.arm(scene, port, "m")


def feetech_robot(scene: Scene, port: str) -> LiveDevice:
    """Feetech STS or SMS servos at the slave's end, feetech:PORT; see teleop/live/devices/arms/README.md."""
    return DRIVER.arm(scene, port, "s")


def _chain(argument: str, ids: tuple[tuple[int, float], ...]) -> FeetechChain:
    port, settings = settings_of("feetech", argument, READERS, EXAMPLE)
    if (settings.get("mode") == "pwm") is not ("stall" in settings):
        raise Refused("feetech's PWM mode needs the torque at full PWM, stall= in N m, and positions need none; write "
                      f"mode=pwm&stall=1.5, or neither: {EXAMPLE}")
    return FeetechChain(port, ids, baud=settings.get("baud", 1_000_000),
                          timeout=settings.get("timeout", TIMEOUT_MS), limit=settings.get("limit"),
                        stall=settings.get("stall"))


DRIVER = SdkDriver("feetech", __name__, READERS, EXAMPLE, _chain, ("mode", "stall"), "mode=pwm&stall=1.5", None)
feetech_bus = DRIVER.bus
letting_go = DRIVER.letting_go  # of the watchdog process
