"""Joints on a bus of positions as a device of torques, by the drive of a `Servo` for each.

The arithmetic is `goal_of` and `follow` of `teleop.physics.servo`, the lines by which a run in virtual time moves the
same scene. A bus has `read()` (positions in rad, the newest), `goal(positions)` and `close()`, which return at once and
raise `DeviceError`; `teleop/live/devices/arms` has some.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from teleop.errors import DeviceError, Refused, number_of
from teleop.live.devices.device_watchdog import DeviceWatchdog
from teleop.physics.servo import Servo, felt_torque, follow, goal_of, is_due
from teleop.protocol.endpoint import Axes, Reading
from teleop.scene.scene import Scene

BODIES = {"m": "master", "s": "slave"}
LOOK_S = 0.5  # between two looks at how many exchanges the bus carries
LOST_S = 0.1  # without a tick for so long: a drive begins anew where the joints are


class PositionBus(Protocol):
    """Bus of one or more position servos. No call waits; each raises `DeviceError` where the bus is lost."""

    def read(self) -> Axes:
        """Return the newest position of each joint, rad."""

    def goal(self, x: Axes) -> None:
        """Give each joint its goal, rad."""

    def close(self) -> None:
        """Let the joints go: with their goal where they are, or without torque."""


class PositionServo:
    """Device of torques whose joints take positions. `hold` gives N m; `read` rad, rad/s and the torque that is felt.

    `servos`: one for all joints or one for each; `dt`: of the scene, s. `push`: 1.0 at the slave, -1.0 at the master,
    whose torques act against the hand. Servos have no watchdog of their line, so the bus has one, or `unwatched` says
    that the arm presses on when its end is killed. Raises `Refused`, also for a servo whose condition fails.
    """

    weightless = True

    def __init__(self, bus: PositionBus, servos: Servo | Sequence[Servo], dt: float, *, push: float = 1.0,
                 watchdog: DeviceWatchdog | None = None, unwatched: bool = False) -> None:
        self.watchdog = watchdog or getattr(bus, "watchdog", None)
        if self.watchdog is None and not unwatched:
            raise Refused("a bus of position servos that has no watchdog presses on when its end is killed; give it "
                          "watchdog=DeviceWatchdog(open=\"my_arm:letting_go\"), or write unwatched=True")
        self.bus, self._push, self._dt = bus, push, dt
        x = bus.read()
        servos = (servos,) * len(x) if isinstance(servos, Servo) else tuple(servos)
        if len(servos) != len(x) or len({(each.every, each.drive) for each in servos}) != 1:
            raise Refused(f"the bus has {number_of(len(x), 'joint')}, and was given {number_of(len(servos), 'servo')}; "
                          "give it one for all or one for each, of the same drive and the same every")
        for each in servos:
            each.check(dt)
        self._servos = servos
        self._drives = [each.drive_numbers(dt) for each in servos]
        self._k = 0
        self._next_look: int | None = None
        self._slow = ""
        self._held: Axes = (0.0,) * len(x)
        self._begin(x)

    @property
    def notes(self) -> list[str]:
        """Sentences on the bus, for a check and for the summary of a run."""
        return getattr(self.bus, "notes", [])

    def _begin(self, x: Axes) -> None:
        """Begin at rest where the joints are."""
        self._x, self._v, self._goals = list(x), [0.0] * len(x), x
        self._states: list[Any] | None = [each.drive_start(self._dt, place)
                                          for each, place in zip(self._servos, x, strict=True)]

    def _check_rate(self, k: int) -> None:
        """Raise `DeviceError` while the bus carries so few exchanges that a drive could make energy."""
        if self._next_look is None:  # the first exchanges are slow, and tell nothing
            self._next_look = k + round(LOOK_S / self._dt)
        elif k >= self._next_look:
            rate = getattr(self.bus, "rate", 0.0)  # 0.0: it does not know yet
            self._next_look, self._slow = k + round(LOOK_S / self._dt), ""
            try:
                for each in self._servos if rate > 0.0 else ():
                    each.check(self._dt, 1.0 / rate)
            except Refused as error:
                self._slow = f"the bus carries {rate:.0f} exchanges a second: {error}"
        if self._slow:
            raise DeviceError(self._slow)

    def read(self, k: int) -> Reading:
        """Move the drives on to tick k by the newest positions. Raises `DeviceError` where the bus has none."""
        try:
            newest = self.bus.read()
            self._check_rate(k)
        except DeviceError:
            self._states = None
            raise
        if self._states is None or (k - self._k) * self._dt > LOST_S:
            self._begin(newest)
        else:
            for _ in range(k - self._k):
                for i, c in enumerate(self._drives):
                    self._x[i], self._v[i], self._states[i] = follow(
                        c, self._x[i], self._v[i], self._push * self._held[i], self._states[i], newest[i])
        self._k = k
        assert self._states is not None
        torques = [self._push * felt_torque(c, x, v, goal, state[0]) for c, x, v, goal, state in zip(
            self._drives, self._x, self._v, self._goals, self._states, strict=True)]
        return Reading(tuple(self._x), tuple(self._v), tuple(torques))

    def hold(self, force: Axes) -> None:
        """Hold these torques, N m: a goal at each exchange with the bus. Raises `DeviceError` where it is lost."""
        self._held = force
        if self._states is None:
            return
        goals = tuple([goal_of(c, x, self._push * f, state[0]) if is_due(c, f, state) else goal
                       for c, x, f, state, goal in zip(
                           self._drives, self._x, force, self._states, self._goals, strict=True)])
        if self._servos[0].every == 1 or self._states[0][1] == 0 or goals != self._goals:
            self._goals = goals
            self.bus.goal(goals)

    def close(self) -> None:
        """Let the joints go."""
        self.bus.close()


def position_arm(scene: Scene, e: str, open_bus: Callable[[], PositionBus], otherwise: str) -> PositionServo:
    """Open the arm of positions at an end, "m" or "s", whose bodies in the scene are servos. Raises `Refused`.

    `otherwise`: what else to do where they are not, as a clause.
    """
    bodies = scene.per_axis(BODIES[e])
    if not all(isinstance(each, Servo) for each in bodies):
        raise Refused(f"servos that take positions are driven by their numbers, and the {BODIES[e]} of scene "
                      f"{scene.name} is no Servo; take a scene whose is, such as servo_arm, or {otherwise}")
    bus = open_bus()
    try:
        return PositionServo(bus, bodies, scene.dt_ns / 1e9, push=1.0 if e == "s" else -1.0)
    except BaseException:
        bus.close()
        raise
