"""Watchdog process of a device, which sets its force to zero when the end that drives it is silent or gone.

For devices whose hardware has no deadline of its own. The end and the process share a page of memory, eight words, and
a pipe. The heartbeat is the time at which a force other than zero was last renewed, or zero while none is held. The
pipe closes when the end dies, whatever it dies of; an end that has set its force to zero says goodbye on it first.

When the watchdog sets the force to zero, it counts that in `FIRED` before it does so. An end that comes back
afterwards finds the count above its own, `ACKED`: it holds zero and nothing else until the watchdog has seen that
(`DONE`), and its device reads as failing for as long, so that the guard begins at gain zero. Then it is armed again.

The process outlives the end: it has a session of its own, ignores any signal that can be ignored, and ends when the end
has said goodbye, or is gone and the force is zero. A lock on the device's name lets it have one at a time. So an end
that is started again waits for the watchdog of the one before, and is never zeroed by it.
"""

from __future__ import annotations

import json
import os
import re
import select
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, suppress
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from io import StringIO
from mmap import mmap
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any

from teleop.errors import DeviceError, Refused, number
from teleop.live.devices.guarded_device import let_go
from teleop.live.process.output import live
from teleop.live.process.realtime import run_first
from teleop.live.records.record import EVENTS
from teleop.protocol.endpoint import Axes, Reading
from teleop.protocol.guard import DEADLINE, Event, Silence
from teleop.scene.library import ROOT, scene_folders
from teleop.storage.folder import lock

if TYPE_CHECKING:
    from teleop.live.devices.guarded_device import LiveDevice

BEAT, K, ACKED = 0, 1, 2  # words that the end writes: ns of its last force, tick, and the firings that it has seen
SEEN, FIRED, DONE = 3, 4, 5  # words that the watchdog writes: ns of its last look, firings, and those that are over
TEXT = 64  # bytes of the eight words; where a sentence begins, if the watchdog could not start
SIZE = 4096  # bytes of the page
GONE_NS = 1_000_000_000  # without a look of the watchdog for so long, the device is driven no more
START_S = 20.0  # for the watchdog to open the device
END_S = 3.0  # for it to end
GOODBYE = b"."


@dataclass(frozen=True, kw_only=True)
class DeviceWatchdog:
    """Access of a watchdog process to a device, whose force it sets to zero: the device's attribute `watchdog`.

    `open`: "module:function", importable where the end runs, without running the end. The function is called once, at
    the start, with `arguments` (texts), opens the device by itself and returns a function without arguments that sets
    its force to zero. That one is called while the end is silent for `deadline` seconds with a force held, or gone.
    `device`: the name by which one end at a time drives it; left out: `open` with its `arguments`.

    >>> DeviceWatchdog(open="my_arm:zeroing", arguments=("/dev/ttyACM0",)).deadline
    0.15
    """

    open: str
    arguments: tuple[str, ...] = ()
    deadline: float = DEADLINE
    device: str = ""

    def __post_init__(self) -> None:
        module, _, function = self.open.partition(":")
        if not (module and function.isidentifier()):
            raise Refused(f"a device watchdog opens its device by \"module:function\", not {self.open!r}; write for "
                          "example DeviceWatchdog(open=\"my_arm:zeroing\")")
        number("a device watchdog's deadline", self.deadline, above=0.01)


class WatchedDevice:
    """`device`, with the heartbeat of its watchdog in every `hold`. Costs about 1 us a tick.

    While its watchdog has taken over, or does not answer, it reads as a device that fails and holds zero.
    """

    def __init__(self, device: LiveDevice, deadline: float, page: mmap) -> None:
        self.device, self.deadline = device, deadline
        self.scene_body = getattr(device, "scene_body", False)
        self._is_carrier = hasattr(device, "carries")  # beside a force of zero it may hold one of its own
        self._words: Any = memoryview(page).cast("q")

    def read(self, k: int) -> Reading:
        """Read the device. Raises `DeviceError` while its watchdog has taken over or does not answer."""
        words = self._words
        words[K] = k
        if words[FIRED] != words[ACKED]:
            raise DeviceError(f"its watchdog has set its force to zero, for no heartbeat came for {self.deadline:g} s")
        if time.monotonic_ns() - words[SEEN] > GONE_NS:
            raise DeviceError("its watchdog process does not answer, and without it nothing may be driven")
        return self.device.read(k)

    def hold(self, force: Axes) -> None:
        """Have the device hold `force` (N, per axis). Raises `DeviceError` if it holds zero instead."""
        words = self._words
        if not any(force) and not self._is_carrier:
            self.let_go(force)
        elif words[FIRED] != words[ACKED]:
            self._hold_zero(force)
        else:
            if not words[BEAT]:
                words[BEAT] = time.monotonic_ns()  # armed before there is a force
            self.device.hold(force)
            words[BEAT] = time.monotonic_ns()
            if words[FIRED] != words[ACKED]:  # it took over just now, or while this process stood still in `hold`
                self._hold_zero(force)

    @property
    def carries(self) -> bool:
        """True while the device holds a force of its own."""
        return bool(getattr(self.device, "carries", False))

    def lower(self) -> None:
        """Have the device end the force of its own, if it has one."""
        getattr(self.device, "lower", lambda: None)()

    def let_go(self, zero: Axes) -> None:
        """Have the device hold no force, none of its own either."""
        words = self._words
        let_go(self.device, zero)
        words[BEAT] = 0
        if words[DONE] == words[FIRED]:
            words[ACKED] = words[FIRED]

    def _hold_zero(self, force: Axes) -> None:
        self.let_go((0.0,) * len(force))
        raise DeviceError("its watchdog has taken over, and zero is held")

    @property
    def lets_go(self) -> bool:
        """True if the force that was held last is zero."""
        return not self._words[BEAT]

    def release(self) -> None:
        """Use the page no more: the run is over, and whatever is held from now on is held without a watchdog."""
        words, self._words = self._words, [0, 0, 0, 1 << 62, 0, 0, 0, 0]
        words.release()


@contextmanager
def with_watchdog(device: LiveDevice, folder: Path, priority: int | None = None,
                  default: DeviceWatchdog | None = None) -> Iterator[LiveDevice]:
    """`device` with its watchdog process, if it names one; the process ends with the block. Raises `Refused`.

    `default`: the watchdog of a device that names none; None: such a device has no process.
    `folder`: of the run, where the watchdog notes in the events what it did. `priority`: what it asks for under
    SCHED_FIFO, to run before an end that is scheduled so; None for an end that is not.
    """
    watchdog: DeviceWatchdog | None = getattr(device, "watchdog", None) or default
    if watchdog is None:
        yield device
        return
    deadlines = [one for one in (getattr(device, "deadline", None), watchdog.deadline) if one is not None]
    with memory_page("device watchdog") as file, mmap(file.fileno(), SIZE) as page:
        process, goodbye = _start(watchdog, file.fileno(), folder, priority)
        ours = WatchedDevice(device, min(deadlines), page)
        try:
            _await(process, page)
            yield ours
        finally:
            with suppress(OSError):  # the watchdog is gone
                if ours.lets_go:
                    os.write(goodbye, GOODBYE)
            ours.release()
            os.close(goodbye)
            with suppress(subprocess.TimeoutExpired):  # it goes on trying, and says what became of it
                process.wait(END_S)


def memory_page(name: str) -> IO[bytes]:
    """Make a file of one page, in memory alone if the system can: a page on its way to a disk would hold up a tick."""
    memory = getattr(os, "memfd_create", None)
    file: IO[bytes] = os.fdopen(memory(name), "r+b") if memory else TemporaryFile()  # noqa: SIM115 (its caller closes it)
    file.truncate(SIZE)
    return file


def _start(
    watchdog: DeviceWatchdog, page: int, folder: Path, priority: int | None
) -> tuple[subprocess.Popen[bytes], int]:
    """The process and the end of the pipe on which it is said goodbye to."""
    theirs, ours = os.pipe()
    about = {"open": watchdog.open, "arguments": watchdog.arguments, "deadline": watchdog.deadline, "page": page,
             "end": os.getpid(), "device": watchdog.device or " ".join([watchdog.open, *watchdog.arguments]),
             "pipe": theirs, "folder": str(folder.absolute()), "priority": priority}
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "teleop.live.devices.device_watchdog", json.dumps(about)],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, pass_fds=(page, theirs),
            env={**os.environ, "PYTHONPATH": module_path()},
            start_new_session=True,  # what the terminal sends the end does not reach it
        )
    except OSError as error:
        os.close(ours)
        raise Refused(f"the device's watchdog could not be started ({error.strerror or error}); without it nothing is "
                      "driven") from error
    finally:
        os.close(theirs)
    return process, ours


def module_path() -> str:
    """PYTHONPATH of a process beside the end, in which all is importable that is here."""
    return os.pathsep.join([str(ROOT), *(os.path.abspath(each) for each in (*sys.path, *scene_folders()))])


def _await(process: subprocess.Popen[bytes], page: mmap) -> None:
    """Wait until the watchdog looks after the device. Raises `Refused` with its reason if it cannot."""
    until = time.monotonic() + START_S
    with memoryview(page) as plain, plain.cast("q") as words:
        while not words[SEEN]:
            if process.poll() is not None:
                reason = bytes(page[TEXT:]).partition(b"\0")[0].decode(errors="replace")
                raise Refused(reason or f"the device's watchdog ended with exit code {process.returncode} at its start")
            if time.monotonic() > until:
                raise Refused(f"the device's watchdog was not ready in {START_S:g} s; see what its `open` waits for")
            time.sleep(0.005)


RETRY_S = 5.0  # for a device that cannot be set to zero, once the end is gone
HEEDED = {signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT, signal.SIGCHLD}  # its own


class Watching:
    """Judgement of the process at each look. Times are ns of the monotonic clock, `words` the page shared with the end.
    """

    def __init__(self, words: Any, zero: Callable[[], object], deadline: float, report: Callable[[str], None]) -> None:
        self.silence = Silence(round(deadline * 1e9))
        self._words, self._zero, self._report = words, zero, report
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

    def take_over(self) -> bool:
        """Set the force to zero, since the end has died; False if that failed."""
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
                self._report(failed)
            self._failed = failed
            return False
        if not self._is_zero:
            self._report(f"{why}; its force was set to zero")
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
            zero = open_zero(about["open"], about["arguments"])
        except Refused as refused:
            sentence = str(refused).encode()[: SIZE - TEXT - 1]
            page[TEXT : TEXT + len(sentence)] = sentence
            return 2
        _run_before_end(about["priority"])
        watching = Watching(words, zero, about["deadline"], lambda text: _report(text, words[K], Path(about["folder"])))
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
    while not watching.take_over():
        if time.monotonic() > until:
            return 1
        time.sleep(wait / 1e3)
    return 0


def open_zero(target: str, arguments: list[str]) -> Callable[[], object]:
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
    checked: Callable[[], object] = zero
    return checked


def _run_before_end(priority: int | None) -> None:
    """Have this process run before an end that is scheduled before all others."""
    if priority is not None:
        with suppress(OSError, AttributeError):
            run_first(priority)


def _report(text: str, k: int, folder: Path) -> None:
    with suppress(OSError), (folder / EVENTS).open("a") as file:
        file.write(json.dumps(Event(k, "watchdog", text).document()) + "\n")
    print(f"device watchdog: {text}", file=sys.stderr, flush=True)


WAIT_S = 3.0  # for the watchdog process of an end that was there before
LOOK_S = 0.02
FOLDER = "bilateral-teleop"
RUNTIME = "XDG_RUNTIME_DIR"
_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_CURE = f"set {RUNTIME} to a folder that is yours alone (mode 700)"


def take_lock(device: str, end: int) -> int | None:
    """Lock the device of this name: a file in a folder of the user's own, as a descriptor; None without such locks.

    So one end at a time drives it. The system unlocks it with its process, whatever that dies of. No other user can
    take the name first, and processes in other network namespaces find the same file. `end`: the process that drives
    the device, which a refusal names. Raises `Refused` if another process has it for `WAIT_S`, or without that folder.
    """
    if not hasattr(os, "geteuid"):
        return None
    readable = re.sub(r"[^A-Za-z0-9.-]+", "_", device)[:60]
    path = lock_folder() / f"{readable}-{sha256(device.encode()).hexdigest()[:16]}.lock"
    try:
        held = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        why = error.strerror or error
        raise Refused(f"the lock on the device {device}, {path}, cannot be opened ({why}); {_CURE}") from error
    until = time.monotonic() + WAIT_S
    while not lock(held, shared=False):
        if time.monotonic() > until:
            holder = os.pread(held, 20, 0).decode(errors="replace").strip()
            os.close(held)
            raise Refused(f"another end drives this device already ({device}), process {holder or 'unknown'}; end that "
                          f"one first{f', for example by kill {holder}' if holder.isdecimal() else ''}")
        time.sleep(LOOK_S)
    os.ftruncate(held, 0)
    os.pwrite(held, f"{end}\n".encode(), 0)
    return held


def lock_folder() -> Path:
    """The folder of the locks, which is made if it is missing: of no other user, and no link. Raises `Refused`."""
    runtime = os.environ.get(RUNTIME, "")
    if not (os.path.isabs(runtime) and _is_own(Path(runtime))):
        import pwd

        try:
            runtime = str(Path(pwd.getpwuid(os.geteuid()).pw_dir) / ".cache")
            os.makedirs(runtime, mode=0o700, exist_ok=True)
        except (KeyError, OSError) as error:
            raise Refused(f"there is no folder for the lock on a device ({error}); {_CURE}") from error
    path = Path(runtime) / FOLDER
    try:
        with suppress(FileExistsError):
            path.mkdir(mode=0o700)
        if not _is_own(path):
            raise Refused(f"{path}, where the locks on devices are, is a link, of another user, or open to others; "
                          f"remove it (rm -r {path}), or {_CURE}")
    except OSError as error:
        raise Refused(f"{path}, for the lock on a device, cannot be made ({error.strerror}); {_CURE}") from error
    return path


def _is_own(path: Path) -> bool:
    """True if it is a folder of this user that others may not enter."""
    try:
        status = path.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and not status.st_mode & _OTHERS


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
