"""What a sweep's folder is held to: `sweep.json`, written once and whole, and locked by the process that adds rows."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from math import isfinite, prod
from pathlib import Path
from sys import maxsize
from typing import IO, Any

from teleop.errors import Refused, number_of
from teleop.storage import strict_json as stored
from teleop.storage.files import is_part, open_regular, read_bytes
from teleop.storage.folder import claim, lock, numbered
from teleop.storage.strict_json import Misshapen, anything, dict_of, either, list_of, parse, record, whole
from teleop.sweeps.grid import plain

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
    return plain(value)


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
    """How many rows the sweep of a definition has; as many as can be numbered if it does not say."""
    grid = definition.get("grid", {})
    if not {"axes", "seeds"} <= grid.keys():
        return maxsize
    lists = [*(axis["values"] for axis in grid["axes"] if "values" in axis), grid["seeds"]]
    return min(prod(each["count"] if isinstance(each, dict) else len(each) for each in lists), maxsize)


def with_edits(there: Mapping[str, Any], wanted: Mapping[str, Any], mended: Sequence[str], has_rows: bool
               ) -> dict[str, Any]:
    """The definition `there` with the digests that a wanted one may change: of `mended` metrics, or of all."""
    made, own = dict(there), METRIC_SOURCES
    if not has_rows and "sources" in there:
        made["sources"] = wanted.get("sources")
    if isinstance(there.get(own), dict) and isinstance(wanted.get(own), dict):
        made[own] = {name: wanted[own].get(name, digest) if name in mended or not has_rows else digest
                     for name, digest in there[own].items()}
    return made


def check_same(folder: Path, there: object, wanted: object) -> None:
    """Raise `Refused`, naming the first difference, if the definition in `folder` is not the wanted one."""
    for name, old, new in _differences("", there, wanted):
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
    found = re.fullmatch(r"grid\.axes\[(\d+)\]\.values[.\w]*(?:\[(\d+)\].*)?", name)
    if found is not None:
        knobs = ",".join(wanted["grid"]["axes"][int(found[1])]["knobs"])
        return f"value {int(found[2]) + 1} of {knobs}" if found[2] else f"the list of values of {knobs}"
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
    """What opens a file of the folder to be written: never another one that it may link to."""
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
