"""A device without its arm's weight, Coriolis torques and friction, by a model; and the torque of what touches it.

    python -m slave bench_top --set axes=7 --set units=rad --robot "compensated:arm.xml?friction=0.7 | openarm:can0"

The law's torque goes to the motors with the model's beside it, u = law + c, which the law is not told of:

    c = clip(h(q, v) - M' v/2 + s F tanh(v/v_s), limit), times a gain that ramps in from 0, within a slew limit.

**Weight.** g(q) is the slope of a potential, so its compensation makes no energy, but for what holding it over a tick
leaves: at most |dq|^T |dg/dq| |dq|/2 a tick, which joints with a damping above |dg/dq| dt/2 take up, and with readings
d ticks old above |dg/dq| dt (1/2 + d). Of a Panda that is 0.03 N m s/rad.

**Coriolis.** Compensating all of C v is not passive: of M(q) v' = u the energy v^T M v/2 grows by v^T M' v/2 that
nobody puts in. A mass on a rail that turns gives m w^2 (r2^2 - r1^2)/2 each time it is let out turning and drawn in
standing. What is compensated is the part without power, C v - M' v/2, for v^T (C - M'/2) v = 0. What is left,
M v' + M' v/2 = u, has an energy that grows by the work of u alone. M' is the change of M since the tick before.

**Friction.** s F tanh(v/v_s) with s < 1 of the file's `frictionloss` F does at most s F |dx| of work in a tick,
whatever was read, how late, and how noisy, and friction of F takes F |dx| from a joint that moves. So it never drives
while s F is at most the friction of the joint; where the file says more than the joint has, it does. Viscous damping
stays.

**The momentum observer** (De Luca and Mattone, ICRA 2003) is r = K (p - int(u + C^T v - g + r) dt - p(0)), p = M v, so
r' = K (f - r): the torque f of what touches the arm behind a low-pass. With M at its mean over a tick,
d(M v) - int M' v dt = M dv to second order, so it is the observer of `teleop.stages.observer` with the arm's momentum,

    f_mean(k) = M dv/dt + h + friction - u,        r += (1 - exp(-K dt)) (f_mean - r),

h and friction at their mean of both ticks. For a torque held over the tick and constant M and h it is exact; else off
by terms in dt^2 of M' v'', M'' v' and h''. It comes 1/K + dt/2 late. White noise of v of rms e leaves K M e in r;
counts of an encoder of size d, differentiated, some K M d/(sqrt(6) dt). Friction that the file has not is in r: an arm
that moves tells the torque less friction, and one that stands up to F of what the friction holds. A motor that gives
another torque than it was given, as at its own limit, is told as a touch.

**What ends it.** The weight stays compensated in a safe state, while the law's force is let go: an arm that loses both
falls, and a potential does no work on whoever holds it. It ends where the end cannot know that it is right: without a
reading for 0.1 s, of which the second half lowers it; after a stall in which the device has let go; where the device
did not take a force. After the run it is lowered along its ramp, and an arm without brakes sinks. `let_go`, a second
signal, and the device's own deadline or watchdog process end it at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import expm1, isfinite
from typing import Any

import numpy as np

from teleop.errors import DeviceError, Refused, number
from teleop.live.devices.arm_model import ArmModel, Dynamics
from teleop.live.devices.guarded_device import LiveDevice, let_go
from teleop.live.devices.settings import for_each, numbers, positive, settings_of, within
from teleop.protocol.endpoint import Axes, Reading
from teleop.protocol.guard import BLIND_NS, LAPSING
from teleop.scene.axes import FORCE_UNIT
from teleop.scene.scene import Scene
from teleop.stages.observer import Coefficients, observe

EXAMPLE = "compensated:arm.xml?friction=0.7 | openarm:can0"
MARGIN = 1.25  # of the greatest torque that the model was found to need, where no limit is typed
MOST_SHARE = 0.9  # of the file's friction
SLEW_S = 0.05  # in which a torque may come from 0 to its limit
BANDWIDTH = 100.0  # 1/s, of the observer of a device without a force sensor
BLIND_S = BLIND_NS / 1e9
LONGEST_S = 0.02  # s between two ticks of an end by which a ramp goes: what is longer was a stall
KEPT = ("deadline", "watchdog", "simulated", "passive", "bus")  # attributes that are the device's


class Compensated:
    """`device` at the end `e`, "m" or "s", whose motors carry the arm of `model` beside the law's torque.

    `friction`: the share of the file's friction that is compensated, at most 0.9; a number for all joints, or one for
    each. `limit` (N m, of slides N): the most that the compensation gives a joint, beside the law's own caps; left out,
    1.25 of the most that the model needs among 500 states. `ramp` (s): in which it comes and goes. `slow` (rad/s or
    m/s): speed below which its friction fades. `observer` (1/s): bandwidth of the momentum observer, whose torque the
    readings have as f; left out, 100 where the device has no force sensor, whose readings stay where it has one. Raises
    `Refused`.
    """

    scene_body = False

    def __init__(self, device: LiveDevice, model: ArmModel, *, e: str = "s", dt: float = 1e-3,
                 friction: float | Sequence[float] = 0.0, limit: float | Sequence[float] | None = None,
                 ramp: float = 0.5, slow: float = 0.05, observer: float | None = None) -> None:
        if getattr(device, "weightless", False) or getattr(device, "scene_body", False):
            raise Refused("this device's arm has no weight that a model could carry: servos of positions, a Franka and "
                          "simulated bodies carry their own, and a robot in MuJoCo unless ?gravcomp=0 stands behind "
                          "its file; leave the compensation out, or write that")
        self.device, self.model, self._push = device, model, 1.0 if e == "s" else -1.0
        n = len(model.names)
        shares = _per_joint("friction", friction, n, low=0.0, high=MOST_SHARE)
        self._dt, self._slow = number("dt", dt, above=0.0), number("slow", slow, above=0.0)
        self._step = self._dt / number("ramp", ramp, low=0.05, high=1.0)
        self._friction = np.array(shares) * model.friction
        self.limit = MARGIN * model.most + self._friction if limit is None else np.array(
            _per_joint("limit", limit, n, above=0.0))
        self._K = None if observer is None else number("observer", observer, above=0.0)
        for name in KEPT:
            if hasattr(device, name):
                setattr(self, name, getattr(device, name))
        self._lapse = LAPSING * getattr(device, "deadline", np.inf)  # s
        self._zero = (0.0,) * n
        self._senses: bool | None = None  # the device does; None before its first reading
        self._cut = np.zeros(n, int)  # ticks at which each joint's limit cut
        self._k = self._tried = 0  # the tick of the last reading, and the last that was to have one
        self._every = self._passed = 1  # ticks of the grid in one of this end: as many as passed twice in a row
        self._before: tuple[Any, Dynamics] | None = None  # velocity and dynamics at the last reading
        self._lowers = False
        self._forget()

    def _forget(self) -> None:
        """Begin at no torque, along the ramp."""
        self._gain, self._unread = 0.0, 0
        self._wanted = self._carried = np.zeros(len(self._zero))
        self._u, self._touch = np.zeros(len(self._zero)), [0.0] * len(self._zero)
        self._before = None

    @property
    def carries(self) -> bool:
        """True while it holds a torque of its own."""
        return bool(self._carried.any())

    @property
    def notes(self) -> list[str]:
        """Sentences for the summary: those of the device, and the joints whose compensation its limit cut."""
        cut = [f"{name} at {ticks} ticks (limit {most:.3g} {FORCE_UNIT[unit]})" for name, ticks, most, unit in zip(
            self.model.names, self._cut.tolist(), self.limit.tolist(), self.model.units, strict=True) if ticks]
        return [*getattr(self.device, "notes", ()), *([
            f"the compensation was cut to its limit: {', '.join(cut)}; type a greater ?limit= if the arm's motors "
            "and its model are right"] if cut else [])]

    def read(self, k: int) -> Reading:
        """Read the device, compute what its joints need, and put the observer's torque into f."""
        passed, self._tried = k - self._tried, k
        if passed * self._dt > self._lapse or self._fading() == 0.0:
            self._forget()
        reading = self.device.read(k)
        if self._senses is None:
            self._senses = reading.f is not None
            self._K = (None if self._senses else BANDWIDTH) if self._K is None else self._K
        if not all(map(isfinite, (*reading.x, *reading.v))):  # as it is: the end judges it
            return reading if self._K is None else reading._replace(f=self._zero)
        ticks = k - self._k
        if ticks == self._passed and ticks * self._dt <= LONGEST_S:
            self._every = max(1, ticks)
        self._passed = ticks or self._passed
        steady = self._unread < 2  # one torque was held since the last reading
        self._gain *= self._fading()  # what readings that failed have taken
        self._k, self._unread = k, 0
        v = np.array(reading.v)
        now = self.model.at(reading.x, v)
        if self._before is None or ticks > 0:
            self._want(v, now, max(1, ticks) * self._dt)
            if steady and ticks > 0 and self._before is not None and self._K is not None:
                self._observe(v, now, ticks * self._dt)
            self._before = v, now
        if not self._lowers:
            self._gain = min(1.0, self._gain + self._every * self._step)
        return reading if self._K is None else reading._replace(
            f=tuple([-self._push * each for each in self._touch]))

    def hold(self, force: Axes) -> None:
        """Hold the law's `force`, and the compensation beside it. What the device does not take begins again at 0."""
        self._unread += 1
        if self._lowers:
            self._gain = max(0.0, self._gain - self._every * self._step)
        reach = self.limit * (self._every * self._dt / SLEW_S)
        target = self._gain * self._fading() * self._wanted
        self._carried = np.minimum(np.maximum(target, self._carried - reach), self._carried + reach)
        total = force + self._push * self._carried
        self._u = self._push * total
        try:
            self.device.hold(tuple(total.tolist()))
        except (DeviceError, OSError):
            self._forget()
            raise

    def lower(self) -> None:
        """End the compensation along its ramp, from the next `hold` on: the run is over."""
        self._lowers = True

    def let_go(self, zero: Axes) -> None:
        """Hold nothing, at once."""
        self._forget()
        let_go(self.device, zero)

    def close(self) -> None:
        """Close the device, if that can be."""
        getattr(self.device, "close", lambda: None)()

    def _fading(self) -> float:
        """Share that is left after so many forces without a reading: it falls in the second half of `BLIND_S`."""
        if self._unread < 2:  # nearly always
            return 1.0
        passed = (self._unread - 1) * self._every * self._dt
        return max(0.0, min(1.0, 2.0 - 2.0 * passed / BLIND_S))

    def _want(self, v: Any, now: Dynamics, span: float) -> None:
        """Find the torques that the joints need, within their limits, `span` s after the last reading."""
        inertia = now.inertia if self._before is None else self._before[1].inertia
        needed = now.torque - (now.inertia - inertia) @ v / (2.0 * span)
        needed += self._friction * np.tanh(v / self._slow)
        if not isfinite(needed.sum()):  # of a reading that no arm has
            needed = np.zeros(len(v))
        self._wanted = np.minimum(np.maximum(needed, -self.limit), self.limit)
        self._cut += self._wanted != needed

    def _observe(self, v: Any, now: Dynamics, span: float) -> None:
        """Take the torque of whatever touches the arm on by `span` s."""
        assert self._before is not None
        assert self._K is not None
        v_before, before = self._before
        momentum = 0.5 * (now.inertia + before.inertia) @ (v - v_before)
        mean = 0.5 * (v + v_before)
        held = 0.5 * (now.torque + before.torque) - self._u + (
            self.model.damping * mean + self.model.friction * np.tanh(mean / self._slow))
        c = Coefficients(1.0, 1.0 / span, -expm1(-self._K * span))
        self._touch = [observe(c, each, 0.0, gained, rest) for each, gained, rest in zip(
            self._touch, momentum.tolist(), held.tolist(), strict=True)]
        if not isfinite(sum(self._touch)):
            self._touch = [0.0] * len(self._touch)


def _per_joint(name: str, values: float | Sequence[float], joints: int, *, low: float | None = None,
               above: float | None = None, high: float | None = None) -> tuple[float, ...]:
    """Return a number for each joint, within bounds. Raises `Refused`."""
    several = (values,) if isinstance(values, int | float) else tuple(values)
    return for_each(name, tuple([number(name, each, low=low, above=above, high=high) for each in several]), joints)


def _shares(name: str, text: str) -> tuple[float, ...]:
    read = within(0.0, MOST_SHARE)
    return tuple([read(name, each) for each in text.split(",")])


READERS = {"friction": _shares, "limit": numbers, "ramp": within(0.05, 1.0), "slow": positive, "observer": positive,
           "joints": lambda _name, text: tuple(text.split(","))}


def _open(scene: Scene, arm: str, e: str) -> Compensated:
    """Open the device behind the `|` of MODEL.xml?settings | DEVICE. Raises `Refused`."""
    from teleop.live.devices.opening import find_device

    model, _, device = (each.strip() for each in arm.partition("|"))
    if not device:
        raise Refused(f"compensated names a model and, behind a |, the device whose arm it is, not {arm!r}; write for "
                      f"example {EXAMPLE}")
    file, settings = settings_of("compensated", model, READERS, EXAMPLE)
    arm_model = ArmModel(file, scene, settings.pop("joints", ()))
    opened = find_device(e, device).open(scene)
    try:
        return Compensated(opened, arm_model, e=e, dt=scene.dt, **settings)
    except BaseException:
        getattr(opened, "close", lambda: None)()
        raise


def compensated_device(scene: Scene, arm: str) -> Compensated:
    """Any device with its arm's weight carried, compensated:ARM.xml | DEVICE, see teleop/live/devices/README.md."""
    return _open(scene, arm, "m")


def compensated_robot(scene: Scene, arm: str) -> Compensated:
    """Any robot with its arm's weight carried, compensated:ARM.xml | ROBOT, see teleop/live/devices/README.md."""
    return _open(scene, arm, "s")
