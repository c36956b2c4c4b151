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
from contextlib import suppress
from enum import StrEnum
from math import pi
from pathlib import Path
from statistics import median
from time import monotonic_ns, sleep
from typing import NamedTuple, Protocol

from teleop.errors import DeviceError, number_of
from teleop.live.devices.device_watchdog import DeviceWatchdog
from teleop.protocol.endpoint import Axes, Reading

COUNTS = 4096  # of a turn, of both vendors' servos
RADIANS = 2.0 * pi / COUNTS  # of a count
ZERO = 2048  # counts, half a turn: x = 0
TIMEOUT_MS = 34.0  # for an answer, beside the time that its bytes take: as long as both SDKs wait
MOST_TIMEOUT_MS = 80.0  # the thread must come round to what is to be let go of
STALE_NS = 16_000_000  # beyond that a position is no longer where the joint is
LAPSE_NS = 100_000_000  # a goal that was not renewed is let go of
SILENT_NS = 500_000_000  # then the line is left to the watchdog process for so long
WAKE_NS = 50_000_000  # that a reading waits after that
RETRY_NS = 250_000_000  # between two attempts to open a port again
WINDOW_NS = 20_000_000  # over which the velocity is taken
LEAST_S = 0.0005  # between two exchanges: the tick gets the interpreter
STOP_S = 0.5  # for the thread to let go and end
KEPT = 2000  # durations of exchanges


class LetsGo(StrEnum):
    """State in which servos are left: with the goal where they are, or without torque."""

    HOLD = "hold"
    LIMP = "limp"


class ServoFault(DeviceError):
    """An error that a servo reports of itself, such as its temperature: the chain goes limp."""


class ServoChain(Protocol):
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

    def rest(self, how: LetsGo, at: Axes | None = None) -> Axes | None:
        """Hold each joint `at` (rad; left out, where it is), or switch the torque off; a torque becomes zero.

        Returns where the joints are held, None where they are not.
        """

    def rearm(self) -> None:
        """Make goals count again after a pause of the line."""

    def close(self) -> None:
        """Close the port."""


class Sample(NamedTuple):
    t: int  # ns, when it was read
    x: Axes  # rad


class ServoBus:
    """Joints of a `ServoChain`, exchanged with by a thread. All calls but `close` return at once.

    What is wrong is a `DeviceError` of one sentence. A port that is lost is opened again every 0.25 s.
    """

    def __init__(self, chain: ServoChain, *, lets_go: LetsGo = LetsGo.HOLD, rate: float | None = None,
                 watchdog: DeviceWatchdog | None = None) -> None:
        """Raises `Refused` or `DeviceError` if it cannot be driven. `rate`: Hz; None: what the adapter carries."""
        self.watchdog = watchdog
        self.exchange_s: deque[float] = deque(maxlen=KEPT)
        self._chain, self._lets_go = chain, lets_go
        self._period_ns = 0 if rate is None else round(1e9 / rate)
        self._goal: Axes | None = None
        self._renewed = self._wanted = monotonic_ns()
        self._stale_ns = STALE_NS + round(1e6 * chain.timeout_ms)
        self._limps = self._is_limp = self._faulty = self._silent = False
        self._why: str | None = None
        self._rested = 0  # ns, when a goal that was not renewed was let go of; 0: none was
        self._retry = 0
        self._open = True
        self._last = monotonic_ns()  # of the last exchange
        try:
            chain.open()
            first = _first(chain)
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
        """Newest positions, rad. Raises `DeviceError` where there are none that are new.

        Waits up to 50 ms for the first ones after a pause in which the line was left to the watchdog process.
        """
        self._wanted = now = monotonic_ns()
        until = now + WAKE_NS
        while self._silent and now < until:
            sleep(LEAST_S)
            now = monotonic_ns()
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
        if now - self._newest[0].t > self._stale_ns:
            raise DeviceError(f"{self._chain.port} has given no position for {(now - self._newest[0].t) / 1e9:.3f} s")

    def _run(self) -> None:
        began = monotonic_ns()
        while not self._done.wait(max(LEAST_S, (began + self._period_ns - monotonic_ns()) / 1e9)):
            began = monotonic_ns()
            if self._rested and began - self._rested < SILENT_NS and max(self._wanted, self._renewed) < self._rested:
                self._silent = True
                continue
            try:
                self._exchange(began)
            except ServoFault as error:
                self._lose(error, began)
                self._faulty = True
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
        goal = None if self._faulty else self._goal
        if self._limps and not self._faulty:
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
        if self._faulty:  # no more: what it was given meanwhile is old
            self._faulty, self._goal = False, None
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
        self._silent = False
        self._newest = sample, tuple([(a - b) / span for a, b in zip(sample.x, since.x, strict=True)])

    def _lose(self, error: Exception, now: int) -> None:
        self._why = str(error) or type(error).__name__
        self._is_limp = self._silent = False
        if isinstance(error, OSError) and self._open:
            self._open, self._retry = False, now + RETRY_NS
            self._why = f"{self._chain.port} is lost ({error_text(error)})"
            with suppress(Exception):
                self._chain.close()
        self._done.wait(0.005)


def _first(chain: ServoChain) -> Sample:
    """Read a chain for the first time; a lost answer is asked for again, twice."""
    for _ in range(2):
        with suppress(DeviceError):
            return Sample(monotonic_ns(), chain.read())
    return Sample(monotonic_ns(), chain.read())


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
