"""A periodic timer for asyncio that is late by tens of microseconds, not by a millisecond.

asyncio's own timers are rounded up to its selector's whole milliseconds. A Linux timerfd is a file that
becomes readable at the instant, so the loop wakes for it as it does for a socket. Where there is none, the
loop's own timers are used and `precise` says so.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import time
from collections.abc import Callable

_ABSOLUTE = 1  # TFD_TIMER_ABSTIME


class _Timespec(ctypes.Structure):
    _fields_ = (("sec", ctypes.c_long), ("nsec", ctypes.c_long))


class _Itimerspec(ctypes.Structure):
    _fields_ = (("interval", _Timespec), ("value", _Timespec))


def _timespec(ns: int) -> _Timespec:
    return _Timespec(ns // 1_000_000_000, ns % 1_000_000_000)


class Alarm:
    """Calls `wake` at instants of the monotonic clock (ns): once, or again every `interval_ns`."""

    def __init__(self, loop: asyncio.AbstractEventLoop, wake: Callable[[], None]) -> None:
        self._loop, self._wake = loop, wake
        self._fd = -1
        self._handle: asyncio.TimerHandle | None = None
        self._due, self._interval = 0, 0
        try:
            libc = ctypes.CDLL(None, use_errno=True)
            self._settime = libc.timerfd_settime
            self._fd = libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        except (OSError, AttributeError):
            self._fd = -1
        self.precise = self._fd >= 0
        if self.precise:
            loop.add_reader(self._fd, self._rang)

    def set(self, due_ns: int, interval_ns: int = 0) -> None:
        """Ring at `due_ns` (at once if it has passed), then every `interval_ns` if that is not 0."""
        if self.precise:
            # A value of zero would disarm the timer.
            spec = _Itimerspec(_timespec(interval_ns), _timespec(max(1, due_ns)))
            if self._settime(self._fd, _ABSOLUTE, ctypes.byref(spec), None):
                raise OSError(ctypes.get_errno(), "the timer cannot be set")
        else:
            self._due, self._interval = due_ns, interval_ns
            self._arm()

    def close(self) -> None:
        """Ring no more."""
        if self.precise:
            self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self.precise = False
        elif self._handle is not None:
            self._handle.cancel()

    def _rang(self) -> None:
        try:
            os.read(self._fd, 8)
        except BlockingIOError:
            return
        self._wake()

    def _arm(self) -> None:
        if self._handle is not None:
            self._handle.cancel()
        wait = max(0, self._due - time.monotonic_ns())
        self._handle = self._loop.call_later(wait / 1e9, self._rang_coarse)

    def _rang_coarse(self) -> None:
        if self._interval:
            behind = max(0, time.monotonic_ns() - self._due) // self._interval
            self._due += self._interval * (behind + 1)
            self._arm()
        self._wake()
