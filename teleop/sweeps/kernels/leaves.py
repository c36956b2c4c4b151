"""The numbers of a row, laid out flat: what a compiled kernel is given, and how it makes them the row's own again.

A row's numbers come as a tree: NamedTuples and tuples of floats, whole numbers and lists. Flat they are three lists;
the tree's *shape* is what rows of one kernel share, and the text of the kernel puts the tree together from it.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any, NamedTuple

FLOATS = {float}
_SHAPES: dict[Any, Any] = {}  # one of each, however many rows have it


class Leaves(NamedTuple):
    """A tree taken apart."""

    shape: tuple[Any, ...]  # "(", ")", "i", "a", so many floats, and the class of each NamedTuple in place of its "("
    reals: array[float]
    wholes: list[int]
    arrays: list[Any]


def leaves(tree: Any) -> Leaves:
    """A tree taken apart. A list is an array; None the whole number 0: what a kernel is given and does not name."""
    found = Leaves((), array("d"), [], [])
    shape: list[Any] = []
    _take(tree, shape, *found[1:])
    kind = tuple(shape)
    return Leaves(_SHAPES.setdefault(kind, kind), *found[1:])


def _take(tree: Any, shape: list[Any], reals: array[float], wholes: list[int], arrays: list[Any]) -> None:
    if isinstance(tree, tuple):
        shape.append(type(tree) if hasattr(tree, "_fields") else "(")
        if set(map(type, tree)) == FLOATS:  # nearly always
            shape.append(len(tree))
            reals.extend(tree)
        else:
            for each in tree:
                _take(each, shape, reals, wholes, arrays)
        shape.append(")")
    elif isinstance(tree, float):
        shape.append(1)
        reals.append(float(tree))
    elif isinstance(tree, list):
        import numpy as np

        shape.append("a")
        arrays.append(np.asarray(tree))
    else:
        shape.append("i")
        wholes.append(0 if tree is None else int(tree))


def expression(shape: tuple[Any, ...], real: str, class_name: Callable[[type], str]) -> str:
    """What puts the tree together, `real` with the number of a float in place of `{}`."""
    numbers = {"f": count(), "i": count(), "a": count()}
    words = {"f": real, "i": "wholes[{}]", "a": "arrays[{}]"}

    def some(code: Any, rest: Iterator[Any]) -> list[str]:
        """What one code stands for: several numbers side by side, or one tuple."""
        if isinstance(code, int) or code in words:
            kind, many = ("f", code) if isinstance(code, int) else (code, 1)
            return [words[kind].format(next(numbers[kind])) for _ in range(many)]
        inner: list[str] = []
        while (each := next(rest)) != ")":
            inner += some(each, rest)
        start = "(" if code == "(" else f"{class_name(code)}("
        return [f"{start}{', '.join(inner)}{',' if inner and code == '(' else ''})"]

    rest = iter(shape)
    return some(next(rest), rest)[0]
