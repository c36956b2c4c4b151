"""The record of a hand: where its reference was, tick by tick, while it was steered.

`hand.bin` is one line of JSON, `{"version": 1, "dt_ns": ..., "axes": ...}`, then rows of little-endian float64: the
tick, and the reference (m) in each axis. Ticks grow from row to row; at one without a row the reference is as at the
row before. `HandRecording` is the reference that it holds, for any scene.
"""

from __future__ import annotations

import json
import warnings
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from struct import Struct
from typing import Any, BinaryIO, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from teleop.errors import Refused, number_of
from teleop.scene.axes import MOST_AXES
from teleop.scene.scene import MOST_TICKS
from teleop.storage.files import open_regular, read_bytes
from teleop.storage.strict_json import Misshapen, list_of, parse, record, text, whole

FILE = "hand.bin"
PAGE = "page.json"
VERSION = 1
ANEW = ("again", "lost", "idle")  # why a part began whose bodies were not where those of the part before were
EVERY = 16  # rows between two writes: a live page follows them
LONGEST = 1 << 10  # bytes of a header
FARTHEST = 1e6  # m, of a place: with more a scene has diverged
_VERSION = whole(low=VERSION, high=VERSION)
_HEADER = record({"version": _VERSION, "dt_ns": whole(low=1000, high=10**10), "axes": whole(low=1, high=MOST_AXES)})
_PAGE = record({"version": _VERSION, "parts": list_of(record({"folder": text, "why": text}), most=100_000)})


class HandWriter:
    """Appends rows to `folder/hand.bin`, which it makes. A full disk ends the record, never the motion."""

    def __init__(self, folder: Path, dt_ns: int, axes: int) -> None:
        """Begin the file. Raises `OSError`, also where there is one."""
        self.trouble: str | None = None
        self._pack = Struct(f"<{1 + axes}d").pack
        self._rows = bytearray()
        self._count = 0
        self.newest = -1  # the tick of the last row; before the first -1
        self._file: BinaryIO = (folder / FILE).open("xb")
        self._file.write(json.dumps({"version": VERSION, "dt_ns": dt_ns, "axes": axes}).encode() + b"\n")
        self._file.flush()

    def add(self, k: int, r: Sequence[float]) -> None:
        """Append the row of tick k, if it has none yet: the reference r, m, per axis."""
        if k <= self.newest:
            return
        self.newest = k
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


class _Part(NamedTuple):
    """Contents of one file: nanoseconds a tick, the ticks (rows,), the positions (rows, axes) in m."""

    dt_ns: int
    k: NDArray[Any]
    r: NDArray[Any]


@dataclass(frozen=True, slots=True)
class HandRecording:
    """Motion of a steered hand in a live run, as the reference of a hand: sample for sample the run's own.

    `path` is the folder of a live page, of one of its parts, or of its master. The ticks of a page go on over its
    parts, where two have the same tick the later one stands, and only what came since the page was last started again,
    or an end was, or it wrote nothing for a while, is taken: before it the bodies were elsewhere. The first tick that
    is recorded is tick 0; after the last the hand stays. A file whose last row is cut off, as a killed process leaves
    it, is taken up to there, with a warning.

    `axes`, `dt_ns` and `ticks` say what it was recorded in, and how many ticks it takes; a scene needs the same axes
    and dt. Nothing in the folder is run and no link in it is followed. Raises `Refused` for what holds no such record.
    """

    path: str
    axes: int = field(init=False, repr=False)
    dt_ns: int = field(init=False, repr=False)
    ticks: int = field(init=False, repr=False)
    crc: int = field(init=False, repr=False)
    """Of the samples: another motion under the same path is another reference."""
    _places: tuple[array[float], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        path: object = self.path
        if not isinstance(path, str | PathLike) or not fspath(path):
            raise Refused(f"a recorded hand is named by the folder of a live page, not {path!r}; write for example "
                          "hand='runs/hard_wall-page-1'")
        part = _read(Path(path))
        places = _dense(part, path)
        values = {"path": fspath(path), "axes": len(places), "dt_ns": part.dt_ns, "ticks": len(places[0]) - 1,
                  "crc": crc32(b"".join(each.tobytes() for each in places)), "_places": places}
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def duration(self) -> float:
        """The time (s) from its first sample to its last."""
        return self.ticks * self.dt_ns / 1e9

    def check(self, axes: int, dt_ns: int) -> None:
        """Refuse a scene with other axes, or ticks of another length."""
        if (axes, dt_ns) != (self.axes, self.dt_ns):
            cure = f", or --set dt={self.dt_ns / 1e9:g}" if axes == self.axes else ""
            raise Refused(f"the hand in {self.path} was recorded in {number_of(self.axes, 'axis', 'axes')} with "
                          f"dt={self.dt_ns / 1e9:g} s, and the scene has {number_of(axes, 'axis', 'axes')} and "
                          f"dt={dt_ns / 1e9:g} s; take the scene that it was recorded in{cure}")

    def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> tuple[array[float], ...]:
        """For each axis the position (m) at the ticks first .. first+count-1."""
        self.check(axes, dt_ns)
        rows = [each[first:first + count] for each in self._places]
        return tuple([some + array("d", [each[-1]]) * (count - len(some))
                      for some, each in zip(rows, self._places, strict=True)])


def _read(folder: Path) -> _Part:
    """Read all parts in `folder` as one. Raises `Refused`."""
    joined: _Part | None = None
    empty: Path | None = None  # a part that ended before its first tick tells of no motion
    for inside in _folders(folder):
        part = _part(inside / FILE)
        if not len(part.k):
            empty = inside / FILE
            continue
        if joined is None:
            joined = part
            continue
        if (part.dt_ns, part.r.shape[1]) != (joined.dt_ns, joined.r.shape[1]) or part.k[0] < joined.k[0]:
            raise Refused(f"{inside / FILE} does not go on where the parts before it end: its ticks or axes are "
                          f"others; give one part of {folder}")
        before = joined.k < part.k[0]
        joined = _Part(part.dt_ns, np.concatenate([joined.k[before], part.k]),
                      np.concatenate([joined.r[before], part.r]))
    if joined is None and empty is not None:
        raise Refused(f"{empty} has no row yet; give another folder, or ask again when its run has ended")
    if joined is None:
        raise Refused(f"{folder} holds no record of a steered hand ({FILE}); give the folder of a live page "
                      "(`teleop demo --page`), of one of its parts, or of its master")
    return joined


def _folders(folder: Path) -> list[Path]:
    """The folders in `folder` with a record of the hand, in order."""
    if (folder / FILE).exists():
        return [folder]
    inside = [folder / "master"]
    if (folder / PAGE).exists():
        try:
            page = parse(read_bytes(folder / PAGE, links=False))
            _PAGE(page, PAGE)
        except (OSError, Misshapen) as error:
            why = error.strerror if isinstance(error, OSError) else error
            raise Refused(f"{folder / PAGE} does not say which parts the page has ({why}); give one part of "
                          f"{folder}") from error
        parts = page["parts"]
        since = max([i for i, part in enumerate(parts) if part["why"] in ANEW], default=0)
        names = [part["folder"] for part in parts[since:]]
        if wrong := next((name for name in names if Path(name).name != name or name == ".."), None):
            raise Refused(f"{folder / PAGE} names the part {wrong[:99]!r}, which is no folder in it; give one part of "
                          f"{folder}")
        inside = [folder / name / "master" for name in names]
    for each_one in inside:
        for link in (each_one, each_one.parent):
            if link != folder and link.is_symlink():
                raise Refused(f"{link} is a link, and what a folder links to is not opened; give the folder itself")
    return [each_one for each_one in inside if (each_one / FILE).exists()]


def _part(path: Path) -> _Part:
    """The rows of one file. Raises `Refused`."""
    try:
        with open_regular(path, links=False) as file:
            line = file.readline(LONGEST)
            if not line.endswith(b"\n"):
                raise Misshapen("its first line is no header")
            header = parse(line)
            _HEADER(header, "its header")
            data = file.read()
    except (OSError, Misshapen) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise Refused(f"{path} is no record of a steered hand ({why}); give another folder") from error
    width = 1 + header["axes"]
    rows = len(data) // (8 * width)
    if len(data) % (8 * width):
        from teleop.live.records.reader import TruncatedRecord

        warnings.warn(f"{path} is cut off in the middle of a row, as by a killed process: what came after row {rows} "
                      "is lost", TruncatedRecord, stacklevel=2)
    table = np.frombuffer(data, dtype="<f8", count=rows * width).reshape(rows, width)
    k, r = table[:, 0], table[:, 1:]
    with np.errstate(invalid="ignore"):
        sound = (np.diff(k, prepend=-1.0) > 0.0) & (k == np.floor(k)) & (k < MOST_TICKS)
        sound &= (np.abs(r) <= FARTHEST).all(axis=1)
    if not sound.all():
        raise Refused(f"{path} is damaged: its row {int(np.argmin(sound))} is no tick with the places of a hand; give "
                      "another folder")
    return _Part(header["dt_ns"], k.astype(np.int64), r)


def _dense(part: _Part, path: object) -> tuple[array[float], ...]:
    """A place for each tick from the first to the last, per axis. Raises `Refused`."""
    from teleop.simulation.trace import far_apart

    k = part.k - part.k[0]
    if not k[-1]:
        raise Refused(f"{path} holds a hand at one tick alone, and no motion; give another folder")
    if far_apart(k):
        raise Refused(f"{path} is damaged: it has {number_of(len(k), 'row')} for {k[-1]} ticks of a hand; give another "
                      "folder")
    at = np.searchsorted(k, np.arange(k[-1] + 1), side="right") - 1
    return tuple([array("d", np.ascontiguousarray(axis[at], dtype=float).tobytes()) for axis in part.r.T])
