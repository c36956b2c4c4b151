"""Rows of a live record on the disk, read a part at a time."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import TYPE_CHECKING, Any

from teleop.live.records.header import OWN
from teleop.simulation.trace import blocks
from teleop.storage.files import open_regular

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class TruncatedRecord(UserWarning):
    """A live record ends in the middle of a row."""


class RecordFile:
    """The rows of a record on the disk, as many as were there when it was opened: read a part at a time, never kept."""

    def __init__(self, path: Path, offset: int, width: int, count: int) -> None:
        self._path, self._offset, self._width, self._count = path, offset, width, count

    def __len__(self) -> int:
        return self._count

    def part(self, start: int, stop: int) -> NDArray[np.float64]:
        """All columns of the rows from `start` up to `stop`, of shape (rows, columns)."""
        import numpy as np

        size = 8 * self._width
        with open_regular(self._path, links=False) as file:
            file.seek(self._offset + size * start)
            data = file.read(size * (stop - start))
        if len(data) < size * (stop - start):
            raise OSError(errno.EIO, "it has become shorter since it was opened", str(self._path))
        return np.frombuffer(data, dtype="<f8").reshape(stop - start, self._width)

    def table(self, start: int, stop: int) -> NDArray[np.float64]:
        """The same without the columns before the end's own."""
        return self.part(start, stop)[:, len(OWN):]


class RecordColumn:
    """One of the first columns of a record, which `numpy.asarray` reads as numbers of type `dtype`."""

    def __init__(self, rows: RecordFile, at: int, dtype: str) -> None:
        self._rows, self._at, self._dtype = rows, at, dtype

    def __len__(self) -> int:
        return len(self._rows)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        import numpy as np

        out = np.empty(len(self), dtype=dtype or self._dtype)
        for block in blocks(len(self)):
            out[block] = self._rows.part(block.start, block.stop)[:, self._at].astype(self._dtype)
        return out
