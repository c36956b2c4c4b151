"""The time for which a motor holds its force after the end that drives it was killed or stopped, has crashed, or hangs.

The motor outlives the end (`python -m teleop.bench.watchdog`) and has no deadline of its own: the device's watchdog
process (`teleop.live.devices.device_watchdog`) sets its force to zero. It is a small file that both the end and the
watchdog map into memory: the force that it holds, when the watchdog set it to zero, and an order to hang. It hangs as a
driver in C may, which no signal ends. Each trial is a live run of its own.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from mmap import mmap
from pathlib import Path
from statistics import median
from struct import Struct
from tempfile import TemporaryDirectory

from teleop.live.devices.device_watchdog import DeviceWatchdog
from teleop.live.end import end_main
from teleop.live.records.record import read_events
from teleop.protocol.endpoint import Axes, Reading
from teleop.protocol.guard import DEADLINE
from teleop.scene.library import ROOT
from teleop.scene.scene import Scene

PAGE_SIZE = 4096
HANG = 1
_FORCE, _WORD = Struct("=d"), Struct("=q")
_ZEROED, _ORDER, _HOLDS = 8, 16, 24  # where: ns at which the watchdog set it to zero last, the order, calls of `hold`


class Motor:
    """The file. `force` in N, `zeroed_ns` of the monotonic clock, 0 before; `holds` counts the end's calls."""

    def __init__(self, path: Path) -> None:
        if not path.exists():
            path.write_bytes(bytes(PAGE_SIZE))
        with path.open("r+b") as file:
            self._page = mmap(file.fileno(), PAGE_SIZE)

    @property
    def force(self) -> float:
        """The force that the motor holds now (N)."""
        force: float = _FORCE.unpack_from(self._page)[0]
        return force

    @property
    def zeroed_ns(self) -> int:
        """The time at which the watchdog set it to zero last (ns)."""
        return self._word(_ZEROED)

    @property
    def holds(self) -> int:
        """The number of times that the end has set its force."""
        return self._word(_HOLDS)

    @property
    def order(self) -> int:
        """The order to its driver: `HANG`, or 0."""
        return self._word(_ORDER)

    @order.setter
    def order(self, order: int) -> None:
        _WORD.pack_into(self._page, _ORDER, order)

    def hold(self, force: float) -> None:
        """Hold so much, as the end has it."""
        _FORCE.pack_into(self._page, 0, force)
        _WORD.pack_into(self._page, _HOLDS, self.holds + 1)

    def zero(self) -> None:
        """Hold nothing, as the watchdog has it."""
        _FORCE.pack_into(self._page, 0, 0.0)
        _WORD.pack_into(self._page, _ZEROED, time.monotonic_ns())

    def _word(self, at: int) -> int:
        word: int = _WORD.unpack_from(self._page, at)[0]
        return word


class ClampedArm:
    """A device that cannot move and whose motor is the file at `path`. Hangs in a call of C's when it is ordered to."""

    def __init__(self, scene: Scene, path: Path) -> None:
        self._at_rest = Reading(scene.vector("start_s", scene.start_s), (0.0,) * scene.axes, (0.0,) * scene.axes)
        self._motor = Motor(path)
        self.watchdog = DeviceWatchdog(open="teleop.bench.watchdog:zeroing", arguments=(str(path.absolute()),))

    def read(self, k: int) -> Reading:
        """The position at which it is clamped."""
        return self._at_rest

    def hold(self, force: Axes) -> None:
        """Set the motor's force."""
        if self._motor.order == HANG:
            _hang()
        self._motor.hold(force[0])


def zeroing(path: str) -> Callable[[], None]:
    """For the watchdog: opens the motor by itself; what is returned sets it to zero."""
    return Motor(Path(path)).zero


def _hang() -> None:
    """Wait for ever inside libc, with the interpreter's lock: no handler of a signal gets to run."""
    libc, mutex = ctypes.PyDLL(None), ctypes.create_string_buffer(128)
    for _ in range(2):
        libc.pthread_mutex_lock(mutex)


Row = tuple[str, str, str]
SCENE = ("hard_wall", "--set", "law=direct", "--link", "none", "--set", "duration=60")
FORCE = 1.0  # N at least, at the blow
CALM = 0.2  # s of it before
PATIENCE = 30.0  # s
TRIALS = 4  # of each blow in a round


def watchdog(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked), over 4 `rounds` trials of each blow."""
    rows: list[Row] = []
    early = 0
    for what, (blow, bound) in BLOWS.items():
        took = []
        for _ in range(TRIALS * rounds):
            with TemporaryDirectory() as name:
                one, before = trial(blow, Path(name))
            took.append(one)
            early += before
        rows.append((f"force is zero after {what}: median, most of {len(took)}",
                     f"{median(took) * 1e3:.1f}, {max(took) * 1e3:.1f} ms", f"asked: at most {bound * 1e3:.0f}"))
    rows.append(("the watchdog acted before the blow, in all of these", str(early), "asked: at most 0"))
    return rows


def trial(blow: Callable[[int, Motor], None], folder: Path) -> tuple[float, int]:
    """Seconds from the blow to zero force, and how often the watchdog had acted before it."""
    motor = Motor(folder / "motor")
    with Ends(folder) as ends:
        until = time.monotonic() + PATIENCE
        since = None
        while since is None or time.monotonic() - since < CALM:
            if abs(motor.force) < FORCE:
                since = None
            elif since is None:
                since = time.monotonic()
            if time.monotonic() > until:
                raise TimeoutError("no force came about in this run")
            time.sleep(0.002)
        early = acted(folder / "slave")
        began = time.monotonic_ns()
        blow(ends.slave.pid, motor)
        while motor.zeroed_ns < began:
            if time.monotonic() > until:
                raise TimeoutError("the force was not set to zero")
            time.sleep(0.0005)
        took = (motor.zeroed_ns - began) / 1e9
    return took, early


def acted(folder: Path) -> int:
    """The number of times that the watchdog of the end in `folder` has acted."""
    return sum(event.get("what") == "watchdog" for event in read_events(folder))


class Ends:
    """A slave that drives the motor in `folder`, and a master, until the block ends; then both are killed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._processes: list[subprocess.Popen[str]] = []

    def __enter__(self) -> Ends:
        self.slave = self._start("slave", "--listen", "127.0.0.1:0")
        assert self.slave.stdout is not None
        port = json.loads(self.slave.stdout.readline())["port"]
        self.master = self._start("master", "--peer", f"127.0.0.1:{port}")
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            process.kill()
            process.communicate()

    def _start(self, name: str, *options: str) -> subprocess.Popen[str]:
        program = ["teleop.bench.watchdog", str(self._folder / "motor")] if name == "slave" else [name]
        process = subprocess.Popen(
            [sys.executable, "-m", *program, *SCENE, *options, "--out", str(self._folder / name), "--json"], cwd=ROOT,
            text=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )
        self._processes.append(process)
        return process


def _signals(number: signal.Signals) -> Callable[[int, Motor], None]:
    return lambda pid, _motor: os.kill(pid, number)


def _hangs(_pid: int, motor: Motor) -> None:
    motor.order = HANG


BLOWS: dict[str, tuple[Callable[[int, Motor], None], float]] = {
    "SIGKILL": (_signals(signal.SIGKILL), 0.1), "SIGSEGV": (_signals(signal.SIGSEGV), 0.1),
    "SIGSTOP": (_signals(signal.SIGSTOP), 2 * DEADLINE), "a hang in its driver": (_hangs, 2 * DEADLINE),
}


if __name__ == "__main__":
    sys.exit(end_main("s", lambda scene: ClampedArm(scene, Path(sys.argv[1])), sys.argv[2:]))
