"""The rigid baseline: how a scene would run with a massless rigid rod in place of law and link.

Master and slave are one body then, gripped by the hand and touching what the slave touches; nothing can track better
or feel more alike. Its motion and its force are the measures that a law's are compared with. The hand's spring and
damper act on the body as forces that are held for one tick; the rest of its motion is the scene's own exact step.

A law may track well because its drag keeps the hand off the wall: the force on the wall is then a small part of the
baseline's. One that hardly reflects the wall lets the hand press harder than the baseline does.
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.errors import Refused
from teleop.physics.plant import MassDamper
from teleop.scene.axes import PER_AXIS
from teleop.scene.scene import Scene
from teleop.simulation.bodies import reference_samples, slave_plants
from teleop.simulation.felt import END
from teleop.simulation.rest import still
from teleop.stages.slave_units import scales

LATE = 0.5  # the share of a run, from its end, that counts as late: the hand is in contact then


class BaselineMotion(NamedTuple):
    """The baseline along one axis at every tick: position (m), velocity (m/s), force on the environment (N)."""

    start: float  # m
    x: list[float]
    v: list[float]
    f_env: list[float]


class Baseline(NamedTuple):
    """Motion and force of the baseline over a run. SI units."""

    moved: float  # m, rms of its way from where it starts, over the run
    pressed: float  # N, rms of its force on the environment
    steady: float | None  # N, of that force at the end, where the hand comes to stand against something; else None
    scale: float  # N, the force that the drag is compared with
    fastest: float  # m/s, its greatest speed


class ContactForce(NamedTuple):
    """Force on the environment, N, magnitude over the axes."""

    peak: float
    late: float  # mean over the late part


def baseline_motion(scene: Scene) -> list[BaselineMotion]:
    """The motion of the baseline along each axis; none where no hand moves a slave, and where the scene scales."""
    paths = reference_samples(scene)
    if paths is None or scene.slave is None or scene.frame is not None or set(scales(scene)) != {(1.0, 1.0)}:
        return []
    dt = scene.dt_ns / 1e9
    ends = list(zip(*[scene.per_axis(name) for name in ("master", "slave", "hand")], strict=True))
    bodies = [MassDamper(mass=master.mass + slave.mass + (0.0 if hand is None else hand.mass),
                         damping=master.damping + slave.damping, friction=master.friction + slave.friction)
              for master, slave, hand in ends]
    rigid = replace(scene, slave=bodies[0] if all(body == bodies[0] for body in bodies) else tuple(bodies))
    motions = []
    for plant, path, start, (_, _, hand) in zip(
            slave_plants(rigid), paths, scene.vector("start_m", scene.start_m), ends, strict=True):
        x, v = start, 0.0
        inner = () if plant.start is None else (plant.start,)
        motion = BaselineMotion(start, [], [], [])
        for k in range(scene.ticks):
            motion.x.append(x)
            motion.v.append(v)
            motion.f_env.append(plant.force(plant.c, x, v, *inner))
            push = 0.0 if hand is None else hand.k * (path[k] - x) + hand.d * ((path[k + 1] - path[k]) / dt - v)
            x, v, _, *inner = plant.move(plant.c, x, v, push, *inner)  # type: ignore[assignment]  # z or nothing
        motions.append(motion)
    return motions


def rigid_baseline(scene: Scene) -> Baseline:
    """Move the baseline through the scene. Raises `Refused` for a scene in which no hand moves two ends."""
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
    if scene.frame is not None:
        raise Refused(f"scene {scene.name} turns the slave's base, and a law is tuned against a rigid rod between hand "
                      "and slave, which does not; leave the frame out")
    hand = scene.hand
    way = force = fastest = 0.0
    ends = []
    last = max(1, round(END * 1e9 / scene.dt_ns))
    for motion in baseline_motion(scene):
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
    return Baseline(moved, pressed, steady, scale, fastest)


def baseline_contact(scene: Scene) -> ContactForce | None:
    """Contact force of the baseline; None where nothing is touched, and where there is no baseline."""
    motion = baseline_motion(scene)
    contact = contact_force(np.array([axis.f_env for axis in motion]).T) if motion else None
    return contact if contact is not None and contact.late > 0.0 else None


def contact_force(forces: NDArray[np.float64]) -> ContactForce:
    """Peak and late mean of a run's forces (ticks,) or (ticks, axes) on the environment, N."""
    size = np.abs(forces) if forces.ndim == 1 else np.sqrt((forces * forces).sum(axis=1))
    return ContactForce(float(size.max()), float(size[-max(1, round(LATE * len(size))):].mean()))
