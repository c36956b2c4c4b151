"""Recorded references: the motion of a hand, read from a CSV file."""

from __future__ import annotations

from array import array
from bisect import bisect_right
from dataclasses import dataclass, field
from math import isfinite
from operator import itemgetter
from zlib import crc32

from teleop.errors import Refused, number, number_of
from teleop.storage.files import read_bytes

Row = tuple[float, ...]
HEADERS = (("t", "x"), ("t", "x", "y", "z"))
FORM = "one row `t, x` or `t, x, y, z` per instant, in s and m"


@dataclass(frozen=True, kw_only=True, slots=True)
class Recording:
    """A reference that replays the file at `path`, its positions times `scale`.

    The file has the columns `t, x` or `t, x, y, z` (s, m); that line may stand above them, `#` begins a
    comment, empty lines are skipped. t increases from row to row. The motion is straight between rows and
    held before the first and after the last. A file of one column of positions moves the first axis of a
    scene, one of three needs a scene of three axes. The file is read once, when the recording is made;
    Refused with path and line where it cannot be replayed.
    """

    path: str
    scale: float = 1.0
    crc: int = field(init=False, repr=False)
    """Of what was recorded: other contents under the same path are another motion."""
    _rows: tuple[Row, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        number("scale", self.scale)
        rows = read(self.path)
        object.__setattr__(self, "_rows", rows)
        object.__setattr__(self, "crc", crc32(repr(rows).encode()))

    def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> tuple[array[float], ...]:
        """For each axis the position (m) at the ticks first .. first+count-1."""
        rows, scale = self._rows, float(self.scale)
        had = len(rows[0]) - 1
        if had not in (1, axes):
            raise Refused(f"{self.path} holds a motion along {had} axes, the scene has axes={axes}; set "
                          f"axes={had}, or keep only the columns t and x")
        out: tuple[array[float], ...] = tuple(array("d") for _ in range(had))
        last = len(rows) - 1
        at = max(0, bisect_right(rows, first * dt_ns / 1e9, key=itemgetter(0)) - 1)
        for k in range(first, first + count):  # rows[at] is the newest row that is not ahead of the tick
            t = k * dt_ns / 1e9
            while at < last and rows[at + 1][0] <= t:
                at += 1
            before, after = rows[at], rows[min(at + 1, last)]
            # 0 before the first row and after the last
            part = (t - before[0]) / (after[0] - before[0]) if t > before[0] and at < last else 0.0
            for axis, values in enumerate(out, start=1):
                values.append(scale * (before[axis] + (after[axis] - before[axis]) * part))
        return out + tuple(array("d", [0.0]) * count for _ in range(axes - had))


def read(path: str) -> tuple[Row, ...]:
    """Read the rows of a recording, at least one. Raises `Refused` with path and line for a row that is none."""
    rows: list[Row] = []
    width = 0  # of the header or the first row; 0 before either
    for at, line in enumerate(_lines(path), start=1):
        cells = [cell.strip() for cell in line.split("#", 1)[0].split(",")]
        if cells == [""]:
            continue
        if not width and tuple(cell.lower() for cell in cells) in HEADERS:
            width = len(cells)
            continue
        row = tuple(_cell(cell, path, at) for cell in cells)
        width = width or len(row)
        if len(row) != width or width not in (2, 4):
            right = width if width in (2, 4) else "2 or 4"
            raise Refused(f"{path} line {at}: {number_of(len(row), 'column')} in place of {right}; complete or remove "
                          f"the line: {FORM}")
        if rows and row[0] <= rows[-1][0]:
            raise Refused(f"{path} line {at}: t = {row[0]:g} s does not come after {rows[-1][0]:g} s; sort "
                          "the rows by time and keep one for each instant")
        rows.append(row)
    if not rows:
        raise Refused(f"{path} holds no motion; a recording has {FORM}")
    return tuple(rows)


def _lines(path: str) -> list[str]:
    """The lines of a text file."""
    if not isinstance(path, str):
        raise Refused(f"path must be the name of a CSV file, not {path!r}; write path='reach.csv'")
    try:
        return read_bytes(path).decode("utf-8-sig").splitlines()
    except OSError as error:
        raise Refused(f"cannot read the recording {path!r}: {error.strerror}; name a CSV file") from None
    except ValueError:
        raise Refused(f"{path!r} is not text; a recording is a CSV file, {FORM}") from None


def _cell(cell: str, path: str, at: int) -> float:
    """Convert a cell of a CSV file to a finite number. Raises `Refused`."""
    try:
        value = float(cell.replace("_", "?"))  # only Python reads 1_0 as a number
    except ValueError:
        raise Refused(f"{path} line {at}: {cell!r} is not a number; correct or remove it: {FORM}") from None
    if not isfinite(value):
        raise Refused(f"{path} line {at}: {cell!r} is not finite; correct or remove the line")
    return value
