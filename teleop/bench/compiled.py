"""The C programs of the benches (`c/*.c`), made where they are needed: what Python is measured beside, or against."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

SOURCES = Path(__file__).with_name("c")


def compiled(name: str, folder: Path) -> str | None:
    """The program of `c/<name>.c`, made in `folder`; None where it cannot be made: `reason` says why."""
    compiler = _compiler()
    if compiler is None or not SOURCES.is_dir():
        return None
    program = str(folder / name)
    subprocess.run([compiler, "-O2", "-o", program, str(SOURCES / f"{name}.c")], check=True)
    return program


def reason() -> str:
    """The reason for which `compiled` makes no program here."""
    return "no C compiler here" if _compiler() is None else "its C program is in the repository alone"


def _compiler() -> str | None:
    return os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
