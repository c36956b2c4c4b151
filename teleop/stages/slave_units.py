"""Units and directions of the slave's axes in those of the master, as a scene's scaling and frame have them.

What both mean is in `teleop.stages.scaling`, loaded where a scene has one; this is what every run asks.
"""

from __future__ import annotations

from typing import Any


def scales(scene: Any) -> tuple[tuple[float, float], ...]:
    """(scale_x, scale_f) of each axis of a scene, with the size of its frame; (1.0, 1.0) where it scales nothing."""
    pairs = tuple([(1.0, 1.0) if each is None else (each.scale_x, each.scale_f) for each in scene.per_axis("scaling")])
    if scene.frame is None or scene.frame.scale == 1.0:
        return pairs
    size = scene.frame.scale
    return tuple([pair if i in scene.turning else (pair[0] * size, pair[1] / size) for i, pair in enumerate(pairs)])


def transpose(m: tuple[float, ...]) -> tuple[float, ...]:
    """The entries of a matrix, column by column: of a rotation those of the way back."""
    return (*m[::3], *m[1::3], *m[2::3])


def turn(m: tuple[float, ...], firsts: tuple[int, ...], values: Any) -> list[Any]:
    """Values of axes, each three from these on turned by the matrix: numbers, or columns of a trace."""
    out = [*values]
    for i in firsts:
        x, y, z = values[i:i + 3]
        out[i:i + 3] = [m[n] * x + m[n + 1] * y + m[n + 2] * z for n in (0, 3, 6)]
    return out


def places_of_slave(scene: Any, places: Any) -> list[Any]:
    """Places of the slave, one for each axis, in the master's metres and directions."""
    scaled = [x / scale_x for x, (scale_x, _) in zip(places, scales(scene), strict=True)]
    frame = scene.frame
    return scaled if frame is None else turn(transpose(frame.matrix), frame.triples(scene), scaled)
