"""Timers that are late by tens of microseconds, and the clock of suspension.

A live end sleeps from tick to tick (`Alarm`). The relay has sockets to wait for besides: it has a Linux timerfd
(`Timer`), a file that becomes readable at the instant.
"""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

_ABSOLUTE = 1  # TFD_TIMER_ABSTIME


class _Timespec(ctypes.Structure):
    _fields_ = (("sec", ctypes.c_long), ("nsec", ctypes.c_long))


class _Itimerspec(ctypes.Structure):
    _fields_ = (("interval", _Timespec), ("value", _Timespec))


class Timer:
    """A timerfd: `fd` becomes readable at instants of the monotonic clock (ns). Where there is none, it is -1."""

    def __init__(self) -> None:
        self.fd = -1
        self._spec = _Itimerspec()
        self._at = ctypes.byref(self._spec)
        try:
            libc = ctypes.CDLL(None, use_errno=True)
            self._settime = libc.timerfd_settime
            self.fd = libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        except (OSError, AttributeError):
            self.fd = -1

    def set(self, due_ns: int, interval_ns: int = 0) -> None:
        """Ring at `due_ns` (at once if it has passed), then every `interval_ns` if that is not 0."""
        spec = self._spec
        spec.interval.sec, spec.interval.nsec = divmod(interval_ns, 1_000_000_000)
        spec.value.sec, spec.value.nsec = divmod(max(1, due_ns), 1_000_000_000)  # zero would disarm it
        if self._settime(self.fd, _ABSOLUTE, self._at, None):
            raise OSError(ctypes.get_errno(), "the timer cannot be set")

    def expirations(self) -> int:
        """The number of times that it rang since the last call."""
        try:
            return int.from_bytes(os.read(self.fd, 8), "little")
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Ring no more."""
        with suppress(OSError):  # others have closed it
            os.close(self.fd)
        self.fd = -1


_SLACK = 29  # PR_SET_TIMERSLACK of Linux, which is 50 us by default for a thread that is not real-time


class Alarm:
    """Waits for instants of the monotonic clock (ns): for one, or for each of those `interval_ns` apart.

    With `spin_ns` it wakes so long before an instant, and is awake until then.
    """

    def __init__(self, spin_ns: int = 0) -> None:
        self._due, self._interval, self._early = 0, 0, spin_ns
        with suppress(OSError, AttributeError):  # elsewhere than on Linux the system wakes as it does
            ctypes.CDLL(None).prctl(_SLACK, 1, 0, 0, 0)

    def set(self, due_ns: int, interval_ns: int = 0) -> None:
        """Wait for `due_ns`, then for every `interval_ns` after it if that is not 0."""
        self._due, self._interval = due_ns, interval_ns

    def wait(self) -> None:
        """Sleep until the next instant, never less; return at once where it has passed. Those missed are skipped."""
        clock, due = time.monotonic_ns, self._due
        left = due - self._early - clock()
        if left > 0:
            time.sleep(left * 1e-9)
        while (now := clock()) < due:
            pass
        if self._interval:
            self._due = due + ((now - due) // self._interval + 1) * self._interval


LEAST_NS = 1_000_000  # shorter is no suspension

Clock = Callable[[], int]


def boottime() -> Clock | None:
    """A clock (ns) that counts the time in which the machine is suspended; None where the system has none."""
    which = getattr(time, "CLOCK_BOOTTIME", None)
    return None if which is None else partial(time.clock_gettime_ns, which)


class Suspension:
    """Suspension of the machine, seen by comparing `boot`, which counts it, with `mono`, which does not; both in ns.

    `time.monotonic_ns` is such a `mono` on Linux: all that an end knows of its peer is older than it says afterwards.
    Without `boot` no suspension is seen.
    """

    def __init__(self, boot: Clock | None, mono: Clock = time.monotonic_ns) -> None:
        self._boot, self._mono = boot, mono
        before = mono()
        self._apart = 0 if boot is None else boot() - before  # if anything, too large

    def duration(self) -> int:
        """Time for which the machine was suspended since the last call, ns; 0 if it was not."""
        # Read in this order the difference is too small, if anything, when the process is held up between the two.
        if self._boot is None:
            return 0
        apart = self._boot() - self._mono()
        slept = apart - self._apart
        if slept > 0:
            self._apart = apart
        return slept if slept > LEAST_NS else 0
