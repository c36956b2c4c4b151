"""Printed ends, compiled with every warning an error, beside Python at more ticks than check.c has."""

from __future__ import annotations

import struct
import subprocess
from pathlib import Path

from teleop.emit.files import FLAGS, Files, files
from teleop.emit.vectors import Vectors, vectors
from teleop.scene.scene import Scene
from tests.programs import COMPILERS, program


def compiled(made: Files, folder: Path, *flags: str) -> Path:
    """The program of check.c; the test is skipped where there is no compiler."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in made.texts.items():
        (folder / name).write_text(text)
    code = next(name for name in made.texts if name.endswith(".c") and name != "check.c")
    words = [program(*COMPILERS), *FLAGS.split(), *flags, code, "check.c", "-lm", "-o", "check"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:2000]
    return folder / "check"


def differences(built: Path, rows: Vectors | None = None) -> str:
    """What a program of check.c prints, of its own rows or of these; "" where every bit is the same."""
    words = [program(built)]
    if rows is not None:
        file = built.parent / "rows"
        file.write_bytes(b"".join([struct.pack(f"{len(row)}d", *row) for row in rows.rows]))
        words.append(str(file))
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr
    assert (done.returncode == 1) == ("all bits" not in done.stdout)
    return done.stdout * done.returncode


def assert_same(scene: Scene, e: str, folder: Path, *, count: int = 1000, again: int = 150) -> Files:
    """Hold a printed end to Python: its own 500 ticks, and `count` tame and wild ones."""
    made = files(scene, e, "hand" if scene.slave is None else e)
    built = compiled(made, folder, "-O1")
    assert differences(built) == ""
    for wild in (0.0, 0.01):
        rows = vectors(scene, e, made.tick, count=count, seed=7, wild=wild, again=again)
        assert differences(built, rows) == "", f"{scene.name} {e}, wild {wild}"
    return made
