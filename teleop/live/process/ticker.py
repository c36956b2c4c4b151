"""A periodic timer for asyncio that is late by tens of microseconds, not by a millisecond.

asyncio's own timers are rounded up to its selector's whole milliseconds. A Linux timerfd is a file that
becomes readable at the instant, so the loop wakes for it as it does for a socket. Where there is none, the
loop's own timers are used and `precise` says so.

What is left is the time that the system takes to wake a process, and asyncio to come to the point. The second is
known, and the timer is set earlier by it. An alarm with `spin_ns` is woken earlier still and waits for the instant
awake, which costs that share of a core and takes the first away too.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import time
from collections.abc import Callable
from contextlib import suppress

from teleop.live.process.tick_loop import TickLoop

_ABSOLUTE = 1  # TFD_TIMER_ABSTIME
_LOOP_NS = 15_000  # from waking up to the callback; where that is faster, the rest is waited for


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

    def rang(self) -> int:
        """How often it has rung since this was asked last."""
        try:
            return int.from_bytes(os.read(self.fd, 8), "little")
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Ring no more."""
        with suppress(OSError):  # others have closed it
            os.close(self.fd)
        self.fd = -1


class Alarm:
    """Calls `wake` at instants of the monotonic clock (ns): once, or again every `interval_ns`; never before them.

    With `spin_ns` it is there so long before an instant, and awake until then. What is not precise cannot do that.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, wake: Callable[[], None], spin_ns: int = 0) -> None:
        self._loop, self._wake = loop, wake
        self._handle: asyncio.TimerHandle | None = None
        self._due, self._interval, self._early = 0, 0, max(spin_ns, _LOOP_NS)
        self._timer = Timer()
        self.precise = self._timer.fd >= 0
        if self.precise:
            (loop.ring if isinstance(loop, TickLoop) else loop.add_reader)(self._timer.fd, self._rang)

    def set(self, due_ns: int, interval_ns: int = 0) -> None:
        """Ring at `due_ns` (at once if it has passed), then every `interval_ns` if that is not 0."""
        self._due, self._interval = due_ns, interval_ns
        if self.precise:
            self._timer.set(due_ns - self._early, interval_ns)
        else:
            self._arm()

    def close(self) -> None:
        """Ring no more."""
        if self.precise:
            loop = self._loop
            (loop.ring_no_more if isinstance(loop, TickLoop) else loop.remove_reader)(self._timer.fd)
            self._timer.close()
            self.precise = False
        elif self._handle is not None:
            self._handle.cancel()

    def _rang(self) -> None:
        """Of the instants that rang, wait for the last: those before it have passed."""
        rang = self._timer.rang()
        if not rang:
            return
        clock, due = time.monotonic_ns, self._due + (rang - 1) * self._interval
        self._due = due + self._interval
        while clock() < due:
            pass
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
