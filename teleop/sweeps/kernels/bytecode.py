"""What a function's own instructions say of whether it can be compiled, and over lanes.

A plain function that it calls counts as its own.
"""

from __future__ import annotations

import dis
from collections.abc import Iterator
from types import CodeType, FunctionType

from teleop.sweeps.kernels.digest import named_in

COMPREHENDS = ("LIST_APPEND", "SET_ADD", "MAP_ADD")  # from Python 3.12 on in the function's own loop, no function
MAKES_LISTS = ("BUILD_LIST", "BUILD_SET", "BUILD_MAP", "LIST_EXTEND", "SET_UPDATE")
COMPREHENSION = "makes a function of its own or a comprehension"
EXACT = frozenset(("sqrt", "fabs"))  # of math: what lanes have too


def unlike_python(function: FunctionType) -> str | None:
    """What compiled code works out otherwise than Python, if the function has it."""
    for each in _all(function):
        before = None
        for now in dis.get_instructions(each.__code__):
            power = now.opname == "BINARY_POWER" or (now.opname == "BINARY_OP" and now.argrepr in ("**", "**="))
            if power and before is not None and before.opname == "LOAD_CONST" and isinstance(before.argval, int):
                return "`**` with a whole number, which rounds otherwise where it is compiled; write x*x"
            if now.opname == "UNARY_INVERT":
                return "`~`, which means something else of a truth where it is compiled; write `not`"
            before = now
    return None


def branches(function: FunctionType) -> bool:
    """True if the function branches on a number, or has a loop."""
    return any("_IF_" in now.opname or now.opname == "FOR_ITER"
               for each in _all(function) for now in dis.get_instructions(each.__code__))


def without_lanes(function: FunctionType) -> str | None:
    """What of a function eight scenes side by side cannot do, if it has it."""
    for each in _all(function):
        names = {now.opname for now in dis.get_instructions(each.__code__)}
        if "FOR_ITER" in names and names.intersection(COMPREHENDS):
            return COMPREHENSION
    if any(now.opname == "FOR_ITER" or "JUMP_BACKWARD" in now.opname
           for each in _all(function) for now in dis.get_instructions(each.__code__)):
        return "has a loop"
    for each in _all(function):
        if any(isinstance(part, CodeType) for part in each.__code__.co_consts):
            return COMPREHENSION
        if any(now.opname in MAKES_LISTS for now in dis.get_instructions(each.__code__)):
            return "makes a list"
        if odd := sorted(name for name, thing in named_in(each).items()
                         if getattr(thing, "__module__", None) == "math" and name not in EXACT):
            return f"uses {odd[0]}"
    return None


def _all(function: FunctionType, seen: set[int] | None = None) -> Iterator[FunctionType]:
    """The function and the plain ones that it calls."""
    seen = set() if seen is None else seen
    if id(function) not in seen:
        seen.add(id(function))
        yield function
        for each in named_in(function).values():
            if isinstance(each, FunctionType):
                yield from _all(each, seen)
