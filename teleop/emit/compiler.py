"""The C compiler of this machine; it needs no other file of the package, so that `teleop doctor` can name it."""

from __future__ import annotations

import shutil

COMPILERS = ("cc", "gcc", "clang")


def find_compiler() -> str | None:
    """The path of a C compiler; None where there is none."""
    return next(filter(None, map(shutil.which, COMPILERS)), None)
