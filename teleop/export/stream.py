"""A live run as it grows, and to PlotJuggler over UDP, from a process of its own: the ends know nothing of it.

The rows of each end come some at a time, in order, each once. A datagram is an array of at most `ROWS` objects in JSON
(PlotJuggler takes arrays from 3.16.0 on), or with one row a datagram an object. Each begins with its `timestamp`, in
seconds since tick 0.
"""

from __future__ import annotations

import socket
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.export.columns import Field, Keys, Objects, field, paths_of
from teleop.export.stored import parts_in, turned
from teleop.live.net.wire import Address, host_port
from teleop.live.records.end_result import NAMES
from teleop.live.records.reader import FILE, OWN, GrowingRecord, Row
from teleop.scene.axes import labels_in
from teleop.storage.folder import is_being_written
from teleop.storage.strict_json import Misshapen

ROWS = 16  # a datagram
LARGEST = 60_000  # bytes of a datagram; UDP takes 65,507
PAUSE = 0.001  # s after each datagram: what is there already goes 16 times as fast as it came at 1 kHz, not in a burst
IDLE = 0.01  # s between two looks at a record that has nothing new


class Some(NamedTuple):
    """Rows of one end; `shift_ns` is added to their times."""

    end: GrowingEnd
    rows: list[Row]
    shift_ns: int


class GrowingEnd:
    """Growing record of an end, of the part `number` (0 of a whole run): `fields` of its rows once there are any."""

    def __init__(self, folder: Path, number: int) -> None:
        self.number = number
        self.over = False  # is all read, and is nobody writing any more
        self.last: int | None = None  # tick
        self._record = GrowingRecord(folder)
        self._waiting: deque[Row] = deque()

    @property
    def header(self) -> dict[str, Any]:
        """Header of its record, which there is once there are rows."""
        assert self._record.header is not None
        return self._record.header

    @property
    def fields(self) -> list[Field]:
        """The columns of a row after those of `OWN`, the axes of each side by side. Raises `Refused`."""
        names, e = self.header["columns"][len(OWN):], self.header["end"]
        labels = labels_in(self.header)
        fields = [field(name, names.count(name), labels) for name in dict.fromkeys(names)]
        if [one.name for one in fields for _ in range(one.axes)] != names or {f"late_{e}", f"seq_{e}"} & {*names}:
            raise Refused(f"{self._record.folder / FILE} has columns in an order that no record has; give another "
                          "folder")
        return fields

    def take(self, most: int) -> list[Row]:
        """The next rows, at most so many. Raises `Refused` if the record is damaged."""
        if not self._waiting and not self.over:
            written = is_being_written(self._record.folder)  # first: what is read then may be the last
            self._waiting.extend(self._read())
            if not self._waiting and not written:
                self.over = True
                self._record.close()
        taken = [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]
        if taken:
            self.last = int(taken[-1][0])
        return taken

    def close(self) -> None:
        """Let go of the record."""
        self._record.close()

    def _read(self) -> list[Row]:
        at = self._record.folder / FILE
        try:
            return self._record.read()
        except (OSError, Misshapen) as error:
            why = error.strerror if isinstance(error, OSError) else error
            raise Refused(f"{at} is no sound record of a live end ({why}); what was read before is sent") from error


class GrowingRun:
    """The run in `folder`: one end's, both ends', or several parts, of which another may come at any time."""

    def __init__(self, folder: Path) -> None:
        """Raises `Refused` if there is no live run in `folder`."""
        self.folder = folder
        self.over = False
        self._ends: list[GrowingEnd] = []  # those that have rows, or may have
        self._known: set[Path] = set()
        self._shift_ns: dict[int, int] = {}  # by number of the part
        self._reached: dict[str, int] = {}  # time of the last row that was taken, ns, by end
        self._look()
        if not self._known and not is_being_written(folder):
            raise Refused(_none_in(folder))
        self.live = is_being_written(folder) or any(is_being_written(one) for one in self._known)

    def take(self, most: int) -> list[Some]:
        """Take the next rows of each end, at most so many, of the earliest part that has any; `over` if none follow."""
        some = list(self._next(most))
        if not some:
            written = is_being_written(self.folder)  # first: what is found then may be the last
            self._look()
            some = list(self._next(most))
            self.over = not some and not written and not self._ends
        return some

    def _next(self, most: int) -> Iterator[Some]:
        number: int | None = None
        for end in list(self._ends):
            if number not in (None, end.number):
                return
            rows = end.take(most)
            if rows:
                number = end.number
                yield Some(end, rows, self._shifted(end, rows))
            elif end.over:
                self._ends.remove(end)

    def close(self) -> None:
        """Let go of all records."""
        for end in self._ends:
            end.close()

    def _look(self) -> None:
        """Find the records that have come."""
        for number, folder in _ends_in(self.folder):
            if folder not in self._known:
                self._known.add(folder)
                self._ends.append(GrowingEnd(folder, number))
                self._ends.sort(key=lambda end: end.number)

    def _shifted(self, end: GrowingEnd, rows: list[Row]) -> int:
        """Shift of the times of these rows, ns: 0 unless the ends of this part began their ticks anew."""
        dt_ns, name = end.header["dt_ns"], end.header["end"]
        first = int(rows[0][0]) * dt_ns
        if end.number not in self._shift_ns:
            before = self._reached.get(name, -1)
            anew = first + self._latest_shift() <= before
            self._shift_ns[end.number] = max(self._reached.values()) + dt_ns - first if anew else self._latest_shift()
        shift = self._shift_ns[end.number]
        self._reached[name] = int(rows[-1][0]) * dt_ns + shift
        return shift

    def _latest_shift(self) -> int:
        return self._shift_ns[max(self._shift_ns)] if self._shift_ns else 0


def _ends_in(folder: Path) -> Iterator[tuple[int, Path]]:
    """The folders of ends that have begun a record, and the number of the part that each is of, 0 of a whole run."""
    if (folder / FILE).is_file():
        yield 0, folder
        return
    parts = parts_in(folder) if turned(folder) else [(0, folder)]
    yield from ((number, part / name) for number, part in parts for name in NAMES.values()
                if (part / name / FILE).is_file())


def _none_in(folder: Path) -> str:
    if not folder.is_dir():
        return f"there is no folder {folder}; give the one that a live end or a demo writes, once it has begun"
    if (folder / "trace.npz").is_file():
        return (f"{folder} holds a run in virtual time, which is there as a whole: teleop export {folder} "
                "--mcap FILE or --csv FILE, and PlotJuggler opens the file")
    return f"{folder} holds no record of a live end; give the folder that a live end or a demo writes"


@dataclass
class Sent:
    """Count of the rows and datagrams sent, and of those that nobody took."""

    rows: int = 0
    datagrams: int = 0
    unheard: int = 0


def stream(
    run: GrowingRun, to: Address, *, rows: int, stopped: Callable[[], bool], warn: Callable[[str], None]
) -> Sent:
    """Send all that is in `run`, and what comes, until it is over or `stopped`; `warn` once if nobody listens.

    Raises `Refused` if nothing can be sent there, or nobody listens and the run is over already.
    """
    sent, encoders, warned = Sent(), dict[GrowingEnd, RowEncoder](), False
    with connected(to) as sock:
        while not (run.over or stopped()):
            any_rows = False
            for some in run.take(rows):
                any_rows = True
                encoder = encoders.get(some.end) or encoders.setdefault(some.end, RowEncoder(some.end))
                for data in encoder.datagrams(some, one=rows == 1):
                    _send(sock, data, to, sent)
                    time.sleep(PAUSE)
                sent.rows += len(some.rows)
            if sent.unheard and not warned:
                warned = True
                nobody = (f"nobody listens on {host_port(to)}: start PlotJuggler's UDP Server there, with that port "
                          "and the protocol json")
                if not run.live:
                    raise Refused(f"{nobody}, and type this again")
                warn(f"{nobody}; what comes until then is not kept for it")
            if not any_rows:
                time.sleep(IDLE)
    return sent


class RowEncoder:
    """The rows of one end as datagrams. Every number is under topic, column and, where it has axes, the axis' name."""

    def __init__(self, end: GrowingEnd) -> None:
        self._dt_ns = end.header["dt_ns"]
        e = end.header["end"]
        common: list[Keys] = [("timestamp",), ("master" if e == "m" else "slave", f"late_{e}"), ("link", f"seq_{e}")]
        self._objects = Objects([*common, *[path for one in end.fields for path in paths_of(one)]])

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
        raise Refused(f"cannot send to {host_port(to)} ({error.strerror or error}); give the address of the machine on "
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
        raise Refused(f"could not send to {host_port(to)} ({error.strerror or error}) after {sent.datagrams - 1} "
                      "datagrams; see whether that machine can be reached, or send less at a time: --rows 1") from error
