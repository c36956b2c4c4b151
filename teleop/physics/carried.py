"""An environment that is carried along a path: any plant, seen from the frame that moves with it.

The path is given at the ticks and straight in between, so within a tick the frame moves evenly and is as
good as the ground: with s its speed, y = x - r(t) and w = v - s,

    m x'' + b v = f - f_env     becomes     m y'' + b w = (f - b s) - f_env(y, w)

so the plant of the still environment moves the body exactly. Only the body's own damping b, which sees the
ground, is left over, as a force b s that is constant within the tick. Coulomb friction sees the ground as
well: a plant with friction is told s (see `teleop.physics.implicit.implicit_plant`). At a tick s may jump: position
and velocity of the body do not, and w does by as much as s.

The functions here take that of the still plant first, and a carried plant has them bound to it
(`teleop.physics.plant.bound`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from inspect import signature
from itertools import pairwise
from math import isfinite
from typing import Any, NamedTuple

from teleop.errors import Refused, number
from teleop.physics.path import Path, Speeds
from teleop.physics.plant import Force, MassDamper, Move, Plant, bound


class Carried(NamedTuple):
    """The coefficients of `move_carried` and `carried_force`."""

    c: Any  # of the still environment
    path: Any  # at the ticks 0 .. last, and the last place once more: a list, or a `Path`
    speeds: Any  # on the left of the ticks 0 .. last, and 0 once more: a list, or `Speeds`
    b: float
    last: int


def carried(plant: Plant, path: Sequence[float], body: MassDamper, dt: float) -> Plant:
    """`plant`, which is `body` in an environment that stays put, with that environment carried along `path`.

    `path` is where the environment is (m) at the ticks 0, 1, ..., added to the places that it has of its own:
    one entry more than there are ticks. Whoever goes on beyond finds the environment resting at the last one. A
    `teleop.physics.path.Path` is read as the body goes, and what is not finite in it comes out at its tick.

    `f_env` at a tick is the left limit, like all that is read there: the damper of an environment still feels
    the speed of the piece just ended. Before the first tick everything rests, so there that speed is 0,
    though a path may well begin with another.

    The inner state is (k, ...): the tick, then the inner state of `plant` if it has one. Refused: a path that
    is not finite, and a body with friction whose plant cannot be told the speed of what it touches.
    """
    number("dt", dt, above=0.0)
    slides = body.friction > 0.0
    if slides and len(signature(plant.move).parameters) < 6:
        raise Refused(f"a body with friction={body.friction:g} N is not followed in this environment while it moves: "
                      "friction is with the ground, not with what moves; write friction=0 or let it rest")
    if isinstance(path, Path):
        return _along(plant, Carried(plant.c, path, Speeds(path, dt), body.damping, len(path) - 1), slides)
    places = list(path)
    if set(map(type, places)) != {float} or not all(map(isfinite, places)):
        places = [number(f"the path at tick {k}", place, example="path=[0.0, 0.001]") for k, place in enumerate(places)]
    if not places:
        raise Refused("a path needs a place for each tick; write for example path=[0.0] for one that rests")
    speeds = [0.0, *[(end - begin) / dt for begin, end in pairwise(places)], 0.0]
    if not all(map(isfinite, speeds)):
        raise Refused(f"the path moves faster than numbers go in ticks of dt={dt:g} s; check its units: m")
    return _along(plant, Carried(plant.c, [*places, places[-1]], speeds, body.damping, len(places) - 1), slides)


def _along(plant: Plant, c: Carried, slides: bool) -> Plant:
    if plant.start is None:
        return Plant(bound(move_carried, plant.move), bound(carried_force, plant.force), tuple(c), (0,))
    report = None if plant.report is None else partial(_report, plant.report)
    move = move_carried_sliding if slides else move_carried_inner
    return Plant(bound(move, plant.move), bound(carried_force_inner, plant.force), tuple(c), (0, *plant.start), report)


def is_carried(plant: Plant) -> bool:
    """True if `carried` made this plant."""
    return getattr(plant.move, "func", None) in (move_carried, move_carried_inner, move_carried_sliding)


def at_rest(plant: Plant) -> Plant:
    """The plant that `carried` was given, but for its report."""
    move: Any = plant.move
    force: Any = plant.force
    return Plant(move.args[0], force.args[0], Carried(*plant.c).c, plant.start[1:] or None)


def _report(report: Any, z: tuple[Any, ...]) -> Mapping[str, float]:
    entries: Mapping[str, float] = report(z[1:])
    return entries


def move_carried(move: Move, c: tuple[Any, ...], x: float, v: float, f: float, z: tuple[int]
                 ) -> tuple[float, float, int, tuple[int]]:
    """Move a body over one tick beside an environment that moves and has no inner state; c is `Carried`."""
    still, path, speeds, b, last = c
    k = z[0] if z[0] < last else last
    s = speeds[k + 1]
    y, w, truncated = move(still, x - path[k], v - s, f - b * s)
    return path[k + 1] + y, s + w, truncated, (k + 1,)


def carried_force(force: Force, c: tuple[Any, ...], x: float, v: float, z: tuple[int]) -> float:
    """`f_env` of an environment that moves and has no inner state, as the left limit; c is `Carried`."""
    still, path, speeds, _, _ = c
    k = z[0]
    return force(still, x - path[k], v - speeds[k])


def move_carried_inner(move: Move, c: tuple[Any, ...], x: float, v: float, f: float, z: tuple[Any, ...]
                       ) -> tuple[float, float, int, tuple[Any, ...]]:
    """`move_carried` for an environment with an inner state, which is z without its first entry."""
    still, path, speeds, b, last = c
    k = z[0] if z[0] < last else last
    s = speeds[k + 1]
    y, w, truncated, inner = move(still, x - path[k], v - s, f - b * s, z[1:])
    return path[k + 1] + y, s + w, truncated, (k + 1, *inner)


def move_carried_sliding(move: Move, c: tuple[Any, ...], x: float, v: float, f: float, z: tuple[Any, ...]
                         ) -> tuple[float, float, int, tuple[Any, ...]]:
    """`move_carried_inner` for a body with friction, which the plant works out from the speed over the ground."""
    still, path, speeds, b, last = c
    k = z[0] if z[0] < last else last
    s = speeds[k + 1]
    y, w, truncated, inner = move(still, x - path[k], v - s, f - b * s, z[1:], s)
    return path[k + 1] + y, s + w, truncated, (k + 1, *inner)


def carried_force_inner(force: Force, c: tuple[Any, ...], x: float, v: float, z: tuple[Any, ...]) -> float:
    """`carried_force` for an environment with an inner state."""
    still, path, speeds, _, _ = c
    k = z[0]
    return force(still, x - path[k], v - speeds[k], z[1:])
