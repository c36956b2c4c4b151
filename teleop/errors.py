"""Refusals: one sentence that says what is wrong, why, and what to type.

`Refused` is the only exception that the command line turns into exit code 2. Misuse found while an
object is made (a negative mass, an unknown name) raises it at once, before anything is computed or
written; what happens *during* a run is a status of the run, never an exception.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import inf, isfinite
from numbers import Real
from typing import Any


class Refused(ValueError):
    """A request that cannot be carried out as it stands; the text is the whole answer."""


class DeviceError(Exception):
    """Raised by a device or robot that cannot be read or moved now; its end is safe until it can again."""


class WrongNumber(Refused):
    """A refused number: its name, its value, the range that it must be in, and an example of a good one.

    The example is a number, which is typed behind the last word of the name, or the whole text to type.
    """

    def __init__(self, name: str, value: object, must: str, example: float | str, note: str = "") -> None:
        shown = f"{value:g}" if type(value) is float else repr(value)
        typed = example if isinstance(example, str) else f"{name.rpartition(' ')[2]}={example:g}"
        super().__init__(f"{name} must be {must}, not {shown}; write for example {typed}{note and f' ({note})'}")
        self.name, self.value, self._must, self._example, self._note = name, value, must, example, note

    def with_name(self, name: str) -> WrongNumber:
        """The same refusal with another name of the number, the one under which it was typed."""
        return WrongNumber(name, self.value, self._must, self._example, self._note)

    def with_note(self, note: str) -> WrongNumber:
        """The same refusal with what the number is and where its range comes from, in brackets at the end."""
        return WrongNumber(self.name, self.value, self._must, self._example, note)


class WrongCount(Refused):
    """A refused tuple of numbers, one for each axis: its name, the tuple, and how many axes there are."""

    def __init__(self, name: str, value: tuple[object, ...], axes: int) -> None:
        super().__init__(f"{name} has {number_of(len(value), 'number')}, the scene has "
                         f"{number_of(axes, 'axis', 'axes')}; write one number, which means for each axis, or as many "
                         "as there are axes")
        self.name, self.value, self._axes = name, value, axes

    def with_name(self, name: str) -> WrongCount:
        """The same refusal with another name of the numbers, the one under which they were typed."""
        return WrongCount(name, self.value, self._axes)


def enough(value: float, *, least: bool) -> str:
    """A bound of a condition as it is typed, to four digits: rounded up if it is the least that is enough, else down.

    >>> enough(40.239, least=True), enough(40.239, least=False), enough(0.25, least=True)
    ('40.24', '40.23', '0.25')
    >>> enough(0.5 - 0.2, least=False)
    '0.3'
    """
    from decimal import ROUND_CEILING, ROUND_FLOOR, Context  # for a condition that is broken

    rounded = Context(prec=4, rounding=ROUND_CEILING if least else ROUND_FLOOR).create_decimal(f"{value:.12g}")
    return f"{float(rounded):g}"


def nearest(word: str, known: Iterable[str]) -> str:
    """Last words of a refusal of an unknown name: the nearest known names, or all of them.

    >>> nearest("wavee", ["wave", "pfra"])
    'did you mean wave?'
    """
    names = sorted(known)
    close = closest(word, names)
    return f"did you mean {' or '.join(close)}?" if close else f"there are: {', '.join(names)}"


def closest(word: str, known: Iterable[str]) -> list[str]:
    """At most three of the known names that are close to `word`, the closest first."""
    from difflib import get_close_matches

    return get_close_matches(word, sorted(known), n=3, cutoff=0.6)


def plural(count: float, one: str, many: str = "") -> str:
    """The noun that stands behind `count`: `one`, or `many`, which left out is `one` with an s.

    >>> plural(1, "row"), plural(2, "row"), plural(0, "axis", "axes")
    ('row', 'rows', 'axes')
    """
    return one if count == 1 else many or f"{one}s"


def number_of(count: float, one: str, many: str = "") -> str:
    """A count and its noun, see `plural`.

    >>> number_of(1, "contact"), number_of(2, "contact")
    ('1 contact', '2 contacts')
    """
    return f"{count} {plural(count, one, many)}"


def enumerated(names: Iterable[str], last: str = "and") -> str:
    """Names as a sentence has them.

    >>> enumerated(["run"]), enumerated(["run", "demo", "sweep"])
    ('run', 'run, demo and sweep')
    """
    *first, end = names
    return f"{', '.join(first)} {last} {end}" if first else end


def number(name: str, value: object, *, low: float | None = None, above: float | None = None,
           high: float | None = None, unit: str = "", example: str = "") -> float:
    """Convert `value` to a float. Raises `Refused` if it is no finite number in the range.

    `low` and `high` are included in the range, `above` is not; the sentence gives them with the `unit`. A bool is not a
    number here, a numpy scalar is. `example`: what to type, where that is not a number behind the name.

    >>> number("delay", 3, low=0.0)
    3.0
    """
    if type(value) is float:  # nearly always
        got = value
    elif isinstance(value, bool) or not isinstance(value, Real):
        raise WrongNumber(name, value, "a number", example or _in_range(low, above, high))
    else:
        try:
            got = float(value)
        except OverflowError:  # a whole number beyond all floats
            got = inf
    if not isfinite(got):
        raise WrongNumber(name, got, "finite", example or _in_range(low, above, high))
    if above is not None and got <= above:
        raise WrongNumber(name, got, f"above {above:g} {unit}".rstrip(),
                          example or (above + 1.0 if high is None else min(above + 1.0, high)))
    if low is not None and got < low:
        raise WrongNumber(name, got, f"at least {low:g} {unit}".rstrip(), example or low)
    if high is not None and got > high:
        raise WrongNumber(name, got, f"at most {high:g} {unit}".rstrip(), example or high)
    return got


def numbers(name: str, value: object, *, low: float | None = None, above: float | None = None,
            high: float | None = None) -> float | tuple[float, ...]:
    """Convert a number, or a tuple with one for each axis, to floats. Raises `Refused` as `number` does."""
    if isinstance(value, tuple):
        return tuple([number(name, each, low=low, above=above, high=high) for each in value])
    return number(name, value, low=low, above=above, high=high)


def by_axis(name: str, value: float | tuple[float, ...], axes: int) -> tuple[float, ...]:
    """Numbers of so many axes, out of one for all or one for each. Raises `Refused` for more or fewer."""
    if isinstance(value, tuple) and len(value) != axes:
        raise WrongCount(name, value, axes)
    return value if isinstance(value, tuple) else (value,) * axes


def _in_range(low: float | None, above: float | None, high: float | None) -> float:
    """A number of the range, 1 where it is one."""
    least = max(1.0, low if low is not None else 1.0, above + 1.0 if above is not None else 1.0)
    return least if high is None else min(least, high)


def whole_number(name: str, value: object, *, low: float | None = None, high: float | None = None) -> int:
    """Convert `value` to an int. Raises `Refused` if it is no whole number in the range; 3.0 is one."""
    got = number(name, value, low=low, high=high)
    if not got.is_integer():
        raise WrongNumber(name, got, "a whole number", round(got))
    return int(got)


class NamedValues(dict[str, Any]):
    """Values by name; an unknown name raises `KeyError` with the nearest ones. `kind`: what a name stands for."""

    def __init__(self, kind: str, values: Mapping[str, Any]) -> None:
        super().__init__(values)
        self.kind = kind

    def __missing__(self, name: str) -> Any:
        raise KeyError(f"there is no {self.kind} {name!r}; {nearest(name, self)}")

    def __reduce__(self) -> tuple[Any, ...]:
        return NamedValues, (self.kind, dict(self))
