"""The axes of a scene: how many, their names and units, and its parts axis by axis.

An axis moves along a line, in m under a force in N, or turns, in rad under a torque in N m. Each number of a scene is
in the units of its axis: where it turns, a mass is a moment of inertia in kg m^2, a damping is in N m s/rad, a
stiffness in N m/rad, and a force cap is in N m. Work is in J on every axis, so energies add up over both kinds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from teleop.errors import Refused, WrongCount, enumerated, number_of

MOST_AXES = 16
PER_AXIS = ("law", "master", "slave", "hand", "environment", "cap", "device_m", "device_s", "scaling")
FORCE_UNIT = {"m": "N", "rad": "N m"}  # of an axis, by the unit of its position
NOTHING = ("hand", "environment", "cap")  # parts that an axis may do without while others have one
_LETTERS = ("x", "y", "z")


def axis_names(names: tuple[str, ...], axes: int) -> tuple[str, ...]:
    """The names of the axes of a scene: those that it gives; else x, y, z, and of more than three axis1, axis2, ...

    >>> axis_names((), 2), axis_names((), 4)
    (('x', 'y'), ('axis1', 'axis2', 'axis3', 'axis4'))
    """
    return names or (_LETTERS[:axes] if axes <= len(_LETTERS) else tuple([f"axis{i + 1}" for i in range(axes)]))


def check_names(names: tuple[str, ...], units: tuple[str, ...], axes: int) -> None:
    """Refuse names and units that are not one for each axis, names that are none or twice there, and other units."""
    for what, texts, example in (("names", names, '("shoulder", "elbow")'), ("units", units, '("rad", "rad")')):
        if not isinstance(texts, tuple) or not all(isinstance(each, str) for each in texts):
            raise Refused(f"{what} must be a tuple of texts, one for each axis, not {texts!r}; write for example "
                          f"{what}={example}")
        if texts and len(texts) != axes:
            raise Refused(f"{what} has {number_of(len(texts), 'entry', 'entries')}, the scene has "
                          f"{number_of(axes, 'axis', 'axes')}; write one for each axis, or leave {what} out")
    for name in names:
        if not name.isidentifier() or len(name) > 32:
            raise Refused(f"an axis is named by at most 32 letters, digits and _, not beginning with a digit, and "
                          f"{name!r} is none; write for example names=(\"shoulder\", \"elbow\")")
        if names.count(name) > 1:
            raise Refused(f"two axes have the name {name}; give each another one")
    for unit in units:
        if unit not in FORCE_UNIT:
            raise Refused(f"the unit of an axis is m or rad, not {unit!r}; write for example units=(\"m\", \"rad\")")


def parts_by_axis(name: str, parts: Any, axes: int) -> tuple[Any, ...]:
    """The part of each axis, of a part of the scene or a tuple with one for each.

    One environment alone is on the first axis, and any other part alone is on every axis. Raises `Refused`.
    """
    if not isinstance(parts, tuple):
        return (parts, *[None] * (axes - 1)) if name == "environment" else (parts,) * axes
    if len(parts) != axes:
        nothing = {
            "environment": "; write None for an axis that touches nothing",
            "law": "; write one number for all axes, or one for each, as law.K=300,200,100 for three",
        }.get(name, "; write one part for all axes, or one for each")
        raise Refused(f"{name} names {number_of(len(parts), 'axis', 'axes')}, the scene has {axes}{nothing}")
    if name not in NOTHING and None in parts:
        raise Refused(f"{name} is None on the axis with index {parts.index(None)}; give each axis its own {name}")
    return parts


def distinct(parts: tuple[Any, ...]) -> list[Any]:
    """The parts, each once: most axes share one."""
    return list({id(part): part for part in parts}.values())


def check_alike(name: str, parts: tuple[Any, ...]) -> None:
    """Refuse parts of different kinds where a run has one kind for all axes, and differs in their numbers alone."""
    if name == "law" and len(kinds := {type(each).__name__ for each in parts}) > 1:
        raise Refused("the laws of the axes are of one class, with numbers of their own, not "
                      f"{enumerated(sorted(kinds))}; write for example law=(Wave(b=2.0), Wave(b=1.0))")
    if name in ("device_m", "device_s"):
        has = {(each.encoder is None, type(each.velocity), each.every, each.delay) for each in parts}
        if len(has) > 1:
            raise Refused(f"the parts of {name} differ in more than numbers; give each axis an encoder or none, one "
                          "kind of velocity estimator, and the same every and delay")
    if name == "cap" and len({getattr(each, "power", None) for each in parts}) > 1:
        raise Refused("the power of a cap is that of all axes of an end together; give the cap of each axis the same "
                      "power, or none")


def scales(scene: Any) -> tuple[tuple[float, float], ...]:
    """(scale_x, scale_f) of each axis of a scene, see `teleop.stages.scaling`; (1.0, 1.0) where it scales nothing."""
    return tuple([(1.0, 1.0) if each is None else (each.scale_x, each.scale_f) for each in scene.per_axis("scaling")])


def each_axis(make: Callable[..., Any], axes: int, **numbers: Any) -> Any:
    """Make a part of these numbers: one for each axis where a number is a tuple, else one for all axes.

    A tuple has one number for each axis. Raises `Refused` if it has more or fewer.

    >>> from teleop import MassDamper
    >>> [each.mass for each in each_axis(MassDamper, 2, mass=(0.5, 0.2), damping=0.1)]
    [0.5, 0.2]
    """
    for name, value in numbers.items():
        if isinstance(value, tuple) and len(value) != axes:
            raise WrongCount(name, value, axes)
    if not any(isinstance(value, tuple) for value in numbers.values()):
        return make(**numbers)
    return tuple([make(**{name: value[i] if isinstance(value, tuple) else value for name, value in numbers.items()})
                  for i in range(axes)])
