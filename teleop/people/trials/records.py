"""Record of a trial: what is kept of it on the disk, and what is measured of its movement.

    sub-03/trial-007/interval-1/master/hand.bin    the hand of the first interval, for any other law
    sub-03/trial-007/interval-1/ends.bin           rows and inputs of both ends, to the bit: see `unpack`
    sub-03/trial-007/interval-2/...                the second interval of a comparison
    sub-03/trial-007/cuts                          how often the trial was cut, and run again

The columns of a law are its own, so these files have the mode 0600, as the key.

`ends.bin` is compressed by zlib: a line of JSON with the first line of each file, its columns and what was left of a
last row, then the columns, of those alike one. A column is the difference of each number from the one before, as whole
numbers of 64 bits, and of these all first bytes, all second ones and so on, since neighbours differ in the last bytes.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast
from zlib import compress, decompress
from zlib import error as ZlibError

import numpy as np
from numpy.typing import NDArray

from teleop.errors import Refused
from teleop.live.page.rows import HAND
from teleop.live.records.end_result import NAMES
from teleop.live.records.inputs import INPUTS
from teleop.live.records.reader import FILE as RECORD
from teleop.live.records.reader import RecordFile, read_noted
from teleop.people.plan import TaskKind
from teleop.people.schedule import Trial
from teleop.storage.files import read_bytes
from teleop.storage.strict_json import Misshapen, json_text, list_of, parse, record, text, whole

Floats = NDArray[np.float64]
CUTS, PACKED = "cuts", "ends.bin"
LEVEL = 4  # of zlib: 6 is a twentieth smaller, and takes twice as long
_FILES = [f"{name}/{file}" for name in NAMES.values() for file in (RECORD, INPUTS)]
_INDEX = record({"version": whole(low=1, high=1), "sizes": list_of(whole(low=0)), "files": list_of(record(
    {"file": text, "head": text, "columns": list_of(whole(low=0)), "rest": text}))})
MOVED = 1e-3  # m, from which on a movement has begun
STILL, REST = 1e-3, 0.3  # m, s: a reach has ended when the slave has moved no more than that for so long ...
HALFWAY = 0.5  # ... beyond this share of the distance


def begin_trial(folder: Path) -> int:
    """Make the folder of a trial; return how often the trial was cut before."""
    part = folder.with_name(f"{folder.name}.part")
    cuts = max([_cuts(each) + 1 for each in (folder, part) if each.is_dir()], default=0)
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir()
    if cuts:
        (part / CUTS).write_text(f"{cuts}\n")
    shutil.rmtree(folder, ignore_errors=True)
    part.rename(folder)
    return cuts


def _cuts(folder: Path) -> int:
    try:
        return int((folder / CUTS).read_text())
    except (OSError, ValueError):
        return 0


def keep(ends: Mapping[str, Path], to: Path) -> None:
    """Keep hand, inputs and record of an interval in the folder `to`."""
    files: list[dict[str, Any]] = []
    columns: dict[bytes, int] = {}  # each once, with its number
    for e, source in ends.items():
        for name in (RECORD, INPUTS):
            if not (source / name).is_file():
                continue
            head, _, rows = (source / name).read_bytes().partition(b"\n")
            width = len(parse(head)["columns"])
            whole = len(rows) // (8 * width) * 8 * width
            table = np.frombuffer(rows[:whole], "<u8").reshape(-1, width)
            numbers = [columns.setdefault(table[:, i].tobytes(), len(columns)) for i in range(width)]
            files.append({"file": f"{NAMES[e]}/{name}", "head": head.decode(), "columns": numbers,
                          "rest": rows[whole:].hex()})
        if (source / HAND).is_file():
            (to / NAMES[e]).mkdir(parents=True)
            with private_file(to / NAMES[e] / HAND) as file:
                file.write((source / HAND).read_bytes())
    sizes = [len(each) for each in columns]
    index = json_text({"version": 1, "files": files, "sizes": sizes}).encode() + b"\n"
    to.mkdir(parents=True, exist_ok=True)
    with private_file(to / PACKED) as file:
        file.write(compress(index + b"".join(map(_folded, columns)), LEVEL))


def unpack(interval: Path, to: Path) -> None:
    """Make of what was kept of an interval the folder that its ends left. Raises `Refused`."""
    try:
        index, _, data = decompress(read_bytes(interval / PACKED, links=False)).partition(b"\n")
        about = parse(index)
        _INDEX(about, PACKED)
        columns, at = [], 0
        for size in about["sizes"]:
            columns.append(_unfolded(data[at:at + size]))
            at += size
        for each in about["files"]:
            if each["file"] not in _FILES:
                raise Misshapen(f"it has a file {each['file'][:40]!r}")
            path = to / each["file"]
            path.parent.mkdir(parents=True, exist_ok=True)
            table = np.stack([columns[i] for i in each["columns"]], axis=1)
            path.write_bytes(each["head"].encode() + b"\n" + table.tobytes() + bytes.fromhex(each["rest"]))
    except (OSError, ZlibError, ValueError, IndexError, Misshapen) as error:
        raise Refused(f"{interval} holds no record of a trial ({error}); give the folder of a study") from None
    for name in NAMES.values():
        if (interval / name / HAND).is_file():
            (to / name / HAND).write_bytes(read_bytes(interval / name / HAND, links=False))


def _folded(column: bytes) -> bytes:
    numbers = np.frombuffer(column, "<u8")
    return np.diff(numbers, prepend=numbers.dtype.type(0)).view("u1").reshape(-1, 8).T.tobytes()


def _unfolded(data: bytes) -> NDArray[np.uint64]:
    steps = np.frombuffer(data, "u1").reshape(8, -1).T.copy().view("<u8")[:, 0]
    return np.cumsum(steps, dtype="<u8")


def private_file(path: Path) -> BinaryIO:
    """Open a file to append to, which no other user can read."""
    return os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o600), "ab")


@dataclass(frozen=True, slots=True)
class Movement:
    """Measurements of an interval; see `TrialOutcome`."""

    time: float | None
    end: float | None
    overshoot: float | None
    peak_force: float
    delay: float | None
    skipped: float


def measure(kind: TaskKind, trial: Trial, ends: Mapping[str, Path], span: tuple[int, int], dt: float) -> Movement:
    """Measure an interval by the records of its two ends, at the ticks of `span`. Raises `Refused` without any."""
    master, slave = (_Rows(ends[e], span) for e in NAMES)
    if not len(master.ticks) or not len(slave.ticks):
        raise Refused("the interval has no rows")
    force = np.sqrt((master["f_m"] ** 2).sum(axis=1))
    start = _first(np.abs(master["x_m"][:, 0] - master["x_m"][0, 0]) > MOVED)
    peak = float(force.max())
    time = end = overshoot = None
    if kind is TaskKind.REACH:
        x = slave["x_s"][:, 0]
        rest = rest_begins(x, trial.level, dt)
        end = float(x[-1] if rest is None else x[min(rest + round(REST / dt), len(x)) - 1])
        overshoot = float(max(x.max() - trial.level, 0.0))
        if rest is not None and start is not None:
            time = round(float(slave.ticks[rest] - master.ticks[start]) * dt, 9)
    elif kind is TaskKind.PRESS:
        overshoot, reached = peak - trial.level, _first(force >= trial.level)
        if reached is not None and start is not None:
            time = round(float(master.ticks[reached] - master.ticks[start]) * dt, 9)
    elif kind is TaskKind.FREE:
        time = round((span[1] - span[0]) * dt, 9)
    ages = [each.age(dt) for each in (slave, master)]
    delay = None if None in ages else float(sum(age for age in ages if age is not None))
    return Movement(time, end, overshoot, peak, delay, max(master.skipped, slave.skipped))


def rest_begins(x: Floats, distance: float, dt: float) -> int | None:
    """The index at which a reach comes to rest, beyond half of its distance; None: it goes on.

    >>> rest_begins(np.minimum(np.arange(1000) * 1e-4, 0.05), 0.05, 1e-3)
    491
    """
    count = round(REST / dt)
    if len(x) < count:
        return None
    windows = np.lib.stride_tricks.sliding_window_view(x, count)
    at_rest = (windows.max(axis=1) - windows.min(axis=1) <= STILL) & (windows[:, 0] >= HALFWAY * distance)
    return _first(at_rest)


def _first(true: NDArray[np.bool_]) -> int | None:
    at = int(true.argmax())
    return at if true[at] else None


class _Rows:
    """The rows of an end within an interval, by column."""

    def __init__(self, folder: Path, span: tuple[int, int]) -> None:
        header, rows, _, _ = read_noted(folder)
        self._columns = header["columns"]
        ticks = np.asarray(rows.ticks)
        low, high = np.searchsorted(ticks, [span[0], span[1] + 1])
        self._table = cast("RecordFile", rows.rows).part(int(low), int(high))
        self.ticks = ticks[low:high]
        self.skipped = 1.0 - len(self.ticks) / (span[1] - span[0] + 1)

    def __getitem__(self, name: str) -> Floats:
        at = [i for i, each in enumerate(self._columns) if each == name]
        column: Floats = self._table[:, at]
        return column

    def age(self, dt: float) -> float | None:
        """Mean age of the played messages, s."""
        played = self._table[:, 2]
        known = played >= 0.0
        return float((self.ticks[known] - played[known]).mean()) * dt if known.any() else None
