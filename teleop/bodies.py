"""The scene's bodies as exact steps: the gripped master, the slave in what it touches, the reference."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.scene import Scene

if TYPE_CHECKING:
    from teleop.plant import Plant


class Bodies(NamedTuple):
    """What moves between two ticks of a run in virtual time."""

    master: Any  # the coefficients of the master's motion and of its grip's force
    slaves: list[Plant]  # for each axis
    instead: Mapping[str, Any] = MappingProxyType({})  # of the functions that the tick's text names, by those names


def exact_bodies(scene: Scene) -> Bodies:
    """The scene's own bodies, without an error of integration."""
    return Bodies(master_plant(scene), slave_plants(scene))


def master_plant(scene: Scene) -> Any:
    """The coefficients of the master's motion: with the hand gripped to it, or alone."""
    from teleop.plant import free_space, grip

    dt = scene.dt_ns / 1e9
    if scene.hand is None:
        return free_space(scene.master, dt).c
    # A plain tuple: it unpacks faster than a NamedTuple, at every tick.
    return tuple(grip(scene.master, scene.hand.mass, scene.hand.k, scene.hand.d, dt))


def slave_plants(scene: Scene) -> list[Plant]:
    """The slave's exact motion in what it touches, for each axis."""
    from teleop.plant import free_space

    dt = scene.dt_ns / 1e9
    return [free_space(scene.slave, dt) if e is None else e.plant(scene.slave, dt) for e in scene.environments]


def reference_samples(scene: Scene) -> tuple[list[float], ...] | None:
    """Where the hand wants to be, per axis, at the ticks 0 .. n: one more than the run has."""
    if scene.hand is None:
        return None
    return scene.hand.reference.samples(scene.axes, scene.ticks + 1, scene.dt_ns)
