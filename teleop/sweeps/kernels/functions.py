"""Functions as a compiler sees them: a digest of all that they depend on.

The digest changes with an edit anywhere below a function.

A function is its code, its defaults, and all that it names around it: functions and classes and what those name, what
it takes from modules, and constants of any kind. The code is that in memory: a file may have been edited since.
What belongs to Python itself and numpy goes by its version.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

from teleop.storage.files import read_bytes

VERSIONED = frozenset({*sys.stdlib_module_names, "numpy"}) - {"__main__"}


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
