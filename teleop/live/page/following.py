"""What a page looks at while the ends write it: the newest rows of a record, and where the hand's reference is."""

from __future__ import annotations

import os
from collections import deque
from pathlib import Path
from struct import Struct
from struct import error as StructError
from typing import BinaryIO

from teleop.live.records.following import GrowingRecord, Row
from teleop.storage.files import open_regular
from teleop.storage.strict_json import parse

KEPT = 512  # rows, the newest ones
HAND = "hand.bin"
LONGEST_LINE = 1 << 10  # bytes of its header

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


class Follower(GrowingRecord):
    """The record in `folder` as it grows, where each column stands in a row of it, and its newest rows."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.places: dict[str, slice] = {}  # of each column in a row, once there is a header
        self.axes = 0
        self.newest: deque[Row] = deque(maxlen=KEPT)  # oldest first; of one tick each

    def read(self) -> list[Row]:
        """The rows that have come, oldest first. Raises `OSError` or `Misshapen` for what is no record of a run."""
        rows = super().read()
        if self.header is not None and not self.places:
            columns, self.axes = self.header["columns"], self.header["axes"]
            self.places = {name: slice(columns.index(name), columns.index(name) + columns.count(name))
                           for name in columns}
        self.newest.extend(rows)
        return rows

    def at(self, k: float) -> Row | None:
        """The newest row of a tick up to k, if it is still known."""
        return next((row for row in reversed(self.newest) if row[0] <= k), None)
