"""Eight scenes side by side in plain Python, so that text which is compiled over lanes runs without a compiler.

`Lanes` are eight floats that are reckoned with as one, and `Mask` eight truths, which no `if` may ask for one. `WORDS`
are the words of `teleop.simulation.masks` and `teleop.stages.memory` for them.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

WIDTH = 8


class Eight(tuple[Any, ...]):
    """One number or truth for each of eight scenes."""

    __slots__ = ()
    __hash__ = tuple.__hash__


class Mask(Eight):
    """Eight truths."""

    __slots__ = ()

    def __bool__(self) -> bool:
        raise TypeError("eight scenes side by side take no branch of their own")


class Lanes(Eight):
    """Eight floats."""

    __slots__ = ()


def each_lane(function: Callable[..., Any], *values: Any) -> list[Any]:
    """The answers of a function to the numbers of each lane; what has no lanes is the same in all."""
    return [function(*[lane(value, i) for value in values]) for i in range(WIDTH)]


def lane(value: Any, i: int) -> Any:
    """The numbers of lane i."""
    if isinstance(value, Eight):
        return value[i]
    return tuple.__new__(type(value), [lane(each, i) for each in value]) if isinstance(value, tuple) else value


def _operation(kind: type[Eight], result: type[Eight], word: str, function: Callable[..., Any]) -> None:
    setattr(kind, f"__{word}__", lambda self, *other: result(each_lane(function, self, *other)))
    if word in ("add", "sub", "mul", "truediv", "and", "or"):
        setattr(kind, f"__r{word}__", lambda self, other: result(each_lane(function, other, self)))


for _word in ("add", "sub", "mul", "truediv", "neg", "abs"):
    _operation(Lanes, Lanes, _word, getattr(operator, _word))
for _word in ("lt", "le", "gt", "ge", "eq", "ne"):
    _operation(Lanes, Mask, _word, getattr(operator, _word))
_operation(Mask, Mask, "and", lambda a, b: a and b)
_operation(Mask, Mask, "or", lambda a, b: a or b)


def select(mask: Any, here: Any, there: Any) -> Any:
    """Numbers, truths or tuples of such."""
    if isinstance(here, tuple) and not isinstance(here, Eight):
        return tuple.__new__(type(here), [select(mask, a, b) for a, b in zip(here, there, strict=True)])
    if not isinstance(mask, Mask):
        return here if mask else there
    found = each_lane(lambda which, a, b: a if which else b, mask, here, there)
    return Mask(found) if all(isinstance(one, bool) for one in found) else Lanes(found)


def invert(mask: Any) -> Any:
    """Of eight truths, or of one."""
    return Mask(each_lane(operator.not_, mask)) if isinstance(mask, Mask) else not mask


def any_lane(mask: Any) -> bool:
    """Of eight truths, or of one."""
    return any(mask) if isinstance(mask, Mask) else mask


def broadcast(tree: Any) -> Any:
    """Numbers in every lane."""
    if isinstance(tree, tuple) and not isinstance(tree, Eight):
        return tuple.__new__(type(tree), [broadcast(each) for each in tree])
    return tree if isinstance(tree, Eight) else Lanes([tree] * WIDTH)


def side_by_side(trees: list[Any]) -> Any:
    """Trees of numbers as one, each number with its lanes."""
    one = trees[0]
    if isinstance(one, tuple) and not isinstance(one, Eight):
        return tuple.__new__(type(one), [side_by_side([tree[i] for tree in trees]) for i in range(len(one))])
    return Lanes(trees) if isinstance(one, float) else one


def put(kept: list[Any], k: Any, size: int, message: Any) -> None:
    """Under one number, or under that of each lane."""
    put_selected(True, kept, k, size, message)


def put_selected(mask: Any, kept: list[Any], k: Any, size: int, message: Any) -> None:
    """The same where the mask is true."""
    for i in range(WIDTH):
        row = int(lane(k, i)) % size
        here = Mask([bool(lane(mask, i)) and n == i for n in range(WIDTH)])
        kept[row] = select(here, message, kept[row])


def get(kept: list[Any], k: Any, size: int) -> Any:
    """Of one number, or of that of each lane."""
    return side_by_side([lane(kept[int(lane(k, i)) % size], i) for i in range(WIDTH)])


def store(out: list[Any], mask: Any, ran: int, figures: tuple[Any, ...]) -> None:
    """Of each scene for which the mask is true, the ticks that ran and its figures."""
    for i in range(WIDTH):
        if lane(mask, i):
            out[i] = ran, lane(figures, i)


WORDS = {each.__name__: each for each in (select, invert, any_lane, broadcast, put, put_selected, get, store)}


def lane_by_lane(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that branches, for eight scenes."""
    return lambda *values: Lanes(each_lane(function, *values))
