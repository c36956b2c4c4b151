"""The device at a live end, as the loop trusts it: what fails or is not finite never reaches the law or the motor."""

from __future__ import annotations

from contextlib import suppress
from math import inf, isfinite, isnan
from numbers import Real
from typing import Any, Protocol

from teleop.errors import DeviceError, Refused, number, number_of
from teleop.protocol.endpoint import Axes, Endpoint, Reading
from teleop.protocol.switches import switches_of
from teleop.simulation.trace import ForceSource

DEAD_NS = 2_000_000_000  # a device that fails for so long is not waited for
_FLOAT = frozenset((float,))


class LiveDevice(Protocol):
    """A master device or a slave robot, as the live loop uses it.

    **A force that `hold` has set has to lapse to zero at the device itself when it is not renewed for a stated time.**
    Of a process that is killed or stopped, or that hangs in a driver, no line runs any more that could let go; it would
    push the hand for ever. A device whose hardware lapses has an attribute `deadline`, that time in s (0.15, say: a
    machine may stall for 0.07); the end renews at every tick and takes a longer stall of its own for a force that was
    let go. A device whose hardware cannot has an attribute `watchdog`, a `teleop.DeviceWatchdog`: a process beside the
    end that does it. Of a device that has neither the end says so at its start and in its summary.

    What cannot be read or held raises `DeviceError`, or an OSError: the end is safe until it can again. Both functions
    are called from one thread, but for one case: where one of them does not return, a second signal has `hold` called
    with zeros from another thread. It should then not wait without a bound for a lock that the first call has.

    It may have `close()`, called once, the last of all, with the force at zero; what that raises is told. An attribute
    `senses` says whether it has a force sensor, and its readings are held to that. One `simulated` that is true says
    that no machine moves, so that `check_device` pushes it without being asked to. One `scene_body` that is true says
    that it simulates the scene's own body: a force that it does not sense is then worked out from its motion after the
    run. Of any other device there is the force that it senses, or none.

    One that holds a force of its own beside the law's, such as its arm's weight, says so by an attribute `carries`. It
    has `lower()`, which ends that along a ramp of a second at most while the loop goes on reading and holding zeros,
    and `let_go(zero)`, which ends all force at once; of others `hold` of zeros does.
    """

    def read(self, k: int) -> Reading:
        """Read the state at tick k; the force held since the last reading acted until now.

        Tick 0 is asked for more than once: before the first exchange, and before the run. After that k only grows.
        A number may be of any real type (int, numpy's scalars); what is none (bool, str, None, complex) is refused.
        A switch is a bool, at every tick, or None at every tick.
        """
        ...

    def hold(self, force: Axes) -> None:
        """Hold this force (N, per axis) from now on: at the slave along +x, at the master against the hand, -x."""
        ...


def deadline_of(device: LiveDevice, endpoint: Endpoint) -> float | None:
    """After how long (s) a force that is not renewed lapses; None: never, or it does not matter. Raises `Refused`.

    Ends that go by packets have none: their ticks take as long as packets do, and their devices are simulated.
    """
    deadline: float | None = getattr(device, "deadline", None)
    if deadline is None or endpoint.stepped:
        return None
    number("a device's deadline", deadline, above=0.0)
    if endpoint.end_scene.dt > deadline / 2:
        raise Refused(f"the device's force lapses after {deadline:g} s, and this end would renew it every "
                      f"{endpoint.end_scene.dt:g} s; tick at least every {deadline / 2:g} s, by --rate or the "
                      "scene's dt")
    return deadline


def let_go(device: LiveDevice, zero: Axes) -> None:
    """Have a device hold no force at once: one that holds a force of its own by its `let_go`, others by `hold`."""
    getattr(device, "let_go", device.hold)(zero)


def is_simulated(device: LiveDevice) -> bool:
    """True if the device says that no machine moves."""
    return bool(getattr(device, "simulated", False) or getattr(device, "scene_body", False))


class GuardedDevice:
    """A device whose failures are values. `trouble`: its failure now, None if it works.

    `trusted`: its readings are taken as they are. So it is where ends go by packets and must do as in virtual time,
    where a reading that is not finite is a run that diverged.
    """

    def __init__(self, device: LiveDevice, axes: int, *, trusted: bool = False) -> None:
        self.device, self.trusted = device, trusted
        self.trouble: str | None = None
        self.forced = False  # it was given a force, and has not taken zero since
        self.closed = False  # it is given zero alone from now on
        self.sensor: bool | None = None  # it senses the external force; None before its first reading
        self.switches: tuple[str, ...] = ()  # its switches, from its first reading on
        self._fields: tuple[type, ...] = ()  # the types of what a reading holds, from the first one on
        self._floats: tuple[type, ...] = ()  # of its numbers
        self._axes = axes
        self._zero = (0.0,) * axes
        self._held_well = True
        self._failing_ns: int | None = None  # since when; None while it is well

    def read(self, k: int, now: int) -> Reading | None:
        """Read it at tick k, in floats; None: it could not, or a velocity or a force is not finite, or a number is NaN.

        An infinite position passes: it is a body that has left, which ends the run. Raises `Refused` if its first
        reading is not made of numbers; a later one that is not counts as none.
        """
        reading = self._read(k)
        if reading is not None and self._held_well:
            self.trouble = self._failing_ns = None
        else:
            self._failing_ns = now if self._failing_ns is None else self._failing_ns
        return reading

    def _read(self, k: int) -> Reading | None:
        try:
            reading = self.device.read(k)
        except (DeviceError, OSError) as error:
            self.trouble = str(error) or type(error).__name__
            return None
        if type(reading) is Reading and tuple(map(type, reading)) == self._fields:
            x, v, f, _, _ = reading
            numbers = x + v if f is None else x + v + f
            if len(x) == len(v) == self._axes and tuple(map(type, numbers)) == self._floats and isfinite(sum(numbers)):
                return reading  # nearly always; a sum that is not finite may be one of numbers that are
        try:
            reading = _in_floats(reading, len(self._zero))
        except Refused as refused:
            if self.sensor is None:
                raise
            self.trouble = str(refused)
            return None
        numbers = reading.v + (reading.f or ())
        if not self.trusted and (not all(map(isfinite, numbers)) or any(map(isnan, reading.x))):
            self.trouble = "what it reads is not finite"
            return None
        has = switches_of(reading)
        if self.sensor is None:
            self.switches = has
        elif has != self.switches:
            self.trouble = (f"it read {_switch_list(has)} where its first reading had {_switch_list(self.switches)}; a "
                            "device has a switch or none")
            return None
        if (reading.f is not None) is not self.sensor:
            if self.sensor is not None:
                self.trouble = (f"it read {'f=None' if self.sensor else 'a force f'} where its first reading had "
                                f"{'a force f' if self.sensor else 'f=None'}; a device has a force sensor or none")
                return None
            self.sensor = _sensor_of(self.device, reading)
            self._fields, self._floats = tuple(map(type, reading)), (float,) * (self._axes * (2 + self.sensor))
        return reading

    @property
    def force_source(self) -> ForceSource:
        """Source of the external force at this end, for its record; known from its first reading on."""
        return "sensor" if self.sensor else "bodies" if getattr(self.device, "scene_body", False) else "unknown"

    def hold(self, force: Axes) -> bool:
        """Have it hold `force` (N, per axis); True if it took that.

        An exception that is neither DeviceError nor OSError comes through: it is a fault.
        """
        if self.closed:
            force = self._zero
        pushes = any(force)
        if pushes or self.carries:
            self.forced = True
        try:
            if self.closed:
                let_go(self.device, force)
            else:
                self.device.hold(force)
            self._held_well, self.forced = True, pushes or self.carries
        except (DeviceError, OSError) as error:
            self._failed(error)
        return self._held_well

    def let_go(self) -> bool:
        """Have it hold no force, none of its own either, whatever it raises; True if it took that."""
        try:
            let_go(self.device, self._zero)
            self._held_well, self.forced = True, False
        except BaseException as error:
            self._failed(error)
        return self._held_well

    @property
    def carries(self) -> bool:
        """True while it holds a force of its own, beside the one that it was given last."""
        return bool(getattr(self.device, "carries", False))

    def lower(self) -> None:
        """Have it end the force of its own along a ramp, if it has one; what that raises is none of an end's faults."""
        with suppress(Exception):
            getattr(self.device, "lower", lambda: None)()

    def _failed(self, error: BaseException) -> None:
        self._held_well, self.trouble = False, str(error) or type(error).__name__

    def dead(self, now: int) -> bool:
        """True if it has failed for longer than `DEAD_NS`."""
        return self._failing_ns is not None and now - self._failing_ns > DEAD_NS


def _sensor_of(device: LiveDevice, reading: Reading) -> bool:
    """True if this first reading has a force. Raises `Refused` where the device says otherwise."""
    senses, says = reading.f is not None, getattr(device, "senses", None)
    if says is not None and bool(says) is not senses:
        raise Refused(f"the device says senses = {bool(says)} and reads {'a force f' if senses else 'f=None'}; have "
                      "its readings hold f always, or never, as senses says")
    return senses


def _in_floats(reading: Any, axes: int) -> Reading:
    """`reading` with every number as a float. Raises `Refused` if it is not made of numbers, one for each axis."""
    if type(reading) is Reading:
        x, v, f, clutch, present = reading
        clutch, present = _switch("clutch", clutch), _switch("present", present)
        if (type(x) is type(v) is tuple and len(x) == len(v) == axes and _FLOAT.issuperset(map(type, x + v))
                and (f is None or (type(f) is tuple and len(f) == axes and _FLOAT.issuperset(map(type, f))))):
            same = clutch is reading.clutch and present is reading.present
            return reading if same else Reading(x, v, f, clutch, present)
        if all(isinstance(part, tuple) and len(part) == axes and all(map(_is_number, part))
               for part in (x, v, *(() if f is None else (f,)))):
            return Reading(_floats(x), _floats(v), None if f is None else _floats(f), clutch, present)
    had = {len(part) for part in reading[:2] if isinstance(part, tuple)} if isinstance(reading, Reading) else set()
    if len(had) == 1 and had != {axes}:
        n = had.pop()
        raise Refused(f"the device has {number_of(n, 'axis', 'axes')}, for so many numbers has the x that it read, and "
                      f"the scene has {axes}; take a scene of {number_of(n, 'axis', 'axes')} at both ends (--set "
                      f"axes={n} where it has that knob), or another device")
    rest = "," if axes == 1 else "".join(f", {{0}}{axis}" for axis in range(2, axes + 1))
    sample_x, sample_v = (f"({letter}{rest.format(letter)})" for letter in "xv")
    raise Refused("a device's read gives Reading(x, v, f), each a tuple with a number for each axis, here "
                  f"{axes}, in m, m/s and N, f None without a force sensor; this one gave {str(reading)[:99]}; "
                  f"write for example Reading({sample_x}, {sample_v}, None)")


def _switch_list(switches: tuple[str, ...]) -> str:
    return " and ".join(switches) if switches else "no switch"


def _switch(name: str, value: Any) -> Any:
    """The state of a switch as a truth of Python's; one of numpy's counts. Raises `Refused`."""
    if value is None or value is True or value is False or (name == "clutch" and value in ("translation", "rotation")):
        return value
    if getattr(getattr(value, "dtype", None), "kind", "") == "b" and getattr(value, "shape", None) == ():
        return bool(value)
    raise Refused(f"a device's read gives {name}=True or {name}=False, or None where it has no such switch; this one "
                  f"gave {str(value)[:40]!r}; write for example Reading(x, v, f, {name}=True)")


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _floats(part: Any) -> Axes:
    return tuple(map(_to_float, part))


def _to_float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:  # a whole number beyond all floats
        return inf if value > 0 else -inf
