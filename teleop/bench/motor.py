"""A motor that outlives the process that drives it, for measuring what lets go of it: `python -m teleop.bench.motor`.

It is a small file that both the end and the device's watchdog map into memory: the force that it holds, when the
watchdog set it to zero, and an order to hang, as a driver in C may, that no signal ends.
"""

from __future__ import annotations

import ctypes
import sys
import time
from collections.abc import Callable
from mmap import mmap
from pathlib import Path
from struct import Struct

from teleop.live.devices.device_watchdog import DeviceWatchdog
from teleop.live.end import end_main
from teleop.protocol.endpoint import Axes, Reading
from teleop.scene.scene import Scene

SIZE = 4096
HANG = 1
_FORCE, _WORD = Struct("=d"), Struct("=q")
_ZEROED, _ORDER, _HOLDS = 8, 16, 24  # where: ns at which the watchdog set it to zero last, the order, calls of `hold`


class Motor:
    """The file. `force` in N, `zeroed_ns` of the monotonic clock, 0 before; `holds` counts the end's calls."""

    def __init__(self, path: Path) -> None:
        if not path.exists():
            path.write_bytes(bytes(SIZE))
        with path.open("r+b") as file:
            self._page = mmap(file.fileno(), SIZE)

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
        self.watchdog = DeviceWatchdog(open="teleop.bench.motor:zeroing", arguments=(str(path.absolute()),))

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


if __name__ == "__main__":
    sys.exit(end_main("s", lambda scene: ClampedArm(scene, Path(sys.argv[1])), sys.argv[2:]))
