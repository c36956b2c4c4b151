"""A grid as it is typed: `delay=0:0.5:51`, `law=wave,pfra`, `delay,k_e=0.01/1e3,0.02/2e3`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

from teleop.errors import Refused, number
from teleop.sweeps.grid import MOST_VALUES, Range

_KNOB = r"[^\W\d][\w.]*"
_NEXT_AXIS = re.compile(rf"(?<!,)\s+(?={_KNOB}(?:\s*,\s*{_KNOB})*\s*=)")


def parse_axes(texts: Sequence[str]) -> dict[str | tuple[str, ...], list[Any]]:
    """Axes as they are typed, for `grid`; one text may hold several, parted by blanks. Raises `Refused`.

    A comma parts values, LOW:HIGH:N is a range with its ends and LOW:HIGH:N:log one of equal ratios; what looks like a
    number is one. Knobs that are turned together have their values parted by /. Brackets and quotes keep together what
    is in them, and what is in quotes stays a text, so a link may be written with or without.

    >>> parse_axes(["delay=0:0.5:3 law=wave,pfra", "k_e,d_e=1e2/0.5,1e3/2"])
    {'delay': [0.0, 0.25, 0.5], 'law': ['wave', 'pfra'], ('k_e', 'd_e'): [(100.0, 0.5), (1000.0, 2)]}
    >>> parse_axes(["link=delay(0.05) | gamma(0.01, 2.0),'delay(0.1) ; delay(0.2)'"])
    {'link': ['delay(0.05) | gamma(0.01, 2.0)', 'delay(0.1) ; delay(0.2)']}
    """
    axes: dict[str | tuple[str, ...], list[Any]] = {}
    for names, parts in _typed(texts):
        written = ",".join(names)
        if len(names) == 1:
            axes[written] = [value for part in parts for value in _values(written, part)]
            continue
        points = axes[names] = []
        for part in parts:
            columns = [_values(written, each) for each in _parted(part, "/")]
            most = max(map(len, columns))
            if len(columns) != len(names) or any(len(column) not in (1, most) for column in columns):
                raise Refused(f"{written}={part} does not give {len(names)} values parted by /, or as many ranges with "
                              f"equal numbers of values; write for example {written}={_slashes(names)}")
            points += zip(*(column * most if len(column) == 1 else column for column in columns), strict=True)
    return axes


def parse_ranges(texts: Sequence[str]) -> dict[str, Range | list[Any]]:
    """Ranges as they are typed, for `sampled`: LOW:HIGH, LOW:HIGH:log, or values of which one is drawn.

    >>> parse_ranges(["k_e=1e2:1e6:log", "law=wave,pfra"])
    {'k_e': Range(low=100.0, high=1000000.0, log=True), 'law': ['wave', 'pfra']}
    """
    ranges: dict[str, Range | list[Any]] = {}
    for names, parts in _typed(texts):
        written, (first, *more) = ",".join(names), parts[0].split(":")
        if len(names) > 1:
            raise Refused(f"{written}: a sample draws each knob by itself; write each as a text of its own, "
                          f"{names[0]}=0:0.5 {names[1]}=1,2")
        if not (more and _is_number(first)):
            ranges[written] = [_value(written, part) for part in parts]
        elif len(parts) == 1 and _is_number(more[0]) and more[1:] in ([], ["log"]):
            ranges[written] = _range(written, parts[0], first, more[0], log=len(more) == 2)
        else:
            raise Refused(f"{written}={','.join(parts)} is not LOW:HIGH or LOW:HIGH:log; write for example "
                          f"{written}=0:0.5, or {written}=1e2:1e6:log by equal ratios")
    return ranges


def _typed(texts: Sequence[str]) -> Iterator[tuple[tuple[str, ...], list[str]]]:
    """The names of each axis and its values, still as texts."""
    seen: set[str] = set()
    for text in [texts] if isinstance(texts, str) else texts:
        for axis in _parted(text.strip(), _NEXT_AXIS):
            left, equals, right = axis.partition("=")
            names = tuple(name.strip() for name in left.split(","))
            if not equals or not all(names):
                raise Refused(f"{axis!r} gives no knob values; write for example delay=0:0.5:51 or law=wave,pfra")
            for name in names:
                if name in seen:
                    raise Refused(f"{name} is in the grid twice; write all of its values after one {name}=, parted by "
                                  "commas")
                seen.add(name)
            if not right.strip():
                raise Refused(f"{left.strip()}= has no values; write for example {left.strip()}={_slashes(names)}")
            yield names, [part.strip() for part in _parted(right, ",")]


def listed(text: str) -> list[str]:
    """The parts of a list: `text` parted at the commas that are in no brackets and no quotes. Raises `Refused`.

    >>> listed("wave,deadband(0.1, floor=1e-3) | direct")
    ['wave', 'deadband(0.1, floor=1e-3) | direct']
    """
    return [part.strip() for part in _parted(text, ",") if part.strip()]


def _parted(text: str, gap: str | re.Pattern[str]) -> list[str]:
    """`text` parted at the gaps that are in no brackets and no quotes; a quote begins where a value does."""
    gap = re.compile(re.escape(gap)) if isinstance(gap, str) else gap
    parts, start, at, depth, quote = [], 0, 0, 0, ""
    while at < len(text) and depth >= 0:
        sign = text[at]
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"" and (depth or text[:at].rstrip()[-1:] in ("", "=", ",", "/")):
            quote = sign
        elif sign in "([{)]}":
            depth += 1 if sign in "([{" else -1
        elif not depth and (found := gap.match(text, at)):
            parts.append(text[start:at])
            start = at = found.end()
            continue
        at += 1
    if quote or depth:
        raise Refused(f"{text!r} has a bracket or a quote without its other one; write both")
    return [*parts, text[start:]]


def _values(name: str, text: str) -> list[Any]:
    """One value, or those of a range."""
    text = text.strip()
    first, *more = text.split(":")
    if not more or not _is_number(first):
        return [_value(name, text)]
    if len(more) not in (2, 3) or not _is_number(more[0]) or more[2:] not in ([], ["log"]):
        raise Refused(f"{name}={text} is not LOW:HIGH:N or LOW:HIGH:N:log; write for example {name}=0:0.5:51, "
                      f"or {name}=1e2:1e6:9:log by equal ratios")
    count = more[1].strip()
    if not (count.isascii() and count.isdecimal() and len(count) < 10 and 2 <= int(count) <= MOST_VALUES):
        raise Refused(f"{name}={text} must have a whole number of values from 2 to {MOST_VALUES}, both ends included, "
                      f"not {count!r}; write for example {name}={first}:{more[0]}:51")
    return _range(name, text, first, more[0], log=len(more) == 3).values(int(count))


def _range(name: str, text: str, low: str, high: str, *, log: bool) -> Range:
    """The range from `low` to `high` that was typed as `text`."""
    try:
        return Range(float(low), float(high), log=log)
    except Refused as refused:
        raise Refused(f"{name}={text}: {refused}") from None


def _value(name: str, text: str) -> Any:
    """A number, or a text; in quotes always a text."""
    if text[:1] in ("'", '"'):
        if len(text) < 2 or text.find(text[0], 1) != len(text) - 1:
            raise Refused(f"{name}={text} goes on after a quoted value; write a comma between values, "
                          f"{name}='one','other'")
        return text[1:-1]
    if not text:
        raise Refused(f"{name} has an empty value; leave the comma out, or write '' for an empty text")
    if not _is_number(text):
        return text
    try:
        return int(text)
    except ValueError:
        return number(name, float(text))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _slashes(names: tuple[str, ...]) -> str:
    return ",".join("/".join(f"{i}" for _ in names) for i in (1, 2))
