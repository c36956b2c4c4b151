"""Functions as the compiler sees them: a digest of all they depend on, and the limits of their instructions.

The digest changes with an edit anywhere below a function.

A function is its code, its defaults, and all that it names around it: functions and classes and what those name, what
it takes from modules, and constants of any kind. The code is that in memory: a file may have been edited since.
What belongs to Python itself, numpy or numba goes by its version.
"""

from __future__ import annotations

import dis
import sys
from collections.abc import Iterable, Iterator
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

from teleop.storage.files import read_bytes

VERSIONED = frozenset({*sys.stdlib_module_names, "numpy", "numba", "llvmlite"}) - {"__main__"}


def digest(texts: Iterable[str]) -> str:
    """A short name for these texts."""
    return sha256(repr(list(texts)).encode()).hexdigest()[:20]


def sources(parts: Iterable[Any]) -> list[str]:
    """The texts that these parts depend on."""
    seen: set[int] = set()
    return [text for part in parts for text in _texts(part, seen)]


def constants(parts: Iterable[Any]) -> list[str]:
    """Texts of the parts that are not source: constants that may change while a process runs."""
    seen: set[int] = set()
    return [text for part in parts for text in _texts(part, seen, source=False)]


def file_digest(path: Path) -> str:
    """Digest of a file."""
    return sha256(read_bytes(path)).hexdigest()[:20]


def named_in(function: FunctionType) -> dict[str, Any]:
    """Globals that a function and the functions within it name."""
    return {name: function.__globals__[name] for name in _names(function.__code__) if name in function.__globals__}


@lru_cache(maxsize=1024)
def _names(code: CodeType) -> tuple[str, ...]:
    inner = [name for each in code.co_consts if isinstance(each, CodeType) for name in _names(each)]
    return tuple(dict.fromkeys([*code.co_names, *inner]))


def _texts(part: Any, seen: set[int], *, source: bool = True, names: tuple[str, ...] = ()) -> Iterator[str]:
    """Texts of one part; of a module, of its members with these names."""
    part = getattr(part, "py_func", part)  # of one that is compiled already
    if isinstance(part, ModuleType):
        if part.__name__.partition(".")[0] not in VERSIONED:
            for name in names:
                if name in vars(part):
                    yield from _texts(vars(part)[name], seen, source=source, names=names)
    elif isinstance(part, FunctionType | type):
        if id(part) in seen or (part.__module__ or "").partition(".")[0] in VERSIONED:
            return
        seen.add(id(part))
        if isinstance(part, FunctionType):
            yield from _of_function(part, seen, source)
        else:
            yield from _of_class(part, seen, source)
    elif hasattr(part, "tobytes"):  # of numpy
        yield f"{part.dtype}{part.shape}{part.tobytes()!r}"
    elif not callable(part):
        yield repr(part)


def _of_function(part: FunctionType, seen: set[int], source: bool) -> Iterator[str]:
    if source:
        yield _code(part.__code__)
    yield repr((part.__defaults__, part.__kwdefaults__))
    names = _names(part.__code__)
    for thing in named_in(part).values():
        yield from _texts(thing, seen, source=source, names=names)


def _of_class(part: type, seen: set[int], source: bool) -> Iterator[str]:
    yield part.__qualname__
    for base in part.__bases__:
        yield from _texts(base, seen, source=source)
    for name, thing in vars(part).items():
        if isinstance(thing, FunctionType) and not name.startswith("__"):
            yield from _texts(thing, seen, source=source)
        elif isinstance(thing, bool | int | float | str | tuple) and not name.startswith("__"):
            yield f"{name}={thing!r}"


@lru_cache(maxsize=4096)
def _code(code: CodeType) -> str:
    inner = [_code(each) if isinstance(each, CodeType) else sorted(map(repr, each)) if isinstance(each, frozenset)
             else repr(each) for each in code.co_consts]
    return repr((code.co_code, inner, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars))


COMPREHENDS = ("LIST_APPEND", "SET_ADD", "MAP_ADD")  # from Python 3.12 on in the function's own loop, no function
MAKES_LISTS = ("BUILD_LIST", "BUILD_SET", "BUILD_MAP", "LIST_EXTEND", "SET_UPDATE")
COMPREHENSION = "makes a function of its own or a comprehension"
EXACT = frozenset(("sqrt", "fabs"))  # of math: what lanes have too


def unlike_python(function: FunctionType) -> str | None:
    """Name an instruction of the function that means something else in compiled code; none if there is none."""
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
    """Name a part of the function that eight scenes side by side cannot run; none if there is none."""
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
