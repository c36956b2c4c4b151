"""The force that a live end holds, and its way to zero where the law cannot be asked. Sans-IO.

That is so while there is no reading, after a force that was not finite, and when the run is over. The force that was
held is then scaled by the guard's gain, which falls along the watchdog's ramp, within the scene's cap: it falls in
amount at every tick and never turns. It is open loop, so without a reading the way is short.
"""

from __future__ import annotations

from math import isfinite

from teleop.protocol.guard import Guard
from teleop.scene.axes import FORCE_UNIT
from teleop.scene.scene import Scene
from teleop.stages.force_cap import cap, caps
from teleop.stages.velocity_cap import limit_speed

BLIND_NS = 100_000_000  # the longest that a force is held without a reading


class HeldForce:
    """`force` (N, per axis) of end `e`, which ticks at every `every`-th tick of the scene's grid."""

    def __init__(self, scene: Scene, e: str, every: int, guard: Guard) -> None:
        self.force: tuple[float, ...] = (0.0,) * scene.axes
        self._e, self._every, self._guard = e, every, guard
        self._dt_ns, dt = scene.dt_ns, every * scene.dt_ns / 1e9
        # Of each axis its greatest velocity, None where it has none, and its cap; none of a scene without a cap.
        self._limits = [] if scene.cap is None else [(each.speed(), each.limits(dt)) for each in caps(scene)]
        self._units = [FORCE_UNIT[unit] for unit in scene.axis_units]
        self._k = 0  # the tick at which it was set last

    def begin(self, k: int) -> None:
        """The law begins at tick k."""
        self._k = k - self._every

    def since(self, k: int) -> int:
        """Number of own ticks since it was set last, at tick k, where it is set again."""
        ticks, self._k = (k - self._k) // self._every, k
        return ticks

    def take(self, k: int, force: tuple[float, ...]) -> bool:
        """Set it to `force` (N, per axis) at tick k; False if that is not finite, and then it stays what it was."""
        if not isfinite(sum(force)) and not all(map(isfinite, force)):  # a sum may be too great that is of finite ones
            return False
        if not any(force):
            self.zero(k)
        self.force = force
        return True

    def zero(self, k: int) -> None:
        """Set it to zero at tick k, with an event where that is a step which the slew limit does not allow.

        There is none where the device has set it to zero by itself.
        """
        steps = [(abs(f), unit) for f, (_, c), unit in zip(self.force, self._limits, self._units, strict=False)
                 if abs(f) > c.step * (1.0 + 1e-9)]
        self.force = (0.0,) * len(self.force)
        if steps and not self._guard.lapsed:
            self._guard.tell(k, "zero", "{:.3g} {} set to zero in one step, which the slew limit still held".format(
                *max(steps)))

    def lost(self) -> None:
        """The device did not take it: whatever it holds now, the next force begins at zero, along the guard's ramp."""
        self._guard.gain = 0.0
        self.force = (0.0,) * len(self.force)

    def blind(self, k: int, ran: int, trouble: str) -> tuple[float, ...]:
        """The force to hold at tick k, which has no reading and so no law; `ran`: the last tick that had.

        After `BLIND_NS` there is none, whatever ramp and slew limit ask.
        """
        self._k, before = k, self._guard.gain
        gain = self._guard.step(k, False, trouble)
        if gain >= before:  # of a stepped end without a watchdog
            gain = self._guard.fall()
        if (k - ran) * self._dt_ns > BLIND_NS or self._guard.lapsed:
            self._guard.gain = gain = 0.0
            self.zero(k)
        return self._scaled(before, gain, None)

    def over(self, v: tuple[float, ...] | None, passed: int = 1) -> tuple[float, ...]:
        """The force to hold `passed` own ticks later with the run over; one step of the slew limit, however many.

        Whoever asks ends this where the guard is `overdue`.

        `v`: the velocity (m/s, per axis), by which the velocity cap is kept; None if it is not known.
        """
        before, gain = self._guard.gain, self._guard.fall(passed)
        if self._guard.lapsed:
            self.force = (0.0,) * len(self.force)
        return self._scaled(before, gain, v)

    def _scaled(self, before: float, gain: float, v: tuple[float, ...] | None) -> tuple[float, ...]:
        part = gain / before if before > 0.0 else 0.0
        force = [part * each for each in self.force]
        along = None if v is None or not all(map(isfinite, v)) else v if self._e == "s" else [-each for each in v]
        for i, (speed, c) in enumerate(self._limits):
            if speed is not None and along is not None:
                force[i] = limit_speed(speed, force[i], along[i])
            force[i] = cap(c, force[i], self.force[i])
        self.force = tuple(force)
        return self.force
