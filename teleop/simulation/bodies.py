"""The scene's bodies as exact steps: the gripped master, the slave in what it touches, the reference."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from types import MappingProxyType
from typing import Any, NamedTuple

from teleop.errors import Refused, number_of
from teleop.physics.path import Blocks, Path
from teleop.physics.plant import Force, MassDamper, Move, Plant, bound, free_space, grip
from teleop.scene.parts import Environment, Reference, Vector
from teleop.scene.scene import Scene

WHOLE = 3_600_000  # ticks, an hour at 1 kHz: so much of a reference that is sampled as a whole, before a run begins


class BodyNumbers(NamedTuple):
    """The coefficients of the bodies, and their inner states at the first tick."""

    c_m: tuple[Any, ...]  # for each axis
    z_m: tuple[Any, ...]
    c_s: tuple[Any, ...]
    z_s: tuple[Any, ...]


class Bodies(NamedTuple):
    """Bodies that move between two ticks of a run in virtual time."""

    master: tuple[Any, ...]  # the coefficients of the master's motion and of its grip's force, for each axis
    slaves: list[Plant]  # for each axis; none in a scene without a slave
    instead: Mapping[str, Any] = MappingProxyType({})  # of the functions that the tick's text names, by those names
    inner_m: tuple[Any, ...] = ()  # the master's inner state at the first tick, for each axis, if it has one
    report_m: Callable[[Any], Mapping[str, float]] | None = None  # what to say of that state afterwards
    method: str = ""  # METHOD:N of a fixed-step method with N sub-steps a tick; empty: the scene's own steps

    def functions(self) -> dict[str, Any]:
        """Functions of the bodies, by the names that the text of a run has for them."""
        moves = {f"move_s{i}": plant.move for i, plant in enumerate(self.slaves)}
        return {**moves, **{f"force_s{i}": plant.force for i, plant in enumerate(self.slaves)}, **self.instead}

    def numbers(self) -> BodyNumbers:
        """The numbers that it begins with."""
        return BodyNumbers(self.master, self.inner_m, tuple([plant.c for plant in self.slaves]),
                    tuple([plant.start for plant in self.slaves]))


def exact_bodies(scene: Scene, slaves: list[Plant] | None = None) -> Bodies:
    """The scene's own bodies: without an error of integration, or with one that is kept to `scene.tolerance`.

    `slaves`: its `slave_plants`, where they are at hand.
    """
    slaves = slave_plants(scene) if slaves is None else slaves
    if not master_has_inner(scene):
        return Bodies(master_coefficients(scene), slaves)
    masters = held_masters(scene)
    functions = {"move_held": masters[0].move, "held_force": masters[0].force}
    return Bodies(tuple([each.c for each in masters]), slaves, functions, tuple([each.start for each in masters]),
                  masters[0].report)


def master_has_inner(scene: Scene) -> bool:
    """True if the master's motion has an inner state: on one of its axes, or of a motor damped by a shunt."""
    return scene.electrical is not None or any(has_inner(body) for body in scene.per_axis("master"))


def has_inner(body: Any) -> bool:
    """True if a body's motion has an inner state: friction, or what a servo keeps."""
    return body.friction > 0.0 or getattr(body, "inner", False)


def master_coefficients(scene: Scene) -> tuple[Any, ...]:
    """The coefficients of the master's motion where that is linear, for each axis.

    With the hand gripped to it, or alone. An axis that no hand holds beside others that one does has a grip of no mass,
    no stiffness and no damping, which is the same motion.
    """
    dt = scene.dt_ns / 1e9

    def coefficients(body: MassDamper, hand: tuple[float, float, float] | None) -> Any:
        # A plain tuple: it unpacks faster than a NamedTuple, at every tick.
        return free_space(body, dt).c if hand is None else tuple(grip(body, *hand, dt))

    return _by_axis(scene, coefficients)


def _by_axis(scene: Scene, make: Callable[[MassDamper, tuple[float, float, float] | None], Any]) -> tuple[Any, ...]:
    """Call `make` with the master's body and the mass, stiffness and damping of the hand, for each axis.

    None in place of these in a scene without a hand. What is the same on several axes is made once.
    """
    masters = scene.reference is not None
    made: dict[tuple[int, int], Any] = {}
    keys = []
    for body, hand in zip(scene.per_axis("master"), scene.per_axis("hand"), strict=True):
        keys.append((id(body), id(hand)))
        if keys[-1] not in made:
            moves = (0.0, 0.0, 0.0) if hand is None else (hand.mass, hand.k, hand.d)
            made[keys[-1]] = make(body, moves if masters else None)
    return tuple([made[key] for key in keys])


def held_masters(scene: Scene) -> tuple[Plant, ...]:
    """The master where its motion has an inner state, for each axis: see `master_has_inner`."""
    dt = scene.dt_ns / 1e9

    def plant(body: MassDamper, hand: tuple[float, float, float] | None) -> Plant:
        masters = hand or (0.0, 0.0, 0.0)
        if hasattr(body, "master_plant"):
            if scene.electrical is not None:
                raise Refused("a position servo has no motor of its own to damp; leave electrical out")
            servo: Plant = body.master_plant(*masters, dt)
            return servo
        if scene.electrical is None:
            from teleop.physics.implicit import implicit_master

            return implicit_master(body, *masters, dt, friction=body.friction, tol=scene.tolerance)
        from teleop.physics.relaxing import relaxing_master

        if body.friction > 0.0:
            raise Refused("friction of the master and electrical damping do not go together yet; leave one of them out")
        return relaxing_master(body, *masters, dt, b_e=scene.electrical.b, cutoff=scene.electrical.cutoff)

    bodies = scene.per_axis("master")
    return tuple(_started(list(_by_axis(scene, plant)), scene, bodies, scene.start_m))


def _started(plants: list[Plant], scene: Scene, bodies: Sequence[Any], start: Vector) -> list[Plant]:
    """The plants with the inner states in which bodies that tell one are at rest at `start` (m, per axis)."""
    if not any(hasattr(body, "start") for body in bodies):
        return plants
    return [plant._replace(start=body.start(scene.dt_ns / 1e9, at)) for plant, body, at in zip(
        plants, bodies, scene.vector("start", start), strict=True)]


def slave_plants(scene: Scene, *, as_it_goes: bool = False) -> list[Plant]:
    """The slave's motion in what it touches, for each axis.

    `as_it_goes`: the path of what moves is sampled while the slave does, see `path_of`, and not all of it before.
    """
    if scene.slave is None:
        return []
    bodies = scene.per_axis("slave")
    plants = _started([_slave(scene, body, one, as_it_goes)
                       for body, one in zip(bodies, scene.environments, strict=True)], scene, bodies, scene.start_s)
    if any(plant.start is not None for plant in plants):  # they share the lines of the tick
        return [plant if plant.start is not None else with_inner(plant) for plant in plants]
    return plants


def _slave(scene: Scene, body: MassDamper, environment: Environment | None, as_it_goes: bool) -> Plant:
    """The slave in one environment, which may be carried along a path."""
    dt = scene.dt_ns / 1e9
    path: Reference | None = getattr(environment, "path", None)
    if hasattr(body, "slave_plant"):
        if path is not None or (environment is not None and not hasattr(environment, "resistance")):
            raise Refused(f"a position servo is not known in {type(environment).__name__}; take a wall, a tissue or a "
                          "Hunt-Crossley body that stands still")
        servo: Plant = body.slave_plant(dt, None if environment is None else environment.resistance())
        return servo
    still: Any = environment if path is None else environment.environment  # type: ignore[union-attr]
    if body.friction > 0.0 or (still is not None and not hasattr(still, "plant")):
        plant = _integrated(scene, body, still)
    elif still is None:
        plant = free_space(body, dt)
    else:
        plant = still.plant(body, dt)
    if path is None:
        return plant
    from teleop.physics.carried import carried

    sampled = path_of if as_it_goes else _whole
    places, = sampled(path, 1, scene.ticks + 1, scene.dt_ns)
    return carried(plant, places, body, dt)


def _integrated(scene: Scene, body: MassDamper, environment: Any) -> Plant:
    """The slave where its motion has no closed form, to the scene's tolerance."""
    from teleop.physics.implicit import Resistance, implicit_plant

    if environment is not None and not hasattr(environment, "resistance"):
        raise Refused(f"a slave with friction is not known in {type(environment).__name__}, which has no "
                      "resistance(); write friction=0, or take a wall, a tissue or a Hunt-Crossley body")
    resistance = Resistance() if environment is None else environment.resistance()
    return implicit_plant(body, scene.dt_ns / 1e9, resistance=resistance, friction=body.friction, tol=scene.tolerance)


def with_inner(plant: Plant) -> Plant:
    """A plant without an inner state, called like those that have one."""
    return plant._replace(move=bound(_move_beside, plant.move), force=bound(_force_beside, plant.force), start=())


def _move_beside(move: Move, c: Any, x: float, v: float, f: float, z: Any) -> tuple[Any, ...]:
    return (*move(c, x, v, f), z)


def _force_beside(force: Force, c: Any, x: float, v: float, z: Any) -> float:  # noqa: ARG001
    return force(c, x, v)


def reference_samples(scene: Scene) -> tuple[Sequence[float], ...] | None:
    """Reference positions of the hand, per axis, at the ticks 0 .. n: one more than the run has."""
    reference = scene.reference
    return None if reference is None else reference.samples(scene.axes, scene.ticks + 1, scene.dt_ns)


def path_of(reference: Reference, axes: int, count: int, dt_ns: int, most: int = WHOLE) -> tuple[Sequence[float], ...]:
    """A reference at the ticks 0 .. count-1, for each axis, to be read in the order of the ticks and as it is needed.

    One whose `samples` takes `first` is sampled a block at a time. Of one without it `most` samples are taken here, and
    after these it stays where it is.
    """
    if "first" in signature(reference.samples).parameters:
        blocks = Blocks(lambda first, some: reference.samples(axes, some, dt_ns, first=first))  # type: ignore[call-arg]  # asked above
        paths = tuple([Path(blocks, axis, count) for axis in range(axes)])
        for path in paths:  # what it refuses, it refuses here
            path[0]
        return paths
    return _whole(reference, axes, min(count, most), dt_ns)


def _whole(reference: Reference, axes: int, count: int, dt_ns: int) -> tuple[Sequence[float], ...]:
    return reference.samples(axes, count, dt_ns)


def check_turn(old: Scene | None, new: Scene) -> None:
    """Refuse that a simulated device goes on with a scene whose ticks or axes are others; None: it has had no scene."""
    if old is not None and (old.dt_ns, old.axes) != (new.dt_ns, new.axes):
        was, to = (f"dt={scene.dt:g} s and {number_of(scene.axes, 'axis', 'axes')}" for scene in (old, new))
        raise Refused(f"a simulated device goes on with another scene in the same ticks and axes: it has {was}, and "
                      f"scene {new.name} has {to}; take one with the same dt and axes, or start the end anew")
