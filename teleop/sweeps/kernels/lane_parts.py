"""The parts of a kernel over lanes: the functions that a scene's text names, as eight scenes at once call them.

The branches of a function become masks (`teleop.simulation.specialise`), and that is compiled over lanes. One with a
loop is run lane by lane, compiled for one scene; of a wall, lines here cover every tick that stays in its mode, and
lanes in which the mode changes go to the wall itself. A law with a loop has no lanes at all: see `NotVectorised`.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from inspect import signature
from math import inf, nan
from types import FunctionType
from typing import Any

from teleop.physics.contact import move_wall
from teleop.simulation import masks
from teleop.simulation.specialise import NotSpecialised, specialise
from teleop.sweeps.kernels import lanewise
from teleop.sweeps.kernels.bytecode import branches, without_lanes
from teleop.sweeps.kernels.compiled import jit, jitted, part_at
from teleop.sweeps.kernels.kernel import NotVectorised
from teleop.sweeps.kernels.lanes import WIDTH
from teleop.sweeps.kernels.lanewise import any_lane, broadcast, lane, select, with_lane
from teleop.sweeps.kernels.measures import magnitude_of


def lane_part(place: str) -> Any:
    """What stands at "module:name", for lanes."""
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
    """An end of a law at "module:name", for lanes: all that it answers with has lanes."""
    end = part_at(place)
    why = without_lanes(end)
    try:
        if not why:
            return _made("def call({0}): return broadcast(function({0}))", end, _for_lanes(end))
    except NotSpecialised as error:
        why = f"is not made of masks ({error})"
    raise NotVectorised(f"{end.__qualname__} {why}, so it runs one scene at a time")


def _masked(function: FunctionType) -> Any:
    """A function whose branches are masks, compiled over lanes."""
    made = specialise(function, engine="vector")
    names = {word: getattr(lanewise, thing.__name__) if getattr(thing, "__module__", "") == masks.__name__
             else _for_lanes(thing) for word, thing in made.names.items()}
    exec(compile(ast.Module([made.tree], []), made.file, "exec"), names)
    return jit(names[function.__name__])


def _lane_by_lane(function: FunctionType) -> Any:
    return _made("def call({0}):\n"
                 "    told = broadcast(function({1}))\n"
                 "    for i in range(1, width):\n"
                 "        told = with_lane(told, i, function({2}))\n"
                 "    return told", function, jitted(function))


def _made(text: str, function: FunctionType, compiled: Any) -> Any:
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
