"""The engine `vector`: a kernel compiled by numba that runs eight scenes side by side over the whole horizon.

The eight share their structure, their number of ticks and every whole number; each float has a lane for each of them.
Where they share their link's schedule and their hand's path too they are `alike`, and these are read once for all
eight; where not, they are `apart`.
"""

from __future__ import annotations

from collections.abc import Sequence

from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies
from teleop.simulation.felt import frame_of
from teleop.simulation.structure import structure_of
from teleop.sweeps.kernels.calls import Tile, called
from teleop.sweeps.kernels.compiled import cause, module
from teleop.sweeps.kernels.kernel import Inputs, Kernel, KernelOutput, NotVectorised, gives, tree_of
from teleop.sweeps.kernels.lane_parts import lane_end, lane_part
from teleop.sweeps.kernels.lanes import WIDTH
from teleop.sweeps.kernels.lanewise import any_lane, broadcast, invert, load, select
from teleop.sweeps.kernels.leaves import leaves
from teleop.sweeps.kernels.rings import as_lanes, at, each, get, put, put_selected, ring, store

__all__ = ["WIDTH", "any_lane", "as_lanes", "at", "broadcast", "each", "get", "invert", "lane_end", "lane_part", "load",
           "put", "put_selected", "ring", "select", "store"]

REAL = f"load(reals, base + {{}} * {WIDTH})"
CALLS = {
    "alike": """\
        loop(given, law, dt, ticks, x_limit, start_m, start_s, (plays[t * 2 * {width}], 0),
             (plays[(2 * t + 1) * {width}], 0), sizes[t], {one_path}, held,
             (lags[t * 2 * {width}], lags[(2 * t + 1) * {width}], out[t * {row}:(t + 1) * {row}],
              start, window, last))""",
    "apart": """\
        loop(given, law, dt, ticks, x_limit, start_m, start_s, (each(plays, 2 * t), 0), (each(plays, 2 * t + 1), 0),
             sizes[t], {own_paths}, held,
             (as_lanes(each(lags, 2 * t)), as_lanes(each(lags, 2 * t + 1)), out[t * {row}:(t + 1) * {row}],
              start, window, last))""",
}
SOURCES = (*[f"teleop.sweeps.kernels.{name}" for name in (
    "lanes", "lanewise", "rings", "lane_parts", "bytecode", "vector")],
    "teleop.simulation.expressions", "teleop.simulation.specialise")
OF_THE_LAW = ("begin_", "law_", "total_")


def maker(word: str) -> str:
    """What makes the part called `word`."""
    return "lane_end" if word.startswith(OF_THE_LAW) else "lane_part"


def vector(scene: Scene, bodies: Bodies, measures: Sequence[str], *, keep: bool = True) -> Kernel:
    """The kernel of a scene's structure. Raises `NotVectorised` where that has no lanes, `NotCompiled` as `scalar`."""
    from numba.core.errors import NumbaError

    if structure_of(scene).m.has.inner or structure_of(scene).s.has.inner:
        raise NotVectorised("a body with an inner state is moved one scene at a time")
    if any(own.has.leaves_out and "compute_delay" in [stage.name for stage in own.stages]
           for own in (structure_of(scene).m, structure_of(scene).s)):
        raise NotVectorised("a computation delay at an end that leaves out ticks runs one scene at a time")
    if leaves(tree_of(scene, bodies)).arrays:
        raise NotVectorised("a part with a list among its numbers runs one scene at a time")
    kernels = module(scene, bodies, measures, "vector", keep=keep)
    given = gives(scene, measures)

    def run(rows: Sequence[Inputs], lags: Sequence[tuple[int, int]]) -> list[KernelOutput]:
        tiles: dict[str, list[tuple[int, Tile]]] = {"alike": [], "apart": []}
        for first in range(0, len(rows), WIDTH):
            tile = list(zip(rows[first:first + WIDTH], lags[first:first + WIDTH], strict=True))
            one, lag = tile[0]
            alike = all(row.schedule is one.schedule and row.path is one.path and own == lag for row, own in tile)
            tile += [tile[-1]] * (WIDTH - len(tile))  # lanes without a row of their own repeat the last
            tiles["alike" if alike else "apart"].append((first, tile))
        found: dict[int, KernelOutput] = {}
        for name, several in tiles.items():
            if several:
                try:
                    told = called(getattr(kernels, name), [tile for _, tile in several], len(given))
                except NumbaError as error:  # compiled at the first call of its name
                    raise NotVectorised(f"rows of schedules of their own have no lanes: {cause(error)}") from error
                for (first, _), ones in zip(several, told, strict=True):
                    found |= enumerate(ones, first)
        return [found[i] for i in range(len(rows))]

    return Kernel("vector", tuple(measures), given, frame_of(scene), run, WIDTH)
