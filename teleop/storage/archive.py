"""The arrays of a run in a file of numpy's (npz), read without trusting what the file says of itself.

The sizes in the head of the archive and in the heads of its arrays are compared with each other and with the number of
rows that the run has before room is made for any array. Objects, which would be pickles, are refused. Whoever needs no
array as a whole reads all of them side by side, some rows at a time: `open_arrays`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from math import prod
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

from teleop.storage.files import open_regular
from teleop.storage.strict_json import Misshapen

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MOST_ARRAYS = 256
MOST_AXES = 16
INFLATED = 256 * 2**20  # bytes of all arrays of an archive that is compressed; of one that is not, its own size
_NAME = re.compile(r"([A-Za-z_][A-Za-z0-9_]{0,63})\.npy")
_HEAD = 4096  # bytes that numpy's head of one array takes at most


def read_arrays(path: Path, rows: int | None) -> dict[str, NDArray[Any]]:
    """The arrays of the archive at `path` by name: numbers or truths, each (rows,) or (rows, axes).

    Without `rows` they are those of an analysis: each of its own length, complex too, with up to three dimensions.

    Raises `OSError`, `Misshapen`, or what `zipfile` and numpy raise of a broken archive. A link is not followed.
    """
    with open_regular(path, links=False) as file, ZipFile(file) as archive:
        return {name: _array(archive, part, name, rows) for name, part in _parts(archive, file)}


class StoredArray:
    """An array of an archive that is open: `shape` and `dtype`, and its rows, read once from the first to the last."""

    def __init__(self, stream: IO[bytes], shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.shape, self.dtype = shape, dtype
        self._stream = stream

    def read(self, rows: int) -> NDArray[Any]:
        """The next `rows` rows, of shape (rows,) or (rows, axes). Raises `Misshapen` if there are fewer."""
        import numpy as np

        out: NDArray[Any] = np.empty((rows, *self.shape[1:]), self.dtype)
        _fill(self._stream, out.reshape(-1).view(np.uint8), last=False)
        return out


@contextmanager
def open_arrays(path: Path, rows: int) -> Iterator[dict[str, StoredArray]]:
    """The same arrays, open to be read some rows at a time. Raises what `read_arrays` does.

    Refused too is an array that is stored column by column, which this package never writes.
    """
    with ExitStack() as opened:
        file = opened.enter_context(open_regular(path, links=False))
        archive = opened.enter_context(ZipFile(file))
        arrays = {}
        for name, part in _parts(archive, file):
            stream = opened.enter_context(archive.open(part))
            shape, by_columns, dtype = _head(stream, part, name, rows)
            if by_columns and len(shape) > 1:
                raise Misshapen(f"{name} is stored column by column")
            arrays[name] = StoredArray(stream, shape, dtype)
        yield arrays


def _parts(archive: ZipFile, file: BinaryIO) -> list[tuple[str, ZipInfo]]:
    """The arrays in the archive by name, if they are few, of a size that it can have, and each is there once."""
    parts = archive.infolist()
    size = file.seek(0, 2)
    whole = sum(part.file_size for part in parts)
    if len(parts) > MOST_ARRAYS:
        raise Misshapen(f"it has {len(parts)} arrays, more than {MOST_ARRAYS}")
    if whole > max(size, INFLATED):
        raise Misshapen(f"its {size} bytes would inflate to {whole}")
    parts_by_name: dict[str, ZipInfo] = {}
    for part in parts:
        name = _NAME.fullmatch(part.filename)
        if name is None or name[1] in parts_by_name or part.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
            raise Misshapen(f"{part.filename[:80]!r} in it is no array of its own")
        parts_by_name[name[1]] = part
    return [*parts_by_name.items()]


def _head(stream: IO[bytes], part: ZipInfo, name: str, rows: int | None) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, is it stored column by column, and type of an array; leaves `stream` at its numbers."""
    from numpy.lib.format import read_array_header_1_0, read_magic

    if read_magic(stream) != (1, 0):
        raise Misshapen(f"{name} is no array of numpy's format 1.0")
    shape, by_columns, dtype = read_array_header_1_0(stream, max_header_size=_HEAD)
    numbers = dtype.kind in "fiub" and (4 if dtype.kind == "f" else 1) <= dtype.itemsize <= 8
    if not (numbers or (rows is None and dtype.kind == "c" and dtype.itemsize == 16)):
        raise Misshapen(f"{name} holds {dtype}, and a trace holds numbers")
    most = 2 if rows is not None else 3
    if not 1 <= len(shape) <= most or rows not in (None, shape[0]) or not all(
            1 <= each <= MOST_AXES for each in shape[1:]):
        expected = f"the run has {rows} rows" if rows is not None else "curves have 1 to 3 dimensions"
        raise Misshapen(f"{name} is of shape {shape}, and {expected}")
    count = prod(shape)
    if part.file_size - stream.tell() != count * dtype.itemsize:
        raise Misshapen(f"{name} is of another size than its head says")
    return shape, by_columns, dtype


def _array(archive: ZipFile, part: ZipInfo, name: str, rows: int | None) -> NDArray[Any]:
    import numpy as np

    with archive.open(part) as stream:
        shape, by_columns, dtype = _head(stream, part, name, rows)
        flat: NDArray[Any] = np.empty(prod(shape), dtype)
        _fill(stream, flat.view(np.uint8), last=True)
    got = flat.reshape(shape[::-1]).T if by_columns else flat.reshape(shape)
    return np.asarray(got)


def _fill(stream: IO[bytes], room: NDArray[Any], *, last: bool) -> None:
    """Read as many bytes as there is `room` for; of the `last` ones the checksum is looked at."""
    import numpy as np

    at = 0
    while at < len(room):
        block = stream.read(min(1 << 20, len(room) - at))
        if not block:
            raise Misshapen("it ends in the middle of an array")
        room[at : at + len(block)] = np.frombuffer(block, np.uint8)
        at += len(block)
    if last:
        stream.read(1)
