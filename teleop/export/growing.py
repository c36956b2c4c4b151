"""A live run as it grows: the rows of each of its ends, some at a time, in order, each once."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.export.columns import Field, field
from teleop.export.stored import parts_in, turned
from teleop.live.records.end_result import NAMES
from teleop.live.records.following import GrowingRecord, Row
from teleop.live.records.header import OWN
from teleop.live.records.record import FILE
from teleop.scene.axis_labels import labels_in
from teleop.storage.folder import is_being_written
from teleop.storage.strict_json import Misshapen


class Some(NamedTuple):
    """Rows of one end; `shift_ns` goes onto their times."""

    end: GrowingEnd
    rows: list[Row]
    shift_ns: int


class GrowingEnd:
    """One end's record, of the part `number` (0 of a whole run): `fields` of its rows once there are any."""

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
        found = [field(name, names.count(name), labels) for name in dict.fromkeys(names)]
        if [one.name for one in found for _ in range(one.axes)] != names or {f"late_{e}", f"seq_{e}"} & {*names}:
            raise Refused(f"{self._record.folder / FILE} has columns in an order that no record has; give another "
                          "folder")
        return found

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
        """Of each end the next rows, at most so many, of the earliest part that has any; `over`: there will be none."""
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
        """What goes onto the times of these rows, ns: nothing, unless the ends of this part began their ticks anew."""
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
