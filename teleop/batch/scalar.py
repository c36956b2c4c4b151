"""The engine `scalar`: a kernel compiled by numba that runs one scene at a call."""

from __future__ import annotations

from collections.abc import Sequence

from teleop.batch.compiled import module
from teleop.batch.kernel import Inputs, Kernel, Told
from teleop.batch.lanewise import came, where, whole
from teleop.batch.rings import ago, packet, power_of_two, received, ring, sample, sent
from teleop.bodies import Bodies
from teleop.scene import Scene

__all__ = ["ago", "came", "packet", "received", "ring", "sample", "sent", "where", "whole"]

FEATURES = frozenset({"compiled"})
REAL = "reals[{}]"
CALL = """\
    out[0], told = loop(given, law, dt, count, x_limit, start_m, start_s, play_m, play_s, size, ref, held, lag_x, lag_f)
    for i in range(len(told)):
        out[i + 1] = told[i]"""
SOURCES = ("teleop.batch.lanewise", "teleop.batch.rings", "teleop.batch.scalar")


def maker(word: str) -> str:  # noqa: ARG001 - every part is made alike
    """What makes the part called `word`."""
    return "compiled_part"


def scalar(scene: Scene, bodies: Bodies, measures: Sequence[str]) -> Kernel:
    """The kernel of a scene's structure. Raises `NotCompiled` where a part of it is not made for that."""
    import numpy as np

    loop = module(scene, bodies, measures, "scalar").kernel

    def run(rows: Sequence[Inputs], lags: Sequence[tuple[int, int]]) -> list[Told]:
        told = []
        for row, lag in zip(rows, lags, strict=True):
            out = np.empty(len(measures) + 2)
            assert row.flat is not None
            _, reals, wholes, arrays = row.flat
            forth, back = row.water.plays
            size = power_of_two(max(row.water.size, *lag))
            loop(np.array(reals), np.array(wholes, dtype=np.int64), tuple(arrays), row.ticks, back, forth, size,
                 row.path, *lag, out)
            told.append(Told(int(out[0]), tuple(out[1:].tolist())))
        return told

    return Kernel("scalar", tuple(measures), run)
