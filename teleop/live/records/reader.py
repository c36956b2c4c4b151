"""Readers of a live end's record: its header, its rows on the disk a part at a time, and its rows as they come."""

from __future__ import annotations

import errno
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from struct import Struct
from typing import TYPE_CHECKING, Any, BinaryIO

from teleop.errors import Refused
from teleop.protocol.manifest import MOST_EVERY
from teleop.scene.axes import MOST_AXES, SHAPES
from teleop.scene.library import own_file
from teleop.scene.scene import MOST_TICKS, Scene
from teleop.simulation.structure import SENSED, columns
from teleop.simulation.summary_shape import MOST_SEED
from teleop.simulation.trace import EndRecord, ForceSource, blocks
from teleop.storage.files import open_regular
from teleop.storage.strict_json import Misshapen, dict_of, list_of, one_of, parse, record, text, whole

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

FILE = "record.bin"
IDLE = "idle.bin"  # the newest rows of an end that writes no more of its run
OWN = ("k", "late_ns", "seq")  # columns before the end's
LAW = "law_sha256"  # of a law in a file of the user's own: the first digits of that of its content, as it ran
LONGEST = 1 << 20  # bytes of a header
MOST_COLUMNS = 100 * MOST_AXES
MOST = 1 << 18  # bytes that are read at a time: 2 s of a scene with three axes
Row = tuple[float, ...]  # tick, lateness (ns), packet played, and the end's columns
_BLOCK = 4096  # rows that are looked at together
_LARGEST = float(1 << 53)  # a whole number that a float holds exactly
_HEADER = record({
    "end": one_of("m", "s"), "dt_ns": whole(low=1000, high=10**10), "axes": whole(low=1, high=MOST_AXES), "scene": text,
    "knobs": dict_of(text), "seed": whole(low=0, high=MOST_SEED), "mode": one_of("live", "lockstep"),
    "columns": list_of(text, most=MOST_COLUMNS),
}, {"every": whole(low=1, high=MOST_EVERY), "command": list_of(text), "force": one_of("sensor", "bodies", "unknown"),
    LAW: text, **SHAPES})


def header_columns(scene: Scene, e: str, force: ForceSource) -> list[str]:
    """The columns of the record of the end `e`, each once per axis where it has axes."""
    flat = list(OWN)
    for name in columns(scene, e, force == "sensor"):
        flat += [name.removesuffix("@")] * (scene.axes if "@" in name else 1)
    return flat


def law_entry(scene: Scene) -> dict[str, str]:
    """Entry of a header on a law in a file of the user's; empty for one that comes with a package."""
    file = own_file(type(scene.laws[0]))
    return {} if file is None else {LAW: file.digest}


def read_header(file: BinaryIO) -> dict[str, Any]:
    """The first line of a record, which leaves `file` at its first row. Raises `Misshapen`."""
    line = file.readline(LONGEST)
    if not line.endswith(b"\n"):
        raise Misshapen("its first line is no header")
    header: dict[str, Any] = parse(line)
    _HEADER(header, "its header")
    if len(header["columns"]) <= len(OWN):
        raise Misshapen("its header names no column")
    if "force" not in header:  # of a release that did not say whose device it was
        header["force"] = "sensor" if SENSED[header["end"]] in header["columns"] else "unknown"
    return header


def sound_rows(file: BinaryIO, width: int) -> tuple[int, str]:
    """Count the rows from here on that can be ticks of a run; and say why the next one cannot.

    A row can be one if its tick is whole and later than the one before, its lateness and its packet are numbers. What
    a machine without power left unwritten, or others wrote, ends the record there, before any room is made for it.
    """
    import numpy as np

    count, last = 0, -1.0
    while block := file.read(8 * width * _BLOCK):
        whole = len(block) // (8 * width)
        table = np.frombuffer(block[: 8 * width * whole], dtype="<f8").reshape(-1, width)
        ticks, late, played = table[:, 0], table[:, 1], table[:, 2]
        with np.errstate(invalid="ignore"):
            sound = (np.diff(ticks, prepend=last) > 0.0) & (ticks == np.floor(ticks)) & (ticks < MOST_TICKS)
            sound &= (np.abs(late) < _LARGEST) & (np.abs(played) < _LARGEST) & (played == np.floor(played))
        if not sound.all():
            return count + int(np.argmin(sound)), "damaged, with a row that is no tick of a run"
        count += whole
        if whole * 8 * width < len(block):
            return count, "cut off in the middle of a row, as by a killed process"
        last = ticks[-1]
    return count, ""


def check_fits(scene: Scene, header: dict[str, Any], ticks: Sequence[int], folder: object) -> None:
    """Refuse a record that cannot be of a run of `scene`: of another law or other columns, or with ticks beyond it."""
    if LAW in header and law_entry(scene) != {LAW: header[LAW]}:
        raise Refused(f"the file of the law was edited since the run in {folder}, and a summary would tell of a law "
                      "that did not run; put back the file as it was")
    expected = (scene.dt_ns, scene.axes, header_columns(scene, header["end"], header["force"]))
    if expected != (header["dt_ns"], header["axes"], header["columns"]):
        raise Refused(f"the record in {folder} is not of the scene {scene.name} as it is here: its tick, axes or "
                      "columns are others; install the release that wrote it, or give another folder")
    if len(ticks) and ticks[-1] >= scene.ticks:
        raise Refused(f"the record in {folder} has a tick {ticks[-1]}, and its run has the ticks 0 to "
                      f"{scene.ticks - 1}; the file is damaged: give another folder")


class TruncatedRecord(UserWarning):
    """A live record ends in the middle of a row."""


class RecordFile:
    """The rows of a record on the disk, as many as were there when it was opened: read a part at a time, never kept."""

    def __init__(self, path: Path, offset: int, width: int, count: int) -> None:
        self._path, self._offset, self._width, self._count = path, offset, width, count

    def __len__(self) -> int:
        return self._count

    def part(self, start: int, stop: int) -> NDArray[np.float64]:
        """Read all columns of the rows from `start` up to `stop`, of shape (rows, columns)."""
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
    """Column of a record, one of the first, which `numpy.asarray` reads as numbers of type `dtype`."""

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


def read_record(folder: Path) -> tuple[dict[str, Any], EndRecord, RecordColumn]:
    """The header, the rows and the lateness (ns) of each tick of the record in `folder`. Raises `Refused`.

    Rows and lateness are read when they are asked for, as they were then: the file may be growing.
    """
    import numpy as np

    path = folder / FILE
    try:
        with open_regular(path, links=False) as file:
            header = read_header(file)
            width, start = len(header["columns"]), file.tell()
            count, rest = sound_rows(file, width)
    except (OSError, Misshapen) as error:  # no file, or one of something else
        why = error.strerror if isinstance(error, OSError) else error
        raise Refused(f"{folder} holds no record of a live end ({why}); give the folder of one") from error
    if rest:
        warnings.warn(f"{path} is {rest}: row {count} and what came after it are lost", TruncatedRecord, stacklevel=2)
    rows = RecordFile(path, start, width, count)
    ticks = np.asarray(RecordColumn(rows, 0, "int64"))
    record = EndRecord(ticks, rows, RecordColumn(rows, 2, "int64"), header["force"])
    return header, record, RecordColumn(rows, 1, "float64")


def read_noted(folder: Path) -> tuple[dict[str, Any], EndRecord, RecordColumn, list[str]]:
    """The same as `read_record`, with what it warns of as sentences for the summary."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        parts = read_record(folder)
    return *parts, [str(warning.message) for warning in warned]


class GrowingRecord:
    """The record in `folder`, from its header on, as soon as it is there; a row that is cut off waits for its rest.

    `name`: `IDLE` for the newest rows of an end that writes no more, whose file becomes shorter each time it is begun
    anew: what was in it then has been read, or is lost.
    """

    def __init__(self, folder: Path, name: str = FILE) -> None:
        self.folder, self.name = folder, name
        self.header: dict[str, Any] | None = None
        self._file: BinaryIO | None = None
        self._offset = self._first = 0  # where the next row is; the first
        self._row = Struct("")
        self._last = -1.0

    def read(self) -> list[Row]:
        """The rows that have come, oldest first. Raises `OSError` or `Misshapen` for what is no record of a run."""
        if self._file is None and not self._begin():
            return []
        assert self._file is not None
        if self.name == IDLE and os.fstat(self._file.fileno()).st_size < self._offset:
            self._offset = self._first
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
            file = open_regular(self.folder / self.name, links=False)
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
        self._first = self._offset = file.tell()
        self._file = file
        self._row = Struct(f"<{len(self.header['columns'])}d")
        return True
