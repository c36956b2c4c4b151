"""Dynamixel X servos by ROBOTIS' SDK: `dynamixel:PORT`, positions with a bounded current, or torques by the current.

    python -m slave bench_top --set axes=4 --set units=rad --listen 0.0.0.0:9001 \
        --robot "dynamixel:/dev/ttyUSB0?mode=current&kt=1.78&limit=0.5"

Numbers of the X series' table as the e-manual has them. The operating mode is written where it is another one, since
the torque is off for that. In both modes the servos' Bus Watchdog is armed: without any packet for 0.1 s they stop by
themselves.
"""

from __future__ import annotations

from inspect import signature

try:
    import dynamixel_sdk
except ModuleNotFoundError as error:
    raise ImportError("Dynamixel servos are reached by ROBOTIS' SDK, which is not installed; type pip install "
                      "'bilateral-teleop[dynamixel]', or pip install dynamixel-sdk") from error
from teleop.errors import DeviceError, Refused
from teleop.live.devices.arms.sdk_chain import SdkChain, SdkDriver
from teleop.live.devices.arms.servo_bus import (
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
from teleop.protocol.guard import DEADLINE
from teleop.scene.scene import Scene

EXAMPLE = "dynamixel:/dev/ttyUSB0?ids=1-6"
READERS = {"ids": ids_of, "baud": whole, "rate": positive, "timeout": within(1.0, MOST_TIMEOUT_MS),
           "lets_go": one_of(*LetsGo), "mode": one_of("position", "current"), "kt": numbers, "limit": numbers,
           "unit": numbers}
UNIT_MA = {1020: 2.69, 1030: 2.69, 1120: 2.69, 1130: 2.69, 1190: 1.0, 1200: 1.0}  # of XM430, XM540, XL330, by model
MODEL, RETURN_DELAY, MODE, MOST_CURRENT = (0, 2), (9, 1), (11, 1), (38, 2)  # addresses and bytes
TORQUE, FAULTS, WATCHDOG, CURRENT, GOAL, PRESENT = (64, 1), (70, 1), (98, 1), (102, 2), (116, 4), (132, 4)
CURRENT_MODE, POSITION_MODE = 0, 5  # the latter bounded by the goal current, over several turns
WATCHDOG_UNITS = 5  # of 20 ms
ALERT = 0x80  # of the error byte of an answer: see FAULTS
ERRORS = {1: "could not do it", 2: "does not know the instruction", 3: "got a damaged packet", 4: "got a number out of "
          "its range", 5: "got too few bytes", 6: "got a number beyond its limits", 7: "may not be written there now"}
FAULT_TEXT = {1: "its supply voltage is out of range", 4: "it is too hot", 8: "its encoder fails",
              16: "its circuit had a shock", 32: "it is overloaded"}
SLOW_US = 100  # that a servo waits before it answers


class DynamixelChain(SdkChain):
    """A chain of X servos. `kt`: N m/A of torques by the current; None: positions.

    `limit`: A, that a servo draws at most; None: its own limit. `unit`: mA of a count of the current, where the model
    is not known.
    """

    def __init__(self, port: str, ids: tuple[tuple[int, float], ...], *, baud: int = 1_000_000,
                 timeout: float = TIMEOUT_MS,
                 kt: tuple[float, ...] | None = None, limit: tuple[float, ...] | None = None,
                 unit: tuple[float, ...] | None = None) -> None:
        super().__init__(dynamixel_sdk, dynamixel_sdk.PacketHandler(2.0), "dynamixel", port, baud, ids, timeout)
        if "fast_option" in signature(self._packets.syncReadTx).parameters:  # since version 4 of the SDK
            self.read_options = (False,)  # a status packet from each servo
        self.notes: list[str] = []
        self._kt, self._limit, self._unit = [None if each is None else for_each(f"dynamixel's {name}", each, len(ids))
                                             for name, each in (("kt", kt), ("limit", limit), ("unit", unit))]
        self._is_on = False
        self._bounds: list[int] = []  # counts of the current
        self._units: list[float] = []  # A of a count

    def open(self) -> None:
        """Open the port, see that each servo answers and what it is, and set its mode. Moves nothing."""
        self.connect()
        self.find()
        self._bounds, self._units, self.notes, self._is_on = [], [], [], False
        delay = 0
        for i, each in enumerate(self.ids):
            model = self.read_register(each, *MODEL)
            unit = UNIT_MA.get(model) if self._unit is None else self._unit[i]
            if unit is None:
                raise Refused(f"servo {each} on {self.port} is of model {model}, whose unit of the current is not "
                              "known here; type the mA that its manual has for Goal Current, for example ?unit=2.69")
            most = self.read_register(each, *MOST_CURRENT)
            self._units.append(unit / 1e3)
            self._bounds.append(most if self._limit is None else min(most, round(self._limit[i] / (unit / 1e3))))
            delay = max(delay, 2 * self.read_register(each, *RETURN_DELAY))
            mode = POSITION_MODE if self._kt is None else CURRENT_MODE
            self.write_register(each, *WATCHDOG, 0)  # clears what it may have noted of an earlier run
            if self.read_register(each, *MODE) != mode:
                self.write_register(each, *TORQUE, 0)
                self.write_register(each, *MODE, mode)
        if delay > SLOW_US:
            self.notes.append(f"its servos wait {delay} us before they answer; set Return Delay Time (address 9) to 0 "
                              "with the vendor's tool for a higher rate")

    def read(self) -> Axes:
        """Read each joint's position, rad."""
        counts = [int.from_bytes(each, "little", signed=True) for each in self.read_block(*PRESENT)]
        return tuple([sign * (each - ZERO) * RADIANS for sign, each in zip(self.signs, counts, strict=True)])

    def write(self, values: Axes) -> None:
        """Give goals or torques, and switch the torque on if it is off."""
        self._give(values)
        if not self._is_on:
            if self._kt is None:
                self.write_all(*CURRENT, self._bounds)
            self.write_all(*TORQUE, [1] * len(self.ids))
            self.write_all(*WATCHDOG, [WATCHDOG_UNITS] * len(self.ids))
            self._is_on = True
            self._give(values)  # a servo that was off may have set its goal to where it is

    def _give(self, values: Axes) -> None:
        if self._kt is None:
            self.write_all(*GOAL, [ZERO + round(sign * x / RADIANS) for sign, x in zip(
                self.signs, values, strict=True)])
            return
        counts = [round(sign * each / kt / unit) for each, sign, kt, unit in zip(
            values, self.signs, self._kt, self._units, strict=True)]
        self.write_all(*CURRENT, [max(-most, min(most, each)) for each, most in zip(counts, self._bounds, strict=True)])

    def rest(self, how: LetsGo, at: Axes | None = None) -> Axes | None:
        """Give each servo its own position, or `at`, as its goal, or switch its torque off; a current becomes 0."""
        if self._kt is not None:
            self.write_all(*CURRENT, [0] * len(self.ids))
        elif how is LetsGo.HOLD:
            at = self.read() if at is None else at
            self._give(at)
            return at
        self.write_all(*TORQUE, [0] * len(self.ids))
        self._is_on = False
        return None

    def rearm(self) -> None:
        """Clear the Bus Watchdog, which may have stopped the servos in a pause of the line, and arm it again."""
        self.write_all(*WATCHDOG, [0] * len(self.ids))
        if self._is_on:
            self.write_all(*WATCHDOG, [WATCHDOG_UNITS] * len(self.ids))

    def length_of(self, packet: list[int]) -> int:
        """Return how many bytes an answer brings, beside its instruction, its error and its checksum."""
        return packet[5] + (packet[6] << 8) - 4

    def check_flags(self, servo: int, flags: int, data: bytes) -> None:
        """Raise `ServoFault` for what a servo reports of itself, `DeviceError` for what it did not take."""
        if flags & ALERT:
            answer, result, _ = self._packets.readTxRx(self._handler, servo, *FAULTS)
            faults = answer[0] if result == self._sdk.COMM_SUCCESS and answer else 0
            words = [text for bit, text in FAULT_TEXT.items() if faults & bit] or ["it has an error of its hardware"]
            raise ServoFault(f"servo {servo} on {self.port} reports: {' and '.join(words)}; all torques are off until "
                             "it reports nothing (a restart of the servo clears it)")
        if flags:
            raise DeviceError(f"servo {servo} on {self.port} {ERRORS.get(flags, f'answered with error {flags}')}")


def dynamixel_device(scene: Scene, port: str) -> LiveDevice:
    """Dynamixel X servos at the master's end, dynamixel:PORT; see teleop/live/devices/arms/README.md."""
    return DRIVER.arm(scene, port, "m")


def dynamixel_robot(scene: Scene, port: str) -> LiveDevice:
    """Dynamixel X servos at the slave's end, dynamixel:PORT; see teleop/live/devices/arms/README.md."""
    return DRIVER.arm(scene, port, "s")


def _chain(argument: str, ids: tuple[tuple[int, float], ...]) -> DynamixelChain:
    port, settings = settings_of("dynamixel", argument, READERS, EXAMPLE)
    if (settings.get("mode") == "current") is not ("kt" in settings):
        raise Refused("dynamixel's torques need mode=current and the N m of an ampere, and positions neither; write "
                      "for example mode=current&kt=1.78 (XM430-W350: 4.1 N m at 2.3 A), or leave both out")
    return DynamixelChain(port, ids, baud=settings.get("baud", 1_000_000),
                          timeout=settings.get("timeout", TIMEOUT_MS), kt=settings.get("kt"),
                          limit=settings.get("limit"), unit=settings.get("unit"))


DRIVER = SdkDriver("dynamixel", __name__, READERS, EXAMPLE, _chain, ("mode", "kt"), "mode=current&kt=1.78", DEADLINE)
dynamixel_bus = DRIVER.bus
letting_go = DRIVER.letting_go  # of the watchdog process
