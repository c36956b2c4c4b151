"""The rigid rod: what a scene would come to if a massless rigid rod stood in place of law and link.

Master and slave are one body then, gripped by the hand and touching what the slave touches; nothing can track better
or feel more alike. Its motion and its force are the measures that a law's are compared with. The hand's spring and
damper act on the body as forces that are held for one tick; the rest of its motion is the scene's own exact step.
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt
from typing import NamedTuple

from teleop.errors import Refused
from teleop.physics.plant import MassDamper
from teleop.scene.scene import Scene
from teleop.simulation.bodies import reference_samples, slave_plants
from teleop.simulation.metrics import END
from teleop.simulation.rest import still


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
    if scene.scaling is not None and (scene.scaling.scale_x, scene.scaling.scale_f) != (1.0, 1.0):
        raise Refused(f"scene {scene.name} scales the slave's motion or force, and a law is tuned against a rigid rod "
                      "between hand and slave, which does not; leave scale_x and scale_f out")
    hand, dt = scene.hand, scene.dt_ns / 1e9
    one = replace(scene, slave=MassDamper(
        mass=hand.mass + scene.master.mass + scene.slave.mass, damping=scene.master.damping + scene.slave.damping,
        friction=scene.master.friction + scene.slave.friction))
    way = force = fastest = 0.0
    ends = []
    last = scene.ticks - max(1, round(END / dt))
    for plant, samples, start in zip(slave_plants(one), path, scene.vector("start_m", scene.start_m), strict=True):
        x, v, late = start, 0.0, 0.0
        inner = () if plant.start is None else (plant.start,)
        for k in range(scene.ticks):
            f_env = plant.force(plant.c, x, v, *inner)
            way += (x - start) * (x - start)
            force += f_env * f_env
            late += f_env * (k >= last)
            fastest = max(fastest, abs(v))
            push = hand.k * (samples[k] - x) + hand.d * ((samples[k + 1] - samples[k]) / dt - v)
            x, v, _, *inner = plant.move(plant.c, x, v, push, *inner)  # type: ignore[assignment]  # z or nothing
        ends.append(late / (scene.ticks - last))
    moved, pressed = sqrt(way / scene.ticks), sqrt(force / scene.ticks)
    if not moved > 0.0:
        raise Refused(f"the hand of scene {scene.name} moves nothing, so no law tracks better than another; take a "
                      "scene with a motion, for example hard_wall")
    held = sqrt(sum([each * each for each in ends]))
    steady = held if still(scene, path) is not None and held > 1e-3 * hand.k * moved else None
    scale = steady or (pressed if pressed > 1e-3 * hand.k * moved else hand.k * moved)
    return Rod(moved, pressed, steady, scale, fastest)
