"""Standard output and standard error of a live process, written without ever blocking or raising.

A live process holds a force, or relays the packets of one that does, so a write for people must not cost it a tick: a
pipe may be full because its reader was stopped, closed because the reader has ended, a terminal may be paused with
Ctrl-S. `with live():` replaces `sys.stdout` and `sys.stderr`, so that this holds for every print of the process, those
of laws, devices and libraries included. What does not fit at once is dropped and counted. Behind that block, when no
force is held any more, the final table or JSON may wait for its reader, for a bounded time.
"""

from __future__ import annotations

import io
import os
import select
import signal
import socket
import stat
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from errno import EBADF
from functools import partial
from typing import Any

from teleop.errors import number_of, plural

END_S = 2.0  # s in all that the last words of a process wait for their reader
_ANEW = os.O_WRONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
_installed: list[Output] = []


class Output(io.RawIOBase):
    """A raw binary stream over a file descriptor (int) whose `write` neither blocks nor raises.

    Each write is one message: it is dropped whole (counted in `dropped`), or goes out whole before the next one, so
    that no line is torn. `wait(seconds)` lets the writes of the next `seconds` block as long as that, all together.
    """

    def __init__(self, fd: int) -> None:
        super().__init__()
        self.dropped = 0  # messages for which there was no room
        self._fd = fd
        self._put = _without_blocking(fd)
        self._anew = True  # is that by a descriptor of its own
        self._tail = b""  # of a message that is out in part
        self._until = 0.0  # when waiting ends, of the monotonic clock (s)

    def wait(self, seconds: float) -> None:
        """Let writes block until `seconds` from now; 0 for not at all."""
        self._until = time.monotonic() + seconds

    def write(self, data: Any) -> int:
        """Write `data` (bytes), if the reader takes it now. Returns its size, whatever became of it."""
        message = bytes(data)
        if not self._push():
            self.dropped += 1
            return len(message)
        self._tail = message
        if not self._push() and len(self._tail) == len(message):
            self._tail = b""
            self.dropped += 1
        return len(message)

    def flush(self) -> None:
        """Write what is left of a message that is out in part, as far as it goes."""
        self._push()

    def _push(self) -> bool:
        """Write as much of the tail as goes; True if nothing of it is left."""
        while self._tail:
            try:
                self._tail = self._tail[self._put(self._tail) :]
            except BlockingIOError:
                if not self._room():
                    return False
            except (OSError, ValueError) as error:  # its reader has gone, its disk is full, it was closed
                if getattr(error, "errno", None) == EBADF and self._anew:  # others closed the one that was opened anew
                    self._anew, self._put = False, partial(_flagged, self._fd)
                else:
                    self._tail = b""
        return True

    def _room(self) -> bool:
        """Wait for room while waiting is allowed."""
        left = self._until - time.monotonic()
        if left <= 0.0:
            return False
        try:
            return bool(select.select([], [self._fd], [], left)[1])
        except (OSError, ValueError):
            return False

    def writable(self) -> bool:
        """True: it is for writing."""
        return True

    def fileno(self) -> int:
        """The descriptor as it was given."""
        return self._fd

    def isatty(self) -> bool:
        """True if it is a terminal."""
        return os.isatty(self._fd)


@contextmanager
def live() -> Iterator[None]:
    """Inside, no print of this process blocks or raises; behind it, prints wait `END_S` for their reader, in all.

    A stream that was replaced already, by a test for one, stays as it is.
    """
    with suppress(AttributeError, ValueError):  # a background process of a terminal with `stty tostop` would be stopped
        signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    for name in ("stdout", "stderr"):
        _replace(name)
    for output in _installed:
        output.wait(0.0)
    try:
        yield
    finally:
        for output in _installed:
            output.wait(END_S)
        if missing := sum(output.dropped for output in _installed):
            were = f"{number_of(missing, 'message')} on the output {plural(missing, 'was', 'were')} dropped"
            print(f"teleop: {were}, since its reader did not take {plural(missing, 'it', 'them')} in time",
                  file=sys.stderr)


def _replace(name: str) -> None:
    stream: Any = getattr(sys, name)
    if stream is None or stream is not getattr(sys, f"__{name}__"):
        return
    with suppress(OSError, ValueError):  # it is no file of the system's
        stream.flush()
        raw: Any = Output(stream.fileno())  # TextIOWrapper asks for a buffer and is as well without
        setattr(sys, name, io.TextIOWrapper(raw, stream.encoding, "backslashreplace", line_buffering=True))
        _installed.append(raw)


def _without_blocking(fd: int) -> Callable[[bytes], int]:
    """A function that writes to `fd` what fits now, or raises BlockingIOError.

    The flag O_NONBLOCK belongs to what a descriptor refers to, which other processes share, a shell for one. So a pipe
    or a terminal is opened anew, with a flag of its own; a socket takes the flag with each call.
    """
    kind = os.fstat(fd).st_mode
    if stat.S_ISSOCK(kind):
        sock = socket.socket(fileno=os.dup(fd))
        return lambda data: sock.send(data, socket.MSG_DONTWAIT)
    if not (stat.S_ISFIFO(kind) or stat.S_ISCHR(kind)):
        return lambda data: os.write(fd, data)  # a file has room, or says that it has none
    try:
        reopened = os.open(f"/proc/self/fd/{fd}", _ANEW)
    except OSError:  # a terminal of another user, a pipe without a reader, another system than Linux
        return lambda data: _flagged(fd, data)
    original = os.fstat(reopened)

    def write(data: bytes) -> int:
        if not os.path.samestat(os.fstat(reopened), original):  # others have closed it, and its number is reused
            raise OSError(EBADF, os.strerror(EBADF))
        return os.write(reopened, data)

    return write


def _flagged(fd: int, data: bytes) -> int:
    """Write with the shared flag set for as long as that takes."""
    before = os.get_blocking(fd)
    os.set_blocking(fd, False)
    try:
        return os.write(fd, data)
    finally:
        os.set_blocking(fd, before)
