"""The device at a live end, as the loop trusts it: what fails or is not finite never reaches the law or the motor."""

from __future__ import annotations

from math import isfinite, isnan
from typing import Protocol

from teleop.endpoint import Axes, Reading
from teleop.errors import DeviceError, Refused

DEAD_NS = 2_000_000_000  # a device that fails for so long is not waited for


class Device(Protocol):
    """A master device or a slave robot, as the live loop uses it.

    What cannot be read or held raises `DeviceError`, or an OSError: the end is safe until it can again.
    """

    def read(self, k: int) -> Reading:
        """What it reads at tick k; the force held since the last reading acted until now."""
        ...

    def hold(self, force: Axes) -> None:
        """Hold this force (N, per axis) from now on: at the slave along +x, at the master against the hand, -x."""
        ...


class Stand:
    """A device whose failures are values. `trouble`: what is wrong with it now, None if nothing is.

    `trusted`: what it reads is taken as it is. So it is where ends go by packets and must do as in virtual time, where
    what is not finite is a run that diverged.
    """

    def __init__(self, device: Device, axes: int, *, trusted: bool = False) -> None:
        self.device, self.trusted = device, trusted
        self.trouble: str | None = None
        self._zero = (0.0,) * axes
        self._held_well, self._known = True, False
        self._sound_ns: int | None = None  # when it was last well, or first asked

    def read(self, k: int, now: int) -> Reading | None:
        """What it reads at tick k; None: it could not, or a velocity, a force or NaN among it is not finite.

        A position that is infinite is let through: it is a body that has left, which ends the run.
        """
        if self._sound_ns is None:
            self._sound_ns = now
        try:
            reading = self.device.read(k)
        except (DeviceError, OSError) as error:
            self.trouble = str(error) or type(error).__name__
            return None
        if not self._known:
            self._check(reading)
        if not self.trusted and not self._is_sound(reading):
            self.trouble = "what it reads is not finite"
            return None
        if self._held_well:
            self.trouble, self._sound_ns = None, now
        return reading

    def hold(self, force: Axes) -> None:
        """Have it hold `force` (N, per axis)."""
        try:
            self.device.hold(force)
            self._held_well = True
        except (DeviceError, OSError) as error:
            self._held_well, self.trouble = False, str(error) or type(error).__name__

    def let_go(self) -> None:
        """Have it hold no force."""
        self.hold(self._zero)

    def dead(self, now: int) -> bool:
        """Has it failed for so long that it is not worth waiting for?"""
        return self._sound_ns is not None and now - self._sound_ns > DEAD_NS

    def _check(self, reading: Reading) -> None:
        """Refuse a device that reads something else than it should, at its first reading."""
        axes, self._known = len(self._zero), True
        parts = [part for part in reading if part is not None] if isinstance(reading, Reading) else []
        if not parts or any(not isinstance(part, tuple) or len(part) != axes for part in parts):
            x, v = (f"({letter}{',' if axes == 1 else f', {letter}2' * (axes - 1)})" for letter in "xv")
            raise Refused("a device's read gives Reading(x, v, f), each a tuple with a number for each axis, here "
                          f"{axes}, in m, m/s and N, f None without a force sensor; this one gave {str(reading)[:99]}; "
                          f"write for example Reading({x}, {v}, None)")

    @staticmethod
    def _is_sound(reading: Reading) -> bool:
        return all(map(isfinite, reading.v + (reading.f or ()))) and not any(map(isnan, reading.x))
