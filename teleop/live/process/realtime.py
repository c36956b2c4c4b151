"""Real-time scheduling, which a live process asks the system for unless `--no-realtime` leaves it.

Asked for are SCHED_FIFO, so that the loop runs as soon as its timer rings whatever else computes, and memory that
stays. Either may be refused; then the run goes on without, and is late by as much as the machine lets it wait.

What a real-time thread could do wrong:

- A loop that never sleeps would keep a core from everyone else. `RLIMIT_RTTIME` bounds that: after `AWAKE_S` of
  processor time without a sleep the system sends SIGXCPU, and the loop is given back to the ordinary scheduler and runs
  on. Compiled code that hangs with the interpreter's lock held lets nothing answer it, and is killed after `KILLED_S`;
  the force then lapses by the device's deadline or its watchdog.
- `SCHED_RESET_ON_FORK`: no process and no thread that is started later has the priority by inheritance. The thread that
  answers a second signal and the watchdog process of a device get the next higher one, `RealTime.above`.
- It is given back before anything is written at the end of a run.

Locked are the pages that are there and those that come; where a limit bounds locked memory, only those that are there,
since a limit that is reached later would make memory fail. The collector stays on: in ten seconds it runs 13 times, for
0.1 ms, as `driving` freezes what was there before the run.
"""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from argparse import Namespace
from contextlib import suppress
from pathlib import Path
from threading import get_native_id
from types import TracebackType
from typing import NamedTuple

from teleop.live.process.interrupt import Interrupt

SPIN_NS = 150_000  # how long before a tick `--spin` wakes: more than it takes to wake a process, nearly always
PRIORITY = 40  # of 1 .. 99: above all that is not real-time, below the kernel's own interrupt threads, which have 50
RELAY_PRIORITY = PRIORITY - 1  # of the channel, which waits awake for its packets: not while an end has a tick to do
LIMIT = 50  # the limit on priority that is proposed: room for PRIORITY and for what runs above it
AWAKE_S = 0.5  # s of processor time without a sleep, after which the process is given back
KILLED_S = 2.0  # the same, after which the system kills it
CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23
GIVEN_BACK = f"given back, as the loop did not sleep for {AWAKE_S:g} s of processor time"
_REFUSED = "no "  # begins what a report has in place of a right
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_CONTAINER = (Path("/.dockerenv"), Path("/run/.containerenv"))
_LIMITS = Path("/etc/security/limits.d")  # of pam_limits


class Granted(NamedTuple):
    """Scheduling and memory that the system gave. See `is_refused`; without scheduling `priority` is None."""

    scheduler: str
    memory: str
    priority: int | None = None

    @property
    def whole(self) -> bool:
        """True if nothing was refused."""
        return not (is_refused(self.scheduler) or is_refused(self.memory))


class RealTime:
    """Real-time scheduling of the thread that enters it, until the block ends or `give_back` is called.

    `granted` is None where it was not asked for.
    """

    def __init__(self, interrupt: Interrupt, *, wanted: bool = True, priority: int = PRIORITY) -> None:
        self.granted: Granted | None = None
        self._interrupt, self._wanted, self._priority = interrupt, wanted, priority
        self._thread = 0  # the system's number of the one that has the priority
        self._limits: tuple[int, int] | None = None
        self._overran = False

    def __enter__(self) -> RealTime:
        if self._wanted:
            # A collection does not sleep: in a process with millions of objects it takes longer than a thread with
            # real-time scheduling may stay awake. So they are looked at before, and never again.
            gc.collect()
            gc.freeze()
            self._limits = _bound_awake()
            self._thread, self._interrupt.overrun = get_native_id(), self._overrun
            self.granted = ask(self._priority)
            if self.granted.priority is None:
                self._thread, self._interrupt.overrun = 0, None
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.give_back()

    @property
    def report(self) -> dict[str, str] | None:
        """The entries of the summary, by name; None if it was not asked for."""
        if self.granted is None:
            return None
        scheduler = f"{self.granted.scheduler}; {GIVEN_BACK}" if self._overran else self.granted.scheduler
        return {"scheduler": scheduler, "memory": self.granted.memory}

    @property
    def above(self) -> int | None:
        """The priority of a thread or process that has to run before the loop; None where the loop has none."""
        return None if self.granted is None or self.granted.priority is None else self.granted.priority + 1

    def give_back(self) -> None:
        """Go back to ordinary scheduling. May be called from any thread, and more than once."""
        if self._thread:
            with suppress(OSError):  # the flag stays, since to take it off is a privilege
                os.sched_setscheduler(self._thread, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))
        self._thread = 0
        if self._limits is not None:
            _limit_awake(*self._limits)
            self._limits = None

    def _overrun(self) -> None:
        self._overran = True
        self.give_back()


def scheduling_of(args: Namespace, interrupt: Interrupt, priority: int = PRIORITY) -> RealTime:
    """Make the block that a live process enters around its run, by its options; a stepped end asks for nothing."""
    return RealTime(interrupt, wanted=args.realtime and not getattr(args, "lockstep", False), priority=priority)


def ask(priority: int = PRIORITY) -> Granted:
    """Ask for both, for the thread that calls; return the answer."""
    memory = _lock()
    try:
        priority = run_first(priority, room=1 + PRIORITY - priority)
    except (OSError, AttributeError) as error:  # the second: this system has no word for it
        return Granted(_refused(error), memory)
    return Granted(f"SCHED_FIFO, priority {priority}", memory, priority)


def run_first(priority: int, thread: int = 0, *, room: int = 0) -> int:
    """Give `thread` (0: the one that calls) SCHED_FIFO at `priority`, or at the most that the limit allows.

    Of what the limit allows, so many priorities as `room` are left above it, if it allows more than one. Returns the
    priority. Raises OSError if the system refuses, AttributeError where there is no such scheduling.
    """
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    most = _own_limit()
    try:
        os.sched_setscheduler(thread, policy, os.sched_param(priority))
    except PermissionError:
        if most < 1:
            raise
        priority = min(priority, max(1, most - room))
        os.sched_setscheduler(thread, policy, os.sched_param(priority))
    return priority


def sentence(report: dict[str, str]) -> str:
    """Write a report in one line, with the command that would give the rest.

    >>> sentence({"scheduler": "SCHED_FIFO, priority 40", "memory": "locked"})
    'real-time scheduling: SCHED_FIFO, priority 40; memory locked'
    """
    text = f"real-time scheduling: {report['scheduler']}; memory {report['memory']}"
    if not any(map(is_refused, report.values())) or not hasattr(os, "sched_setscheduler"):
        return text
    return f"{text}; {cure()}, or leave it with --no-realtime"


def cure(*, for_good: bool = False) -> str:
    """Name the command that gives the refused rights: in this terminal, or `for_good`."""
    if any(each.exists() for each in _CONTAINER):
        return f"start this container with --ulimit rtprio={LIMIT} --ulimit memlock=-1"
    if os.geteuid() == 0:
        return "give this process, which is root's without them, the capabilities CAP_SYS_NICE and CAP_IPC_LOCK"
    if for_good and _LIMITS.is_dir():
        return (f"type  printf \"$USER - %s\\n\" \"rtprio {LIMIT}\" \"memlock unlimited\" | "
                f"sudo tee {_LIMITS}/teleop.conf  and log in again")
    typed = f"sudo prlimit --pid $$ --rtprio={LIMIT} --memlock=unlimited"
    return f"type  {typed}  for this terminal" + ("" if for_good else " (for good: see teleop doctor)")


def capable(number: int) -> bool:
    """True if this process holds the capability (Linux)."""
    try:
        text = Path("/proc/self/status").read_text()
    except OSError:
        return False
    held = next((line.split()[1] for line in text.splitlines() if line.startswith("CapEff:")), "0")
    return bool(int(held, 16) >> number & 1)


def is_refused(granted: str) -> bool:
    """True of the text of a right that the system refused, in a report."""
    return granted.startswith(_REFUSED)


def _refused(error: BaseException) -> str:
    return f"{_REFUSED}({getattr(error, 'strerror', None) or 'not on this system'})"


def _own_limit() -> int:
    """Return the highest priority that a process may have without a privilege, and raise the soft limit to it."""
    if sys.platform != "linux":
        return 0
    import resource

    hard = resource.getrlimit(resource.RLIMIT_RTPRIO)[1]
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_RTPRIO, (hard, hard))
    return 99 if hard == resource.RLIM_INFINITY else hard


def _bound_awake() -> tuple[int, int] | None:
    """Bound the time without a sleep; the limits as they were, None where there are none."""
    if sys.platform != "linux":
        return None
    import resource

    before = resource.getrlimit(resource.RLIMIT_RTTIME)
    soft, hard = (least if limit == resource.RLIM_INFINITY else min(limit, least) for limit, least in zip(
        before, (round(AWAKE_S * 1e6), round(KILLED_S * 1e6)), strict=True))
    _limit_awake(soft, hard)
    return before


def _limit_awake(soft: int, hard: int) -> None:
    import resource

    with suppress(OSError, ValueError):  # to raise a hard limit is a privilege
        resource.setrlimit(resource.RLIMIT_RTTIME, (soft, hard))


def _lock() -> str:
    """Lock the memory of this process; return the result as a text."""
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        which = _MCL_CURRENT | (_MCL_FUTURE if _without_bound() else 0)
        if libc.mlockall(which):
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))
    except (OSError, AttributeError) as error:
        return _refused(error)
    return "locked" if which & _MCL_FUTURE else "locked as it was at the start"


def _without_bound() -> bool:
    """True if locked memory has no limit for this process."""
    if sys.platform != "linux":
        return True
    import resource

    return capable(CAP_IPC_LOCK) or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY

