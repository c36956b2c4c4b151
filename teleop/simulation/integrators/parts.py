"""The bodies of a scene taken apart, so that each can be moved by something else and be put back where it was."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import pi
from typing import Any

from teleop.errors import Refused
from teleop.physics.plant import MassDamper, Plant
from teleop.physics.sdirk import Core
from teleop.scene.scene import Scene
from teleop.simulation.bodies import exact_bodies, with_inner
from teleop.simulation.integrators.relaxed import Branch


def slave_of(scene: Scene) -> MassDamper:
    """The scene's slave. Refused where there is none: what is compared are ways to move it."""
    if scene.slave is None:
        raise Refused(f"precision compares ways to move a slave, and scene {scene.name} has none; take one that has, "
                      "for example hard_wall")
    body: MassDamper = scene.slave
    return body


def has_closed_form(scene: Scene) -> bool:
    """True if every body has a closed form, so that the run is exact."""
    return scene.master.friction == 0.0 and not any(core_of(still) for still, _ in stills(scene))


def check_no_servo(scene: Scene) -> None:
    """Refuse position servos, which no method of integration knows."""
    if any(hasattr(body, "lateness") for body in (*scene.per_axis("master"), *scene.per_axis("slave"))):
        raise Refused("a position servo is moved by its own steps alone, which no other method is compared with; leave "
                      "bodies out, or take a scene without one, for example hard_wall")


def stills(scene: Scene) -> list[tuple[Plant, Any]]:
    """For each axis the slave's plant in its environment, and that environment, as if it rested."""
    return [_still(*pair) for pair in _own(scene)]


def whole_plants(scene: Scene) -> list[Plant]:
    """For each axis the slave's plant, an environment that moves included."""
    return [plant for plant, _ in _own(scene)]


def rebuilt(scene: Scene, make: Callable[[Plant, Any], Plant]) -> list[Plant]:
    """The scene's slaves, each plant replaced by what `make(plant, environment)` gives, seen as if it rested.

    What `make` gives has an inner state if and only if its plant had one.
    """
    plants = [_carried_as(pair[0], make(*_still(*pair))) if is_carried(pair[0]) else make(*pair)
              for pair in _own(scene)]
    if any(plant.start is not None for plant in plants):
        return [plant if plant.start is not None else with_inner(plant) for plant in plants]
    return plants


def _own(scene: Scene) -> list[tuple[Plant, Any]]:
    """Each axis' plant and environment, as they are when the axis is alone: the axes of a scene share their calls."""
    if scene.slave is None:
        return []
    if scene.axes == 1:
        return [(exact_bodies(scene).slaves[0], scene.environments[0])]
    alone = replace(scene, axes=1, names=(), units=(), environment=None, start_m=0.0, start_s=0.0)
    return [(exact_bodies(replace(alone, environment=one)).slaves[0], one) for one in scene.environments]


def is_carried(plant: Plant) -> bool:
    """True if the plant's environment moves, so that its inner state begins with the tick."""
    if plant.start is None:
        return False
    from teleop.physics import carried

    return carried.is_carried(plant)


def _still(plant: Plant, environment: Any) -> tuple[Plant, Any]:
    if not is_carried(plant):
        return plant, environment
    from teleop.physics.carried import at_rest

    return at_rest(plant), environment.environment


def _carried_as(whole: Plant, still: Plant) -> Plant:
    from teleop.physics.carried import Carried

    move: Any = whole.move
    force: Any = whole.force
    c = tuple(Carried(*whole.c)._replace(c=still.c))
    return Plant(partial(move.func, still.move), partial(force.func, still.force), c, (0, *(still.start or ())))


def core_of(still: Plant) -> tuple[float, float, Core] | None:
    """Side, place and equation of a plant that is integrated; None for one with a closed form."""
    if still.start is None:
        return None
    from teleop.physics.implicit import move_implicit

    if still.move is not move_implicit:
        return None
    side, at, core = still.c[:3]
    return side, at, core


def relaxing_branch(still: Plant, environment: Any, body: MassDamper) -> Branch | None:
    """The equation of a body in tissue that relaxes; None if it is in something else."""
    if still.start is None:
        return None
    from teleop.physics.relaxing import move_relaxing

    if still.move is not move_relaxing or not all(hasattr(environment, name) for name in ("k", "k1", "tau")):
        return None
    return Branch(body.mass, body.damping, environment.k, 1.0, environment.k1 * environment.tau, environment.tau)


def master_branch(scene: Scene) -> Branch:
    """The equation of the master where it is damped electrically."""
    hand, shunt = scene.hand, scene.electrical
    assert shunt is not None
    m_h, k, d = (hand.mass, hand.k, hand.d) if hand is not None else (0.0, 0.0, 0.0)
    return Branch(scene.master.mass + m_h, scene.master.damping + d + shunt.b, k, -shunt.b, 1.0,
                  1.0 / (2.0 * pi * shunt.cutoff))
