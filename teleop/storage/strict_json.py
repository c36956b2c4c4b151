"""JSON that a folder of unknown origin holds: parsed strictly, its shape checked before anything makes use of it.

A check is called with a value and with what that value is called; it raises `Misshapen`, whose text says what is wrong.
Checks are put together from smaller ones: `record({"k": whole(low=0)})` asks for an object with a whole number k.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from math import isfinite
from pathlib import Path
from typing import Any, NoReturn

from teleop.storage.files import replacing

Check = Callable[[object, str], None]
DEEPEST = 32  # brackets within brackets
LONGEST = 300  # digits of a whole number: a float still has room for it


class Misshapen(ValueError):
    """JSON that is none, or that is of something else than what was asked for."""


def parse(data: bytes | str) -> Any:
    """The value that `data` holds in JSON. Raises `Misshapen`.

    Stricter than JSON: no NaN and no number that is not finite, no name twice in one object, a bounded depth.

    >>> parse('{"k": 3}')
    {'k': 3}
    """
    got = _decoded(data, _STRICT)
    level = [got]
    for _ in range(DEEPEST):
        level = [inner for each in level if isinstance(each, dict | list)
                 for inner in (each.values() if isinstance(each, dict) else each)]
        if not level:
            return got
    raise Misshapen(f"it has brackets within brackets, more than {DEEPEST} deep")


def parse_line(data: bytes | str) -> Any:
    """The same for short lines of which there are many: the caller looks at the depth, and that numbers are finite."""
    return _decoded(data, _LINE)


def _decoded(data: bytes | str, decoder: json.JSONDecoder) -> Any:
    try:
        return decoder.decode(data if isinstance(data, str) else data.decode())
    except RecursionError:
        raise Misshapen("it has too many brackets within brackets") from None
    except Misshapen:
        raise
    except ValueError as error:
        raise Misshapen(f"it is no JSON: {error}") from None


def json_text(value: Any, *, indent: int | None = None) -> str:
    """`value` as JSON that every reader takes, `parse` too. Never raises over a number."""
    return json.dumps(json_value(value), indent=indent, allow_nan=False, default=str)


def write_document(path: Path, value: Any) -> None:
    """Write `value` as the JSON file `path`, indented, whole or not at all. Raises `OSError`."""
    text = json_text(value, indent=2)
    with replacing(path) as file:
        file.write(text.encode() + b"\n")


def json_value(value: Any) -> Any:
    """`value` in numbers that JSON has: one that is not finite becomes the text "inf", "-inf" or "nan".

    >>> json_value({"margin": float("-inf"), "ages": (0.1, float("nan"))})
    {'margin': '-inf', 'ages': [0.1, 'nan']}
    """
    if isinstance(value, float):
        return value if isfinite(value) else str(float(value))
    if isinstance(value, dict):
        return {key: json_value(inner) for key, inner in value.items()}
    return [json_value(inner) for inner in value] if isinstance(value, list | tuple) else value


def text(value: object, name: str) -> None:
    """A text."""
    if type(value) is not str:
        _wrong(value, name, "a text")


def real(value: object, name: str) -> None:
    """A number."""
    if type(value) not in (int, float):
        _wrong(value, name, "a number")


def truth(value: object, name: str) -> None:
    """True or false."""
    if type(value) is not bool:
        _wrong(value, name, "true or false")


def anything(value: object, name: str) -> None:
    """Whatever there is."""


def whole(*, low: int | None = None, high: int | None = None) -> Check:
    """A whole number from `low` to `high`, both included."""
    def check(value: object, name: str) -> None:
        if type(value) is not int:
            _wrong(value, name, "a whole number")
        if (low is not None and value < low) or (high is not None and value > high):
            _wrong(value, name, f"a whole number of at {'least' if low is not None and value < low else 'most'} "
                                f"{low if low is not None and value < low else high}")

    return check


def between(low: float, high: float) -> Check:
    """A number from `low` to `high`, both included."""
    def check(value: object, name: str) -> None:
        real(value, name)
        if not low <= value <= high:  # type: ignore[operator]  # it is a number
            _wrong(value, name, f"a number from {low:g} to {high:g}")

    return check


def one_of(*values: str) -> Check:
    """Text out of these."""
    def check(value: object, name: str) -> None:
        if type(value) is not str or value not in values:
            _wrong(value, name, " or ".join(values))

    return check


def optional(inner: Check) -> Check:
    """The same, or nothing."""
    def check(value: object, name: str) -> None:
        if value is not None:
            inner(value, name)

    return check


def either(*several: Check) -> Check:
    """Value that passes one of these checks; the last says what is wrong."""
    def check(value: object, name: str) -> None:
        for option in several[:-1]:
            try:
                option(value, name)
            except Misshapen:
                continue
            return
        several[-1](value, name)

    return check


def list_of(inner: Check, *, most: int = 10_000_000) -> Check:
    """A list of at most so many of them."""
    def check(value: object, name: str) -> None:
        if not isinstance(value, list):
            _wrong(value, name, "a list")
        if len(value) > most:
            raise Misshapen(f"{name} has {len(value)} entries, more than {most}")
        for i, item in enumerate(value):
            inner(item, f"{name}[{i}]")

    return check


def dict_of(inner: Check) -> Check:
    """An object whose values are all of this shape."""
    def check(value: object, name: str) -> None:
        if not isinstance(value, dict):
            _wrong(value, name, "an object")
        for key, item in value.items():
            inner(item, f"{name}.{key}")

    return check


def record(needed: Mapping[str, Check], also: Mapping[str, Check] | None = None) -> Check:
    """An object that has what is `needed`; `also`: what it may have. Whatever else it has is not looked at."""
    def check(value: object, name: str) -> None:
        if not isinstance(value, dict):
            _wrong(value, name, "an object")
        for key, inner in needed.items():
            if key not in value:
                raise Misshapen(f"{name} has no {key}")
            inner(value[key], f"{name}.{key}")
        for key, inner in (also or {}).items():
            if key in value:
                inner(value[key], f"{name}.{key}")

    return check


def _wrong(value: object, name: str, must: str) -> NoReturn:
    shown = "a list" if isinstance(value, list) else "an object" if isinstance(value, dict) else (
        f"{value[:40]!r}" if isinstance(value, str) else f"{value!r}")
    raise Misshapen(f"{name[:200]} must be {must}, not {shown}")


def _whole(digits: str) -> int:
    if len(digits) > LONGEST:
        raise Misshapen(f"it has a whole number of {len(digits)} digits")
    return int(digits)


def _real(digits: str) -> float:
    got = float(digits)
    if not isfinite(got):
        raise Misshapen(f"it has the number {digits[:40]}, which is not finite")
    return got


def _constant(word: str) -> NoReturn:
    raise Misshapen(f"it has {word}, which is no number of JSON")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    got = dict(pairs)
    if len(got) < len(pairs):
        left = [*got]
        twice = next(name for name, _ in reversed(pairs) if not left or left.pop() != name)
        raise Misshapen(f"it has {twice[:40]!r} twice in one object")
    return got


_STRICT = json.JSONDecoder(object_pairs_hook=_once, parse_int=_whole, parse_float=_real, parse_constant=_constant)
_LINE = json.JSONDecoder(object_pairs_hook=_once, parse_constant=_constant)
