"""A device of your own: a robot that stands in for real hardware, as the slave's end of a live run.

    teleop check robot scenarios/examples/device.py                             and, in two terminals,
    python scenarios/examples/device.py hard_wall --listen 127.0.0.1:9001
    python -m master hard_wall --peer 127.0.0.1:9001
"""

from __future__ import annotations

from teleop import DeviceError, Reading, Scene, end_main

MASS, DAMPING, STIFFNESS, SURFACE = 0.5, 1.0, 5e3, 0.03  # kg, N s/m, N/m, m: a carriage before a rubber stop


class Carriage:
    """A carriage on a rail. In place of this class's arithmetic a driver would talk to the motor's controller."""

    deadline = 0.1  # s after which the hardware itself sets a force to zero that is not renewed
    simulated = True  # a machine leaves this out: check_device then pushes it only if it is asked to

    def __init__(self, scene: Scene) -> None:
        if scene.axes != 1:
            raise DeviceError(f"the carriage has one axis, the scene {scene.axes}; take a scene of one axis")
        self._dt = scene.dt_ns / 1e9
        self._x = self._v = self._force = 0.0
        self._k = self._renewed = 0  # ticks

    def read(self, k: int) -> Reading:
        """Position, velocity and contact force before tick k. Ticks may have been left out; it returns at once."""
        while self._k < k:
            held = self._force if (self._k - self._renewed) * self._dt < self.deadline else 0.0
            self._v += self._dt / MASS * (held - DAMPING * self._v - self._touch())
            self._x += self._dt * self._v
            self._k += 1
        return Reading((self._x,), (self._v,), (self._touch(),))

    def hold(self, force: tuple[float, ...]) -> None:
        """Hold `force` (N, along +x) from now on."""
        self._force, self._renewed = force[0], self._k

    def _touch(self) -> float:
        return max(0.0, STIFFNESS * (self._x - SURFACE))


if __name__ == "__main__":
    raise SystemExit(end_main("s", Carriage))
