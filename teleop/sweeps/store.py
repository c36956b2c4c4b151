"""The folder of a sweep: what was asked for, and its rows as they finish. A kill at any time costs the rows in flight.

`sweep.json` holds the definition; it is there, whole, before the first row. `rows.jsonl` holds one line of JSON a
row and is only ever appended to. A line counts once its newline is there, so what a kill leaves half-written is cut
off when the folder is opened again. Whoever only reads (`Store.look`) changes nothing and may do so meanwhile.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from errno import EFBIG
from io import FileIO
from math import inf, isfinite
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from teleop.errors import Refused
from teleop.storage.files import open_regular, replacing
from teleop.storage.strict_json import DEEPEST, Misshapen, parse_line
from teleop.storage.strict_json import LONGEST as LONGEST_NUMBER
from teleop.sweeps.definition import (
    DEFINITION,
    STRICT,
    begun,
    check_same,
    defined_anew,
    locked,
    no_link,
    read_definition,
    rows_of,
    text,
    with_edits,
)

if TYPE_CHECKING:
    from teleop.sweeps.table import Table

ROWS = "rows.jsonl"
LONGEST = 1 << 20  # bytes of a row
_GREATEST = 10**LONGEST_NUMBER


class RowNumbers:
    """The numbers of the rows that are there, a bit for each in pages of 4096: a sweep of 1e9 rows takes 165 MB.

    A page is there from its first row on, so that a number alone, however large, asks for no more than one.
    """

    def __init__(self) -> None:
        self._pages: dict[int, bytearray] = {}
        self._count = 0

    def __contains__(self, row: int) -> bool:
        page = self._pages.get(row >> 12)
        return page is not None and bool(page[(row & 4095) >> 3] >> (row & 7) & 1)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[int]:
        for number in sorted(self._pages):
            for at, byte in enumerate(self._pages[number]):
                yield from ((number << 12) + 8 * at + bit for bit in range(8) if byte >> bit & 1)

    def gaps(self, stop: int) -> Iterator[range]:
        """The rows below `stop` that are missing, as the longest ranges there are, in order."""
        begin: int | None = None
        top = 0  # all below has been looked at
        for number in sorted(self._pages):
            if number << 12 >= stop:
                break
            if number << 12 > top and begin is None:
                begin = top
            for gap, row in self._changes(number, stop):
                if gap:
                    begin = row if begin is None else begin
                elif begin is not None:
                    yield range(begin, row)
                    begin = None
            top = min((number + 1) << 12, stop)
        begin = top if begin is None else begin
        if begin < stop:
            yield range(begin, stop)

    def _changes(self, number: int, stop: int) -> Iterator[tuple[bool, int]]:
        """Is the row missing, and its number: the rows below `stop` of a page, of equal bytes in a row the first."""
        base = number << 12
        for run in re.finditer(rb"\x00+|\xff+|[^\x00\xff]", self._pages[number]):
            begin, byte = base + 8 * run.start(), self._pages[number][run.start()]
            if byte in (0, 255):  # bytes that are all alike need no look at each bit
                if begin < stop:
                    yield byte == 0, begin
                continue
            for bit in range(8):
                if begin + bit < stop:
                    yield not byte >> bit & 1, begin + bit

    def _add(self, row: int) -> None:
        if row not in self:
            page = self._pages.get(row >> 12)
            if page is None:
                page = self._pages[row >> 12] = bytearray(512)
            page[(row & 4095) >> 3] |= 1 << (row & 7)
            self._count += 1

    def _discard(self, row: int) -> None:
        if row in self:
            self._pages[row >> 12][(row & 4095) >> 3] &= ~(1 << (row & 7))
            self._count -= 1


class Store:
    """A sweep's folder, made by `Store.open` or `Store.look`. One thread of one process may append to it."""

    def __init__(self, folder: Path, definition: Mapping[str, Any]) -> None:
        self.folder, self.definition, self.done = folder, definition, RowNumbers()
        self._most = rows_of(definition)
        self._file: FileIO | None = None  # none: only looked at
        self._locks: list[IO[bytes]] = []
        self._size = 0  # bytes of whole lines

    @classmethod
    def open(cls, folder: Path | str, definition: Mapping[str, Any], mended: Sequence[str] = ()) -> Store:
        """Make `folder` for the sweep of this definition, or open it to go on where it stopped.

        `mended`: metrics of the user's own that may have been edited since. Before there is a row, all that is the
        user's own may.

        Raises `Refused` if the folder holds something else or another sweep (naming the first difference), if
        another process writes there, or if it cannot be written to.
        """
        at, wanted = Path(folder), json.loads(text(definition))
        try:
            lock = begun(at, definition)
            there = read_definition(at)
            check_same(at, with_edits(there, wanted, mended, _has_bytes(at / ROWS)), wanted)
            store = cls(at, wanted)
            store._locks.append(lock or locked(at / DEFINITION, "r+b"))
            try:
                store._mend()
                if read_definition(at) != wanted:
                    check_same(at, with_edits(there, wanted, mended, bool(store.done)), wanted)  # others had the folder
                    store._locks.append(defined_anew(at, wanted))  # the first is held on to: others may have it open
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
        from teleop.sweeps.table import Table

        axes = self.definition.get("grid", {}).get("axes", ())
        knobs = tuple(knob for axis in axes for knob in axis["knobs"])
        return Table(self.rows(), knobs, tuple(self.definition.get("metrics", ())))

    def close(self) -> None:
        """Let the disk have it, and others the folder."""
        if self._file is not None:
            with suppress(OSError):
                os.fsync(self._file.fileno())
            self._file.close()
        for file in self._locks:
            file.close()
        self._file, self._locks = None, []

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _lines(self) -> Iterator[tuple[bytes, dict[str, Any] | None]]:
        """Each line with its newline, and its row: none where the line is damaged, or the twin of one before."""
        seen = RowNumbers()
        try:
            file = open_regular(self.folder / ROWS, links=False)
        except FileNotFoundError:  # no row yet
            return
        with file:
            while line := file.readline(LONGEST):
                if not line.endswith(b"\n"):  # the torn last one, or one just being written
                    if len(line) == LONGEST:
                        raise OSError(EFBIG, f"it has a line of more than {LONGEST >> 20} MB")
                    return
                row = _row(line)
                if row is not None and (row["row"] in seen or row["row"] >= self._most):
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


def _has_bytes(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0


def _row(line: bytes) -> dict[str, Any] | None:
    """The row of a line, or none if it holds no row."""
    try:
        row = parse_line(line)
        sound = type(row["row"]) is int and row["row"] >= 0 and all(map(_is_cell, row.values()))
        return row if sound else None
    except (Misshapen, TypeError, KeyError):  # no JSON, or JSON of something else
        return None


def _is_cell(value: Any, level: int = 0) -> bool:
    """Is it a finite number, a text or a truth, or lists of such as a knob may have?"""
    kind = type(value)
    if kind is float:
        return bool(-inf < value < inf)
    if kind is int:
        return bool(-_GREATEST < value < _GREATEST)
    if kind is list:
        return level < DEEPEST and all(_is_cell(each, level + 1) for each in value)
    return kind is not dict


def _line(row: Mapping[str, Any], metrics: frozenset[str]) -> bytes:
    try:
        line = STRICT.encode(row)
    except (TypeError, ValueError):
        line = text({k: v for k, v in row.items() if k not in metrics or (v is not None and isfinite(v))})
    return line.encode() + b"\n"
