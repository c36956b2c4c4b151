"""A live run to PlotJuggler, row by row over UDP, from a process of its own: the ends know nothing of it.

A datagram is an array of at most `ROWS` objects in JSON (PlotJuggler takes arrays from 3.16.0 on), or with one row a
datagram an object. Each begins with its `timestamp`, in seconds since tick 0.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

from teleop.errors import Refused
from teleop.export.columns import paths_of
from teleop.export.growing import GrowingEnd, GrowingRun, Some
from teleop.export.objects import Objects, Path
from teleop.live.net.wire import Address, shown

ROWS = 16  # a datagram
LARGEST = 60_000  # bytes of a datagram; UDP takes 65,507
PAUSE = 0.001  # s after each datagram: what is there already goes 16 times as fast as it came at 1 kHz, not in a burst
IDLE = 0.01  # s between two looks at a record that has nothing new


@dataclass
class Sent:
    """What went out: rows, datagrams, and how many of these nobody took."""

    rows: int = 0
    datagrams: int = 0
    unheard: int = 0


def stream(
    run: GrowingRun, to: Address, *, rows: int, stopped: Callable[[], bool], warn: Callable[[str], None]
) -> Sent:
    """Send all that is in `run`, and what comes, until it is over or `stopped`. `warn` is told once if nobody listens.

    Raises `Refused` if nothing can be sent there, or nobody listens and the run is over already.
    """
    sent, encoders, told = Sent(), dict[GrowingEnd, Encoder](), False
    with connected(to) as sock:
        while not (run.over or stopped()):
            found = False
            for some in run.take(rows):
                found = True
                encoder = encoders.get(some.end) or encoders.setdefault(some.end, Encoder(some.end))
                for data in encoder.datagrams(some, one=rows == 1):
                    _send(sock, data, to, sent)
                    time.sleep(PAUSE)
                sent.rows += len(some.rows)
            if sent.unheard and not told:
                told = True
                nobody = (f"nobody listens on {shown(to)}: start PlotJuggler's UDP Server there, with that port and "
                          "the protocol json")
                if not run.live:
                    raise Refused(f"{nobody}, and type this again")
                warn(f"{nobody}; what comes until then is not kept for it")
            if not found:
                time.sleep(IDLE)
    return sent


class Encoder:
    """The rows of one end as datagrams. Every number is under topic, column and, where it has axes, the axis' name."""

    def __init__(self, end: GrowingEnd) -> None:
        self._dt_ns = end.header["dt_ns"]
        e = end.header["end"]
        own: list[Path] = [("timestamp",), ("master" if e == "m" else "slave", f"late_{e}"), ("link", f"seq_{e}")]
        self._objects = Objects([*own, *[path for one in end.fields for path in paths_of(one)]])

    def datagrams(self, some: Some, *, one: bool = False) -> list[bytes]:
        """The datagrams of some rows; an object instead of an array if each is to have `one` row."""
        k, late, played, *rest = zip(*some.rows, strict=True)
        shift, dt_ns = some.shift_ns, self._dt_ns
        times = [(int(tick) * dt_ns + shift) / 1e9 for tick in k]
        texts = self._objects.texts([times, [ns / 1e9 for ns in late], [*map(int, played)], *rest])
        return [text.encode() for text in texts] if one else [*_packed(texts)]


def _packed(texts: list[str]) -> Iterator[bytes]:
    """Arrays of these objects, each as long as a datagram may be."""
    data = f"[{','.join(texts)}]".encode()
    if len(data) > LARGEST and len(texts) > 1:
        half = len(texts) // 2
        yield from _packed(texts[:half])
        yield from _packed(texts[half:])
    else:
        yield data


def connected(to: Address) -> socket.socket:
    """A UDP socket that sends there, and is told where nobody listens. Raises `Refused`."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.connect(to)
    except OSError as error:
        sock.close()
        raise Refused(f"cannot send to {shown(to)} ({error.strerror or error}); give the address of the machine on "
                      "which PlotJuggler runs, for example --plotjuggler 127.0.0.1:9870") from error
    return sock


def _send(sock: socket.socket, data: bytes, to: Address, sent: Sent) -> None:
    sent.datagrams += 1
    try:
        try:
            sock.send(data)
        except ConnectionRefusedError:  # that is of the datagram before, and this one did not go out
            sent.unheard += 1
            with suppress(ConnectionRefusedError):
                sock.send(data)
    except OSError as error:
        raise Refused(f"could not send to {shown(to)} ({error.strerror or error}) after {sent.datagrams - 1} "
                      "datagrams; see whether that machine can be reached, or send less at a time: --rows 1") from error
