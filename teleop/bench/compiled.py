"""The C programs of the benches (`c/*.c`), made where they are needed: what Python is measured beside, or against."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

SOURCES = Path(__file__).with_name("c")


def compiled(name: str, folder: Path) -> str | None:
    """The program of `c/<name>.c`, made in `folder`; None without a C compiler."""
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    program = str(folder / name)
    subprocess.run([compiler, "-O2", "-o", program, str(SOURCES / f"{name}.c")], check=True)
    return program
