"""Bodies by name: how a person writes which integrator moves them, as `semi_implicit_euler:40`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from teleop.errors import Refused, nearest, number_of
from teleop.simulation.bodies import Bodies, exact_bodies
from teleop.simulation.integrators.methods import METHODS, IntegrationMethod
from teleop.simulation.integrators.stepped import method_bodies

if TYPE_CHECKING:
    from teleop.scene.scene import Scene

EXACT = "exact"
FORM = "METHOD:N with N sub-steps a tick, for example semi_implicit_euler:40, or exact"
MOST_SUBSTEPS = 1_000_000  # of a tick; more is a slip of the keyboard


def bodies_of(scene: Scene, text: str) -> Bodies:
    """The bodies of `scene` as `text` says: `exact` for its own, or `METHOD:N` for a method of `METHODS`.

    A method goes by its name, or by a beginning of it that no other has, a hyphen for an underscore. Raises `Refused`,
    also where the method does not go with these bodies.
    """
    if text == EXACT:
        return exact_bodies(scene)
    name, colon, count = text.partition(":")
    method = _method(name, text)
    if not colon or not (count.isascii() and count.isdecimal()) or not 1 <= int(count) <= MOST_SUBSTEPS:
        raise Refused(f"bodies={text} does not say how many sub-steps a tick has, 1 to {MOST_SUBSTEPS}; write for "
                      f"example {method.name}:40")
    if any(isinstance(getattr(scene, name), tuple) for name in ("master", "slave", "hand")):
        raise Refused(f"bodies={text} moves bodies that are the same on every axis, and scene {scene.name} has some "
                      "for each; leave bodies out, which moves them exactly, or take a scene with one for all axes")
    return method_bodies(scene, method, int(count))


def _method(name: str, text: str) -> IntegrationMethod:
    wanted = name.replace("-", "_")
    found = [m for m in METHODS if m.name == wanted] or [m for m in METHODS if wanted and m.name.startswith(wanted)]
    if len(found) == 1:
        return found[0]
    raise Refused(f"bodies={text} names no integrator; write {FORM}; {nearest(wanted, [m.name for m in METHODS])}")


def told(bodies: Bodies) -> list[str]:
    """The note on a run whose bodies did not move by the scene's own steps."""
    if not bodies.method:
        return []
    name, _, count = bodies.method.partition(":")
    label = next(m.label for m in METHODS if m.name == name)
    return [f"the bodies moved by {label}, {number_of(int(count), 'sub-step')} a tick, in place of the exact steps: "
            f"the figures have the error of that method"]
