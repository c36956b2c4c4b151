"""Servos that a vendor's SDK speaks to over a serial port, with every answer checked.

The SDKs of Feetech and ROBOTIS have the same calls. Neither checks the length of an answer, and Feetech's drops no late
one: both are done here.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from time import monotonic_ns, sleep
from typing import Any, NamedTuple

from teleop.errors import DeviceError, Refused, number_of
from teleop.live.devices.arms.servo_bus import TIMEOUT_MS, LetsGo, ServoBus, ServoChain, TorqueArm, error_text
from teleop.live.devices.device_watchdog import DeviceWatchdog
from teleop.live.devices.guarded_device import LiveDevice
from teleop.live.devices.position_servo import position_arm
from teleop.live.devices.settings import Reader, ids_of, settings_of
from teleop.protocol.endpoint import Axes
from teleop.scene.scene import Scene

TerminalError: type[Exception] = OSError
with suppress(ImportError):  # of a system without terminals
    import termios

    TerminalError = termios.error
PIECE_S = 0.002  # that a read waits in the system; the SDKs themselves look again and again without a pause
SAME_NS = 500_000_000  # between two calls of a watchdog that fired once
TRIES = 3  # of a number of a table, before a run
REPEATS = 3  # of what nobody answers


class SdkDriver(NamedTuple):
    """Driver of one vendor's chains, by the address that is typed. Its calls raise `Refused` or `DeviceError`."""

    name: str
    module: str  # importable by the watchdog process, with `letting_go`
    readers: Mapping[str, Reader]
    example: str
    chain: Callable[[str, tuple[tuple[int, float], ...]], Any]  # makes an `SdkChain` of an address and ids
    torques: tuple[str, ...]  # settings of a chain that takes torques,
    typed: str  # ... and how they are typed
    deadline: float | None  # s, after which the servos let a torque go by themselves

    def settings(self, argument: str) -> dict[str, Any]:
        """Read the settings behind the address."""
        return settings_of(self.name, argument, self.readers, self.example)[1]

    def bus(self, scene: Scene, argument: str) -> ServoBus:
        """Open the bus that `PORT?ids=...` describes."""
        settings = self.settings(argument)
        chain = self.chain(argument, bus_ids(scene, settings, self.name))
        watchdog = DeviceWatchdog(open=f"{self.module}:letting_go", arguments=(argument, chain.signed_ids),
                                  device=f"{chain.name} {os.path.realpath(chain.port)}")
        return ServoBus(chain, lets_go=self.lets_go(argument), rate=settings.get("rate"), watchdog=watchdog)

    def arm(self, scene: Scene, argument: str, e: str) -> LiveDevice:
        """Open the arm at an end, "m" or "s": of torques, where they are typed, else of positions."""
        if not {*self.torques} & self.settings(argument).keys():
            return position_arm(scene, e, lambda: self.bus(scene, argument), f"drive its torques by ?{self.typed}")
        return TorqueArm(self.bus(scene, argument), 1.0 if e == "s" else -1.0, self.deadline)

    def lets_go(self, argument: str) -> LetsGo:
        """Read how the servos are left."""
        return LetsGo(self.settings(argument).get("lets_go", "hold"))

    def letting_go(self, argument: str, ids: str) -> Callable[[], None]:
        """Make the function of the watchdog process, which lets the servos go over a port of its own."""
        chain = self.chain(argument, ids_of("ids", ids))
        chain.connect()
        return rest_of(chain, self.lets_go(argument))


def rest_of(chain: ServoChain, lets_go: LetsGo) -> Callable[[], None]:
    """Make the function of the watchdog process; servos that cannot be read go limp.

    It repeats itself: half a packet of an end that was killed makes servos lose the first that follows it. Called again
    within half a second it holds the joints where it held them before, or they would sink from call to call.
    """
    at: Axes | None = None
    called = 0

    def let_go() -> None:
        nonlocal at, called
        if monotonic_ns() - called > SAME_NS:
            at = None
        for _ in range(REPEATS):
            chain.rearm()
            try:
                at = chain.rest(lets_go, at)
            except DeviceError:
                chain.rest(LetsGo.LIMP)
            sleep(PIECE_S)
        called = monotonic_ns()

    return let_go


class SdkChain:
    """Servos on one port that a vendor's SDK speaks to, every answer checked. `sdk`: its module."""

    def __init__(self, sdk: Any, packets: Any, name: str, port: str, baud: int,
                 ids: tuple[tuple[int, float], ...], timeout_ms: float = TIMEOUT_MS) -> None:
        self.name, self.port, self.baud, self.timeout_ms = name, port, baud, timeout_ms
        self.ids, self.signs = tuple(each for each, _ in ids), tuple(sign for _, sign in ids)
        self._sdk, self._packets, self._handler = sdk, packets, sdk.PortHandler(port)
        self.read_options: tuple[Any, ...] = ()  # further arguments of the SDK's sync read
        self._packet: list[int] = []  # that came last
        receive = packets.rxPacket

        def receive_packet(*arguments: Any) -> tuple[list[int], int]:
            self._packet, result = receive(*arguments)
            return self._packet, result

        packets.rxPacket = receive_packet
        self._handler.setPacketTimeout = lambda length: self._handler.setPacketTimeoutMillis(
            self._handler.tx_time_per_byte * length + timeout_ms)

    @property
    def signed_ids(self) -> str:
        """The ids as they are typed."""
        return ",".join(f"{'-' if sign < 0 else ''}{each}" for each, sign in zip(self.ids, self.signs, strict=True))

    def connect(self) -> None:
        """Open the port. Raises `Refused` or `DeviceError`."""
        try:
            if not self._handler.setBaudRate(self.baud):
                raise Refused(f"{self.name} has no baud rate {self.baud}; its own is 1000000: leave ?baud= out")
        except OSError as error:
            raise DeviceError(f"{self.port} cannot be opened ({error_text(error)}); name the port of the adapter, for "
                              f"example {self.name}:/dev/ttyACM0, and see that you may write to it (group dialout)"
                              ) from error
        self._handler.ser.timeout = PIECE_S
        self._handler.is_using = False

    def close(self) -> None:
        """Close the port; nothing if it is closed."""
        if self._handler.ser is not None:
            self._handler.ser.close()

    def find(self) -> None:
        """See that each servo answers. Raises `DeviceError` with the ids that do."""
        for each in self.ids:
            try:
                self.read_register(each, 0, 1)
            except DeviceError as error:
                answering = [one for one in range(1, 13) if one != each and self._answers(one)]
                raise DeviceError(f"{error}; " + (
                    f"those that answer at {self.baud} baud among 1 to 12 are {', '.join(map(str, answering))}: name "
                    "them by ?ids=" if answering else f"nor does any other of 1 to 12 at {self.baud} baud: see to its "
                    "power and its cable, or type ?baud=")) from None

    def _answers(self, servo: int) -> bool:
        try:
            self.read_register(servo, 0, 1, tries=1)
        except DeviceError:
            return False
        return True

    def read_register(self, servo: int, address: int, length: int, tries: int = TRIES) -> int:
        """Read one number of a servo's table; a lost answer is asked for again."""
        for left in reversed(range(tries)):
            data, result, flags = self._calling(
                servo, lambda: self._packets.readTxRx(self._handler, servo, address, length), clear=True)
            if result == self._sdk.COMM_SUCCESS or not left:
                break
        return int.from_bytes(self._checked(servo, data, result, flags, self._had(result), length), "little")

    def write_register(self, servo: int, address: int, length: int, value: int) -> None:
        """Write one number of a servo's table, and see that it was taken; where no answer comes, again."""
        data = list((value % (1 << 8 * length)).to_bytes(length, "little"))
        for _ in range(TRIES):
            result, flags = self._calling(
                servo, lambda: self._packets.writeTxRx(self._handler, servo, address, length, data), clear=True)
            if result == self._sdk.COMM_SUCCESS:
                break
        self._checked(servo, b"", result, flags, 0, 0)

    def read_block(self, address: int, length: int) -> list[bytes]:
        """Read a piece of every servo's table with one request."""
        result = self._calling(self.ids[0], lambda: self._packets.syncReadTx(
            self._handler, address, length, list(self.ids), len(self.ids), *self.read_options), clear=True)
        if result != self._sdk.COMM_SUCCESS:
            raise DeviceError(f"{self.port} did not take a request of {self.name}")
        answers = []
        for each in self.ids:  # all of them, before one that reports an error is asked for more: they share the line
            answers.append((each, *self._receive(each, length)))
            if answers[-1][2] != self._sdk.COMM_SUCCESS:
                break
        return [self._checked(*answer, length) for answer in answers]

    def _receive(self, servo: int, length: int) -> tuple[Any, int, int, int]:
        """Receive the answer of one servo to a request to all: its bytes, the result, its error, how many bytes."""
        data, result, flags = self._calling(servo, lambda: self._packets.readRx(self._handler, servo, length))
        return data, result, flags, self._had(result)

    def _had(self, result: int) -> int:
        return self.length_of(self._packet) if result == self._sdk.COMM_SUCCESS else 0

    def write_all(self, address: int, length: int, values: list[int]) -> None:
        """Write a number of every servo's table with one packet, which none answers."""
        packed: list[int] = []
        for each, value in zip(self.ids, values, strict=True):
            packed += [each, *(value % (1 << 8 * length)).to_bytes(length, "little")]
        result = self._calling(self.ids[0], lambda: self._packets.syncWriteTxOnly(
            self._handler, address, length, packed, len(packed)))
        if result != self._sdk.COMM_SUCCESS:
            raise DeviceError(f"{self.port} did not take a command of {self.name}")

    def _calling(self, servo: int, call: Callable[[], Any], *, clear: bool = False) -> Any:
        """Call the SDK. `clear`: drop a late answer to an earlier request, which would be taken for one to this."""
        try:
            if clear:
                self._handler.ser.reset_input_buffer()
            return call()
        except TerminalError as error:
            raise OSError(*error.args) from error
        except IndexError:  # of a status packet that is shorter than the SDK believes
            raise DeviceError(f"servo {servo} on {self.port} answered with a packet that is too short") from None
        finally:
            self._handler.is_using = False

    def _checked(self, servo: int, data: Any, result: int, flags: int, had: int, length: int) -> bytes:
        """Return the bytes of an answer that has `had` of them, for `length`. Raises `DeviceError`."""
        if result == self._sdk.COMM_RX_TIMEOUT:
            raise DeviceError(f"servo {servo} on {self.port} does not answer")
        if result == self._sdk.COMM_RX_CORRUPT:
            raise DeviceError(f"servo {servo} on {self.port} answered with a packet that is damaged")
        if result != self._sdk.COMM_SUCCESS:
            raise DeviceError(f"{self.port} did not take a request to servo {servo}")
        self.check_flags(servo, flags, bytes(data))
        if had != length:  # the SDKs take the checksum of a short one for a byte
            raise DeviceError(f"servo {servo} on {self.port} answered with {number_of(had, 'byte')} of {length}")
        return bytes(data)

    def length_of(self, packet: list[int]) -> int:
        """Return how many bytes an answer brings."""
        raise NotImplementedError

    def check_flags(self, servo: int, flags: int, data: bytes) -> None:
        """Raise `ServoFault` for an error that a servo reports in an answer."""


def bus_ids(scene: Scene, settings: dict[str, Any], arm: str) -> tuple[tuple[int, float], ...]:
    """Return the typed ids, or 1 to the number of axes. Raises `Refused` for a scene that has no such joints."""
    ids: tuple[tuple[int, float], ...] = settings.get("ids") or tuple((i + 1, 1.0) for i in range(scene.axes))
    if len(ids) != scene.axes:
        raise Refused(f"the scene has {number_of(scene.axes, 'axis', 'axes')}, and {arm} was given "
                      f"{number_of(len(ids), 'id')}; name one for each axis, for example ids=1-{scene.axes}")
    if (units := set(scene.axis_units)) != {"rad"}:
        raise Refused(f"{arm} has joints, and the scene's axes are in {' and '.join(sorted(units))}; take "
                      f"a scene in rad, for example bench_top with --set axes={scene.axes} --set units=rad")
    return ids
