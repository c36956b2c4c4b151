"""A scene of several axes as the scenes of its axes: which of them are alike, and when an analysis may part them.

Axes touch each other only through a law that sums over them (`master_sums`, `slave_sums`). Without one, the loop of the
scene is that of each axis beside the others: its roots are theirs together.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

from teleop.analysis.models.linear import with_linear_law
from teleop.errors import Refused, nearest
from teleop.law import law_name
from teleop.scene.axes import PER_AXIS
from teleop.scene.scene import Scene, on_axis


class Alike(NamedTuple):
    """Axes with the same loop: the scene of the first of them, and the names of all."""

    scene: Scene
    names: tuple[str, ...]


def couples(scene: Scene) -> bool:
    """True if axes go together: a frame turns them, or the law, or the linear one for it, sums over them."""
    law = with_linear_law(scene).laws[0]
    sums = any(hasattr(law, f"{end}_sums") for end in ("master", "slave"))
    return scene.axes > 1 and (sums or scene.frame is not None)


def alike(scene: Scene) -> list[Alike]:
    """The axes of a scene, those together whose parts are equal; a hand counts by what it is and not by its motion."""
    groups: list[tuple[tuple[Any, ...], int, list[str]]] = []
    every = {name: scene.per_axis(name) for name in PER_AXIS}
    for i, name in enumerate(scene.axis_names):
        parts = tuple([_grip(every[part][i]) if part == "hand" else every[part][i] for part in PER_AXIS])
        same = next((names for others, _, names in groups if others == parts), None)
        if same is None:
            groups.append((parts, i, [name]))
        else:
            same.append(name)
    return [Alike(replace(on_axis(scene, i), name=scene.name), tuple(names)) for _, i, names in groups]


def coupling_law(scene: Scene) -> str:
    """In words why the axes of a scene go together."""
    if scene.frame is not None:
        return "the frame turns three axes together"
    return f"law {law_name(scene.laws[0])} sums over the axes"


def _grip(hand: Any) -> tuple[float, float, float] | None:
    return None if hand is None else (hand.mass, hand.k, hand.d)


def along(scene: Scene, name: str | None) -> Scene:
    """The scene along the axis that is called so, by itself; `name` left out: the scene as it is. Raises `Refused`."""
    if name is None:
        return scene
    if name not in scene.axis_names:
        raise Refused(f"scene {scene.name} has no axis {name!r}; {nearest(name, scene.axis_names)}")
    if couples(scene):
        raise Refused(f"{coupling_law(scene)} of scene {scene.name}, so none of them is judged by itself; leave --axis "
                      "out, or " + ("leave the frame out" if scene.frame is not None else
                                    "take a law that does not, for example --set law=wave"))
    return replace(on_axis(scene, scene.axis_names.index(name)), name=scene.name)


def one_loop(scene: Scene) -> Scene:
    """The scene, whose axes have the same bodies, hand, law and device, so that one stands for all; else `Refused`."""
    if own_parts(scene):
        raise Refused(f"the axes of scene {scene.name} have parts of their own, and this is asked of one loop; name "
                      f"its axis, --axis {scene.axis_names[0]}, or from Python take on_axis(scene, 0)")
    return scene


def own_parts(scene: Scene) -> bool:
    """True if axes have parts of their own beside what they touch."""
    return any(isinstance(getattr(scene, name), tuple) for name in PER_AXIS if name != "environment")
