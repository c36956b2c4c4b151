"""A device beside which a watchdog process runs: the end's side, which renews a heartbeat with every force it holds.

For devices whose hardware has no deadline of its own. The two processes share a page of memory, eight words, and a
pipe. The heartbeat is the time at which a force other than zero was last renewed, or zero while none is held. The
pipe closes when this process dies, whatever it dies of; an end that has set its force to zero says so on it first.

When the watchdog sets the force to zero, it counts that in `FIRED` before it does so. An end that comes back
afterwards finds the count above its own, `ACKED`: it holds zero and nothing else until the watchdog has seen that
(`DONE`), and its device reads as failing for as long, so that the guard begins at gain zero. Then it is armed again.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from mmap import mmap
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any

from teleop.errors import DeviceError, Refused, number
from teleop.protocol.deadline import DEADLINE
from teleop.protocol.endpoint import Axes, Reading
from teleop.scene.library import ROOT, scene_folders

if TYPE_CHECKING:
    from teleop.live.devices.guarded_device import LiveDevice

BEAT, K, ACKED = 0, 1, 2  # words that the end writes: ns of its last force, tick, and the firings that it has seen
SEEN, FIRED, DONE = 3, 4, 5  # words that the watchdog writes: ns of its last look, firings, and those that are over
TEXT = 64  # bytes of the eight words; where a sentence begins, if the watchdog could not start
SIZE = 4096  # bytes of the page
GONE_NS = 1_000_000_000  # without a look of the watchdog for so long, the device is driven no more
START_S = 20.0  # for the watchdog to open the device
END_S = 3.0  # for it to end
GOODBYE = b"."


@dataclass(frozen=True, kw_only=True)
class DeviceWatchdog:
    """How a process beside the end reaches a device to set its force to zero: what a device has as `watchdog`.

    `open`: "module:function", importable where the end runs, without running the end. The function is called once, at
    the start, with `arguments` (texts), opens the device by itself and returns a function without arguments that sets
    its force to zero. That one is called while the end is silent for `deadline` seconds with a force held, or gone.
    `device`: the name by which one end at a time drives it; left out: `open` with its `arguments`.

    >>> DeviceWatchdog(open="my_arm:zeroing", arguments=("/dev/ttyACM0",)).deadline
    0.15
    """

    open: str
    arguments: tuple[str, ...] = ()
    deadline: float = DEADLINE
    device: str = ""

    def __post_init__(self) -> None:
        module, _, function = self.open.partition(":")
        if not (module and function.isidentifier()):
            raise Refused(f"a device watchdog opens its device by \"module:function\", not {self.open!r}; write for "
                          "example DeviceWatchdog(open=\"my_arm:zeroing\")")
        number("a device watchdog's deadline", self.deadline, above=0.01)


class WatchedDevice:
    """`device`, with the heartbeat of its watchdog in every `hold`. Costs about 1 us a tick.

    While its watchdog has taken over, or does not answer, it reads as a device that fails and holds zero.
    """

    def __init__(self, device: LiveDevice, deadline: float, page: mmap) -> None:
        self.device, self.deadline = device, deadline
        self.scene_body = getattr(device, "scene_body", False)
        self._words: Any = memoryview(page).cast("q")

    def read(self, k: int) -> Reading:
        """What the device reads. Raises `DeviceError` while its watchdog has taken over or does not answer."""
        words = self._words
        words[K] = k
        if words[FIRED] != words[ACKED]:
            raise DeviceError(f"its watchdog has set its force to zero, for no heartbeat came for {self.deadline:g} s")
        if time.monotonic_ns() - words[SEEN] > GONE_NS:
            raise DeviceError("its watchdog process does not answer, and without it nothing may be driven")
        return self.device.read(k)

    def hold(self, force: Axes) -> None:
        """Have the device hold `force` (N, per axis). Raises `DeviceError` if it holds zero instead."""
        words = self._words
        if not any(force):
            self._let_go(force)
        elif words[FIRED] != words[ACKED]:
            self._taken_over(force)
        else:
            if not words[BEAT]:
                words[BEAT] = time.monotonic_ns()  # armed before there is a force
            self.device.hold(force)
            words[BEAT] = time.monotonic_ns()
            if words[FIRED] != words[ACKED]:  # it took over just now, or while this process stood still in `hold`
                self._taken_over(force)

    def _let_go(self, zero: Axes) -> None:
        words = self._words
        self.device.hold(zero)
        words[BEAT] = 0
        if words[DONE] == words[FIRED]:
            words[ACKED] = words[FIRED]

    def _taken_over(self, force: Axes) -> None:
        self._let_go((0.0,) * len(force))
        raise DeviceError("its watchdog has taken over, and zero is held")

    @property
    def lets_go(self) -> bool:
        """True if the force that was held last is zero."""
        return not self._words[BEAT]

    def release(self) -> None:
        """Use the page no more: the run is over, and whatever is held from now on is held without a watchdog."""
        words, self._words = self._words, [0, 0, 0, 1 << 62, 0, 0, 0, 0]
        words.release()


@contextmanager
def watched(device: LiveDevice, folder: Path, priority: int | None = None,
            asked: DeviceWatchdog | None = None) -> Iterator[LiveDevice]:
    """`device` with its watchdog process, if it names one; the process ends with the block. Raises `Refused`.

    `asked`: the watchdog of a device that names none; None: that has no such process then.
    `folder`: of the run, where the watchdog notes in the events what it did. `priority`: what it asks for under
    SCHED_FIFO, to run before an end that is scheduled so; None for an end that is not.
    """
    watchdog: DeviceWatchdog | None = getattr(device, "watchdog", None) or asked
    if watchdog is None:
        yield device
        return
    deadlines = [one for one in (getattr(device, "deadline", None), watchdog.deadline) if one is not None]
    with _file() as file, mmap(file.fileno(), SIZE) as page:
        process, goodbye = _start(watchdog, file.fileno(), folder, priority)
        ours = WatchedDevice(device, min(deadlines), page)
        try:
            _await(process, page)
            yield ours
        finally:
            with suppress(OSError):  # the watchdog is gone
                if ours.lets_go:
                    os.write(goodbye, GOODBYE)
            ours.release()
            os.close(goodbye)
            with suppress(subprocess.TimeoutExpired):  # it goes on trying, and says what became of it
                process.wait(END_S)


def _file() -> IO[bytes]:
    """A file of one page, in memory alone if the system can: a page on its way to a disk would hold up a tick."""
    memory = getattr(os, "memfd_create", None)
    file: IO[bytes] = os.fdopen(memory("device watchdog"), "r+b") if memory else TemporaryFile()  # noqa: SIM115
    file.truncate(SIZE)
    return file


def _start(
    watchdog: DeviceWatchdog, page: int, folder: Path, priority: int | None
) -> tuple[subprocess.Popen[bytes], int]:
    """The process and the end of the pipe on which it is said goodbye to."""
    theirs, ours = os.pipe()
    about = {"open": watchdog.open, "arguments": watchdog.arguments, "deadline": watchdog.deadline, "page": page,
             "end": os.getpid(), "device": watchdog.device or " ".join([watchdog.open, *watchdog.arguments]),
             "pipe": theirs, "folder": str(folder.absolute()), "priority": priority}
    path = os.pathsep.join([str(ROOT), *(os.path.abspath(each) for each in (*sys.path, *scene_folders()))])
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "teleop.live.devices.device_watchdog", json.dumps(about)],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, pass_fds=(page, theirs),
            env={**os.environ, "PYTHONPATH": path},
            start_new_session=True,  # what the terminal sends the end does not reach it
        )
    except OSError as error:
        os.close(ours)
        raise Refused(f"the device's watchdog could not be started ({error.strerror or error}); without it nothing is "
                      "driven") from error
    finally:
        os.close(theirs)
    return process, ours


def _await(process: subprocess.Popen[bytes], page: mmap) -> None:
    """Wait until the watchdog looks after the device. Raises `Refused` with its reason if it cannot."""
    until = time.monotonic() + START_S
    with memoryview(page) as plain, plain.cast("q") as words:
        while not words[SEEN]:
            if process.poll() is not None:
                reason = bytes(page[TEXT:]).partition(b"\0")[0].decode(errors="replace")
                raise Refused(reason or f"the device's watchdog ended with exit code {process.returncode} at its start")
            if time.monotonic() > until:
                raise Refused(f"the device's watchdog was not ready in {START_S:g} s; see what its `open` waits for")
            time.sleep(0.005)
