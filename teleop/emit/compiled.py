"""A printed end, compiled and beside Python: where a compiler is there."""

from __future__ import annotations

import struct
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from teleop.emit.compiler import find_compiler
from teleop.emit.files import FLAGS, Files, files
from teleop.emit.types import FLOAT
from teleop.emit.vectors import Vectors, run_vectors, vectors
from teleop.errors import Refused
from teleop.law import law_name
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene


def build(made: Files, folder: Path, compiler: str, flags: Sequence[str] = ("-O1",)) -> Path:
    """The program of check.c, its files and itself in `folder`. Raises `Refused` with what the compiler said."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in made.texts.items():
        (folder / name).write_text(text)
    code = next(name for name in made.texts if name.endswith(".c") and name != "check.c")
    done = subprocess.run([compiler, *FLAGS.split(), *flags, code, "check.c", "-lm", "-o", "check"], cwd=folder,
                          capture_output=True, text=True, check=False)
    if done.returncode:
        raise Refused(f"{code} does not compile: {done.stderr[:500]}")
    return folder / "check"


def differences(built: Path, rows: Vectors | None = None) -> str:
    """Text that a program of check.c prints, of its own rows or of these; "" where every bit is the same."""
    done = ran(built, rows)
    return "" if done.returncode == 0 else done.stdout or f"it ended with {done.returncode}: {done.stderr[:500]}"


def ran(built: Path, rows: Vectors | None = None) -> subprocess.CompletedProcess[str]:
    """Run a program of check.c on its own rows or on these."""
    words = [str(built)]
    if rows is not None:
        file = built.parent / "rows"
        file.write_bytes(b"".join([struct.pack(f"{len(row)}d", *row) for row in rows.rows]))
        words.append(str(file))
    return subprocess.run(words, capture_output=True, text=True, check=False)


def float_error(scene: Scene, e: str) -> str:
    """Sentence on how far the force of the scene's law is off in float over the canonical scene. Raises `Refused`."""
    compiler = find_compiler()
    if compiler is None:
        return "How far it is off over a run was not measured: there was no C compiler."
    canonical = "canonical" if scene.slave is not None else "virtual_wall"
    of = replace(load_scene(canonical), law=scene.laws[0])
    made = files(of, e, e, real=FLOAT)
    with TemporaryDirectory() as folder:
        done = ran(build(made, Path(folder), compiler), run_vectors(of, e, made.tick))
    if done.returncode:
        raise Refused(f"in float {law_name(of.law)} is too far from double over the {canonical} scene: "
                      f"{done.stdout.strip()}; leave --float out")
    return f"Over a run of the {canonical} scene: {done.stdout.strip()}."


def compare(scene: Scene, e: str, compiler: str | None, count: int = 1000) -> Iterator[str]:
    """Print an end, and say where it differs from Python, tame and with wild inputs. Raises `NotPrinted`."""
    made = files(scene, e, "hand" if scene.slave is None else e)
    if compiler is None:
        return
    with TemporaryDirectory() as folder:
        built = build(made, Path(folder), compiler)
        yield from filter(None, [differences(built), *[
            differences(built, vectors(scene, e, made.tick, count=count, seed=7, wild=wild, again=150))
            for wild in (0.0, 0.01)]])
