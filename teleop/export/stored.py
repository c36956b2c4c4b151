"""A run that is over, of whatever kind its folder is, as rows that are read some at a time.

A folder holds one run: of `teleop run`, of a demo with both ends, of one live end. Or it holds the parts of a run whose
law or link was turned while it ran, in the folders 01, 02, ...; these go on counting the same ticks, so they lie on one
time axis.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from zipfile import BadZipFile
from zlib import error as zlib_error

from teleop.errors import Refused
from teleop.export.columns import Field, field
from teleop.live.records.end_result import NAMES
from teleop.live.records.merge import settle
from teleop.live.records.reader import FILE
from teleop.scene.axes import labels_in
from teleop.simulation.result import LATEST, RUNNING, incomplete, law_with_gains, stored_summary
from teleop.storage.archive import StoredArray, open_arrays
from teleop.storage.folder import BEGUN, is_being_written
from teleop.storage.strict_json import Misshapen

if TYPE_CHECKING:
    from numpy.typing import NDArray

BLOCK = 4096  # rows that are in memory at a time
TRACE = "trace.npz"


class LogEntry(NamedTuple):
    """Entry of a run's log. `ns`: its time since tick 0."""

    ns: int
    level: str  # info, warning or error
    name: str  # of the end, or `run`
    message: str


class Part:
    """A run, or a part of one: `summary` as it is stored, `fields` of its rows by name, `number` 0 of a whole run.

    `first` and `last` (s): times of its rows as they are stored, None if it has none. `shift_ns` goes onto all times.
    """

    def __init__(self, folder: Path, number: int) -> None:
        """Raises `Refused` if there is no complete run in `folder`."""
        self.folder, self.number, self.shift_ns = folder, number, 0
        try:
            self.summary: Mapping[str, Any] = stored_summary(folder)
            with open_arrays(folder / TRACE, self.ticks) as arrays:
                if "t" not in arrays or arrays["t"].shape != (self.ticks,):
                    raise Misshapen(f"{TRACE} has no times t")
                axes = {name: array.shape[1] if len(array.shape) == 2 else 1 for name, array in arrays.items()}
                self.first, self.last = _ends_of(arrays["t"], self.ticks)
        except Exception as error:  # no folder, no JSON, no zip, cut short, of another version
            raise incomplete(folder, error) from error
        labels = labels_in(self.summary)
        self.fields: dict[str, Field] = {name: field(name, count, labels) for name, count in axes.items()}

    @property
    def ticks(self) -> int:
        """Number of its rows."""
        return int(self.summary["ticks"])

    def blocks(self) -> Iterator[dict[str, NDArray[Any]]]:
        """Its rows in parts of at most `BLOCK`: each column as it is stored, of shape (rows,) or (rows, axes).

        Raises `Refused` if a file is damaged.
        """
        try:
            with open_arrays(self.folder / TRACE, self.ticks) as arrays:
                for count in _counts(self.ticks):
                    yield {name: array.read(count) for name, array in arrays.items()}
        except (Misshapen, BadZipFile, EOFError, zlib_error) as error:
            raise incomplete(self.folder, error) from error

    def ns(self, t: float) -> int:
        """The time on the axis of the whole run, ns, of what happened at `t` (s)."""
        return round(t * 1e9) + self.shift_ns

    def log(self) -> list[LogEntry]:
        """Log of the run in order of time: how it began, the events of its ends, how it ended."""
        law = law_with_gains(self.summary["parameters"].get("law"))
        what = f"part {self.number:02d}" if self.number else "run"
        entries = [LogEntry(self.ns(self.first or 0.0), "info", "run", f"{what} of {self.summary['scene']}, law {law}")]
        dt_ns = round(self.summary["dt"] * 1e9)
        for end in NAMES.values():
            summary = self.summary.get(end)
            for event in (summary.get("events") or ()) if isinstance(summary, Mapping) else ():
                ns = max(0, event["k"]) * dt_ns + self.shift_ns
                message = f"{event['what']}: {event['why']}"
                entries.append(LogEntry(ns, LEVELS.get(event["what"], "info"), end, message))
        entries.sort(key=lambda one: one.ns)
        status, sentence = self.summary["status"], self.summary["sentence"]
        over = max(entries[-1].ns, self.ns(self.last or 0.0))
        return [*entries, LogEntry(over, STATUS.get(status, "warning"), "run", f"{status}: {sentence}")]


LEVELS = {"safe": "warning", "stopped": "warning", "watchdog": "warning"}  # of events; all others are no trouble
STATUS = {"ok": "info", "diverged": "error", "unreleased": "error"}  # of runs; all others are a warning


def _counts(ticks: int) -> Iterator[int]:
    return (min(BLOCK, ticks - start) for start in range(0, ticks, BLOCK))


def _ends_of(times: StoredArray, ticks: int) -> tuple[float | None, float | None]:
    """The first and the last of the times (s), which have to grow from row to row; None of none."""
    import numpy as np

    first = last = None
    for count in _counts(ticks):
        t = np.asarray(times.read(count), dtype=float)
        if not ((np.diff(t, prepend=-1.0 if last is None else last) > 0.0).all() and t[0] >= 0.0 and t[-1] <= LATEST):
            raise Misshapen(f"{TRACE} has no times t that grow from row to row, up to {LATEST:g} s")
        first, last = float(t[0]) if first is None else first, float(t[-1])
    return first, last


def read_parts(folder: Path, *, trust: bool, left_out: list[str] | None = None) -> list[Part]:
    """The run that lies in `folder`, in order of time. Raises `Refused` if there is none, or it still goes on.

    What a killed process left is made whole first, as `teleop report` does; `trust` is that of `load_result`.
    `left_out`: gets a sentence for each part that cannot be read, as of an end that came to no tick; without it, and
    where no part is left, that is refused.
    """
    _check_kind(folder)
    at = parts_in(folder) if turned(folder) else [(0, folder)]
    going_on = Refused(f"{folder} is of a run that goes on; export it when it is over, or follow it meanwhile: "
                       f"teleop stream {folder} --plotjuggler 127.0.0.1:9870")
    parts: list[Part] = []
    for i, (number, one) in enumerate(at):
        if number and is_being_written(folder):
            raise going_on
        try:
            result = settle(one, trust=trust)
            if result is None or result.status != RUNNING:
                parts.append(Part(one, number))
                continue
        except Refused as refused:
            if left_out is None or (i == len(at) - 1 and not parts):
                raise
            left_out.append(f"part {number:02d} is left out: {refused}")
            continue
        raise going_on
    if not parts:
        raise Refused(f"{folder} holds no part in which an end came to its first tick")
    _on_one_axis(folder, parts)
    return parts


def _on_one_axis(folder: Path, parts: Sequence[Part]) -> None:
    """Put a part behind the one before whose ends were started anew, and so have begun to count their ticks anew."""
    reached = -1
    for part in parts:
        if part.first is not None and part.last is not None:
            if part.ns(part.first) <= reached:
                part.shift_ns = reached + round(part.summary["dt"] * 1e9) - part.ns(part.first)
            reached = part.ns(part.last)
    if reached >= 1 << 63:
        raise Refused(f"{folder} lasts longer than a time in nanoseconds can tell; export its parts one by one")


def turned(folder: Path) -> bool:
    """True if the folder holds a run in parts."""
    return (folder / "page.json").is_file() or (not (folder / "summary.json").is_file() and bool(parts_in(folder)))


def parts_in(folder: Path) -> list[tuple[int, Path]]:
    """The folders 01, 02, ... of a run in parts which an end has written into, in order."""
    folders = [(int(one.name), one) for one in folder.glob("[0-9][0-9]*")
               if one.name.isdecimal() and not one.is_symlink()
               and any((one / name / FILE).is_file() for name in NAMES.values())]
    return sorted(folders)


def _check_kind(folder: Path) -> None:
    if not folder.is_dir():
        raise Refused(f"there is no folder {folder}; give the one that a run was written to")
    if (folder / "sweep.json").is_file():
        raise Refused(f"{folder} holds a sweep, and export takes one run; type teleop report {folder} for its table, "
                      "or run one of its rows with teleop run and export that")
    if is_being_written(folder) and not any(folder.iterdir()):
        raise Refused(f"{folder} {BEGUN}")


def all_fields(parts: Sequence[Part]) -> list[Field]:
    """The columns of all parts, each once, with the most axes that it has; refuse parts of different axes."""
    fields: dict[str, Field] = {}
    for part in parts:
        for name, one in part.fields.items():
            if fields.setdefault(name, one).axes != one.axes:
                raise Refused(f"{part.folder} has {one.axes} axes of {name}, and the parts before have "
                              f"{fields[name].axes}; export each part by itself")
    return [*fields.values()]
