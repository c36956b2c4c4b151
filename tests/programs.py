"""Programs that tests start and that are not this Python: each is declared by its name, and may be missing.

`program` is the only way to one (`tests/test_house.py` refuses any other). A test that uses it has the marker `program`
by itself, so `pytest -m program` runs all of these, for example with a PATH that has none of the programs.
"""

from __future__ import annotations

import shutil
import sys
from functools import cache
from pathlib import Path

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
COMPILERS = ("cc", "gcc", "clang")


def program(*names: str | Path) -> str:
    """Return the path of the first of these programs that is on this machine; skip the test where none is.

    A `Path` is a program that a test has built.
    """
    path = next(filter(None, map(shutil.which, names)), None)
    if path is None:
        pytest.skip(f"needs {' or '.join(map(str, names))}, which this machine does not have")
    return str(path)


def compiler_of(engine: str | None) -> None:
    """Skip the test where this machine has no compiler for an engine of a sweep; None is the one that it chooses."""
    if engine not in ("plain", None):
        program(*COMPILERS)


def uses_programs(item: pytest.Item) -> bool:
    """True if the module of a test, or of one of its fixtures, can start a program."""
    fixtures = getattr(item, "_fixtureinfo").name2fixturedefs.values()  # noqa: B009 - pytest has no public way to them
    modules = {definition.func.__module__ for definitions in fixtures for definition in definitions}
    return any(_starts(name) for name in modules | {getattr(item, "module").__name__})  # noqa: B009


@cache
def _starts(name: str) -> bool:
    return _reaches(name, set())


def _reaches(name: str, seen: set[str]) -> bool:
    """True if the module of this name is this one, or has something of it by way of other modules of the tests."""
    if name == __name__ or not name.startswith("tests.") or name in seen:
        return name == __name__
    seen.add(name)
    parts = (getattr(part, "__module__", None) for part in vars(sys.modules[name]).values())
    return any(_reaches(part, seen) for part in parts if isinstance(part, str))
