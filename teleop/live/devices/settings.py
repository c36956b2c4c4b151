"""Settings behind the `?` of a device's address, as they are typed: `feetech:/dev/ttyACM0?ids=1-6&limit=0.5`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import parse_qsl

from teleop.errors import Refused, nearest, number, number_of

Reader = Callable[[str, str], Any]
"""Reads the text of a setting, of the name that is handed over first. Raises `Refused`."""


def settings_of(device: str, text: str, readers: Mapping[str, Reader], example: str) -> tuple[str, dict[str, Any]]:
    """Return the address before the `?` and the settings behind it by name, those that were typed. Raises `Refused`.

    >>> settings_of("arm", "can0?rate=500", {"rate": positive}, "arm:can0")
    ('can0', {'rate': 500.0})
    """
    address, mark, query = text.partition("?")
    if not address:
        raise Refused(f"{text!r} has no address before its settings; write for example {example}")
    pairs = parse_qsl(query, keep_blank_values=True)
    if mark and not all("=" in part for part in query.split("&")):
        raise Refused(f"the settings {query!r} of {device} cannot be read; each is NAME=VALUE, with & between them: "
                      f"{example}")
    settings: dict[str, Any] = {}
    for name, value in pairs:
        if name not in readers:
            raise Refused(f"{device} has no setting {name!r}; {nearest(name, readers)}; write for example {example}")
        if name in settings:
            raise Refused(f"{device} has its setting {name} twice; write it once")
        settings[name] = readers[name](f"{device}'s {name}", value)
    return address, settings


def within(low: float, high: float) -> Reader:
    """Make a reader of numbers from `low` to `high`."""
    def read(name: str, text: str) -> float:
        return number(name, _real(name, text), low=low, high=high)

    return read


def positive(name: str, text: str) -> float:
    """Read a number above 0."""
    return number(name, _real(name, text), above=0.0)


def numbers(name: str, text: str) -> tuple[float, ...]:
    """Read numbers above 0, one for all joints or one for each.

    >>> numbers("kt", "1.78,1.0")
    (1.78, 1.0)
    """
    return tuple([positive(name, each) for each in text.split(",")])


def for_each(name: str, values: tuple[float, ...], joints: int) -> tuple[float, ...]:
    """Return a number for each joint. Raises `Refused` where there are neither one nor as many."""
    if len(values) not in (1, joints):
        raise Refused(f"{name} has {len(values)} numbers, and there are {number_of(joints, 'joint')}; write one for "
                      "all or one for each, with commas between them")
    return values * joints if len(values) == 1 else values


def whole(name: str, text: str) -> int:
    """Read a whole number above 0."""
    if not text.isascii() or not text.isdecimal() or not int(text):
        raise Refused(f"{name} is a whole number above 0, not {text!r}")
    return int(text)


def one_of(*choices: str) -> Reader:
    """Make a reader of words."""
    def read(name: str, text: str) -> str:
        if text not in choices:
            raise Refused(f"{name} is {' or '.join(choices)}, not {text!r}; write {name.rpartition(' ')[2]}="
                          f"{choices[0]}")
        return text

    return read


def ids_of(name: str, text: str) -> tuple[tuple[int, float], ...]:
    """Read the ids of a chain in the scene's order, each with its sign: -1 of a joint that turns the other way.

    >>> ids_of("ids", "1,-2,4-6")
    ((1, 1.0), (2, -1.0), (4, 1.0), (5, 1.0), (6, 1.0))
    """
    ids: list[tuple[int, float]] = []
    for part in text.split(","):
        first, dash, last = part.removeprefix("-").partition("-")
        ends = [first, last if dash else first]
        if not all(each.isascii() and each.isdecimal() and 0 <= int(each) <= 252 for each in ends):
            raise Refused(f"{name} are whole numbers from 0 to 252 in the scene's order, not {text!r}; write ids=1-6, "
                          "or ids=1,-2,3 where joint 2 turns the other way")
        low, high = map(int, ends)
        ids += [(each, -1.0 if part[0] == "-" else 1.0) for each in range(low, high + 1)]
    if not ids or len({each for each, _ in ids}) < len(ids):
        raise Refused(f"{name} name each joint once and in rising ranges, not {text!r}; write for example ids=1-6")
    return tuple(ids)


def _real(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise Refused(f"{name} is a number, not {text!r}") from None


def axes_of(name: str, text: str) -> tuple[tuple[int, float], ...]:
    """Read the device's axes that are the scene's, in order, each with its sign.

    >>> axes_of("axes", "-zx")
    ((2, -1.0), (0, 1.0))
    """
    axes: list[tuple[int, float]] = []
    sign = 1.0
    for letter in text:
        if letter == "-" and sign > 0.0:
            sign = -1.0
        elif letter in "xyz" and "xyz".index(letter) not in [i for i, _ in axes]:
            axes.append(("xyz".index(letter), sign))
            sign = 1.0
        else:
            axes.clear()
            break
    if not axes or sign < 0.0:
        raise Refused(f"{name} are the device's in the scene's order, each once, not {text!r}; write axes=xyz, or "
                      "axes=-z for one axis that is turned round")
    return tuple(axes)
