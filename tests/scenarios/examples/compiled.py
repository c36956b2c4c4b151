"""The programs of `scenarios/examples/c`, compiled with every warning an error and watched for what C lets pass."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from teleop.__main__ import main
from teleop.scene.library import ROOT
from tests.programs import COMPILERS, program

HERE = ROOT / "scenarios" / "examples" / "c"
STRICT = ["-std=c11", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-g"]
WATCHED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


def compiled(name: str, folder: Path, whole: Path | None = None, *, end: tuple[str, ...] = ()) -> Path:
    """The program of `name`.c, or of the file `whole` that includes those it is of, below `folder`.

    `end`: what `teleop emit` is typed with, of the end that it is for. The test is skipped where there is no compiler.
    """
    compiler = program(*COMPILERS)
    built = folder / name
    sources = [str(HERE / each) for each in ("wire.c", f"{name}.c")] if whole is None else [f"-I{HERE}", str(whole)]
    if end:
        assert main(["emit", *end, "--out", str(folder / "printed"), "--json"]) == 0
        code = next(each for each in (folder / "printed").glob("*.c") if each.name != "check.c")
        sources += [f"-DEND={code.stem}", f"-I{HERE}", f"-I{code.parent}", str(code)]
    why = ""
    for flags in (WATCHED, []):  # not every compiler comes with the libraries that watch
        done = subprocess.run([compiler, *STRICT, *flags, *sources, "-lm", "-o", str(built)],
                              capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return built
        why = done.stderr
    pytest.fail(f"{name}.c does not compile: {why}")
