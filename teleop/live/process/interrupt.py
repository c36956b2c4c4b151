"""Signals that would end or stop the process, taken note of from the first moment to the last.

The loops look at the note when they can stop cleanly. So a signal neither cuts the writing of a record in
two, nor does one that comes early, or twice, end the process before it has told the other end.

Drivers are other people's code, and some take SIGINT or SIGTERM for themselves while they are opened, in Python or
below it. `Interrupt.retake` compares each signal with what was put there, on both levels, and takes it back.

Four kinds of signals that end a process by default are not taken. No process can take SIGKILL. After SIGSEGV, SIGBUS,
SIGFPE and SIGILL the failed instruction would fail again for ever. Python ignores SIGPIPE and SIGXFSZ. SIGSTOP, which
stops a process, cannot be taken. Ctrl-Z (SIGTSTP) is taken: a process that is stopped holds its force.
"""

from __future__ import annotations

import ctypes
import signal
from collections.abc import Callable
from contextlib import suppress
from types import FrameType, TracebackType
from typing import Any

ALWAYS = (signal.SIGINT, signal.SIGTERM)
OTHERS = ("SIGHUP", "SIGQUIT", "SIGUSR1", "SIGUSR2", "SIGABRT", "SIGALRM", "SIGVTALRM", "SIGPROF", "SIGIO", "SIGPWR",
          "SIGSTKFLT", "SIGTRAP", "SIGSYS", "SIGXCPU", "SIGTSTP", "SIGTTIN")
OVERRUN = getattr(signal, "SIGXCPU", None)  # without a sleep for too long, under real-time scheduling
REAL_TIME = range(getattr(signal, "SIGRTMIN", 0), getattr(signal, "SIGRTMAX", -1) + 1)

SHARE = 10  # of the signals

_SIZE = 256  # bytes of a struct sigaction, and more; the handler is its first word in every C library here
_HANDLER = ctypes.sizeof(ctypes.c_void_p)
_DEFAULT = bytes(_HANDLER)
_DEFAULTS = (signal.SIG_DFL, signal.default_int_handler)


def name_of(number: int) -> str:
    """Name of a signal.

    >>> name_of(1), name_of(40)
    ('SIGHUP', 'SIGRTMIN+6')
    """
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"SIGRTMIN+{number - REAL_TIME.start}"


class Interrupt:
    """While it is entered, `name` is None until a signal came, then the first signal's name; `count` says how many.

    What was ignored before stays so, as SIGHUP under nohup, and what has a handler keeps it; SIGINT and SIGTERM are
    taken whatever handler they had.
    """

    def __init__(self) -> None:
        self.name: str | None = None
        self.count = 0
        self.seen = 0  # by `LastResort`: two of one kind that come while compiled code runs are one to a handler
        self.overrun: Callable[[], None] | None = None  # heeds the first SIGXCPU, see `realtime`
        self._overran = False
        self.wakeup = -1  # where `LastResort` hears of signals, by the handler in C
        self.lost = False  # True once `LastResort` has found a signal that is not taken any more
        self._sigaction: Any = getattr(ctypes.CDLL(None), "sigaction", None)
        self._looks = 0  # for signals that were taken below Python
        self.times = 0  # that any was taken back
        self._before: dict[int, Any] = {}
        self._actions: dict[int, bytes] = {}
        self._retaken: set[int] = set()  # and not yet told

    @property
    def signals(self) -> frozenset[int]:
        """The numbers of the signals that are noted."""
        return frozenset(self._before)

    def __enter__(self) -> Interrupt:
        others = [int(getattr(signal, name)) for name in OTHERS if hasattr(signal, name)]
        for number in (*ALWAYS, *others, *REAL_TIME):
            if number in ALWAYS or signal.getsignal(number) in _DEFAULTS:
                with suppress(OSError, ValueError):  # this system keeps it for itself
                    self._before[number] = signal.signal(number, self._note)
                    self._actions[number] = self._action(number)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for number, handler in self._before.items():  # whatever has become of them
            signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def restore(self) -> None:
        """Take back the signals that were taken below Python, and set `lost` if any was. For any thread.

        Only the main thread can set a handler in Python: see `retake`. Of those that are not in `ALWAYS` one in `SHARE`
        is looked at, in turn: all of them at each look are 0.3 % of a core, of the 10 to 20 % that a live end takes.
        """
        self._looks += 1
        for number, action in self._actions.items():
            if (number in ALWAYS or (number + self._looks) % SHARE == 0) and self._is_lost(number):
                self.lost = True
                if self._is_lost_below(number):
                    self._sigaction(number, action, None)
                    self._retaken.add(number)

    def retake(self) -> None:
        """Take back each signal that foreign code has taken or blocked since. For the main thread."""
        self.lost = False
        blocked = signal.pthread_sigmask(signal.SIG_UNBLOCK, self.signals) & self.signals
        self._retaken.update(number for number in self._before if number in blocked or self._is_lost(number))
        self.times += bool(self._retaken)
        for number in self._retaken:
            signal.signal(number, self._note)
        if self.wakeup >= 0:
            with suppress(OSError, ValueError):  # that has been closed too; `LastResort` will see it
                signal.set_wakeup_fd(self.wakeup, warn_on_full_buffer=False)

    def pop_retaken(self) -> list[str]:
        """Return the names of the signals that were taken back since the last call."""
        names = [name_of(number) for number in sorted(self._retaken)]
        self._retaken.clear()
        return names

    def _is_lost(self, number: int) -> bool:
        """True if it would not be noted any more. As at first, one that is not in `ALWAYS` may have another handler."""
        handler = signal.getsignal(number)
        in_python = handler != self._note if number in ALWAYS else handler in _DEFAULTS
        return in_python or self._is_lost_below(number)

    def _is_lost_below(self, number: int) -> bool:
        """True if it is lost at the C level, which Python does not see; False where that cannot be read."""
        before, now = self._actions[number][:_HANDLER], self._action(number)[:_HANDLER]
        return now != before and (number in ALWAYS or now == _DEFAULT)

    def _action(self, number: int) -> bytes:
        """The struct of the system's action at a signal; empty where that cannot be read."""
        was = ctypes.create_string_buffer(_SIZE)
        return was.raw if self._sigaction is not None and self._sigaction(number, None, was) == 0 else b""

    @property
    def again(self) -> bool:
        """True if a second signal has come."""
        return max(self.count, self.seen) > 1

    def _note(self, number: int, frame: FrameType | None) -> None:
        if number == OVERRUN and self.overrun is not None and not self._overran:
            self._overran = True
            self.overrun()
            return
        self.count += 1
        self.name = self.name or name_of(number)
