"""The parts of a kernel over lanes: the functions that a scene's text names, as eight scenes at once call them.

A function without a branch is compiled over lanes as it stands. One that branches is run lane by lane, compiled for one
scene, except where a few lines here say the same without branching; for a wall those cover every tick that stays in its
mode, and lanes in which the mode changes go to the wall itself. A law that branches has no lanes at all: see
`NotVectorised`.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature
from math import inf, nan
from types import FunctionType
from typing import Any

from llvmlite import ir

from teleop.physics.contact import move_wall, wall_force
from teleop.sweeps.kernels.bytecode import without_lanes
from teleop.sweeps.kernels.compiled import jit, jitted, part_at
from teleop.sweeps.kernels.kernel import NotVectorised
from teleop.sweeps.kernels.lanes import BITS, VECTOR, WIDTH, lanes
from teleop.sweeps.kernels.lanewise import intrinsic_of, lane, put, some, spread, where
from teleop.sweeps.kernels.measures import least, most, sound


def lane_part(place: str) -> Any:
    """What stands at "module:name", for lanes."""
    part = part_at(place)
    if not isinstance(part, FunctionType):
        return part
    if part in WITHOUT_BRANCHES:
        return WITHOUT_BRANCHES[part]
    return _lane_by_lane(part) if without_lanes(part) else jitted(part)


def lane_end(place: str) -> Any:
    """An end of a law at "module:name", for lanes: all that it answers with has lanes."""
    end = part_at(place)
    if why := without_lanes(end):
        raise NotVectorised(f"{end.__qualname__} {why}, so it runs one scene at a time")
    return _made("def call({0}): return spread(function({0}))", end)


def _lane_by_lane(function: FunctionType) -> Any:
    return _made("def call({0}):\n"
                 "    told = spread(function({1}))\n"
                 "    for i in range(1, width):\n"
                 "        told = put(told, i, function({2}))\n"
                 "    return told", function)


def _made(text: str, function: FunctionType) -> Any:
    """A function of the same arguments as `function`, compiled."""
    words = list(signature(function).parameters)
    names = {"function": jitted(function), "spread": spread, "lane": lane, "put": put, "width": WIDTH}
    exec(text.format(", ".join(words), *[", ".join(f"lane({word}, {i})" for word in words) for i in ("0", "i")]), names)
    return jit(names["call"])


@jit
def _most(top: Any, size: Any) -> Any:
    return where((size > top) | (size != size), size, top)  # noqa: PLR0124 - only NaN differs from itself


@jit
def _least(low: Any, size: Any) -> Any:
    return where((size < low) | (size != size), size, low)  # noqa: PLR0124


@jit
def _wall_force(c: Any, x: Any, v: Any) -> Any:
    p = c[0] * (x - c[1])
    g = c[2] * p + c[3] * c[0] * v
    return where((p <= 0.0) | (g <= 0.0), 0.0, c[0] * g)


@intrinsic_of
def _sound(typingctx: Any, numbers: Any) -> Any:  # noqa: ARG001
    """1.0 where all are finite, else 0.0."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        finite = ir.Constant(BITS, [1] * WIDTH)
        for i, kind in enumerate(numbers.types):
            number = context.cast(builder, builder.extract_value(args[0], i), kind, lanes)
            gone = builder.fsub(number, number)  # 0.0, or NaN of what is not finite
            finite = builder.and_(finite, builder.fcmp_ordered("==", gone, gone))
        return builder.uitofp(finite, VECTOR)

    return lanes(numbers), make


_one_wall = jitted(move_wall)


@jit
def _move_wall(c: Any, x: Any, v: Any, f: Any) -> Any:
    (side, at, k, d, s12, t1, s22, t2, a11, a12, b1, a21, a22, b2, gp, gu, gf, calm, _, _, _) = c
    p = side * (x - at)
    x1 = x + s12 * v + t1 * f
    v1 = s22 * v + t2 * f
    inside = p > 0.0
    done = (p < 0.0) & (side * (x1 - at) < 0.0) & ((side * v <= 0.0) | (side * v1 >= 0.0))
    if some(inside):
        u = side * v
        w = side * f
        p1 = a11 * p + a12 * u + b1 * w
        u1 = a21 * p + a22 * u + b2 * w
        stays = (inside & (calm == 1.0) & (k * p + d * u > 0.0) & (k * p1 + d * u1 > 0.0) & (p1 > 0.0)
                 & ((gp * p + gu * u + gf * w >= 0.0) | (gp * p1 + gu * u1 + gf * w <= 0.0)))
        x1 = where(stays, at + side * p1, x1)
        v1 = where(stays, side * u1, v1)
        done = done | stays
    if not some(~done):
        return x1, v1, 0
    sound = abs(p) + abs(v) + abs(f) < inf
    x1 = where(done | sound, x1, nan)  # what is not finite is lost
    left = ~done & sound
    if some(left):
        for i in range(WIDTH):
            if lane(left, i):
                x_i, v_i, _ = _one_wall(lane(c, i), lane(x, i), lane(v, i), lane(f, i))
                x1 = put(x1, i, x_i)
                v1 = put(v1, i, v_i)
    return x1, v1, 0



WITHOUT_BRANCHES: dict[Callable[..., Any], Any] = {
    move_wall: _move_wall, wall_force: _wall_force, most: _most, least: _least, sound: _sound,
}
