"""A live end's record as it grows: the rows that have come since it was looked at last.

No array and no numpy: there are a few rows each time.
"""

from __future__ import annotations

import os
from pathlib import Path
from struct import Struct
from typing import Any, BinaryIO

from teleop.live.records.header import read_header
from teleop.live.records.record import FILE
from teleop.scene.scene import MOST_TICKS
from teleop.storage.files import open_regular
from teleop.storage.strict_json import Misshapen

MOST = 1 << 18  # bytes that are read at a time: 2 s of a scene with three axes

Row = tuple[float, ...]  # tick, lateness (ns), packet played, and the end's columns


class GrowingRecord:
    """The record in `folder`, from its header on, as soon as it is there; a row that is cut off waits for its rest."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.header: dict[str, Any] | None = None
        self._file: BinaryIO | None = None
        self._offset = 0
        self._row = Struct("")
        self._last = -1.0

    def read(self) -> list[Row]:
        """The rows that have come, oldest first. Raises `OSError` or `Misshapen` for what is no record of a run."""
        if self._file is None and not self._begin():
            return []
        assert self._file is not None
        data = os.pread(self._file.fileno(), MOST, self._offset)
        whole = len(data) - len(data) % self._row.size
        rows: list[Row] = list(self._row.iter_unpack(memoryview(data)[:whole]))
        for row in rows:
            if not (self._last < row[0] < MOST_TICKS and row[0].is_integer() and row[2].is_integer()):
                raise Misshapen(f"it is damaged: after tick {self._last:g} comes a row that is no tick of a run")
            self._last = row[0]
        self._offset += whole
        return rows

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
            self.header = read_header(file)
        except Misshapen:
            cut = not file.seek(0) and not file.readline().endswith(b"\n")
            file.close()
            if cut:
                return False
            raise
        self._offset, self._file = file.tell(), file
        self._row = Struct(f"<{len(self.header['columns'])}d")
        return True
