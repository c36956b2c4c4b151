"""A carriage on a rail, at either end: `--robot rail`, `--robot rail:STOP` (m), `--device rail_handle`.

In place of `Rail`'s arithmetic a driver would talk to the motor's controller.
"""

from __future__ import annotations

from teleop import DeviceError, Reading, Scene

MASS, DAMPING, STIFFNESS = 0.5, 1.0, 5e3  # kg, N s/m, N/m


class Rail:
    """A carriage with a motor and a rubber stop at `stop` (m). `way`: of its force, 1 at the slave, else -1."""

    deadline = 0.1  # s after which the controller sets a force to zero that is not renewed
    senses = True
    simulated = True

    def __init__(self, scene: Scene, stop: float, way: float) -> None:
        if scene.axes != 1:
            raise DeviceError(f"the rail has one axis, and the scene {scene.axes}; take a scene of one axis")
        self._dt, self._stop, self._way = scene.dt_ns / 1e9, stop, way
        self._x = self._v = self._force = 0.0
        self._k = self._renewed = 0
        self._open = True

    def read(self, k: int) -> Reading:
        """Position, velocity and the force on the stop at tick k."""
        if not self._open:
            raise DeviceError("the port is closed")
        while self._k < k:
            held = self._force if (self._k - self._renewed) * self._dt < self.deadline else 0.0
            self._v += self._dt / MASS * (self._way * held - DAMPING * self._v - self._touch())
            self._x += self._dt * self._v
            self._k += 1
        return Reading((self._x,), (self._v,), (self._touch(),))

    def hold(self, force: tuple[float, ...]) -> None:
        """Hold `force` (N) from now on."""
        self._force, self._renewed = force[0], self._k

    def close(self) -> None:
        """Give the port back."""
        self._open = False

    def _touch(self) -> float:
        return max(0.0, STIFFNESS * (self._x - self._stop))


def carriage(scene: Scene, stop: str = "0.03") -> Rail:
    """A carriage on a rail, rail:STOP, before a rubber stop (m)."""
    return Rail(scene, float(stop), 1.0)


def handle(scene: Scene) -> Rail:
    """The same rail with a handle."""
    return Rail(scene, 10.0, -1.0)
