"""The watchdog process of a device: sets its force to zero when the end that drives it is silent or gone.

Started by `teleop.live.devices.heartbeat`, never by hand. It outlives the end: it has a session of its own, ignores any
signal that can be ignored, and ends when the end has said goodbye, or is gone and the force is zero. A device has one
at a time, so an end that is started again waits for the watchdog of the one before, and is never zeroed by it.
"""

from __future__ import annotations

import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stderr, suppress
from importlib import import_module
from io import StringIO
from mmap import mmap
from pathlib import Path
from typing import Any

from teleop.errors import Refused
from teleop.live.devices.device_lock import take_lock
from teleop.live.devices.heartbeat import ACKED, BEAT, DONE, FIRED, GOODBYE, SEEN, SIZE, TEXT, K
from teleop.live.process.output import live
from teleop.live.process.realtime import run_first
from teleop.live.records.record import EVENTS
from teleop.protocol.deadline import Silence
from teleop.protocol.guard import Event

RETRY_S = 5.0  # for a device that cannot be set to zero, once the end is gone
HEEDED = {signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT, signal.SIGCHLD}  # its own


class Watching:
    """What the process does at each look. Times are ns of the monotonic clock, `words` the page shared with the end."""

    def __init__(self, words: Any, zero: Callable[[], object], deadline: float, tell: Callable[[str], None]) -> None:
        self.silence = Silence(round(deadline * 1e9))
        self._words, self._zero, self._tell = words, zero, tell
        self._beat = 0  # the heartbeat at which it fired
        self._is_zero = False  # since it fired
        self._again = 0  # when the force is to be set to zero again
        self._failed = ""

    def look(self, clock: Callable[[], int]) -> None:
        """See whether the end is still there, and act if it is not."""
        words = self._words
        now = clock()  # before the heartbeat is read: see `Silence`
        beat = words[BEAT]
        words[SEEN] = now
        if words[FIRED] != words[ACKED]:
            if beat != self._beat:  # the end is back, and holds zero
                words[DONE] = words[FIRED]
            elif now >= self._again:  # a call that hung in the driver may have come through after all
                self._set(now, clock)
        elif self.silence.overdue(now, beat):
            self._beat, self._is_zero = beat, False
            words[FIRED] += 1
            if words[BEAT] == beat:
                self._set(now, clock)

    def gone(self) -> bool:
        """The end has died: set the force to zero; False if that failed."""
        self._is_zero = False
        return self._attempt("the end that drove the device is gone")

    def _set(self, now: int, clock: Callable[[], int]) -> None:
        if self._attempt(f"no heartbeat of the end that drives the device for {(now - self._beat) / 1e9:.3f} s"):
            self._again = clock() + self.silence.deadline_ns
        else:
            self._again = clock() + self.silence.look_ns

    def _attempt(self, why: str) -> bool:
        try:
            self._zero()
        except BaseException as error:  # whatever its driver raises, this process goes on
            failed = f"{why}, and its force could not be set to zero: {type(error).__name__}: {error}"
            if not self._failed:
                self._tell(failed)
            self._failed = failed
            return False
        if not self._is_zero:
            self._tell(f"{why}; its force was set to zero")
        self._is_zero, self._failed = True, ""
        return True


def main(argv: list[str]) -> int:
    """The whole process; its exit code."""
    for each in signal.valid_signals() - HEEDED:
        with suppress(OSError, ValueError):  # SIGKILL and SIGSTOP cannot be ignored
            signal.signal(each, signal.SIG_IGN)
    about = json.loads(argv[0])
    with live(), mmap(about["page"], SIZE) as page, memoryview(page) as plain, plain.cast("q") as words:
        try:
            lock = take_lock(about["device"], about["end"])
            zero = opened(about["open"], about["arguments"])
        except Refused as refused:
            sentence = str(refused).encode()[: SIZE - TEXT - 1]
            page[TEXT : TEXT + len(sentence)] = sentence
            return 2
        _first(about["priority"])
        watching = Watching(words, zero, about["deadline"], lambda what: _tell(what, words[K], Path(about["folder"])))
        code = _watch(watching, about["pipe"])
        if lock is not None:
            os.close(lock)
    return code


def _watch(watching: Watching, pipe: int) -> int:
    poll = select.poll()
    poll.register(pipe, select.POLLIN)
    wait = watching.silence.look_ns / 1e6
    while not poll.poll(wait):
        watching.look(time.monotonic_ns)
    if os.read(pipe, 1) == GOODBYE:
        return 0
    until = time.monotonic() + RETRY_S
    while not watching.gone():
        if time.monotonic() > until:
            return 1
        time.sleep(wait / 1e3)
    return 0


def opened(target: str, arguments: list[str]) -> Callable[[], object]:
    """The function that sets the force of the device to zero. Raises `Refused`."""
    name, _, function = target.partition(":")
    printed = StringIO()
    try:
        with redirect_stderr(printed):
            module = import_module(name)
        print(printed.getvalue(), end="", file=sys.stderr, flush=True)
        zero = getattr(module, function)(*arguments)
    except SystemExit as error:
        raise Refused(f"the device's watchdog imported {name}, which ran as a program; write `if __name__ == "
                      f"\"__main__\":` before the line there that calls end_main") from error
    except BaseException as error:
        why = f"{type(error).__name__}: {error}"
        raise Refused(f"the device's watchdog could not open it by {target} ({why})") from error
    if not callable(zero):
        raise Refused(f"{target} returned {zero!r}; let it return the function that sets the force to zero")
    opened_zero: Callable[[], object] = zero
    return opened_zero


def _first(priority: int | None) -> None:
    """Of an end that is scheduled before all others, the watchdog runs before the end."""
    if priority is not None:
        with suppress(OSError, AttributeError):
            run_first(priority)


def _tell(what: str, k: int, folder: Path) -> None:
    with suppress(OSError), (folder / EVENTS).open("a") as file:
        file.write(json.dumps(Event(k, "watchdog", what)._asdict()) + "\n")
    print(f"device watchdog: {what}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
