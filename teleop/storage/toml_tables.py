"""Files of TOML that ask for rows: read whole, and checked key by key. Whatever is wrong raises `Refused`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from teleop.errors import Refused, nearest
from teleop.storage.files import read_bytes

Value = TypeVar("Value")


def read_toml(path: Path, name: str, instead: str) -> dict[str, Any]:
    """The tables of a file. `name` is its name in a sentence, `instead` says what to give where it cannot be read."""
    import tomllib

    try:
        return tomllib.loads(read_bytes(path).decode())
    except (OSError, ValueError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise Refused(f"{name} cannot be read ({why}); give {instead}") from None


def is_tables(value: object) -> bool:
    """True of a list of tables, as [[NAME]] begins them."""
    return isinstance(value, list) and all(isinstance(each, dict) for each in value)


def check_keys(table: Mapping[str, Any], keys: Iterable[str], where: str) -> None:
    """Refuse a key that is not among `keys`."""
    for key in table:
        if key not in keys:
            raise Refused(f"{where} has no key {key!r}; {nearest(key, keys)}"
                          + ("; knobs go into set = {...}" if "set" in keys else ""))


def text_of(value: object, key: str, where: str) -> str:
    """A text that is not empty."""
    if not isinstance(value, str) or not value.strip():
        raise Refused(f"{where}: {key} is a text that is not empty, not {value!r}; write it in quotes")
    return value


def repeated(values: Sequence[Value]) -> Value | None:
    """The first value that stands twice in a list."""
    return next((value for i, value in enumerate(values) if value in values[:i]), None)


def knobs_in(table: object, where: str) -> dict[str, object]:
    """The knobs of a table `set` by their names."""
    if not isinstance(table, dict):
        raise Refused(f"{where}: set is a table of knobs, not {table!r}; write set = {{duration = 2.0}}")
    return _flat(table, "")


def _flat(table: Mapping[str, Any], stem: str) -> dict[str, object]:
    """Knobs by their names: TOML reads `law.K = 5` as a table in a table."""
    knobs: dict[str, object] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            knobs |= _flat(value, f"{stem}{key}.")
        else:
            knobs[stem + key] = tuple(value) if isinstance(value, list) else value
    return knobs
