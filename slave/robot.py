"""Simulated slave: a robot in its environment, moved exactly between the ticks."""

from __future__ import annotations

from teleop.protocol.deadline import DEADLINE
from teleop.protocol.endpoint import Axes, Reading
from teleop.scene.scene import Scene
from teleop.simulation.bodies import slave_plants
from teleop.simulation.structure import structure_of


class SimulatedSlave:
    """Device of the slave in simulation: its motion under the motor's force, which is held between the ticks.

    A force that is not renewed within its deadline lapses: the motion goes on without it.
    It has a force sensor if the scene's law reads f_env.
    """

    deadline = DEADLINE
    scene_body = True

    def __init__(self, scene: Scene) -> None:
        self._plants = slave_plants(scene)
        self._x = list(scene.vector("start_s", scene.start_s))
        self._v = [0.0] * scene.axes
        self._f = [0.0] * scene.axes
        self._inner = structure_of(scene).s.has.inner
        self._z = [plant.start for plant in self._plants]
        self._sensor = structure_of(scene).s.has.felt
        self._k = self._renewed = 0
        self._lapse = max(1, round(DEADLINE * 1e9 / scene.dt_ns))  # ticks

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

    def _touch(self) -> Axes:
        states = zip(self._x, self._v, *[self._z] * self._inner, strict=True)
        return tuple([p.force(p.c, *state) for p, state in zip(self._plants, states, strict=True)])

    def hold(self, force: Axes) -> None:
        """Hold `force` (N) from now on."""
        self._f, self._renewed = list(force), self._k
