"""Printed ends, compiled with every warning an error, beside Python; a test is skipped where there is no compiler."""

from __future__ import annotations

from pathlib import Path

from teleop.emit.compiled import build, differences
from teleop.emit.files import Files, files
from teleop.emit.vectors import vectors
from teleop.scene.scene import Scene
from tests.programs import COMPILERS, program

__all__ = ["assert_same", "compiled", "differences", "limited"]


def limited(x: float, low: float = -1.0, high: float = 1.0) -> float:
    """A helper of laws that returns early, and whose arguments have names and defaults."""
    if x < low:
        return low
    return high if x > high else x


def compiled(made: Files, folder: Path, *flags: str) -> Path:
    """The program of check.c."""
    return build(made, folder, program(*COMPILERS), flags)


def assert_same(scene: Scene, e: str, folder: Path, *, count: int = 1000, again: int = 150) -> Files:
    """Hold a printed end to Python: its own 500 ticks, and `count` tame and wild ones."""
    made = files(scene, e, "hand" if scene.slave is None else e)
    built = compiled(made, folder, "-O1")
    assert differences(built) == ""
    for wild in (0.0, 0.01):
        rows = vectors(scene, e, made.tick, count=count, seed=7, wild=wild, again=again)
        assert differences(built, rows) == "", f"{scene.name} {e}, wild {wild}"
    return made
