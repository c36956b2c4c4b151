"""The folder of a sweep: what was asked for, and its rows as they finish. A kill at any time costs the rows in flight.

`sweep.json` holds the definition; it is there, whole, before the first row. `rows.jsonl` holds one line of JSON a
row and is only ever appended to. A line counts once its newline is there, so what a kill leaves half-written is cut
off when the folder is opened again. Whoever only reads (`Store.look`) changes nothing and may do so meanwhile.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from io import FileIO
from math import isfinite
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO

from teleop.batch.definition import DEFINITION, STRICT, begun, check_same, locked, no_link, read_definition, text
from teleop.errors import Refused
from teleop.files import replacing

if TYPE_CHECKING:
    from teleop.batch.table import Table

ROWS = "rows.jsonl"


class Done:
    """The numbers of the rows that are there, a bit for each: a sweep of 1e9 rows takes 125 MB."""

    def __init__(self) -> None:
        self._bits = bytearray()
        self._count = 0

    def __contains__(self, row: int) -> bool:
        return 0 <= row < 8 * len(self._bits) and bool(self._bits[row >> 3] >> (row & 7) & 1)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[int]:
        return (8 * at + bit for at, byte in enumerate(self._bits) if byte for bit in range(8) if byte >> bit & 1)

    def gaps(self, stop: int) -> Iterator[range]:
        """The rows below `stop` that are missing, as the longest ranges there are, in order."""
        begin, top = None, min(stop, 8 * len(self._bits))
        for run in re.finditer(rb"\x00+|\xff+|[^\x00\xff]", self._bits):
            byte = self._bits[run.start()]
            whole = byte in (0, 255)  # bytes that are all alike need no look at each bit
            for row in (8 * run.start(),) if whole else range(8 * run.start(), 8 * run.end()):
                if row >= top:
                    break
                if row not in self:
                    begin = row if begin is None else begin
                elif begin is not None:
                    yield range(begin, row)
                    begin = None
        begin = top if begin is None else begin
        if begin < stop:
            yield range(begin, stop)

    def _add(self, row: int) -> None:
        if row not in self:
            if row >> 3 >= len(self._bits):
                self._bits.extend(bytes(max((row >> 3) + 1 - len(self._bits), len(self._bits) >> 3)))
            self._bits[row >> 3] |= 1 << (row & 7)
            self._count += 1

    def _discard(self, row: int) -> None:
        if row in self:
            self._bits[row >> 3] &= ~(1 << (row & 7))
            self._count -= 1


class Store:
    """A sweep's folder, made by `Store.open` or `Store.look`. One thread of one process may append to it."""

    def __init__(self, folder: Path, definition: Mapping[str, Any]) -> None:
        self.folder, self.definition, self.done = folder, definition, Done()
        self._file: FileIO | None = None  # none: only looked at
        self._lock: IO[bytes] | None = None
        self._size = 0  # bytes of whole lines

    @classmethod
    def open(cls, folder: Path | str, definition: Mapping[str, Any]) -> Store:
        """Make `folder` for the sweep of this definition, or open it to go on where it stopped.

        Raises `Refused` if the folder holds something else or another sweep (naming the first difference), if
        another process writes there, or if it cannot be written to.
        """
        at, wanted = Path(folder), json.loads(text(definition))
        try:
            lock = begun(at, definition)
            there = read_definition(at)
            check_same(at, there, wanted)
            store = cls(at, there)
            store._lock = lock or locked(at / DEFINITION, "r+b")
            try:
                store._mend()
            except BaseException:
                store.close()
                raise
        except OSError as error:
            raise Refused(f"cannot write to {at} ({error.strerror or error}); make it writable, or give another "
                          f"folder with --out") from error
        return store

    @classmethod
    def look(cls, folder: Path | str) -> Store:
        """The sweep in `folder`, to read from, also while it is being written. Raises `Refused` if there is none."""
        at = Path(folder)
        store = cls(at, read_definition(at))
        try:
            for _, row in store._lines():
                if row is not None:
                    store.done._add(row["row"])
        except OSError as error:
            raise Refused(f"cannot read {at / ROWS} ({error.strerror or error}); make it readable") from error
        return store

    def append(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Add the rows that are not there yet, all in one write, and hand them to the system.

        A row has its number under "row". What JSON has no word for is written as text; a metric that is not
        finite is left out. Raises `Refused` if the disk is full or gone, and then none of `rows` was added.
        """
        if self._file is None:
            raise Refused(f"{self.folder} was opened to be read; open it with `Store.open` to add to it")
        fresh = {row["row"]: row for row in reversed([*rows]) if row["row"] not in self.done}  # of twins the first
        metrics = frozenset(self.definition.get("metrics", ()))
        data = b"".join(_line(fresh[number], metrics) for number in reversed(fresh))
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[self._file.write(rest):]
            for number in fresh:
                self.done._add(number)
            self._size += len(data)
        except BaseException as error:  # an interrupt too: half a line would spoil the one after it
            for number in fresh:
                self.done._discard(number)
            with suppress(OSError):
                self._file.truncate(self._size)
            if isinstance(error, OSError):
                raise Refused(f"could not add to {self.folder / ROWS} ({error.strerror or error}); the rows before "
                              f"are safe: make room and type the same command again") from error
            raise

    def rows(self) -> Iterator[dict[str, Any]]:
        """The rows in the order in which they finished."""
        return (row for _, row in self._lines() if row is not None)

    def table(self) -> Table:
        """Every row that is there, by number: the same table whatever order they finished in."""
        from teleop.batch.table import Table

        axes = self.definition.get("grid", {}).get("axes", ())
        knobs = tuple(knob for axis in axes for knob in axis["knobs"])
        return Table(self.rows(), knobs, tuple(self.definition.get("metrics", ())))

    def close(self) -> None:
        """Let the disk have it, and others the folder."""
        if self._file is not None:
            with suppress(OSError):
                os.fsync(self._file.fileno())
            self._file.close()
        if self._lock is not None:
            self._lock.close()
        self._file = self._lock = None

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _lines(self) -> Iterator[tuple[bytes, dict[str, Any] | None]]:
        """Each line with its newline, and its row: none where the line is damaged, or the twin of one before."""
        seen = Done()
        try:
            file: BinaryIO = (self.folder / ROWS).open("rb")
        except FileNotFoundError:  # no row yet
            return
        with file:
            for line in file:
                if not line.endswith(b"\n"):  # the torn last one, or one just being written
                    return
                row = _row(line)
                if row is not None and row["row"] in seen:
                    row = None
                if row is not None:
                    seen._add(row["row"])
                yield line, row

    def _mend(self) -> None:
        """Read what is there, cut off a torn end, and drop lines that a failing disk or two writers left."""
        path, whole, sound = self.folder / ROWS, 0, True
        for line, row in self._lines():
            whole += len(line)
            if row is None:
                sound = False
            else:
                self.done._add(row["row"])
        if not sound:  # written anew beside it and put in its place, so that no row is ever at risk
            with replacing(path, settle=True) as file:
                whole = sum(file.write(line) for line, row in self._lines() if row is not None)
        self._file, self._size = FileIO(path, "a", opener=no_link), whole
        if self._file.tell() != whole:
            self._file.truncate(whole)


def _row(line: bytes) -> dict[str, Any] | None:
    """The row of a line, or none if it holds no row."""
    try:
        row = json.loads(line.decode())
        return row if type(row["row"]) is int and row["row"] >= 0 else None
    except (ValueError, TypeError, KeyError, RecursionError):  # no JSON, or JSON of something else
        return None


def _line(row: Mapping[str, Any], metrics: frozenset[str]) -> bytes:
    try:
        line = STRICT.encode(row)
    except (TypeError, ValueError):
        line = text({k: v for k, v in row.items() if k not in metrics or (v is not None and isfinite(v))})
    return line.encode() + b"\n"
