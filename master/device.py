"""Simulated master: a device held by the scene's hand, moved exactly between the ticks."""

from __future__ import annotations

from typing import Any

from teleop.physics.plant import grip_force, move_free, move_gripped
from teleop.protocol.deadline import DEADLINE
from teleop.protocol.endpoint import Axes, Reading
from teleop.scene.scene import Scene
from teleop.simulation.bodies import held_master, master_plant, reference_samples
from teleop.simulation.structure import structure_of


class SimulatedMaster:
    """Device of the master in simulation: its motion under the motor's force, which is held between the ticks.

    A force that is not renewed within its deadline lapses: the motion goes on without it.
    It has a force sensor if the scene's law reads f_h and the scene has no observer of it, and if the motion has an
    inner state, since the hand's force cannot be computed afterwards then.
    """

    deadline = DEADLINE
    scene_body = True

    def __init__(self, scene: Scene) -> None:
        has = structure_of(scene).m.has
        self._held = held_master(scene) if has.inner else None
        self._c: Any = master_plant(scene) if self._held is None else self._held.c
        self._z = [None if self._held is None else self._held.start] * scene.axes
        self._reference = reference_samples(scene)
        self._x = list(scene.vector("start_m", scene.start_m))
        self._v = [0.0] * scene.axes
        self._f = [0.0] * scene.axes
        self._dt = scene.dt_ns / 1e9
        self._sensor = has.felt
        self._k = self._renewed = 0
        self._lapse = max(1, round(DEADLINE * 1e9 / scene.dt_ns))  # ticks

    def read(self, k: int) -> Reading:
        """Position, velocity and hand force, the left limit at tick k. Ticks may be left out, not taken twice.

        After the scene's last tick the hand's reference stays where it is.
        """
        while self._k < k:
            if self._k - self._renewed >= self._lapse:
                self._f = [0.0] * len(self._f)
            self._move(self._k)
            self._k += 1
        return Reading(tuple(self._x), tuple(self._v), self._hand() if self._sensor else None)

    def hold(self, force: Axes) -> None:
        """Hold `force` (N, against the hand) from now on."""
        self._f, self._renewed = list(force), self._k

    def _move(self, k: int) -> None:
        for i, (x, v, f) in enumerate(zip(self._x, self._v, self._f, strict=True)):
            if self._held is not None:
                r0, r1 = (0.0, 0.0) if self._reference is None else (self._at(i, k), self._at(i, k + 1))
                self._x[i], self._v[i], self._z[i] = self._held.move(self._c, x, v, f, r0, r1, self._z[i])
            elif self._reference is None:
                self._x[i], self._v[i], _ = move_free(self._c, x, v, -f)
            else:
                self._x[i], self._v[i] = move_gripped(self._c, x, v, f, self._at(i, k), self._at(i, k + 1))

    def _at(self, i: int, k: int) -> float:
        """The hand's reference at tick k, m."""
        assert self._reference is not None
        r = self._reference[i]
        return r[k] if k < len(r) else r[-1]

    def _hand(self) -> Axes:
        if self._reference is None:
            return (0.0,) * len(self._x)
        return tuple([self._grip(i) for i in range(len(self._x))])

    def _grip(self, i: int) -> float:
        k = self._k
        r = self._at(i, k)
        state = self._c, self._x[i], self._v[i], self._f[i], r, (r - self._at(i, k - 1)) / self._dt if k else 0.0
        if self._held is None:
            return grip_force(*state)
        return self._held.force(*state, self._z[i])
