"""A live end's record as it grows: the rows that have come since it was looked at last.

No array and no numpy: there are a few rows each time, sixty times a second.
"""

from __future__ import annotations

import os
from collections import deque
from pathlib import Path
from struct import Struct
from struct import error as StructError
from typing import Any, BinaryIO

from teleop.live.records.header import read_header
from teleop.live.records.record import FILE
from teleop.storage.files import open_regular
from teleop.storage.strict_json import Misshapen, parse

MOST = 1 << 18  # bytes that are read at a time: 2 s of a scene with three axes
KEPT = 512  # rows, the newest ones
HAND = "hand.bin"
LONGEST_LINE = 1 << 10  # bytes of its header

Row = tuple[float, ...]


class Hand:
    """Where the hand's reference is, m per axis: the last whole row of the master's `hand.bin`, see its package."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / HAND
        self._file: BinaryIO | None = None
        self._offset = 0
        self._row = Struct("")

    def newest(self) -> Row | None:
        """That place; None where the master records none, or has not begun to."""
        try:
            if self._file is None and not self._begin():
                return None
            assert self._file is not None
            count = (os.fstat(self._file.fileno()).st_size - self._offset) // self._row.size
            if count < 1:
                return None
            data = os.pread(self._file.fileno(), self._row.size, self._offset + (count - 1) * self._row.size)
            row: Row = self._row.unpack(data)
        except (OSError, StructError, ValueError, KeyError, TypeError):  # it is a help to the eye, and may be missing
            return None
        return row[1:]

    def close(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()
        self._file = None

    def _begin(self) -> bool:
        file = open_regular(self._path, links=False)
        line = file.readline(LONGEST_LINE)
        if not line.endswith(b"\n"):
            file.close()
            return False
        self._offset, self._file = len(line), file
        self._row = Struct(f"<{1 + int(parse(line)['axes'])}d")
        return True


class Follower:
    """The record in `folder`, from its header on, as soon as it is there; a row that is cut off waits for its rest."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.places: dict[str, slice] = {}  # of each column in a row, once there is a header
        self.axes = 0
        self.newest: deque[Row] = deque(maxlen=KEPT)  # oldest first; of one tick each
        self._file: BinaryIO | None = None
        self._offset = 0
        self._row = Struct("")

    def read(self) -> list[Row]:
        """The rows that have come, oldest first. Raises `OSError` or `Misshapen` for what is no record."""
        if self._file is None and not self._begin():
            return []
        assert self._file is not None
        data = os.pread(self._file.fileno(), MOST, self._offset)
        whole = len(data) - len(data) % self._row.size
        if not whole:
            return []
        self._offset += whole
        rows = list(self._row.iter_unpack(memoryview(data)[:whole]))
        self.newest.extend(rows)
        return rows

    def at(self, k: float) -> Row | None:
        """The newest row of a tick up to k, if it is still known."""
        return next((row for row in reversed(self.newest) if row[0] <= k), None)

    def close(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()
        self._file = None

    def _begin(self) -> bool:
        """Read the header; False while it is not there, or not as a whole."""
        try:
            file = open_regular(self.folder / FILE, links=False)
        except FileNotFoundError:
            return False
        try:
            header: dict[str, Any] = read_header(file)
        except Misshapen:
            cut = not file.seek(0) and not file.readline().endswith(b"\n")
            file.close()
            if cut:
                return False
            raise
        self._offset, self._file = file.tell(), file
        columns, self.axes = header["columns"], header["axes"]
        self._row = Struct(f"<{len(columns)}d")
        self.places = {name: slice(columns.index(name), columns.index(name) + columns.count(name)) for name in columns}
        return True
