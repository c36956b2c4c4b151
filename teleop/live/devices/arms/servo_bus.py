"""Servos in a chain on a serial adapter: a thread exchanges with them, and a tick reads the newest that it has.

A vendor's call blocks, 34 ms where a servo does not answer and for ever where an adapter hangs, so no tick makes one.
The thread writes the newest goal and reads all positions, as fast as the adapter carries or at a typed rate. A goal
that no tick renews for 0.1 s is let go of by the thread; of a process that is gone, stopped or holds the interpreter's
lock the watchdog process does it, over the same port (`letting_go` of each driver).
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from enum import StrEnum
from math import pi
from pathlib import Path
from statistics import median
from time import monotonic_ns, sleep
from typing import Any, NamedTuple, Protocol

from teleop.errors import DeviceError, Refused, number_of
from teleop.live.devices.device_watchdog import DeviceWatchdog
from teleop.protocol.endpoint import Axes, Reading
from teleop.scene.scene import Scene

TerminalError: type[Exception] = OSError
with suppress(ImportError):  # of a system without terminals
    import termios

    TerminalError = termios.error
COUNTS = 4096  # of a turn, of both vendors' servos
RADIANS = 2.0 * pi / COUNTS  # of a count
ZERO = 2048  # counts, half a turn: x = 0
TIMEOUT_MS = 34.0  # for an answer, beside the time that its bytes take: as long as both SDKs wait
MOST_TIMEOUT_MS = 80.0  # the thread must come round to what is to be let go of
STALE_NS = 16_000_000  # beyond that a position is no longer where the joint is
LAPSE_NS = 100_000_000  # a goal that was not renewed is let go of
SILENT_NS = 500_000_000  # then the line is left to the watchdog process for so long
RETRY_NS = 250_000_000  # between two attempts to open a port again
WINDOW_NS = 20_000_000  # over which the velocity is taken
PIECE_S = 0.002  # that a read waits in the system; the SDKs themselves look again and again without a pause
LEAST_S = 0.0005  # between two exchanges: the tick gets the interpreter
REPEATS = 3  # of what nobody answers
STOP_S = 0.5  # for the thread to let go and end
KEPT = 2000  # durations of exchanges


class LetsGo(StrEnum):
    """State in which servos are left: with the goal where they are, or without torque."""

    HOLD = "hold"
    LIMP = "limp"


class ServoFault(DeviceError):
    """An error that a servo reports of itself, such as its temperature: the chain goes limp."""


class Chain(Protocol):
    """Servos of one vendor, called from one thread at a time. Its calls block, and raise `DeviceError` or OSError."""

    name: str
    port: str
    timeout_ms: float  # for an answer

    def open(self) -> None:
        """Open the port, and see that each servo answers and is set up as it must be; moves nothing."""

    def read(self) -> Axes:
        """Read the position of each joint, rad."""

    def write(self, values: Axes) -> None:
        """Give each joint its goal, rad, or its torque, N m; with the torque on from then on."""

    def rest(self, how: LetsGo) -> None:
        """Hold each joint where it is, or switch the torque off; a torque becomes zero."""

    def rearm(self) -> None:
        """Make goals count again after a pause of the line."""

    def close(self) -> None:
        """Close the port."""


class Sample(NamedTuple):
    t: int  # ns, when it was read
    x: Axes  # rad


class ServoBus:
    """Joints of a `Chain`, exchanged with by a thread. All calls but `close` return at once.

    What is wrong is a `DeviceError` of one sentence. A port that is lost is opened again every 0.25 s.
    """

    def __init__(self, chain: Chain, *, lets_go: LetsGo = LetsGo.HOLD, rate: float | None = None,
                 watchdog: DeviceWatchdog | None = None) -> None:
        """Raises `Refused` or `DeviceError` if it cannot be driven. `rate`: Hz; None: what the adapter carries."""
        self.watchdog = watchdog
        self.exchange_s: deque[float] = deque(maxlen=KEPT)
        self._chain, self._lets_go = chain, lets_go
        self._period_ns = 0 if rate is None else round(1e9 / rate)
        self._goal: Axes | None = None
        self._renewed = self._wanted = monotonic_ns()
        self._stale_ns = STALE_NS + round(1e6 * chain.timeout_ms)
        self._limps = self._is_limp = False
        self._why: str | None = None
        self._rested = 0  # ns, when a goal that was not renewed was let go of; 0: none was
        self._retry = 0
        self._open = True
        self._last = monotonic_ns()  # of the last exchange
        try:
            chain.open()
            first = Sample(monotonic_ns(), chain.read())
        except BaseException:
            chain.close()
            raise
        self._samples: deque[Sample] = deque((first, first), maxlen=64)
        self._newest = (first, (0.0,) * len(first.x))
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"{chain.name} {chain.port}", daemon=True)
        self._thread.start()

    @property
    def rate(self) -> float:
        """Exchanges a second that the adapter carries, by the median of the newest ones; 0.0 before there is one."""
        times = list(self.exchange_s)
        return 1.0 / max(median(times), 1e-9) if times else 0.0

    @property
    def notes(self) -> list[str]:
        """Sentences on what slows the line down."""
        wait = latency_timer(self._chain.port)
        slow = [] if wait is None or wait <= 1 else [
            f"the adapter at {self._chain.port} holds back what it receives for {wait} ms; type as root: echo 1 > "
            f"{_timer(self._chain.port)}"]
        return [*slow, *getattr(self._chain, "notes", [])]

    def read(self) -> Axes:
        """Newest positions, rad. Raises `DeviceError` where there are none that are new."""
        self._wanted = now = monotonic_ns()
        self._check(now)
        return self._newest[0].x

    def velocities(self) -> Axes:
        """Slopes of the positions over the last 20 ms, rad/s."""
        return self._newest[1]

    def goal(self, x: Axes) -> None:
        """Give each joint a goal, rad (of a chain of torques N m). Raises `DeviceError` where it cannot arrive."""
        if len(x) != len(self._newest[0].x):
            raise DeviceError(f"{self._chain.name} has {number_of(len(self._newest[0].x), 'joint')}, and was given "
                              f"{number_of(len(x), 'goal')}")
        self._renewed = now = monotonic_ns()
        self._goal, self._limps = tuple(x), False
        self._check(now)

    def limp(self) -> None:
        """Switch the torque off. Raises `DeviceError` where that cannot arrive."""
        self._limps, self._goal = True, None
        self._check(monotonic_ns())

    def close(self) -> None:
        """Let the joints go and close the port. Raises `DeviceError` if the servos may still hold their goal."""
        self._done.set()
        self._thread.join(STOP_S)
        if self._thread.is_alive():
            raise DeviceError(f"{self._chain.port} does not take what it is sent, and its servos may still hold their "
                              "goal: switch them off")
        why: Exception | None = None
        for _ in range(3):
            try:
                self._chain.rest(LetsGo.LIMP if self._limps else self._lets_go)
                why = None
                break
            except (DeviceError, OSError) as error:
                why = error
        self._chain.close()
        if why is not None:
            raise DeviceError(f"{why}; its servos may still hold their goal: switch them off")

    def _check(self, now: int) -> None:
        if self._why is not None:
            raise DeviceError(self._why)
        if now - self._newest[0].t > self._stale_ns and now - self._rested > self._stale_ns:
            raise DeviceError(f"{self._chain.port} has given no position for {(now - self._newest[0].t) / 1e9:.3f} s")

    def _run(self) -> None:
        began = monotonic_ns()
        while not self._done.wait(max(LEAST_S, (began + self._period_ns - monotonic_ns()) / 1e9)):
            began = monotonic_ns()
            if self._rested and began - self._rested < SILENT_NS and max(self._wanted, self._renewed) < self._rested:
                continue
            try:
                self._exchange(began)
            except ServoFault as error:
                self._lose(error, began)
                self._goal = None
                with suppress(DeviceError, OSError):
                    self._chain.rest(LetsGo.LIMP)
            except (DeviceError, OSError) as error:
                self._lose(error, began)
            except Exception as error:  # of a library that does not expect what a line can bring
                self._lose(DeviceError(f"{type(error).__name__} in the library of {self._chain.name}: {error}"), began)

    def _exchange(self, now: int) -> None:
        if not self._open:
            if now < self._retry:
                return
            self._retry = now + RETRY_NS
            self._chain.open()
            self._open = True
            self._chain.rest(self._lets_go)  # what it held is not what anybody wants now
        elif now - self._last > LAPSE_NS // 2:
            self._chain.rearm()
        goal = self._goal
        if self._limps:
            if not self._is_limp:
                self._chain.rest(LetsGo.LIMP)
                self._is_limp = True
        elif goal is not None and now - self._renewed > LAPSE_NS:
            self._chain.rest(self._lets_go)
            if self._goal is goal:
                self._goal = None
            self._rested = now
        elif goal is not None:
            self._is_limp = False
            self._chain.write(goal)
        x = self._chain.read()
        end = self._last = monotonic_ns()
        if goal is not None or self._limps or not self.exchange_s:
            self.exchange_s.append((end - now) / 1e9)
        self._publish(Sample(end, x))
        self._why = None

    def _publish(self, sample: Sample) -> None:
        self._samples.append(sample)
        while len(self._samples) > 2 and sample.t - self._samples[1].t >= WINDOW_NS:
            self._samples.popleft()
        since = self._samples[0]
        span = max(sample.t - since.t, 1) / 1e9
        self._newest = sample, tuple([(a - b) / span for a, b in zip(sample.x, since.x, strict=True)])

    def _lose(self, error: Exception, now: int) -> None:
        self._why = str(error) or type(error).__name__
        self._is_limp = False
        if isinstance(error, OSError) and self._open:
            self._open, self._retry = False, now + RETRY_NS
            self._why = f"{self._chain.port} is lost ({error_text(error)})"
            with suppress(Exception):
                self._chain.close()
        self._done.wait(0.005)


class TorqueArm:
    """Joints of a chain of torques as a device: `hold` gives N m, `read` rad and rad/s, without a force sensor.

    `push`: 1.0 at the slave, -1.0 at the master, whose motors push against the hand. `deadline`: s after which the
    servos let go by themselves; None: they do not.
    """

    senses = False

    def __init__(self, bus: ServoBus, push: float, deadline: float | None) -> None:
        self.bus, self._push = bus, push
        self.watchdog = bus.watchdog
        if deadline is not None:
            self.deadline = deadline

    @property
    def notes(self) -> list[str]:
        """Sentences on the bus, for a check and for the summary of a run."""
        return self.bus.notes

    def read(self, k: int) -> Reading:
        """Newest positions of the bus."""
        x = self.bus.read()
        return Reading(x, self.bus.velocities())

    def hold(self, force: Axes) -> None:
        """Hold these torques, N m, from the next exchange on."""
        self.bus.goal(tuple([self._push * each for each in force]))

    def close(self) -> None:
        """Hold no torque, and close the port."""
        self.bus.close()


def watchdog_of(driver: str, argument: str, chain: SdkChain) -> DeviceWatchdog:
    """Make the watchdog of a chain: `letting_go` of its driver's module, in a process and on a port of its own."""
    return DeviceWatchdog(open=f"{driver}:letting_go", arguments=(argument, chain.signed_ids),
                          device=f"{chain.name} {chain.port}")


def rest_of(chain: Chain, lets_go: LetsGo) -> Callable[[], None]:
    """Make the function of the watchdog process; servos that cannot be read go limp.

    It repeats itself: half a packet of an end that was killed makes servos lose the first that follows it.
    """
    def let_go() -> None:
        for _ in range(REPEATS):
            chain.rearm()
            try:
                chain.rest(lets_go)
            except DeviceError:
                chain.rest(LetsGo.LIMP)
            sleep(PIECE_S)

    return let_go


class SdkChain:
    """Servos on one port that a vendor's SDK speaks to, every answer checked. `sdk`: its module."""

    def __init__(self, sdk: Any, packets: Any, name: str, port: str, baud: int,
                 ids: tuple[tuple[int, float], ...], timeout_ms: float = TIMEOUT_MS) -> None:
        self.name, self.port, self.baud, self.timeout_ms = name, port, baud, timeout_ms
        self.ids, self.signs = tuple(each for each, _ in ids), tuple(sign for _, sign in ids)
        self._sdk, self._packets, self._handler = sdk, packets, sdk.PortHandler(port)
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
                self.get(each, 0, 1)
            except DeviceError as error:
                answering = [one for one in range(1, 13) if one != each and self._answers(one)]
                raise DeviceError(f"{error}; " + (
                    f"those that answer at {self.baud} baud among 1 to 12 are {', '.join(map(str, answering))}: name "
                    "them by ?ids=" if answering else f"nor does any other of 1 to 12 at {self.baud} baud: see to its "
                    "power and its cable, or type ?baud=")) from None

    def _answers(self, servo: int) -> bool:
        try:
            self.get(servo, 0, 1)
        except DeviceError:
            return False
        return True

    def get(self, servo: int, address: int, length: int) -> int:
        """Read one number of a servo's table."""
        data, result, flags = self._calling(
            servo, lambda: self._packets.readTxRx(self._handler, servo, address, length), clear=True)
        return int.from_bytes(self._checked(servo, data, result, flags, length), "little")

    def put(self, servo: int, address: int, length: int, value: int) -> None:
        """Write one number of a servo's table, and see that it was taken."""
        data = list((value % (1 << 8 * length)).to_bytes(length, "little"))
        result, flags = self._calling(
            servo, lambda: self._packets.writeTxRx(self._handler, servo, address, length, data), clear=True)
        self._checked(servo, b"", result, flags, 0)

    def get_all(self, address: int, length: int) -> list[bytes]:
        """Read a piece of every servo's table with one request."""
        more = self._sync_read_more()
        result = self._calling(self.ids[0], lambda: self._packets.syncReadTx(
            self._handler, address, length, list(self.ids), len(self.ids), *more), clear=True)
        if result != self._sdk.COMM_SUCCESS:
            raise DeviceError(f"{self.port} did not take a request of {self.name}")
        return [self._take(each, length) for each in self.ids]

    def _take(self, servo: int, length: int) -> bytes:
        """Take the answer of one servo to a request to all."""
        data, result, flags = self._calling(servo, lambda: self._packets.readRx(self._handler, servo, length))
        return self._checked(servo, data, result, flags, length)

    def put_all(self, address: int, length: int, values: list[int]) -> None:
        """Write a number of every servo's table with one packet, which none answers."""
        packed: list[int] = []
        for each, value in zip(self.ids, values, strict=True):
            packed += [each, *(value % (1 << 8 * length)).to_bytes(length, "little")]
        result = self._calling(self.ids[0], lambda: self._packets.syncWriteTxOnly(
            self._handler, address, length, packed, len(packed)))
        if result != self._sdk.COMM_SUCCESS:
            raise DeviceError(f"{self.port} did not take a command of {self.name}")

    def _sync_read_more(self) -> tuple[Any, ...]:
        """Further arguments of the SDK's sync read."""
        return ()

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

    def _checked(self, servo: int, data: Any, result: int, flags: int, length: int) -> bytes:
        if result == self._sdk.COMM_RX_TIMEOUT:
            raise DeviceError(f"servo {servo} on {self.port} does not answer")
        if result == self._sdk.COMM_RX_CORRUPT:
            raise DeviceError(f"servo {servo} on {self.port} answered with a packet that is damaged")
        if result != self._sdk.COMM_SUCCESS:
            raise DeviceError(f"{self.port} did not take a request to servo {servo}")
        self.check_flags(servo, flags)
        if (had := self.length_of(self._packet)) != length:  # the SDKs take the checksum of a short one for a byte
            raise DeviceError(f"servo {servo} on {self.port} answered with {number_of(had, 'byte')} of {length}")
        return bytes(data)

    def length_of(self, packet: list[int]) -> int:
        """Return how many bytes an answer brings."""
        raise NotImplementedError

    def check_flags(self, servo: int, flags: int) -> None:
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


def positions_alone(arm: str, torques: str) -> Refused:
    """Make the refusal of a chain that takes positions where a law gives forces."""
    return Refused(f"{arm} in its position mode takes positions, and a law gives forces; in a file of yours return "
                   f"PositionServo({arm}_bus(scene, argument), ...), or drive its torques by ?{torques}")


def latency_timer(port: str) -> int | None:
    """Read for how long (ms) an FTDI adapter holds back what it receives; None: it says nothing of that."""
    try:
        return int(_timer(port).read_text())
    except (OSError, ValueError):
        return None


def _timer(port: str) -> Path:
    return Path("/sys/bus/usb-serial/devices") / Path(os.path.realpath(port)).name / "latency_timer"


def error_text(error: OSError) -> str:
    """Return the system's own words for an error of a port."""
    return os.strerror(error.errno) if error.errno else str(error)
