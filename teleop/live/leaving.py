"""Way out of a live end: its device without force, its record closed, its peer told how the run ended.

The force goes as in the safe state: along the watchdog's ramp and within the slew limit, tick by tick, so that nothing
jumps in a person's hand. The law has no part in it: the force that was held falls in amount until it is zero. A device
that carries the weight of its arm lowers that meanwhile. The device is read for the velocity cap, but not after a run
that diverged, since its readings are not believed. Without readings the way takes `BLIND_NS` at most, else as long as
the guard says; what is left then goes at once. So does all of it after a second signal, and where something was raised:
what is broken is asked for nothing more than zero.

Each of the steps is taken whatever the ones before it raise. Zero force is tried again for `RETRY_NS` by a device
that does not take it; then the status is `UNRELEASED`, and the sentence says that the force may still be on.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from contextlib import suppress
from fcntl import F_DUPFD_CLOEXEC, fcntl
from functools import partial
from threading import Thread, main_thread
from traceback import walk_stack
from types import TracebackType

from teleop.errors import enumerated
from teleop.live.process.interrupt import OVERRUN, Interrupt, name_of
from teleop.live.process.realtime import run_first
from teleop.live.process.ticker import Alarm
from teleop.live.shell import MAY_BE_ON, Shell, part_of
from teleop.protocol.endpoint import Axes, Endpoint
from teleop.protocol.guard import BLIND_NS, Event
from teleop.scene.axes import FORCE_UNIT
from teleop.terminal.options import FAULT, FORCED

RETRY_NS = 1_000_000_000  # zero force is tried for so long
PAUSE = 0.005  # s between two tries
LOWER_NS = 3_000_000_000  # for the law's force, and for a device to lower what it holds by itself
HEED_S = 2.0  # a signal that was not heeded for so long counts as two
HUNG_S = 0.3  # so long after the second an end that is well has no force any more
LEAVE_S = 4.0  # so long after that it has none either, if it heeds the one; and so long a start is waited for
POLL_S = 0.1  # between two looks at what foreign code may have taken
_HIGH = 200  # the least number of a descriptor that replaces one
ACT_S = 1.0  # for the device to take zero force, the record to be written and the peer to be told


def let_go(shell: Shell) -> None:
    """Take the force of `shell` to zero, one step a tick; nothing of it is recorded but an event."""
    device, endpoint = shell.device, shell.endpoint
    if shell.outcome.fault is not None or not (device.forced or device.carries):
        return
    device.lower()
    if shell.outcome.status != "ok" and device.trouble is None:
        # Now, so that the other end does not go on with what it heard last. How a device that fails has ended is told
        # when it is known.
        shell.bye()
    most, began, k = _sizes_of(endpoint, endpoint.held.force), time.monotonic_ns(), shell.counts.last
    seen = began  # when it was last read
    alarm = Alarm()
    alarm.set(began + endpoint.end_scene.dt_ns, endpoint.end_scene.dt_ns)
    now, passed, reading = began, 1, None  # that of this tick has been used
    carried = device.carries
    at_once: Axes = ()
    while True:
        force = endpoint.held.over(None if reading is None else reading.v, passed)
        if endpoint.guard.overdue and any(force):
            at_once, force = force, (0.0,) * len(force)
        spent = now - seen > BLIND_NS or now - began > LOWER_NS
        if shell.interrupt.again or spent or not (any(force) or device.carries):
            break
        if not device.hold(force):
            break
        alarm.wait()
        before, now = now, time.monotonic_ns()
        passed = max(1, round((now - before) / endpoint.end_scene.dt_ns))
        k += passed * endpoint.every
        reading = None if shell.outcome.status == "diverged" else device.read(k, now)
        seen = seen if reading is None else now
    if not device.let_go():
        endpoint.guard.tell(shell.counts.ran, "zero", f"the device does not take zero force: {device.trouble}")
        return
    left = force if any(force) else at_once
    jump = f", the last {_sizes_of(endpoint, left)} at once" if any(left) else ""
    weight = " and the arm's weight lowered" * carried
    sentence = f"{most} taken to zero{weight} in {(time.monotonic_ns() - began) / 1e9:.3f} s{jump}"
    endpoint.guard.tell(shell.counts.ran, "zero", sentence)


def _sizes_of(endpoint: Endpoint, force: Axes) -> str:
    """The largest size of a force of each unit: "1.61 N", "1.61 N and 0.3 N m"."""
    most: dict[str, float] = {}
    for one, unit in zip(force, endpoint.scene.axis_units, strict=True):
        most[FORCE_UNIT[unit]] = max(most.get(FORCE_UNIT[unit], 0.0), abs(one))
    return enumerated(f"{size:.3g} {unit}" for unit, size in most.items())


def leave(shell: Shell) -> None:
    """Take these steps. What one of them raises is a fault of the run, and keeps no other from being taken."""
    _zero(shell)
    shell.guarded(shell.take_events)
    shell.guarded(shell.recorder.close)
    for _ in range(3):  # a farewell may be lost too
        shell.guarded(shell.bye)
        shell.guarded(partial(time.sleep, 0.002))
    shell.counts.dropped = shell.wire.dropped
    shell.guarded(shell.wire.end)


def _zero(shell: Shell) -> None:
    device, until = shell.device, time.monotonic_ns() + RETRY_NS
    device.closed = True
    while not device.let_go() and device.forced:
        if time.monotonic_ns() > until:
            shell.outcome.unreleased(f"its device did not take zero force in {RETRY_NS / 1e9:g} s ({device.trouble})")
            break
        shell.guarded(partial(time.sleep, PAUSE))
    shell.free = True


class LastResort:
    """A thread that sets the device of `shell` to zero force and ends the process, where a signal does not end it.

    That is so where the loop stands still, in a driver or a law that does not return: at the second signal. A signal's
    handler in Python runs between two steps of the interpreter's main thread, so while a driver hangs in a system call
    there is none. The number of each signal is written to a pipe by Python's handler in C, and this thread waits for it
    there. Ten times a second it sees to it that this handler and that pipe are still what was put there: a driver may
    have taken the one for itself, or closed the other. Where no pipe can be had, it goes by what Python's handlers have
    counted, which a driver that sleeps or waits lets run.

    The thread runs as soon as the main thread has not the interpreter to itself: while that sleeps, waits, reads,
    computes in Python, or is in compiled code that has released the interpreter's lock. Compiled code that hangs with
    the lock held stops this thread too; against that, as against SIGKILL and SIGSTOP, stand the deadline of a device
    and a watchdog in a process of its own.

    The thread touches the device only where the loop is known to stand still: an end that is well lets go by itself.
    """

    def __init__(self, interrupt: Interrupt) -> None:
        self.interrupt = interrupt
        self.shell: Shell | None = None  # whose device is to be let go
        self._names: list[str] = []
        self._leaves = False  # it heeds the signal
        self._done = False
        self._overran = False

    def stand_by(self, shell: Shell) -> None:
        """There is a device to be let go. Of a loop with real-time scheduling, which could keep a core to itself, the
        thread runs first.
        """
        self.shell = shell
        above = None if shell.realtime is None else shell.realtime.above
        if above is not None and self._thread.native_id is not None:
            with suppress(OSError):
                run_first(above, self._thread.native_id)

    def __enter__(self) -> LastResort:
        self._reads, self._writes = os.pipe()
        self._claim()
        self._before = signal.set_wakeup_fd(self._writes, warn_on_full_buffer=False)
        self._thread = Thread(target=self._wait, name="last resort", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with suppress(OSError, ValueError):  # whoever had it before may have closed it
            signal.set_wakeup_fd(self._before)
        self._done = True
        if self._has_pipe():
            os.write(self._writes, b"\0")
        self._thread.join()
        if self._has_pipe():
            os.close(self._reads)
            os.close(self._writes)

    def _claim(self) -> None:
        """The two ends are this thread's own, for the numbers of signals."""
        os.set_blocking(self._writes, False)
        self._pipe = os.fstat(self._writes)
        self.interrupt.wakeup = self._writes

    def _has_pipe(self) -> bool:
        """True if both ends are what they were: others may have closed them, and have opened something else since."""
        try:
            return all(os.path.samestat(os.fstat(end), self._pipe) for end in (self._reads, self._writes))
        except OSError:
            return False

    def _open_anew(self) -> bool:
        """Make another pipe; True if there is one.

        Only the main thread can tell the handler in C of another number (`Interrupt.retake`), and it may stand still.
        So the pipe takes the number that was closed, if nobody else has it since.
        """
        with suppress(OSError):  # there are no descriptors left
            # High numbers: whoever had a low one that is closed by now may still write to it.
            low = os.pipe()
            self._reads, high = (fcntl(end, F_DUPFD_CLOEXEC, _HIGH) for end in low)
            for end in low:
                os.close(end)
            self._writes, old = fcntl(high, F_DUPFD_CLOEXEC, self._writes), self._writes
            unused, self._writes = (high, old) if self._writes == old else (self._writes, high)
            os.close(unused)
            self._claim()
            self.interrupt.lost = True
        return self._has_pipe()

    def _read_signals(self, seconds: float) -> bytes:
        """The numbers of the signals that have come, waiting so long for the first."""
        if not self._has_pipe() and not self._open_anew():
            time.sleep(seconds)
            return b""
        ready, _, _ = select.select([self._reads], [], [], seconds)
        self.interrupt.restore()
        return os.read(self._reads, 64) if ready and self._has_pipe() else b""

    def _wait(self) -> None:
        # The main thread's, unless that has blocked them. To be unblocked here too is to hear of them all the same.
        signal.pthread_sigmask(signal.SIG_SETMASK, signal.valid_signals() - self.interrupt.signals)
        due = float("inf")  # when this thread acts
        while not self._done:
            left = due - time.monotonic()
            if left > 0.0:
                noted, name = self.interrupt.count, self.interrupt.name  # first: the pipe has their numbers by now
                numbers = self._read_signals(min(left, POLL_S))
                before = len(self._names)
                for number in self.interrupt.signals.intersection(numbers):
                    self._names += [name_of(number)] * (numbers.count(number) - self._is_overrun(number))
                if name is not None:
                    self._names += [name] * (noted - len(self._names))
                if len(self._names) > before:
                    self.interrupt.seen = len(self._names)
                    self.interrupt.name = self.interrupt.name or self._names[0]  # whoever handles it in Python
                    due = min(due, time.monotonic() + (HEED_S if len(self._names) == 1 else HUNG_S))
            elif self._may_wait():
                due = float("inf")
            elif not self._leaves and self._heeds_the_first():
                self._leaves, due = True, time.monotonic() + LEAVE_S
            else:
                self._act()

    def _is_overrun(self, number: int) -> bool:
        """True if this one gives real-time scheduling back, which it does also where the loop does not heed it."""
        if number != OVERRUN or self.interrupt.overrun is None or self._overran:
            return False
        self._overran = True
        self.interrupt.overrun()
        return True

    def _may_wait(self) -> bool:
        """True if there is no force to let go: before the run, however long that takes, or after it."""
        return len(self._names) == 1 if self.shell is None else self.shell.free

    def _heeds_the_first(self) -> bool:
        """True before there is a device, and where one signal came and the run is over by it."""
        return self.shell is None or (len(self._names) == 1 and self.shell.outcome.over)

    def _act(self) -> None:
        """Zero force, the record, the peer, a sentence, the end; whatever of it hangs."""
        shell, code, force = self.shell, FAULT, "no force was on"
        if shell is not None and shell.realtime is not None:
            shell.realtime.give_back()  # what hangs would keep the core from the thread that lets go
        why = f"{' and '.join(self._names[:2])} came, and {self._hung()} does not return"
        self.interrupt.count += 1  # should it return even so: not along a ramp
        if shell is not None:
            forced, took = shell.device.forced, list[bool]()
            worker = Thread(target=_let_go_now, args=(shell, why, took), daemon=True)
            worker.start()
            worker.join(ACT_S)
            if forced and took == [True]:
                force = "its device was set to zero force"
            elif forced:
                code, force = FORCED, f"its device did not take zero force: {MAY_BE_ON}"
        _say(f"teleop: {why}; {force}; the process ends without a summary\n")
        os._exit(code)

    @staticmethod
    def _hung() -> str:
        """The part that the main thread is in."""
        frame = sys._current_frames().get(main_thread().ident or 0)
        frames = [] if frame is None else [each for each, _ in walk_stack(frame)]
        return part_of(reversed(frames)) or "the live loop"


def _let_go_now(shell: Shell, why: str, took: list[bool]) -> None:
    shell.device.closed = True
    took.append(shell.device.let_go())
    shell.outcome.status = "stopped"
    shell.outcome.sentence = f"stopped at t = {shell.so_far():.3f} s: {why}"
    shell.guarded(lambda: shell.recorder.note(Event(shell.counts.ran, "stopped", why)))
    shell.guarded(shell.recorder.flush)
    shell.guarded(shell.bye)


def _say(text: str) -> None:
    """Say it on standard error, if there is room for it."""
    with suppress(OSError, ValueError):
        if select.select([], [2], [], 0.0)[1]:
            os.write(2, text.encode(errors="backslashreplace"))
