"""Signals that would end or stop the process, taken note of from the first moment to the last.

The loops look at the note when they can stop cleanly. So a signal neither cuts the writing of a record in
two, nor does one that comes early, or twice, end the process before it has told the other end.

Of the signals that end a process by default these are not among them: SIGKILL, which no process can take; SIGSEGV,
SIGBUS, SIGFPE and SIGILL, after which the instruction that failed would only fail again for ever; SIGPIPE and SIGXFSZ,
which Python ignores. Nor is SIGSTOP, which stops it. Ctrl-Z (SIGTSTP) is: a process that is stopped holds its force.
"""

from __future__ import annotations

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


def name_of(number: int) -> str:
    """What a signal is called.

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
    taken whatever handler they had. `taken`: the numbers.
    """

    def __init__(self) -> None:
        self.name: str | None = None
        self.count = 0
        self.seen = 0  # by `LastResort`: two of one kind that come while compiled code runs are one to a handler
        self.overrun: Callable[[], None] | None = None  # heeds the first SIGXCPU, see `realtime`
        self._overran = False
        self._before: dict[int, Any] = {}

    @property
    def taken(self) -> frozenset[int]:
        return frozenset(self._before)

    def __enter__(self) -> Interrupt:
        others = [int(getattr(signal, name)) for name in OTHERS if hasattr(signal, name)]
        default = (signal.SIG_DFL, signal.default_int_handler)
        for number in (*ALWAYS, *others, *REAL_TIME):
            if number in ALWAYS or signal.getsignal(number) in default:
                with suppress(OSError, ValueError):  # this system keeps it for itself
                    self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)

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
