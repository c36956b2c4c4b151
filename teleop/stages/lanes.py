"""What compiled lines of the tick say, in plain Python: of one number, or of eight scenes side by side.

Compiled code has these by the same names as instructions (`teleop.sweeps.kernels.lanewise`, `...rings`). Here they are
ordinary functions, so that those lines run as they stand. `Lanes` are eight floats that are reckoned with as one, and
`Mask` eight truths, which no `if` may ask for one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from teleop.stages.record import Record

WIDTH = 8
LEFT_OUT = -2  # in place of a message's number: the tick is left out


def _each(function: Callable[..., Any], *values: Any) -> list[Any]:
    """What a function makes of the numbers of each lane; what has no lanes is the same in all."""
    return [function(*[value[i] if isinstance(value, Eight) else value for value in values]) for i in range(WIDTH)]


class Eight(tuple[Any, ...]):
    """One number or truth for each of eight scenes."""

    __slots__ = ()
    __hash__ = tuple.__hash__


class Mask(Eight):
    """Eight truths."""

    __slots__ = ()

    def __and__(self, other: Any) -> Mask:
        return Mask(_each(lambda a, b: a and b, self, other))

    def __or__(self, other: Any) -> Mask:
        return Mask(_each(lambda a, b: a or b, self, other))

    def __invert__(self) -> Mask:
        return Mask(_each(lambda a: not a, self))

    def __mul__(self, other: Any) -> Lanes:
        return Lanes(_each(lambda a, b: float(a) * b, self, other))

    __rmul__ = __mul__

    def __bool__(self) -> bool:
        raise TypeError("eight scenes side by side go no way of their own: write where(), min or max in place of if")


class Lanes(Eight):
    """Eight floats."""

    __slots__ = ()

    def __add__(self, other: Any) -> Lanes:
        return Lanes(_each(lambda a, b: a + b, self, other))

    def __sub__(self, other: Any) -> Lanes:
        return Lanes(_each(lambda a, b: a - b, self, other))

    def __rsub__(self, other: Any) -> Lanes:
        return Lanes(_each(lambda a, b: b - a, self, other))

    def __mul__(self, other: Any) -> Lanes:
        return Lanes(_each(lambda a, b: a * b, self, other))

    def __truediv__(self, other: Any) -> Lanes:
        return Lanes(_each(lambda a, b: a / b, self, other))

    def __rtruediv__(self, other: Any) -> Lanes:
        return Lanes(_each(lambda a, b: b / a, self, other))

    def __neg__(self) -> Lanes:
        return Lanes(_each(lambda a: -a, self))

    def __abs__(self) -> Lanes:
        return Lanes(_each(abs, self))

    def __lt__(self, other: Any) -> Mask:  # type: ignore[override]
        return Mask(_each(lambda a, b: a < b, self, other))

    def __le__(self, other: Any) -> Mask:  # type: ignore[override]
        return Mask(_each(lambda a, b: a <= b, self, other))

    def __gt__(self, other: Any) -> Mask:  # type: ignore[override]
        return Mask(_each(lambda a, b: a > b, self, other))

    def __ge__(self, other: Any) -> Mask:  # type: ignore[override]
        return Mask(_each(lambda a, b: a >= b, self, other))

    __radd__ = __add__
    __rmul__ = __mul__


def where(which: Any, here: Any, there: Any) -> Any:
    """`here` where `which` is true, else `there`."""
    if isinstance(which, Mask):
        return Lanes(_each(lambda w, a, b: a if w else b, which, here, there))
    return here if which else there


def came(seq: Any) -> Any:
    """Is a message's number one from zero on."""
    return Mask(_each(lambda a: a >= 0, seq)) if isinstance(seq, Eight) else seq >= 0


def runs(order: Any) -> Any:
    """Is a tick run; its order is the number of the message that it plays, -1, or `LEFT_OUT`."""
    return Mask(_each(lambda a: a > LEFT_OUT, order)) if isinstance(order, Eight) else order > LEFT_OUT


def chosen(which: Any, here: Any, there: Any) -> Any:
    """`here` where `which` is true, else `there`: numbers, or tuples of such."""
    if isinstance(here, tuple) and not isinstance(here, Eight):
        return tuple.__new__(type(here), [chosen(which, a, b) for a, b in zip(here, there, strict=True)])
    return where(which, here, there)


def only(which: Any, work: Callable[..., None], *given: Any) -> None:
    """Do `work(*given)` in the lanes that are true: in the others each field of its records stays what it was."""
    before = [(record, dict(vars(record))) for record in records(given)]
    work(*given)
    for record, fields in before:
        for name, old in fields.items():
            if (new := getattr(record, name)) is not old and name not in record.passing:
                setattr(record, name, chosen(which, new, old))


def some(which: Mask) -> bool:
    """Is a lane true."""
    return any(which)


def within(x: Any, limit: Any) -> Mask:
    """Where `-limit < x < limit`."""
    return Mask(_each(lambda a, b: -b < a < b, x, limit))


def spread(x: float) -> Lanes:
    """A number in every lane."""
    return Lanes([x] * WIDTH)


def packet(play: Any, k: int) -> Any:
    """The number of the message that is played at tick k, or -1; of each lane, where each has a link of its own."""
    return Eight(_each(lambda own: own[k], play)) if isinstance(play, Eight) else play[k]


def sample(path: Any, k: int) -> Any:
    """Where a path is at tick k; for each lane, where each has its own."""
    return Lanes(_each(lambda own: own[k], path)) if isinstance(path, Eight) else path[k]


def ago(k: int, lag: Any) -> Any:
    """The tick `lag` before k; below zero where there is none."""
    return Eight(_each(lambda own: k - own, lag)) if isinstance(lag, Eight) else k - lag


def records(things: Any) -> list[Record]:
    """The records among these things, and those that they consist of, each once."""
    found: dict[int, Record] = {}
    waiting = list(things)
    while waiting:
        each = waiting.pop()
        if isinstance(each, Record) and id(each) not in found:
            found[id(each)] = each
            waiting += vars(each).values()
        elif isinstance(each, tuple) and not isinstance(each, Eight):
            waiting += each
    return list(found.values())


def whole(number: Any) -> Any:
    """Whole numbers of lanes as lanes; one by itself as it is."""
    return Lanes(map(float, number)) if isinstance(number, Eight) else number


def ring(message: Any, rows: int) -> list[Any]:
    """Room for so many messages such as this one."""
    return [message] * rows


def sent(kept: list[Any], k: int, message: Any) -> None:
    """Keep a message under the number k."""
    kept[k % len(kept)] = message


def placed(kept: list[Any], at: Any, which: Any, message: Any) -> None:
    """Keep a message at place `at`, where `which` is true; of each lane, where each has its own."""
    if not isinstance(which, Mask):
        if which:
            kept[at % len(kept)] = message
        return
    for i in range(WIDTH):
        row = (at[i] if isinstance(at, Eight) else at) % len(kept)
        kept[row] = chosen(Mask([which[i] and n == i for n in range(WIDTH)]), message, kept[row])


def received(kept: list[Any], seq: Any, message: Any) -> Any:
    """The message of number `seq`, or the one there is if that is below zero; of each lane, where each has its own."""
    if not isinstance(seq, Eight):
        return kept[seq % len(kept)] if seq >= 0 else message
    if not isinstance(message, tuple) or isinstance(message, Eight):
        return Lanes([_lane(kept[one % len(kept)], i) if one >= 0 else _lane(message, i) for i, one in enumerate(seq)])
    made = [received([each[n] for each in kept], seq, own) for n, own in enumerate(message)]
    return tuple.__new__(type(message), made)


def _lane(value: Any, i: int) -> Any:
    return value[i] if isinstance(value, Eight) else value


def tell(out: list[Any], which: Mask, ran: int, told: tuple[Any, ...]) -> None:
    """Put the ticks that ran and the figures of these lanes in their places."""
    for i in range(WIDTH):
        if which[i]:
            out[i] = ran, tuple([_lane(each, i) for each in told])
