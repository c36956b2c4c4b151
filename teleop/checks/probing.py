"""Probes of `check_law`: situations in a fixed sequence, extremes among them, and calls of a law's methods in these.

The contract itself, with its sentences, is `teleop.law.contract`; a probe asks for it in situations in which a run
may come, and reports the arguments.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import inf, nan
from typing import Any

from teleop.law import At
from teleop.law.contract import REMEMBER, LawMistake, Method, in_bits

AWKWARD = (0.0, -0.0, 1e-300, -1e-300, 5e-324, 1e50, -1e50)
BEYOND = (inf, -inf, nan, 1e300, -1e300)  # the last tick of a run that diverges
REACHES = ((), (), AWKWARD, AWKWARD, AWKWARD + BEYOND)  # of the probing runs: extremes beside the usual numbers
TICKS = 60  # of each probing run


def answer(method: Method, *arguments: Any, kinds: Mapping[str, type] | None = None, finite: bool = True) -> Any:
    """The method's answer for `arguments`, judged by the contract with every number a float; `Refused` otherwise."""
    try:
        got = method.call(*arguments)
        method.judge(arguments, got, kinds, exact=True, finite=finite)
    except LawMistake as mistake:
        raise LawMistake(f"{mistake} (given {', '.join(map(repr, arguments))})") from None
    return got


def ask_again(method: Method, arguments: tuple[Any, ...], bits: str) -> None:
    """Refuse a method whose answer to the same arguments, `bits` as `in_bits` has it, is another one now."""
    if in_bits(method.call(*arguments)) != bits:
        raise method.refuse(arguments, f"answers the same arguments differently the second time; {REMEMBER}")


def unseen(method: Method, field: str) -> LawMistake:
    """The refusal of a method that reads a field of `At` that its own lines do not name."""
    return LawMistake(f"{method.label}{method.first_line()} reads {field} where it cannot be seen; write at.{field} in "
                   f"{method.label} itself or in a plain function that it calls by name")


def check_blind_start(start: Method, end: Method, at: At, seen: frozenset[str], bits: str) -> None:
    """Refuse a start that reads `f` although its end does not: a force that no end reads is not measured."""
    if "f" not in seen and in_bits(start.call(without(at, "f"))) != bits:
        raise start.refuse((at,), f"reads f, but {end.label} does not, so it is not measured; start without it")


def without(at: At, field: str) -> At:
    """`at` with one field made to show: NaN, or for `fresh` the opposite."""
    changed: Mapping[str, Any] = {"fresh": not at.fresh} if field == "fresh" else {field: nan}
    return at._replace(**changed)


def value(dice: Iterator[float], reach: tuple[float, ...]) -> float:
    """One of `reach`, or a number of either sign between 1e-4 and 10."""
    if reach and next(dice) < 0.5:
        return reach[int(next(dice) * len(reach))]
    size: float = 10.0 ** (5.0 * next(dice) - 4.0)
    return size if next(dice) < 0.5 else -size


def situation(dice: Iterator[float], reach: tuple[float, ...]) -> At:
    """A situation in SI units: numbers as `value` draws them; tick, span, age and gain within their own bounds."""
    x, v, f, f_held, dx = (value(dice, reach) for _ in range(5))
    age = (inf, 0.0, 1e-3, 0.05, 1e5)[int(next(dice) * 5)]
    fresh, dt = next(dice) < 0.5, (1e-3, 1e-3, 1e-6, 10.0)[int(next(dice) * 4)]
    ticks, gain = (1, 1, 2, 100)[int(next(dice) * 4)], (1.0, 1.0, 0.0, next(dice))[int(next(dice) * 4)]
    return At(x, v, f, f_held, dx, fresh, age, dt, ticks * dt, gain)
