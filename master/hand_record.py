"""The record of a hand: where its reference was, tick by tick, while it was steered.

`hand.bin` is one line of JSON, `{"version": 1, "dt_ns": ..., "axes": ...}`, then rows of little-endian float64: the
tick, and the reference (m) in each axis. Ticks grow from row to row; at one without a row the reference is as at the
row before.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from struct import Struct
from typing import BinaryIO

FILE = "hand.bin"
VERSION = 1
EVERY = 250  # rows between two writes


class HandWriter:
    """Appends rows to `folder/hand.bin`, which it makes. A full disk ends the record, never the motion."""

    def __init__(self, folder: Path, dt_ns: int, axes: int) -> None:
        """Begin the file. Raises `OSError`, also where there is one."""
        self.trouble: str | None = None
        self._pack = Struct(f"<{1 + axes}d").pack
        self._rows = bytearray()
        self._count = 0
        self._file: BinaryIO = (folder / FILE).open("xb")
        self._file.write(json.dumps({"version": VERSION, "dt_ns": dt_ns, "axes": axes}).encode() + b"\n")
        self._file.flush()

    def add(self, k: int, r: Sequence[float]) -> None:
        """Append the row of tick k: the reference r, m, per axis."""
        self._rows += self._pack(k, *r)
        self._count += 1
        if self._count % EVERY == 0:
            self._flush()

    def close(self) -> None:
        """Write the rest."""
        self._flush()
        try:
            self._file.close()
        except OSError as error:
            self.trouble = self.trouble or f"the record of the hand was not closed: {error.strerror or error}"

    def _flush(self) -> None:
        rows, self._rows = self._rows, bytearray()
        if self.trouble is not None:
            return
        try:
            self._file.write(rows)
            self._file.flush()
        except OSError as error:
            self.trouble = f"the record of the hand stopped at row {self._count}: {error.strerror or error}"
