"""Axis of a scene as a scene of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from teleop.scene.axes import PER_AXIS
from teleop.scene.parts import Hand, Reference
from teleop.scene.scene import Scene


def on_axis(scene: Scene, i: int) -> Scene:
    """The scene of one axis alone, that with index i, with its own parts, its name and its unit.

    Its hand follows the reference of that axis. What couples the axes of the scene is not in it.
    """
    if scene.axes == 1:
        return scene
    parts: dict[str, Any] = {name: scene.per_axis(name)[i] for name in PER_AXIS if getattr(scene, name) is not None}
    if parts.get("hand") is not None:
        parts["hand"] = OwnGrip(parts["hand"], OneAxis(scene.reference, scene.axes, i))  # type: ignore[arg-type]  # there is one
    for name in ("start_m", "start_s"):
        parts[name] = scene.vector(name, getattr(scene, name))[i]
    return replace(scene, axes=1, rotations=(), names=(scene.axis_names[i],), units=(scene.axis_units[i],),
                   packet_size=None, **parts)


class OneAxis:
    """A reference of several axes along one of them, the one with index i."""

    def __init__(self, reference: Reference, axes: int, i: int) -> None:
        self.reference, self.axes, self.i = reference, axes, i

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[Sequence[float], ...]:
        """The position of that axis at the ticks 0 .. count-1, in m or rad; `axes` is 1."""
        return (self.reference.samples(self.axes, count, dt_ns)[self.i],)


class OwnGrip:
    """A hand's mass, stiffness and damping with another reference."""

    def __init__(self, hand: Hand, reference: Reference) -> None:
        self.mass, self.k, self.d, self.reference = hand.mass, hand.k, hand.d, reference
