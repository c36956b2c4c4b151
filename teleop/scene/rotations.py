"""The rotations of a scene: three successive axes each, on which a law's positions stand for an orientation.

    Scene(axes=6, names=("x", "y", "z", "rx", "ry", "rz"), rotations=(3,), ...)

is a rigid body, of which x, y and z are in m and the rotation, on the axes 3, 4 and 5, is about those three directions
in rad: its coordinates are integrals of the angular velocity, its forces are torques in N m. What an end makes of it is
`teleop.stages.orientation`. In simulation a master and a slave have the same moment of inertia about each direction,
since bodies move axis by axis: one that differs would be gyroscopic. The same law on all three axes is what gives the
torque of a coupling a potential.
"""

from __future__ import annotations

from typing import Any

from teleop.errors import Refused, number_of
from teleop.kind import positions
from teleop.law import law_name, messages, reads, start_at
from teleop.scene.axes import axis_names

BODY = "one moment of inertia and damping"
ALIKE = {"law": "one law", "master": BODY, "slave": BODY, "scaling": "one scale of each kind"}


def check_rotations(scene: Any) -> None:
    """Refuse a scene whose rotations are not three axes each, whose law has no orientation, or whose parts differ."""
    firsts = scene.rotations
    whole = isinstance(firsts, tuple) and all(type(each) is int for each in firsts)
    if not whole or any(b < a + 3 for a, b in zip((-3, *firsts), (*firsts, scene.axes), strict=True)):
        raise Refused(f"rotations={firsts!r} must be the index of the first axis of each rotation, in order, with "
                      f"three axes for each, and the scene has {number_of(scene.axes, 'axis', 'axes')}; write for "
                      "example axes=6, rotations=(3,)")
    if scene.slave is None:
        raise Refused("a scene without a slave has no rotations, since its law renders on each axis by itself; leave "
                      "them out, or write for example slave=MassDamper(mass=0.002)")
    if why := without_orientation(scene.laws[0]):
        raise Refused(f"law {law_name(scene.laws[0])} does not run on the axes of a rotation: {why}; take for example "
                      "law=pp or law=wave, or leave rotations out")
    for first in firsts:
        names = axis_names(scene.names, scene.axes)[first:first + 3]
        if any(unit != "rad" for unit in scene.axis_units[first:first + 3]):
            raise Refused(f"the axes {', '.join(names)} are those of a rotation, and their unit is rad, not "
                          f"{', '.join(scene.axis_units[first:first + 3])}; leave units out, or write rad for them")
        for part, one in ALIKE.items():
            parts = scene.per_axis(part)[first:first + 3]
            if any(each != parts[0] for each in parts):
                raise Refused(f"the axes {', '.join(names)} are those of a rotation, which has {one} for all three, "
                              f"and the {part} of one differs; give the three the same {part}")


def without_orientation(law: Any) -> str:
    """Why a law with two ends does not run on the axes of a rotation; empty if it does."""
    kind_of_law: Any = type(law)
    while kind_of_law is not None:
        for each in (vars(kind_of_law).get("stage"), kind_of_law):
            if why := getattr(each, "no_rotation", ""):
                return str(why)
        kind_of_law = vars(kind_of_law).get("inner_law")
    still = start_at(0.0, 0.0, 0.0, 1e-3)
    types = [*messages(law), *[type(getattr(law, f"{e}_start")(still)[0]) for e in ("master", "slave")]]
    if any(positions(each) for each in types if hasattr(each, "_fields")):
        return ""
    if "x" in reads(law.master) | reads(law.slave):
        return "it reads positions, and declares none of its messages or its state as one, as x: kind.Position does"
    return ""
