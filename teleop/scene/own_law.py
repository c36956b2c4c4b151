"""Laws in files of the user's own: `FILE.py:CLASS`, or `FILE.py` where the file has one law."""

from __future__ import annotations

from functools import lru_cache
from os import stat
from pathlib import Path
from typing import Any

from teleop.errors import Refused, enumerated, nearest
from teleop.laws.around.names import law_text
from teleop.scene.library import own_module
from teleop.scene.parts import SHAPES

_TWO_ENDS, _ONE_PORT = SHAPES["law"][0], SHAPES["one-port law"][0]
_HINT = "law=FILE.py names a file with a law of your own, law=FILE.py:CLASS one of several in it"


def file_named(text: str) -> str:
    """The file in the text that names a law, with stages around it or numbers in brackets; empty if it names none.

    >>> file_named("law_mine.py:Mine"), file_named("law_mine.py"), file_named("wave")
    ('law_mine.py', 'law_mine.py', '')
    >>> file_named("deadband(0.1) | law_mine.py:Mine(K=3.0)")
    'law_mine.py'
    """
    if ".py" not in text:
        return ""
    try:
        return _parted(law_text(text).law)[0]
    except Refused:  # whatever it is, it names a file
        return _parted(text)[0] or text


def file_law(text: str) -> type[Any]:
    """The class of the law that `FILE.py:CLASS` or `FILE.py` names. Raises `Refused`."""
    try:
        at = stat(file_named(text))
    except OSError:
        return _load_law(text, None)  # which says so
    return _load_law(text, (at.st_dev, at.st_ino, at.st_size, at.st_mtime_ns))


def laws_in(file: str) -> dict[str, type[Any]]:
    """The laws that a file defines, its classes with the methods of a law, by name. Raises `Refused`."""
    module = own_module(Path(file), "a law", _HINT)
    return {name: thing for name, thing in vars(module).items()
            if isinstance(thing, type) and thing.__module__ == module.__name__ and not _lacks(thing)}


@lru_cache(maxsize=64)  # a sweep asks for each row
def _load_law(text: str, _: tuple[int, ...] | None) -> type[Any]:
    file, name = _parted(text)
    laws = laws_in(file)
    if not name and len(laws) == 1:
        return next(iter(laws.values()))
    if not name and laws:
        raise Refused(f"{file} has {len(laws)} laws; write {enumerated([f'law={file}:{each}' for each in laws], 'or')}")
    if not name:
        raise Refused(f"{file} has no law: a class with the methods {enumerated(_TWO_ENDS)}, or "
                      f"{enumerated(_ONE_PORT)} where the scene has no slave; README.md has one under \"Write a law\"")
    law = getattr(own_module(Path(file), "a law", _HINT), name, None)
    if law is None:
        hint = nearest(name, laws) if laws else "it has no law"
        raise Refused(f"{file} has no class {name!r}; {hint}")
    if not isinstance(law, type) or (lacks := _lacks(law)):
        why = f"it has no {enumerated(lacks)}" if isinstance(law, type) else "it is no class"
        raise Refused(f"{name} in {file} is no law: {why}; there are: {', '.join(laws) or 'no laws'}")
    return law


def _parted(text: str) -> tuple[str, str]:
    """File and class; without a file of this name two empty texts."""
    file, _, name = text.rpartition(":")
    if file.endswith(".py"):
        return file, name
    return (text, "") if text.endswith(".py") else ("", "")


def _lacks(kind: type) -> list[str]:
    """The methods that a class has not, of those of the kind of law that it is nearer to."""
    two_ends, one_port = ([each for each in shape if not hasattr(kind, each)] for shape in (_TWO_ENDS, _ONE_PORT))
    return one_port if len(one_port) < len(_ONE_PORT) and not len(two_ends) < len(_TWO_ENDS) else two_ends
