"""The rigid rod of `teleop.studies.rod` in figures: the measures that a law's own are compared with."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from teleop.errors import Refused
from teleop.scene.axes import PER_AXIS, scales
from teleop.scene.scene import Scene
from teleop.simulation.bodies import reference_samples
from teleop.simulation.felt import END
from teleop.simulation.rest import still
from teleop.studies.rod import rod_motion


class Rod(NamedTuple):
    """What the rod does. SI units."""

    moved: float  # m, rms of its way from where it starts, over the run
    pressed: float  # N, rms of its force on the environment
    steady: float | None  # N, of that force at the end, where the hand comes to stand against something; else None
    scale: float  # N, the force that the drag is compared with
    fastest: float  # m/s, its greatest speed


def rod(scene: Scene) -> Rod:
    """Move the rod through the scene. Raises `Refused` for a scene in which no hand moves two ends."""
    path = reference_samples(scene)
    if scene.slave is None or scene.hand is None or path is None:
        raise Refused(f"scene {scene.name} has no hand that moves a slave, so there is nothing to tune a law by; take "
                      "another, for example hard_wall or free_motion")
    if any(isinstance(getattr(scene, name), tuple) for name in PER_AXIS if name != "environment"):
        raise Refused(f"the axes of scene {scene.name} have parts of their own, and a search turns one number for each "
                      "knob of a law; tune the law in a scene of one axis, for example --scene hard_wall with "
                      "the numbers of that axis")
    if set(scales(scene)) != {(1.0, 1.0)}:
        raise Refused(f"scene {scene.name} scales the slave's motion or force, and a law is tuned against a rigid rod "
                      "between hand and slave, which does not; leave scale_x and scale_f out")
    hand = scene.hand
    way = force = fastest = 0.0
    ends = []
    last = max(1, round(END * 1e9 / scene.dt_ns))
    for motion in rod_motion(scene):
        for x, v, f_env in zip(motion.x, motion.v, motion.f_env, strict=True):
            way += (x - motion.start) * (x - motion.start)
            force += f_env * f_env
            fastest = max(fastest, abs(v))
        ends.append(sum(motion.f_env[-last:]) / last)
    moved, pressed = sqrt(way / scene.ticks), sqrt(force / scene.ticks)
    if not moved > 0.0:
        raise Refused(f"the hand of scene {scene.name} moves nothing, so no law tracks better than another; take a "
                      "scene with a motion, for example hard_wall")
    held = sqrt(sum([each * each for each in ends]))
    steady = held if still(scene, path) is not None and held > 1e-3 * hand.k * moved else None
    scale = steady or (pressed if pressed > 1e-3 * hand.k * moved else hand.k * moved)
    return Rod(moved, pressed, steady, scale, fastest)
