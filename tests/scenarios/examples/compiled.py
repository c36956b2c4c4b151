"""The programs of `scenarios/examples/c`, compiled with every warning an error and watched for what C lets pass."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from teleop.scene.library import ROOT

HERE = ROOT / "scenarios" / "examples" / "c"
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
STRICT = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-g"]
WATCHED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


def compiled(name: str, folder: Path) -> Path:
    """The program of `name`.c, below `folder`; the test is skipped where there is no compiler."""
    if COMPILER is None:
        pytest.skip("there is no C compiler")
    program, sources = folder / name, [str(HERE / each) for each in ("wire.c", f"{name}.c")]
    why = ""
    for flags in (WATCHED, []):  # not every compiler comes with the libraries that watch
        done = subprocess.run([COMPILER, *STRICT, *flags, *sources, "-lm", "-o", str(program)], capture_output=True,
                              text=True, check=False)
        if done.returncode == 0:
            return program
        why = done.stderr
    pytest.fail(f"{name}.c does not compile: {why}")
