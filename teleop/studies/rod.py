"""The rigid rod: what a scene would come to if a massless rigid rod stood in place of law and link.

Master and slave are one body then, gripped by the hand and touching what the slave touches; nothing can track better
or feel more alike. Its motion and its force are the measures that a law's are compared with. The hand's spring and
damper act on the body as forces that are held for one tick; the rest of its motion is the scene's own exact step.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from teleop.physics.plant import MassDamper
from teleop.scene.axes import scales
from teleop.scene.scene import Scene
from teleop.simulation.bodies import reference_samples, slave_plants


class RodMotion(NamedTuple):
    """The rod along one axis at every tick: position (m), velocity (m/s), force on the environment (N)."""

    start: float  # m
    x: list[float]
    v: list[float]
    f_env: list[float]


def rod_motion(scene: Scene) -> list[RodMotion]:
    """The motion of the rod along each axis; none where no hand moves a slave, and where the scene scales."""
    paths = reference_samples(scene)
    if paths is None or scene.slave is None or set(scales(scene)) != {(1.0, 1.0)}:
        return []
    dt = scene.dt_ns / 1e9
    ends = list(zip(*[scene.per_axis(name) for name in ("master", "slave", "hand")], strict=True))
    bodies = [MassDamper(mass=master.mass + slave.mass + (0.0 if hand is None else hand.mass),
                         damping=master.damping + slave.damping, friction=master.friction + slave.friction)
              for master, slave, hand in ends]
    one = replace(scene, slave=bodies[0] if all(body == bodies[0] for body in bodies) else tuple(bodies))
    found = []
    for plant, path, start, (_, _, hand) in zip(
            slave_plants(one), paths, scene.vector("start_m", scene.start_m), ends, strict=True):
        x, v = start, 0.0
        inner = () if plant.start is None else (plant.start,)
        motion = RodMotion(start, [], [], [])
        for k in range(scene.ticks):
            motion.x.append(x)
            motion.v.append(v)
            motion.f_env.append(plant.force(plant.c, x, v, *inner))
            push = 0.0 if hand is None else hand.k * (path[k] - x) + hand.d * ((path[k + 1] - path[k]) / dt - v)
            x, v, _, *inner = plant.move(plant.c, x, v, push, *inner)  # type: ignore[assignment]  # z or nothing
        found.append(motion)
    return found
