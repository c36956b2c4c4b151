"""The folder of a sweep: what was asked for, and its rows as they finish. A kill at any time costs the rows in flight.

`sweep.json` holds the definition; it is there, whole, before the first row. `rows.jsonl` holds one line of JSON a
row and is only ever appended to. A line counts once its newline is there, so what a kill leaves half-written is cut
off when the folder is opened again. Whoever only reads (`Store.look`) changes nothing and may do so meanwhile.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from errno import EFBIG
from io import FileIO
from math import inf, isfinite, prod
from pathlib import Path
from sys import maxsize
from typing import IO, Any

from teleop.errors import Refused, number_of
from teleop.storage import strict_json as stored
from teleop.storage.files import is_part, open_regular, read_bytes, replacing
from teleop.storage.folder import claim, lock, numbered
from teleop.storage.strict_json import (
    DEEPEST,
    Misshapen,
    anything,
    dict_of,
    either,
    list_of,
    parse,
    parse_line,
    record,
    whole,
)
from teleop.storage.strict_json import LONGEST as LONGEST_NUMBER
from teleop.sweeps.grid import json_value
from teleop.sweeps.table import Table

DEFINITION = "sweep.json"
PART = f".{DEFINITION}.part"
METRIC_SOURCES = "metric_sources"  # of each metric of the user's own, the digest of its code
EDITED = {  # what a difference in a digest means, and what to type
    "sources": "the scene's file or a law was edited, or a recorded link is another, since its rows were run (sources)",
    METRIC_SOURCES: "metric {name} was edited since its rows were run",
}
MOST_COLUMNS = 1000  # knobs, and metrics
_ABSENT = object()
_LISTED = either(list_of(anything), record({"count": whole(low=0)}))  # of many values the definition has the digest
_SHAPE = record({}, {
    "scene": stored.text, "fixed": dict_of(anything), "metrics": list_of(stored.text, most=MOST_COLUMNS),
    "grid": record({}, {
        "axes": list_of(record({"knobs": list_of(stored.text, most=MOST_COLUMNS)}, {"values": _LISTED}),
                        most=MOST_COLUMNS),
        "seeds": _LISTED,
    }),
})
STRICT = json.JSONEncoder(separators=(",", ":"), allow_nan=False)  # and ASCII, whatever a knob's text holds


def text(value: object) -> str:
    """`value` as JSON of one line that any reader takes."""
    try:
        return STRICT.encode(value)
    except (TypeError, ValueError):
        return STRICT.encode(_jsonable(value))


def _jsonable(value: object) -> object:
    """`value` in JSON's types: a numpy number as one of Python's, what JSON has no word for as text."""
    if isinstance(value, Mapping):
        return {str(key): _jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_jsonable(item) for item in value]
    if hasattr(value, "tolist"):  # numpy's scalars and arrays
        return _jsonable(value.tolist())
    if isinstance(value, float):
        return value if isfinite(value) else str(value)
    return json_value(value)


def begun(folder: Path, definition: Mapping[str, Any]) -> IO[bytes] | None:
    """Define the sweep in a folder that is new or empty: its sweep.json, locked; None if something is there already.

    Raises `Refused`, and OSError if the folder cannot be written to.
    """
    claimed = None
    if not os.path.lexists(folder):
        try:
            claimed = claim(folder)
        except Refused:
            if not os.path.lexists(folder):
                raise
    try:
        return _define(folder, definition) if folder.is_dir() and _is_empty(folder) else None
    except BaseException:
        if claimed is not None:
            claimed.drop_empty()
        raise
    finally:
        if claimed is not None:
            claimed.close()


def _is_empty(folder: Path) -> bool:
    """True if there is nothing in `folder`, or what a process left that was killed before it had defined its sweep."""
    return all(is_part(path, DEFINITION) for path in folder.iterdir())


def defined_anew(folder: Path, definition: Mapping[str, Any]) -> IO[bytes]:
    """Put another definition in the place of the one in `folder`, which this process has locked; its own lock."""
    file = _define(folder, definition, anew=True)
    assert file is not None
    return file


def _define(folder: Path, definition: Mapping[str, Any], *, anew: bool = False) -> IO[bytes] | None:
    """Write the definition beside and rename it, its lock with it; None if another process came first."""
    part = folder / PART
    file = locked(part, "a+b")
    try:
        if anew or _is_empty(folder):
            file.truncate(0)
            file.write(json.dumps(json.loads(text(definition)), indent=1).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())  # a rename must never be on the disk before what it names
            part.replace(folder / DEFINITION)
            return file
    except BaseException:
        part.unlink(missing_ok=True)
        file.close()
        raise
    part.unlink(missing_ok=True)
    file.close()
    return None


def read_definition(folder: Path) -> dict[str, Any]:
    """The definition of the sweep in `folder`. Raises `Refused` if there is none."""
    try:
        got: dict[str, Any] = parse(read_bytes(folder / DEFINITION, links=False))
        _SHAPE(got, "it")
    except (OSError, Misshapen) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise Refused(f"{folder} holds no sweep ({DEFINITION}: {why}); give the folder of one, or with --out one "
                      f"that is not there yet") from error
    return got


def rows_of(definition: Mapping[str, Any]) -> int:
    """Number of rows of the sweep of a definition; as many as can be numbered if it does not say."""
    grid = definition.get("grid", {})
    if not {"axes", "seeds"} <= grid.keys():
        return maxsize
    lists = [*(axis["values"] for axis in grid["axes"] if "values" in axis), grid["seeds"]]
    return min(prod(each["count"] if isinstance(each, dict) else len(each) for each in lists), maxsize)


def with_edits(definition_there: Mapping[str, Any], wanted: Mapping[str, Any], mended: Sequence[str], has_rows: bool
               ) -> dict[str, Any]:
    """The definition `there` with the digests that a wanted one may change: of `mended` metrics, or of all."""
    made, metric_key = dict(definition_there), METRIC_SOURCES
    if not has_rows and "sources" in definition_there:
        made["sources"] = wanted.get("sources")
    if isinstance(definition_there.get(metric_key), dict) and isinstance(wanted.get(metric_key), dict):
        made[metric_key] = {name: wanted[metric_key].get(name, digest) if name in mended or not has_rows else digest
                     for name, digest in definition_there[metric_key].items()}
    return made


def check_same(folder: Path, definition_there: object, wanted: object) -> None:
    """Raise `Refused`, naming the first difference, if the definition in `folder` is not the wanted one."""
    for name, old, new in _differences("", definition_there, wanted):
        was, now = ("absent" if value is _ABSENT else _short(value) for value in (old, new))
        free = next(numbered(folder.parent, folder.name))
        digest, _, metric = name.partition(".")
        if digest in EDITED and _ABSENT not in (old, new):
            keep = f"; where that changes none of these rows, keep them by mended=[{metric!r}]" if metric else ""
            raise Refused(f"{folder} holds another sweep: {EDITED[digest].format(name=metric)}; write --out '{free}' "
                          f"for one of its own{keep}")
        raise Refused(f"{folder} holds another sweep: {_as_typed(name, wanted)} is {was} there and {now} here; write "
                      f"--out '{free}', or ask for the same sweep to go on with it")


def _as_typed(name: str, wanted: Any) -> str:
    """A place in a definition as somebody calls it who has typed the sweep."""
    match = re.fullmatch(r"grid\.axes\[(\d+)\]\.values[.\w]*(?:\[(\d+)\].*)?", name)
    if match is not None:
        knobs = ",".join(wanted["grid"]["axes"][int(match[1])]["knobs"])
        return f"value {int(match[2]) + 1} of {knobs}" if match[2] else f"the list of values of {knobs}"
    return "the number of seeds" if name == "grid.seeds.count" else name.removeprefix("fixed.") or DEFINITION


def _differences(name: str, old: Any, new: Any) -> Iterator[tuple[str, object, object]]:
    if isinstance(old, dict) and isinstance(new, dict):
        for key in dict.fromkeys([*new, *old]):
            yield from _differences(f"{name}.{key}".lstrip("."), old.get(key, _ABSENT), new.get(key, _ABSENT))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from _differences(f"{name}[{i}]", a, b)
    elif old != new or isinstance(old, bool) != isinstance(new, bool):
        yield name, old, new


def _short(value: object) -> str:
    line = text(value)
    many = f" ({number_of(len(value), 'value')})" if isinstance(value, (list, dict)) else ""
    return (line if len(line) <= 60 else line[:57] + "...") + many


def no_link(path: str, flags: int) -> int:
    """Open a file of the folder to be written: never another one that it may link to."""
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


def is_growing(folder: Path) -> bool:
    """True if a process that lives adds rows to the sweep in `folder`."""
    try:
        with open_regular(folder / DEFINITION, links=False) as file:
            return not lock(file.fileno(), shared=True)
    except OSError:
        return False


def locked(path: Path, mode: str) -> IO[bytes]:
    """The open file, with a lock on it that goes when the process does, however it ends. Raises `Refused`."""
    file: IO[bytes] = open(path, mode, opener=no_link)  # noqa: SIM115 (it is open as long as the lock)
    if not lock(file.fileno(), shared=False):
        file.close()
        raise Refused(f"another process is writing to {path.parent}; wait for its end or end it, or give another "
                      f"folder with --out")
    return file


ROWS = "rows.jsonl"
LONGEST = 1 << 20  # bytes of a row
_GREATEST = 10**LONGEST_NUMBER


class RowNumbers:
    """The numbers of the rows that are there, a bit for each in pages of 4096: a sweep of 1e9 rows takes 165 MB.

    A page is there from its first row on, so that a number alone, however large, asks for no more than one.
    """

    def __init__(self) -> None:
        self._pages: dict[int, bytearray] = {}
        self._count = 0

    def __contains__(self, row: int) -> bool:
        page = self._pages.get(row >> 12)
        return page is not None and bool(page[(row & 4095) >> 3] >> (row & 7) & 1)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[int]:
        for number in sorted(self._pages):
            for at, byte in enumerate(self._pages[number]):
                yield from ((number << 12) + 8 * at + bit for bit in range(8) if byte >> bit & 1)

    def gaps(self, stop: int) -> Iterator[range]:
        """The rows below `stop` that are missing, as the longest ranges there are, in order."""
        begin: int | None = None
        top = 0  # all below has been looked at
        for number in sorted(self._pages):
            if number << 12 >= stop:
                break
            if number << 12 > top and begin is None:
                begin = top
            for gap, row in self._changes(number, stop):
                if gap:
                    begin = row if begin is None else begin
                elif begin is not None:
                    yield range(begin, row)
                    begin = None
            top = min((number + 1) << 12, stop)
        begin = top if begin is None else begin
        if begin < stop:
            yield range(begin, stop)

    def _changes(self, number: int, stop: int) -> Iterator[tuple[bool, int]]:
        """Yield whether a row is missing, and its number: rows of a page below `stop`, of equal bytes the first."""
        base = number << 12
        for run in re.finditer(rb"\x00+|\xff+|[^\x00\xff]", self._pages[number]):
            begin, byte = base + 8 * run.start(), self._pages[number][run.start()]
            if byte in (0, 255):  # bytes that are all alike need no look at each bit
                if begin < stop:
                    yield byte == 0, begin
                continue
            for bit in range(8):
                if begin + bit < stop:
                    yield not byte >> bit & 1, begin + bit

    def _add(self, row: int) -> None:
        if row not in self:
            page = self._pages.get(row >> 12)
            if page is None:
                page = self._pages[row >> 12] = bytearray(512)
            page[(row & 4095) >> 3] |= 1 << (row & 7)
            self._count += 1

    def _discard(self, row: int) -> None:
        if row in self:
            self._pages[row >> 12][(row & 4095) >> 3] &= ~(1 << (row & 7))
            self._count -= 1


class Store:
    """A sweep's folder, made by `Store.open` or `Store.look`. One thread of one process may append to it."""

    def __init__(self, folder: Path, definition: Mapping[str, Any]) -> None:
        self.folder, self.definition, self.done = folder, definition, RowNumbers()
        self._most = rows_of(definition)
        self._file: FileIO | None = None  # none: only looked at
        self._locks: list[IO[bytes]] = []
        self._size = 0  # bytes of whole lines

    @classmethod
    def open(cls, folder: Path | str, definition: Mapping[str, Any], mended: Sequence[str] = ()) -> Store:
        """Make `folder` for the sweep of this definition, or open it to go on where it stopped.

        `mended`: metrics of the user's own that may have been edited since. Before there is a row, all that is the
        user's own may.

        Raises `Refused` if the folder holds something else or another sweep (naming the first difference), if
        another process writes there, or if it cannot be written to.
        """
        at, wanted = Path(folder), json.loads(text(definition))
        try:
            lock = begun(at, definition)
            definition_there = read_definition(at)
            check_same(at, with_edits(definition_there, wanted, mended, _has_bytes(at / ROWS)), wanted)
            store = cls(at, wanted)
            store._locks.append(lock or locked(at / DEFINITION, "r+b"))
            try:
                store._mend()
                if read_definition(at) != wanted:  # maybe others had the folder meanwhile
                    check_same(at, with_edits(definition_there, wanted, mended, bool(store.done)), wanted)
                    store._locks.append(defined_anew(at, wanted))  # the first is held on to: others may have it open
            except BaseException:
                store.close()
                raise
        except OSError as error:
            raise Refused(f"cannot write to {at} ({error.strerror or error}); make it writable, or give another "
                          f"folder with --out") from error
        return store

    @classmethod
    def look(cls, folder: Path | str) -> Store:
        """The sweep in `folder`, to read from, also while it is being written. Raises `Refused` if there is none."""
        at = Path(folder)
        store = cls(at, read_definition(at))
        try:
            for _, row in store._lines():
                if row is not None:
                    store.done._add(row["row"])
        except OSError as error:
            raise Refused(f"cannot read {at / ROWS} ({error.strerror or error}); make it readable") from error
        return store

    def append(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Add the rows that are not there yet, all in one write, and hand them to the system.

        A row has its number under "row". What JSON has no word for is written as text; a metric that is not
        finite is left out. Raises `Refused` if the disk is full or gone, and then none of `rows` was added.
        """
        if self._file is None:
            raise Refused(f"{self.folder} was opened to be read; open it with `Store.open` to add to it")
        fresh = {row["row"]: row for row in reversed([*rows]) if row["row"] not in self.done}  # of twins the first
        metrics = frozenset(self.definition.get("metrics", ()))
        data = b"".join(_line(fresh[number], metrics) for number in reversed(fresh))
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[self._file.write(rest):]
            for number in fresh:
                self.done._add(number)
            self._size += len(data)
        except BaseException as error:  # an interrupt too: half a line would spoil the one after it
            for number in fresh:
                self.done._discard(number)
            with suppress(OSError):
                self._file.truncate(self._size)
            if isinstance(error, OSError):
                raise Refused(f"could not add to {self.folder / ROWS} ({error.strerror or error}); the rows before "
                              f"are safe: make room and type the same command again") from error
            raise

    def rows(self) -> Iterator[dict[str, Any]]:
        """The rows in the order in which they finished."""
        return (row for _, row in self._lines() if row is not None)

    def table(self) -> Table:
        """Every row that is there, by number: the same table whatever order they finished in."""
        axes = self.definition.get("grid", {}).get("axes", ())
        knobs = tuple(knob for axis in axes for knob in axis["knobs"])
        return Table(self.rows(), knobs, tuple(self.definition.get("metrics", ())))

    def close(self) -> None:
        """Let the disk have it, and others the folder."""
        if self._file is not None:
            with suppress(OSError):
                os.fsync(self._file.fileno())
            self._file.close()
        for file in self._locks:
            file.close()
        self._file, self._locks = None, []

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _lines(self) -> Iterator[tuple[bytes, dict[str, Any] | None]]:
        """Each line with its newline, and its row: none where the line is damaged, or the twin of one before."""
        seen = RowNumbers()
        try:
            file = open_regular(self.folder / ROWS, links=False)
        except FileNotFoundError:  # no row yet
            return
        with file:
            while line := file.readline(LONGEST):
                if not line.endswith(b"\n"):  # the torn last one, or one just being written
                    if len(line) == LONGEST:
                        raise OSError(EFBIG, f"it has a line of more than {LONGEST >> 20} MB")
                    return
                row = _row(line)
                if row is not None and (row["row"] in seen or row["row"] >= self._most):
                    row = None
                if row is not None:
                    seen._add(row["row"])
                yield line, row

    def _mend(self) -> None:
        """Read what is there, cut off a torn end, and drop lines that a failing disk or two writers left."""
        path, whole, sound = self.folder / ROWS, 0, True
        for line, row in self._lines():
            whole += len(line)
            if row is None:
                sound = False
            else:
                self.done._add(row["row"])
        if not sound:  # written anew beside it and put in its place, so that no row is ever at risk
            with replacing(path, settle=True) as file:
                whole = sum(file.write(line) for line, row in self._lines() if row is not None)
        self._file, self._size = FileIO(path, "a", opener=no_link), whole
        if self._file.tell() != whole:
            self._file.truncate(whole)


def _has_bytes(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0


def _row(line: bytes) -> dict[str, Any] | None:
    """The row of a line, or none if it holds no row."""
    try:
        row = parse_line(line)
        sound = type(row["row"]) is int and row["row"] >= 0 and all(map(_is_cell, row.values()))
        return row if sound else None
    except (Misshapen, TypeError, KeyError):  # no JSON, or JSON of something else
        return None


def _is_cell(value: Any, level: int = 0) -> bool:
    """True if a value is a finite number, a text or a truth, or lists of these as a knob may have."""
    kind = type(value)
    if kind is float:
        return bool(-inf < value < inf)
    if kind is int:
        return bool(-_GREATEST < value < _GREATEST)
    if kind is list:
        return level < DEEPEST and all(_is_cell(each, level + 1) for each in value)
    return kind is not dict


def _line(row: Mapping[str, Any], metrics: frozenset[str]) -> bytes:
    try:
        line = STRICT.encode(row)
    except (TypeError, ValueError):
        line = text({k: v for k, v in row.items() if k not in metrics or (v is not None and isfinite(v))})
    return line.encode() + b"\n"
