"""What `--realtime` asks the system for: to run before others, in memory that stays, without garbage collection.

All of it may be refused, and then the run goes on without: it is late now and then by as much as the machine stalls.
Locked are the pages that are there and those that come. The collector is what `Shell` freezes anyway; here it is off.
"""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from argparse import Namespace
from collections.abc import Callable

SPIN_NS = 150_000  # how long before a tick `--spin` wakes: more than it takes to wake a process, nearly always
PRIORITY = 50  # of 1 .. 99: above all that is not real-time, below what the kernel itself runs on threads
_MCL_CURRENT, _MCL_FUTURE = 1, 2


def asked(args: Namespace, name: str) -> dict[str, str] | None:
    """The answers of the system to --realtime, printed on the terminal too; None without --realtime."""
    if not args.realtime:
        return None
    granted = ask()
    if not args.json:
        print(f"{name}: {sentence(granted)}", file=sys.stderr, flush=True)
    return granted


def ask() -> dict[str, str]:
    """Ask for all three; what came of each, by name: a text that begins with "no" where it was refused."""
    return {"scheduler": _granted(_first, f"SCHED_FIFO, priority {PRIORITY}"),
            "memory": _granted(_lock, "locked"), "garbage collection": _granted(gc.disable, "off")}


def sentence(granted: dict[str, str]) -> str:
    """What came of it, in one line, and what would grant the rest."""
    answers = ", ".join(f"{name} {what}" for name, what in granted.items())
    refused = [name for name, what in granted.items() if what.startswith("no")]
    cure = "; allow it with `ulimit -r 99 -l unlimited`, or give the process CAP_SYS_NICE and CAP_IPC_LOCK"
    return f"realtime: {answers}{cure if refused else ''}"


def _granted(ask_for: Callable[[], None], what: str) -> str:
    try:
        ask_for()
    except (OSError, AttributeError) as error:  # the second: this system has no word for it
        return f"no ({getattr(error, 'strerror', None) or 'not on this system'})"
    return what


def _first() -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def _lock() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
