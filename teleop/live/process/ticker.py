"""Timers for asyncio that are late by tens of microseconds, not by a millisecond, and the clock of suspension.

asyncio's own timers are rounded up to its selector's whole milliseconds. A Linux timerfd is a file that becomes
readable at the instant, so the loop wakes for it as it does for a socket. Where there is none, the loop's own timers
are used and `precise` says so.

What remains is the time that the system takes to wake a process, and asyncio to come to the point. The second is
known, and the timer is set earlier by it. An alarm with `spin_ns` is woken earlier still and waits for the instant
awake, which costs that share of a core and takes the first away too.

To asyncio a timer that rings is a readable file: a key to look up, a list of events, a handle that is queued and run in
a context, and all that a thousand times a second with cold caches. In `TickLoop` the selector calls the reader itself
and returns the other events, of which there are nearly always none.
"""

from __future__ import annotations

import asyncio
import ctypes
import gc
import os
import select
import selectors
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from functools import partial
from typing import Any

_MOST = 16  # events in one call
_LOOK_S = 0.1  # without any event, after which the timers are checked: others may have closed one


if hasattr(select, "epoll"):

    class _Ringing(selectors.EpollSelector):
        """Selector that calls `readers`, by the file of their timer, when it rings."""

        def __init__(self) -> None:
            super().__init__()
            self.readers: dict[int, Callable[[], None]] = {}
            self.epoll: Any = self._selector  # type: ignore[attr-defined]  # typeshed lacks it

        def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
            """Call the readers of the timers that rang; return the other files that are ready."""
            readers = self.readers
            if not readers:
                return super().select(timeout)
            ready: list[tuple[selectors.SelectorKey, int]] = []
            longest = _LOOK_S if timeout is None else min(max(timeout, 0.0), _LOOK_S)
            try:
                events = self.epoll.poll(longest, _MOST)
            except InterruptedError:
                return ready
            if not events and longest == _LOOK_S:
                for fd in readers:
                    self.epoll.modify(fd, select.EPOLLIN)  # raises OSError if somebody has closed that timer
            for fd, event in events:
                if fd in readers:
                    readers[fd]()
                else:
                    key = self.get_map()[fd]
                    mask = (selectors.EVENT_WRITE if event & ~select.EPOLLIN else 0) | (
                        selectors.EVENT_READ if event & ~select.EPOLLOUT else 0)
                    ready.append((key, mask & key.events))
            return ready


class TickLoop(asyncio.SelectorEventLoop):
    """asyncio's own loop with `ring`. It needs epoll: see `available`."""

    available = hasattr(select, "epoll")

    def __init__(self) -> None:
        self._ringing = _Ringing()
        super().__init__(self._ringing)

    def ring(self, fd: int, reader: Callable[[], None]) -> None:
        """Call `reader` whenever the timer behind `fd` rings; what it raises is reported as asyncio does."""
        def call() -> None:
            try:
                reader()
            except Exception as error:
                self.call_exception_handler({"message": "a timer's reader raised", "exception": error})

        self._ringing.readers[fd] = call
        self._ringing.epoll.register(fd, select.EPOLLIN)

    def ring_no_more(self, fd: int) -> None:
        """Forget that timer."""
        del self._ringing.readers[fd]
        with suppress(OSError):  # others have closed it
            self._ringing.epoll.unregister(fd)


def in_tick_loop(main: Coroutine[Any, Any, None], failed: Callable[[BaseException], None] = lambda _: None) -> None:
    """Run like `asyncio.run`, in such a loop where the system has epoll.

    `failed` gets the error that ended it, before the loop is taken down.
    """
    with asyncio.Runner(loop_factory=TickLoop if TickLoop.available else None) as runner:
        try:
            runner.run(main)
        except BaseException as error:
            failed(error)
            gc.freeze()  # a loop whose files are gone cannot be closed, and would say so when it is collected
            raise


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
        """Wait for the last of the instants that rang: those before it have passed."""
        count = self._timer.expirations()
        if not count:
            return
        clock, due = time.monotonic_ns, self._due + (count - 1) * self._interval
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
