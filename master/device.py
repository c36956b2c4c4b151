"""The simulated master: the device with the scene's hand on it, moved exactly between the ticks."""

from __future__ import annotations

from typing import Any

from teleop.bodies import master_plant, reference_samples
from teleop.endpoint import Axes, Reading
from teleop.plant import grip_force, move_free, move_gripped
from teleop.scene import Scene
from teleop.tick import features


class SimulatedMaster:
    """Reads where the master is at a tick, and holds the motor's force until the next one is read.

    It has a force sensor if the scene's law reads f_h and no observer stands in for one.
    """

    def __init__(self, scene: Scene) -> None:
        self._c: Any = master_plant(scene)
        self._reference = reference_samples(scene)
        self._x = list(scene.vector("start_m", scene.start_m))
        self._v = [0.0] * scene.axes
        self._f = [0.0] * scene.axes
        self._dt = scene.dt_ns / 1e9
        self._sensor = "sense_m" in features(scene)
        self._k = 0

    def read(self, k: int) -> Reading:
        """Position, velocity and hand force, the left limit at tick k. Ticks may be left out, not taken twice."""
        while self._k < k:
            self._move(self._k)
            self._k += 1
        return Reading(tuple(self._x), tuple(self._v), self._hand() if self._sensor else None)

    def hold(self, force: Axes) -> None:
        """Hold `force` (N, against the hand) from now on."""
        self._f = list(force)

    def _move(self, k: int) -> None:
        for i, (x, v, f) in enumerate(zip(self._x, self._v, self._f, strict=True)):
            if self._reference is None:
                self._x[i], self._v[i], _ = move_free(self._c, x, v, -f)
            else:
                r = self._reference[i]
                self._x[i], self._v[i] = move_gripped(self._c, x, v, f, r[k], r[k + 1])

    def _hand(self) -> Axes:
        if self._reference is None:
            return (0.0,) * len(self._x)
        k, dt = self._k, self._dt
        return tuple([
            grip_force(self._c, x, v, f, r[k], (r[k] - r[k - 1]) / dt if k else 0.0)
            for x, v, f, r in zip(self._x, self._v, self._f, self._reference, strict=True)
        ])
