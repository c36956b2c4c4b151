"""Rows of a sweep: knobs times seeds, each row worked out from its number, none of them stored.

A grid is made of axes, crossed with one another and with the seeds; an axis turns one knob, or several together
(zipped). Rows are numbered in the order of `itertools.product`, the seeds fastest and then the last axis.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from fractions import Fraction
from hashlib import sha256
from itertools import islice
from json import dumps
from math import log10, prod
from numbers import Integral, Real
from os import PathLike, fspath
from sys import maxsize
from typing import Any

import numpy as np

from teleop.errors import Refused, number

MOST_VALUES = 1_000_000  # of one axis, whose values are kept; axes multiply without being kept
WRITTEN_OUT = 1000  # values of an axis that its definition lists; of more it has the digest
OWN = ("row", "seed", "status", "ticks", "sentence")  # what a row has beside knobs and metrics
_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")

Axis = tuple[tuple[str, ...], tuple[tuple[Any, ...], ...]]


@dataclass(frozen=True, kw_only=True, slots=True)
class Grid:
    """Axes (names, points) crossed with one another and with the seeds. Raises `Refused`; `grid` makes one."""

    axes: tuple[Axis, ...]
    seeds: tuple[int, ...] | range

    def __post_init__(self) -> None:
        for names, points in self.axes:
            if not names:
                raise Refused('an axis turns no knobs; write for example {"delay": [0.1]}, or leave it out')
            for name in names:
                if not isinstance(name, str) or not name.strip():
                    raise Refused(f'a knob is called by a text, not {name!r}; write for example {{"delay": [0.1]}}')
                if name in OWN:
                    seeds = "write seeds=30, or type --seeds 30"
                    cure = seeds if name == "seed" else "give the scene's knob another name"
                    raise Refused(f"{name} is a column of every row and cannot be a knob of the grid too; {cure}")
            for point in points:
                if len(point) != len(names):
                    raise Refused(f"{', '.join(names)} are turned together, so a point has {len(names)} values, not "
                                  f"{point!r}; write for example {_example(names)}")
            if not points:
                raise Refused(f"the axis {', '.join(names)} has no values; write at least one, {_example(names)}")
        twice = next((name for i, name in enumerate(self.knobs) if name in self.knobs[:i]), None)
        if twice is not None:
            raise Refused(f"{twice} is in the grid twice; write all of its values into one axis, {_example((twice,))}")
        if not self.seeds:
            raise Refused("a sweep has at least one seed; write seeds=1")
        if self.points * len(self.seeds) > maxsize:
            raise Refused(f"the grid has {self.points * len(self.seeds):.3g} rows, more than can be numbered; "
                          "write fewer values, or take a sample of n points")

    @property
    def knobs(self) -> tuple[str, ...]:
        """Knobs of the axes, in their order."""
        return tuple(name for names, _ in self.axes for name in names)

    @property
    def points(self) -> int:
        """Number of settings of the knobs; each is run with every seed."""
        return prod(len(points) for _, points in self.axes)

    def __len__(self) -> int:
        return self.points * len(self.seeds)

    def point(self, row: int) -> tuple[dict[str, Any], int]:
        """The knobs and the seed of a row, 0 .. len - 1. Raises `Refused` for another number."""
        (_, knobs, seed), = self.rows([row])
        return knobs, seed

    def rows(self, numbers: Iterable[int]) -> list[tuple[int, dict[str, Any], int]]:
        """The number, the knobs and the seed of several rows. Raises `Refused` as `point`."""
        count, seeds, knobs = len(self), self.seeds, self.knobs
        axes = [(len(points), points) for _, points in reversed(self.axes)]
        rows_of = []
        for row in numbers:
            if not 0 <= row < count:
                raise Refused(f"the grid has no row {row}; write a number from 0 to {count - 1}")
            at, seed = divmod(row, len(seeds))
            values: tuple[Any, ...] = ()
            for length, points in axes:
                at, which = divmod(at, length)
                values = points[which] + values
            rows_of.append((row, dict(zip(knobs, values, strict=True)), seeds[seed]))
        return rows_of

    def definition(self) -> dict[str, Any]:
        """The grid as JSON can hold it, equal for grids with equal rows; of a long axis its ends and its SHA-256."""
        axes = [{"knobs": list(names), "values": _summarise([
            [json_value(v) for v in p] if len(names) > 1 else json_value(p[0]) for p in points])}
            for names, points in self.axes]
        s = self.seeds
        seeds = {"first": s[0], "step": s.step, "count": len(s)} if isinstance(s, range) else _summarise(list(s))
        return {"axes": axes, "seeds": seeds}


def grid(axes: Mapping[Any, Iterable[Any]], seeds: int | Iterable[int] = 1) -> Grid:
    """A grid of `axes`: a knob with its values, or a tuple of knobs with tuples of values, which are zipped.

    `seeds`: how many, from 0 on, or which. Values are numbers, texts or parts (laws, links). Raises `Refused`.

    >>> both = grid({"law": ["wave", "pfra"], ("delay", "k_e"): [(0.0, 1e3), (0.1, 1e2)]}, seeds=2)
    >>> len(both), both.point(6)
    (8, ({'law': 'pfra', 'delay': 0.1, 'k_e': 100.0}, 0))
    """
    if not isinstance(axes, Mapping):
        raise Refused(f'the axes of a grid are a dict, not {axes!r}; write for example {{"delay": [0.0, 0.1]}}')
    made: list[Axis] = []
    for key, values in axes.items():
        if isinstance(key, tuple):
            name = ", ".join(map(str, key))
            points = tuple(tuple(clean_values(name, point)) for point in _entries(name, values))
            made.append((key, points))
        else:
            made.append(((key,), tuple((value,) for value in clean_values(key, values))))
    return Grid(axes=tuple(made), seeds=_seeds(seeds))


@dataclass(frozen=True, slots=True)
class Range:
    """Interval of numbers from `low` to `high`, both included; `log` goes by equal ratios. Raises `Refused`."""

    low: float
    high: float
    _: KW_ONLY
    log: bool = False

    def __post_init__(self) -> None:
        low, high = (number(f"a range's {which} end", end, example="0:100")
                     for which, end in (("first", self.low), ("other", self.high)))
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)
        if low == high:
            raise Refused(f"the range {low:g}:{high:g} has a single value; write it alone, {low:g}")
        if self.log and min(low, high) <= 0.0:
            most = max(low, high)
            example = f"{1e-3 * most:g}:{most:g}" if most > 0.0 else "1:1000"  # the same in a grid and in a sample
            raise Refused(f"the range {low:g}:{high:g} by equal ratios must lie above 0; write for example {example}")

    def values(self, n: int) -> list[float]:
        """`n` values evenly spaced, both ends exactly.

        Each is the float nearest to the decimal number: 0 to 0.3 in four is 0, 0.1, 0.2, 0.3 as one would type
        them. By equal ratios it is the exponents of ten that are so spaced, and whole decades are hit.
        """
        count = check_count("a range's number of values", n)
        if count < 2:
            raise Refused("a range with both its ends has at least 2 values; write for example 0:0.5:51, or one value "
                          "alone")
        if not self.log:
            return _evenly(self.low, self.high, count)
        inner = [self._within(10.0**exponent) for exponent in _evenly(log10(self.low), log10(self.high), count)]
        return [self.low, *inner[1:-1], self.high]

    def at(self, u: float) -> float:
        """The value at the part `u` of the way, 0 to 1."""
        if self.log:
            return self.low if u == 0.0 else self._within(10.0 ** (log10(self.low) * (1.0 - u) + log10(self.high) * u))
        return self._within(self.low * (1.0 - u) + self.high * u)

    def _within(self, value: float) -> float:
        return min(max(value, min(self.low, self.high)), max(self.low, self.high))


def sampled(ranges: Mapping[str, Range | Sequence[Any]], n: int, *, key: int = 0, latin: bool = True,
            seeds: int | Iterable[int] = 1) -> Grid:
    """A grid of `n` points drawn from `ranges`: of a `Range` any number, of a list any entry.

    Each knob has Philox dice of its own, keyed by `key` (0 .. 2^64-1) and its name, so knobs that are added change no
    others. `latin`: one point in each of n equal strata of every knob (McKay, Beckman & Conover, Technometrics 21,
    1979); otherwise independent, and a greater n keeps the points that are there.
    """
    count = check_count("n", n)
    if not _is_whole(key, 0, (1 << 64) - 1):
        raise Refused(f"key must be a whole number from 0 to 2^64-1, not {key!r}; write key=1")
    if not isinstance(ranges, Mapping) or not ranges:
        raise Refused('a sample needs the range of at least one knob; write for example {"delay": Range(0.0, 0.5)}')
    columns = []
    for name, over in ranges.items():
        draws = _draws(str(name), count, int(key), latin)
        if isinstance(over, Range):
            columns.append([over.at(u) for u in draws])
            continue
        entries = clean_values(name, over)
        if not entries:
            raise Refused(f"{name} has no values to draw from; write for example {name}=[1.0, 2.0]")
        columns.append([entries[min(int(u * len(entries)), len(entries) - 1)] for u in draws])
    return Grid(axes=((tuple(ranges), tuple(zip(*columns, strict=True))),), seeds=_seeds(seeds))


def json_value(value: Any) -> Any:
    """A knob's value as JSON can hold it: what is no number, text, truth or list of them by its `repr`."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, tuple | list):
        return [json_value(each) for each in value]
    return fspath(value) if isinstance(value, PathLike) else repr(value)


def clean_values(name: object, values: Iterable[Any]) -> list[Any]:
    """The values of a knob, those of numpy as Python's own. Raises `Refused`."""
    return [_clean(str(name), value) for value in _entries(str(name), values)]


def check_count(name: str, n: int) -> int:
    """A number of values, 1 .. `MOST_VALUES`. Raises `Refused`."""
    if not _is_whole(n, 1, MOST_VALUES):
        raise Refused(f"{name} must be a whole number from 1 to {MOST_VALUES}, not {n!r}; write for example 51")
    return int(n)


def _entries(name: str, values: Iterable[Any]) -> Iterator[Any]:
    """Entries of a list as a person wrote it."""
    if isinstance(values, str | bytes) or not isinstance(values, Iterable) or getattr(values, "shape", None) == ():
        raise Refused(f'{name} takes a list of values, not {values!r}; write "{name}": [{values!r}]')
    if isinstance(values, set | frozenset):
        raise Refused(f"{name} takes its values in an order, and a set has none; write a list, [...]")
    for i, value in enumerate(islice(values, MOST_VALUES + 1)):
        if i == MOST_VALUES:
            raise Refused(f"{name} has more than {MOST_VALUES} values; write fewer, or cross several axes")
        yield value


def _clean(name: str, value: Any) -> Any:
    if value is None or isinstance(value, str | bool):
        return value
    if getattr(value, "shape", None) == () and hasattr(value, "item"):  # of numpy
        value = value.item()
    if isinstance(value, bool):
        return value
    if isinstance(value, Real):
        return int(value) if isinstance(value, Integral) else number(name, value)
    if isinstance(value, list | tuple) or hasattr(value, "tolist"):
        return tuple(_clean(name, each) for each in value)
    if _ADDRESS.search(repr(value)):
        raise Refused(f"{name} has the value {value!r}, which no table can tell from another; write it as a text, or "
                      "make it a dataclass")
    return value


def _is_whole(value: object, low: int, high: int) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool) and low <= int(value) <= high


def _seeds(seeds: int | Iterable[int]) -> tuple[int, ...] | range:
    """The seeds, as a range where they are evenly spaced, so that equal seeds are equal however they were given."""
    if isinstance(seeds, Integral) and not isinstance(seeds, bool):
        if seeds < 1:
            raise Refused(f"a sweep has at least one seed, not {seeds}; write seeds=1")
        return range(int(seeds))
    even_seeds = seeds if isinstance(seeds, range) else None
    if even_seeds is None and (isinstance(seeds, bool | str) or not isinstance(seeds, Iterable)):
        raise Refused(f"seeds are a whole number of them or a list, not {seeds!r}; write seeds=30 or seeds=[1, 2, 5]")
    each = [*even_seeds[:1], *even_seeds[-1:]] if even_seeds is not None else list(_entries("seeds", seeds))  # type: ignore[arg-type]  # no int
    for seed in each:
        if not _is_whole(seed, 0, (1 << 64) - 1):
            raise Refused(f"a seed must be a whole number from 0 to 2^64-1, not {seed!r}; write for example "
                          "seeds=[1, 2]")
    if even_seeds is not None:
        return range(even_seeds[0], even_seeds[0] + 1) if len(even_seeds) == 1 else even_seeds
    whole = tuple(int(seed) for seed in each)
    if len(set(whole)) < len(whole):
        raise Refused("the same seed is in the list twice and would give the same rows; write each seed once")
    if not whole:
        return whole
    step = whole[1] - whole[0] if len(whole) > 1 else 1
    even = range(whole[0], whole[0] + step * len(whole), step)
    return even if tuple(even) == whole else whole


def _evenly(low: float, high: float, n: int) -> list[float]:
    """`n` floats nearest to evenly spaced decimal numbers."""
    a, b = Fraction(repr(low)), Fraction(repr(high))
    return [low, *(float(a + (b - a) * k / (n - 1)) for k in range(1, n - 1)), high]


def _draws(name: str, n: int, key: int, latin: bool) -> list[float]:
    """`n` numbers in [0, 1) of a knob's own dice; with `latin` one of them in each of n equal parts."""
    from numpy.random import Philox

    keys = np.array([key, int.from_bytes(sha256(name.encode()).digest()[:8], "little")], np.uint64)
    places, order = (Philox(key=keys, counter=np.array([0, 0, lane, 0], np.uint64)).random_raw(n) for lane in (0, 1))
    u = (np.asarray(places, np.uint64) >> np.uint64(11)).astype(float) * 2.0**-53
    if latin:
        part = np.argsort(order, kind="stable")
        u = np.minimum((part + u) / n, np.nextafter((part + 1) / n, 0.0))  # rounding does not leave the part
    drawn: list[float] = u.tolist()
    return drawn


def _summarise(values: list[Any]) -> Any:
    """The values; of many their number, their ends and the SHA-256 of their JSON."""
    if len(values) <= WRITTEN_OUT:
        return values
    digest = sha256(dumps(_alike(values)).encode()).hexdigest()
    return {"count": len(values), "first": values[0], "last": values[-1], "sha256": digest}


def _alike(value: Any) -> Any:
    """Write equal values equally: 1.0 as 1."""
    if isinstance(value, list):
        return [_alike(each) for each in value]
    return int(value) if isinstance(value, bool | float) and value == int(value) else value


def _example(names: tuple[str, ...]) -> str:
    if len(names) == 1:
        return f'"{names[0]}": [1.0, 2.0]'
    rows = ", ".join(f"({', '.join(f'{i}.0' for _ in names)})" for i in (1, 2))
    return f"({', '.join(repr(name) for name in names)}): [{rows}]"


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
    for names, parts in _split_axes(texts):
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
    for names, parts in _split_axes(texts):
        written, (first, *rest) = ",".join(names), parts[0].split(":")
        if len(names) > 1:
            raise Refused(f"{written}: a sample draws each knob by itself; write each as a text of its own, "
                          f"{names[0]}=0:0.5 {names[1]}=1,2")
        if not (rest and _is_number(first)):
            ranges[written] = [_value(written, part) for part in parts]
        elif len(parts) == 1 and _is_number(rest[0]) and rest[1:] in ([], ["log"]):
            ranges[written] = _range(written, parts[0], first, rest[0], log=len(rest) == 2)
        else:
            raise Refused(f"{written}={','.join(parts)} is not LOW:HIGH or LOW:HIGH:log; write for example "
                          f"{written}=0:0.5, or {written}=1e2:1e6:log by equal ratios")
    return ranges


def _split_axes(texts: Sequence[str]) -> Iterator[tuple[tuple[str, ...], list[str]]]:
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


def split_list(text: str) -> list[str]:
    """The parts of a list: `text` parted at the commas that are in no brackets and no quotes. Raises `Refused`.

    >>> split_list("wave,deadband(0.1, floor=1e-3) | direct")
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
        elif not depth and (match := gap.match(text, at)):
            parts.append(text[start:at])
            start = at = match.end()
            continue
        at += 1
    if quote or depth:
        raise Refused(f"{text!r} has a bracket or a quote without its other one; write both")
    return [*parts, text[start:]]


def _values(name: str, text: str) -> list[Any]:
    """Read a value, or the values of a range."""
    text = text.strip()
    first, *rest = text.split(":")
    if not rest or not _is_number(first):
        return [_value(name, text)]
    if len(rest) not in (2, 3) or not _is_number(rest[0]) or rest[2:] not in ([], ["log"]):
        raise Refused(f"{name}={text} is not LOW:HIGH:N or LOW:HIGH:N:log; write for example {name}=0:0.5:51, "
                      f"or {name}=1e2:1e6:9:log by equal ratios")
    count = rest[1].strip()
    if not (count.isascii() and count.isdecimal() and len(count) < 10 and 2 <= int(count) <= MOST_VALUES):
        raise Refused(f"{name}={text} must have a whole number of values from 2 to {MOST_VALUES}, both ends included, "
                      f"not {count!r}; write for example {name}={first}:{rest[0]}:51")
    return _range(name, text, first, rest[0], log=len(rest) == 3).values(int(count))


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
