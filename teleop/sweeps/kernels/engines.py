"""The compiled engines: `scalar` runs one scene at a time, `vector` eight side by side over the whole horizon.

Eight scenes share their structure, their number of ticks and every whole number; each float has a lane for each of
them. Where they share their link's schedule and their hand's path too they are `alike`, and these are read once for all
eight; where not, they are `apart`.

The branches of a function become masks (`teleop.simulation.specialise`), and that is compiled over lanes. A function
with a loop is run lane by lane, compiled for one scene. Lines here cover every tick of a wall that stays in its mode;
lanes in which the mode changes go to the wall itself. A law with a loop has no lanes at all: see `NotVectorised`.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from inspect import signature
from math import inf, nan
from types import FunctionType
from typing import Any

from teleop.physics.contact import move_wall
from teleop.scene.scene import Scene
from teleop.simulation import masks
from teleop.simulation.bodies import Bodies
from teleop.simulation.felt import frame_of
from teleop.simulation.specialise import NotSpecialised, specialise
from teleop.simulation.structure import structure_of
from teleop.sweeps.kernels import lanes
from teleop.sweeps.kernels.compiled import CompiledEngine, cause, jit, jitted, module, part_at
from teleop.sweeps.kernels.figures import magnitude_of
from teleop.sweeps.kernels.functions import branches, without_lanes
from teleop.sweeps.kernels.kernel import Kernel, KernelOutput, NotVectorised, RowInputs, gives, leaves, tree_of
from teleop.sweeps.kernels.lanes import WIDTH, any_lane, broadcast, invert, lane, load, select, with_lane
from teleop.sweeps.kernels.rings import as_lanes, at, get, put, put_selected, ring, store, tile_of
from teleop.sweeps.kernels.tiles import Tile, call_kernel

__all__ = [
    "any_lane",
    "as_lanes",
    "at",
    "broadcast",
    "get",
    "invert",
    "lane_end",
    "lane_part",
    "load",
    "put",
    "put_selected",
    "ring",
    "select",
    "store",
    "tile_of",
]


def lane_part(place: str) -> Any:
    """Compile the part at "module:name" for lanes."""
    return _for_lanes(part_at(place))


def _for_lanes(part: Any) -> Any:
    if not isinstance(part, FunctionType):
        return part
    if part in WITHOUT_LOOPS:
        return WITHOUT_LOOPS[part]
    if without_lanes(part):
        return _lane_by_lane(part)
    return _masked(part) if branches(part) else jitted(part)


def lane_end(place: str) -> Any:
    """An end of a law at "module:name", for lanes: all of its results have lanes."""
    end = part_at(place)
    why = without_lanes(end)
    try:
        if not why:
            return _wrap("def call({0}): return broadcast(function({0}))", end, _for_lanes(end))
    except NotSpecialised as error:
        why = f"is not made of masks ({error})"
    raise NotVectorised(f"{end.__qualname__} {why}, so it runs one scene at a time")


def _masked(function: FunctionType) -> Any:
    """A function whose branches are masks, compiled over lanes."""
    made = specialise(function, engine="vector")
    names = {word: getattr(lanes, thing.__name__) if getattr(thing, "__module__", "") == masks.__name__
             else _for_lanes(thing) for word, thing in made.names.items()}
    exec(compile(ast.Module([made.tree], []), made.file, "exec"), names)
    return jit(names[function.__name__])


def _lane_by_lane(function: FunctionType) -> Any:
    return _wrap("def call({0}):\n"
                 "    told = broadcast(function({1}))\n"
                 "    for i in range(1, width):\n"
                 "        told = with_lane(told, i, function({2}))\n"
                 "    return told", function, jitted(function))


def _wrap(text: str, function: FunctionType, compiled: Any) -> Any:
    """A function of the same arguments as `function`, which is `compiled`."""
    words = list(signature(function).parameters)
    names = {"function": compiled, "broadcast": broadcast, "lane": lane, "with_lane": with_lane, "width": WIDTH}
    exec(text.format(", ".join(words), *[", ".join(f"lane({word}, {i})" for word in words) for i in ("0", "i")]), names)
    return jit(names["call"])


_many_axes = jitted(magnitude_of)


@jit
def _magnitude_of(*axes: Any) -> Any:
    return _many_axes(*broadcast(axes))  # its loop goes over the axes, not by their numbers


_one_wall = jitted(move_wall)


@jit
def _move_wall(c: Any, x: Any, v: Any, f: Any) -> Any:
    (side, at, k, d, s12, t1, s22, t2, a11, a12, b1, a21, a22, b2, gp, gu, gf, calm, _, _, _) = c
    p = side * (x - at)
    x1 = x + s12 * v + t1 * f
    v1 = s22 * v + t2 * f
    inside = p > 0.0
    done = (p < 0.0) & (side * (x1 - at) < 0.0) & ((side * v <= 0.0) | (side * v1 >= 0.0))
    if any_lane(inside):
        u = side * v
        w = side * f
        p1 = a11 * p + a12 * u + b1 * w
        u1 = a21 * p + a22 * u + b2 * w
        stays = (inside & (calm == 1.0) & (k * p + d * u > 0.0) & (k * p1 + d * u1 > 0.0) & (p1 > 0.0)
                 & ((gp * p + gu * u + gf * w >= 0.0) | (gp * p1 + gu * u1 + gf * w <= 0.0)))
        x1 = select(stays, at + side * p1, x1)
        v1 = select(stays, side * u1, v1)
        done = done | stays
    if not any_lane(~done):
        return x1, v1, 0
    sound = abs(p) + abs(v) + abs(f) < inf
    x1 = select(done | sound, x1, nan)  # what is not finite is lost
    left = ~done & sound
    if any_lane(left):
        for i in range(WIDTH):
            if lane(left, i):
                x_i, v_i, _ = _one_wall(lane(c, i), lane(x, i), lane(v, i), lane(f, i))
                x1 = with_lane(x1, i, x_i)
                v1 = with_lane(v1, i, v_i)
    return x1, v1, 0


WITHOUT_LOOPS: dict[Callable[..., Any], Any] = {
    move_wall: _move_wall, magnitude_of: _magnitude_of,
}


SCALAR = CompiledEngine(
    name="scalar", real="reals[base + {}]", width=1, part_maker=lambda _: "compiled_part",
    calls={"kernel": """\
        out[t * {row}], told = loop(given, law, dt, ticks, x_limit, start_m, start_s, (plays[2 * t], 0),
                                    (plays[2 * t + 1], 0), sizes[t], {one_path}, held,
                                    (lags[2 * t], lags[2 * t + 1], start, window, last))
        for i in range(len(told)):
            out[t * {row} + 1 + i] = told[i]"""},
)
VECTOR = CompiledEngine(
    name="vector", real=f"load(reals, base + {{}} * {WIDTH})", width=WIDTH,
    part_maker=lambda word: "lane_end" if word.startswith(("begin_", "law_", "total_")) else "lane_part",
    calls={
        "alike": """\
        loop(given, law, dt, ticks, x_limit, start_m, start_s, (plays[t * 2 * {width}], 0),
             (plays[(2 * t + 1) * {width}], 0), sizes[t], {one_path}, held,
             (lags[t * 2 * {width}], lags[(2 * t + 1) * {width}], out[t * {row}:(t + 1) * {row}],
              start, window, last))""",
        "apart": """\
        loop(given, law, dt, ticks, x_limit, start_m, start_s, (tile_of(plays, 2 * t), 0),
             (tile_of(plays, 2 * t + 1), 0), sizes[t], {own_paths}, held,
             (as_lanes(tile_of(lags, 2 * t)), as_lanes(tile_of(lags, 2 * t + 1)), out[t * {row}:(t + 1) * {row}],
              start, window, last))""",
    },
)


def scalar_kernel(scene: Scene, bodies: Bodies, measures: Sequence[str], *, keep: bool = True) -> Kernel:
    """The kernel of a scene's structure. Raises `NotCompiled` where a part of it is not made for that."""
    kernel = module(scene, bodies, measures, SCALAR, keep=keep).kernel
    names = gives(scene, measures)

    def run(rows: Sequence[RowInputs], lags: Sequence[tuple[int, int]]) -> list[KernelOutput]:
        return [one for one, in call_kernel(kernel, [[each] for each in zip(rows, lags, strict=True)], len(names))]

    return Kernel("scalar", tuple(measures), names, frame_of(scene), run)


def vector_kernel(scene: Scene, bodies: Bodies, measures: Sequence[str], *, keep: bool = True) -> Kernel:
    """The kernel of a scene's structure. Raises `NotVectorised` where that has no lanes, `NotCompiled` as `scalar`."""
    from numba.core.errors import NumbaError

    if structure_of(scene).m.has.inner or structure_of(scene).s.has.inner:
        raise NotVectorised("a body with an inner state is moved one scene at a time")
    if any(part.has.leaves_out and "compute_delay" in [stage.name for stage in part.stages]
           for part in (structure_of(scene).m, structure_of(scene).s)):
        raise NotVectorised("a computation delay at an end that leaves out ticks runs one scene at a time")
    if leaves(tree_of(scene, bodies)).arrays:
        raise NotVectorised("a part with a list among its numbers runs one scene at a time")
    kernels = module(scene, bodies, measures, VECTOR, keep=keep)
    names = gives(scene, measures)

    def run(rows: Sequence[RowInputs], lags: Sequence[tuple[int, int]]) -> list[KernelOutput]:
        tiles: dict[str, list[tuple[int, Tile]]] = {"alike": [], "apart": []}
        for first in range(0, len(rows), WIDTH):
            tile = list(zip(rows[first:first + WIDTH], lags[first:first + WIDTH], strict=True))
            one, lag = tile[0]
            alike = all(row.schedule is one.schedule and row.path is one.path and part == lag for row, part in tile)
            tile += [tile[-1]] * (WIDTH - len(tile))  # lanes without a row of their own repeat the last
            tiles["alike" if alike else "apart"].append((first, tile))
        results: dict[int, KernelOutput] = {}
        for name, several in tiles.items():
            if several:
                try:
                    outputs = call_kernel(getattr(kernels, name), [tile for _, tile in several], len(names))
                except NumbaError as error:  # compiled at the first call of its name
                    raise NotVectorised(f"rows of schedules of their own have no lanes: {cause(error)}") from error
                for (first, _), ones in zip(several, outputs, strict=True):
                    results |= enumerate(ones, first)
        return [results[i] for i in range(len(rows))]

    return Kernel("vector", tuple(measures), names, frame_of(scene), run, WIDTH)
