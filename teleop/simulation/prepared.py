"""A scene worked out once: what its run, its trace and the rows of a sweep take of it, instead of asking it again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

from teleop.physics.plant import Plant
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies, exact_bodies, reference_samples, slave_plants
from teleop.simulation.rest import Still, still
from teleop.simulation.source import loop_of
from teleop.simulation.structure import Structure, columns, numbers_of, structure_of


def prepare(scene: Scene, bodies: Bodies | None = None) -> Prepared:
    """The scene, worked out once. `bodies`: others than its exact ones."""
    return Prepared(scene, bodies)


class Prepared:
    """A scene and what follows from it alone, each part made when it is first asked for.

    A part raises `Refused` where the scene cannot be run that way, a body without an exact step for example.
    """

    def __init__(self, scene: Scene, bodies: Bodies | None = None) -> None:
        self.scene = scene
        if bodies is not None:
            self.bodies = bodies

    @cached_property
    def structure(self) -> Structure:
        """Structure of the scene, which decides its lines of the tick."""
        return structure_of(self.scene)

    @cached_property
    def slaves(self) -> list[Plant]:
        """The slave's exact motion in what it touches, per axis; none in a scene without a slave."""
        return slave_plants(self.scene)

    @cached_property
    def bodies(self) -> Bodies:
        """The bodies that move between two ticks."""
        return exact_bodies(self.scene, self.slaves)

    @cached_property
    def reference(self) -> tuple[Sequence[float], ...] | None:
        """The path of the hand, m: per axis the samples at the ticks 0 .. n; None without a hand."""
        return reference_samples(self.scene)

    @cached_property
    def still(self) -> Still | None:
        """View of the end of its run, where nothing moves it any more; None where something does."""
        return still(self.scene, self.reference)

    @cached_property
    def starts(self) -> Mapping[str, tuple[float, ...]]:
        """The places that the ends m and s start from, m, per axis."""
        return {e: self.scene.vector(f"start_{e}", getattr(self.scene, f"start_{e}")) for e in ("m", "s")}

    @cached_property
    def numbers(self) -> Any:
        """The numbers of the stages between the bodies and the law, nested by end and stage."""
        return numbers_of(self.scene, self.starts)

    @cached_property
    def loop(self) -> Callable[..., Any]:
        """The loop of a run in virtual time, specialised for this scene."""
        return loop_of(self.scene, self.bodies)

    def columns(self, e: str, sensor: bool | None = None) -> tuple[str, ...]:
        """The names of the record of end `e` (m or s), in order; see `teleop.simulation.structure.columns`."""
        return columns(self.scene, e, sensor)
