"""The axes of a scene: how many, their names and units, and its parts axis by axis.

An axis moves along a line, in m under a force in N, or turns, in rad under a torque in N m. Each number of a scene is
in the units of its axis: where it turns, a mass is a moment of inertia in kg m^2, a damping is in N m s/rad, a
stiffness in N m/rad, and a force cap is in N m. Work is in J on every axis, so energies add up over both kinds.

A document (`summary.json`, the header of a live record) has the keys `axis_names` and `axis_units` where the scene
gives its axes names or units; without them the axes are called as in `axis_names`, and are in m.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from teleop.errors import Refused, WrongCount, enumerated, number_of
from teleop.storage.strict_json import Check, list_of, one_of, text

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
    if name in ("master", "slave") and len({getattr(each, "inner", False) for each in parts}) > 1:
        raise Refused(f"the {name} is a position servo on some axes and not on others; make it one on each, or on none")
    if name in ("device_m", "device_s"):
        has = {(each.encoder is None, type(each.velocity), each.every, each.delay) for each in parts}
        if len(has) > 1:
            raise Refused(f"the parts of {name} differ in more than numbers; give each axis an encoder or none, one "
                          "kind of velocity estimator, and the same every and delay")
    if name == "cap" and len({getattr(each, "power", None) for each in parts}) > 1:
        raise Refused("the power of a cap is that of all axes of an end together; give the cap of each axis the same "
                      "power, or none")


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


SHAPES: dict[str, Check] = {"axis_names": list_of(text, most=MOST_AXES),
                            "axis_units": list_of(one_of(*FORCE_UNIT), most=MOST_AXES)}
TURNING = {"m": "rad", "m/s": "rad/s", "N": "N m", "N/s": "N m/s", "N/m": "N m/rad", "N s/m": "N m s/rad",
           "kg": "kg m^2"}  # the unit of a quantity along an axis that turns, by that along a line


_LONGEST_FIRST = "|".join(sorted(map(re.escape, TURNING), key=len, reverse=True))
_BEHIND = re.compile(rf"(?<=\d )([unmkMG]?)({_LONGEST_FIRST})(?![\w/])")  # a number, with the prefix of the unit


class AxisLabels(NamedTuple):
    """Names and units as a scene gives them; empty: it gives none."""

    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()

    def names_for(self, axes: int) -> tuple[str, ...]:
        """The names of the axes of a record that has so many."""
        return axis_names(self.names if len(self.names) == axes else (), axes)

    def units_for(self, axes: int) -> tuple[str, ...]:
        """The unit of the position, m or rad, of each of so many axes."""
        return self.units if len(self.units) == axes else ("m",) * axes

    def unit(self, unit: str) -> str:
        """A unit of a figure over all axes, by that along a line; empty where some axes turn and others do not.

        >>> AxisLabels(units=("rad", "rad")).unit("N"), AxisLabels().unit("N"), AxisLabels(units=("m", "rad")).unit("s")
        ('N m', 'N', 's')
        """
        units = {unit_on(unit, each) for each in self.units or ("m",)}
        return units.pop() if len(units) == 1 else ""

    def document(self) -> dict[str, list[str]]:
        """The keys of a document; none where the scene gives neither names nor units."""
        return {key: list(labels) for key, labels in zip(SHAPES, self, strict=True) if labels}


def labels_of(scene: Any) -> AxisLabels:
    """The labels that a scene gives its axes."""
    return AxisLabels(scene.names, scene.axis_units if scene.rotations else scene.units)


def labels_in(document: Mapping[str, Any]) -> AxisLabels:
    """The labels in a document whose shape was checked by `SHAPES`."""
    return AxisLabels(*[tuple(document.get(key) or ()) for key in SHAPES])


def told_along(text: str, axis: str) -> str:
    """A sentence on an axis in m or rad, which was written for one along a line: its units behind numbers.

    >>> told_along("with 0.04 kg and 0.2 N s/m after 5 ms, 3 mm of way", "rad")
    'with 0.04 kg m^2 and 0.2 N m s/rad after 5 ms, 3 mrad of way'
    """
    return _BEHIND.sub(lambda match: match[1] + TURNING[match[2]], text) if axis == "rad" else text


def unit_on(unit: str, axis: str) -> str:
    """The unit of a quantity on an axis in m or rad, by that along a line.

    >>> unit_on("N/m", "rad"), unit_on("N/m", "m"), unit_on("J", "rad")
    ('N m/rad', 'N/m', 'J')
    """
    return TURNING.get(unit, unit) if axis == "rad" else unit

