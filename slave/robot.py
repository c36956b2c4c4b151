"""Simulated slave: a robot in its environment, moved exactly between the ticks."""

from __future__ import annotations

from typing import Any

from teleop.physics.plant import Plant
from teleop.protocol.endpoint import Axes, Reading
from teleop.protocol.guard import DEADLINE
from teleop.scene.scene import Scene
from teleop.simulation.bodies import check_turn, slave_plants
from teleop.simulation.structure import structure_of


class SimulatedSlave:
    """Device of the slave in simulation: its motion under the motor's force, which is held between the ticks.

    A force that is not renewed within its deadline lapses: the motion goes on without it.
    It has a force sensor if the scene's law reads f_env, and if the motion has an inner state; `senses`: it has one
    whatever the scene, or none.
    """

    deadline = DEADLINE
    scene_body = True

    def __init__(self, scene: Scene, *, senses: bool | None = None) -> None:
        self._senses = senses
        self._k = self._renewed = self._since = 0  # the tick, that of the newest force, and that of the scene's start
        self._scene: Scene | None = None
        self._plants: list[Plant] = []
        self._x: list[float] = []
        self._v: list[float] = []
        self._f: list[float] = []
        self._z: list[Any] = []  # the inner states of the plants
        self._inner = self._sensor = False
        self._lapse = 1  # ticks until a force lapses
        self._take(scene, again=True)

    def read(self, k: int) -> Reading:
        """Position, velocity and contact force, the left limit at tick k. Ticks may be left out."""
        while self._k < k:
            if self._k - self._renewed >= self._lapse:
                self._f = [0.0] * len(self._f)
            for i, (move, _, c, *_) in enumerate(self._plants):
                state = c, self._x[i], self._v[i], self._f[i]
                if self._inner:
                    self._x[i], self._v[i], _, self._z[i] = move(*state, self._z[i])
                else:
                    self._x[i], self._v[i], _ = move(*state)
            self._k += 1
        return Reading(tuple(self._x), tuple(self._v), self._touch() if self._sensor else None)

    def turn(self, scene: Scene, *, again: bool = False) -> None:
        """Go on with the body and the environment of `scene`, at the same tick, from the same position and velocity.

        An environment that moves goes on along its path by the ticks since the scene's start. `again`: at rest where
        the new scene starts, with no force held, and what moves begins anew. Raises `Refused`, and changes nothing,
        where dt or axes are others.
        """
        check_turn(self._scene, scene)
        self._take(scene, again)

    def _take(self, scene: Scene, again: bool) -> None:
        """Be the slave of `scene`; what it refuses, it refuses before anything is changed."""
        has, plants = structure_of(scene).s.has, slave_plants(scene, as_it_goes=True)
        x = list(scene.vector("start_s", scene.start_s))
        if again:
            self._x, self._v, self._f = x, [0.0] * scene.axes, [0.0] * scene.axes
            self._since = self._renewed = self._k
            self._z = [plant.start for plant in plants]
        else:
            pairs = zip(self._plants, self._z, plants, strict=True)
            self._z = [_goes_on(old, z, new, self._k - self._since) for old, z, new in pairs]
        self._scene, self._plants, self._inner = scene, plants, has.inner
        self._sensor = has.felt if self._senses is None else self._senses
        self._lapse = max(1, round(DEADLINE * 1e9 / scene.dt_ns))

    def _touch(self) -> Axes:
        states = zip(self._x, self._v, *[self._z] * self._inner, strict=True)
        return tuple([p.force(p.c, *state) for p, state in zip(self._plants, states, strict=True)])

    def hold(self, force: Axes) -> None:
        """Hold `force` (N) from now on."""
        self._f, self._renewed = list(force), self._k


def _goes_on(old: Plant, z: Any, new: Plant, ticks: int) -> Any:
    """The inner state with which a slave goes on in another environment, so many ticks after the scene's start.

    That of the same kind of environment goes on, of another it begins.
    """
    if new.move is old.move:
        return z
    if new.start is None:
        return None
    from teleop.physics.carried import is_carried  # loaded by now if it is one

    return (ticks, *new.start[1:]) if is_carried(new) else new.start
