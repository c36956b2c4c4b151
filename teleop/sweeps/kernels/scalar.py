"""The engine `scalar`: a kernel compiled by numba that runs one scene at a time."""

from __future__ import annotations

from collections.abc import Sequence

from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies
from teleop.simulation.felt import frame_of
from teleop.sweeps.kernels.calls import called
from teleop.sweeps.kernels.compiled import module
from teleop.sweeps.kernels.kernel import Inputs, Kernel, KernelOutput, gives
from teleop.sweeps.kernels.rings import at, get, put, ring

__all__ = ["at", "get", "put", "ring"]

REAL = "reals[base + {}]"
WIDTH = 1
CALLS = {"kernel": """\
        out[t * {row}], told = loop(given, law, dt, ticks, x_limit, start_m, start_s, (plays[2 * t], 0),
                                    (plays[2 * t + 1], 0), sizes[t], {one_path}, held,
                                    (lags[2 * t], lags[2 * t + 1], start, window, last))
        for i in range(len(told)):
            out[t * {row} + 1 + i] = told[i]"""}
SOURCES = ("teleop.sweeps.kernels.lanewise", "teleop.sweeps.kernels.rings", "teleop.sweeps.kernels.scalar")


def maker(word: str) -> str:  # noqa: ARG001 - every part is made alike
    """What makes the part called `word`."""
    return "compiled_part"


def scalar(scene: Scene, bodies: Bodies, measures: Sequence[str], *, keep: bool = True) -> Kernel:
    """The kernel of a scene's structure. Raises `NotCompiled` where a part of it is not made for that."""
    kernel = module(scene, bodies, measures, "scalar", keep=keep).kernel
    told = gives(scene, measures)

    def run(rows: Sequence[Inputs], lags: Sequence[tuple[int, int]]) -> list[KernelOutput]:
        return [one for one, in called(kernel, [[each] for each in zip(rows, lags, strict=True)], len(told))]

    return Kernel("scalar", tuple(measures), told, frame_of(scene), run)
