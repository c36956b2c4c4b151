"""Hands: a mass-spring-damper grip, and the references that it follows.

A reference is sampled at the ticks, `t = k*dt_ns/1e9`, and is straight in between. A parameter with a
direction is a number, which means along the first axis, or a tuple with one entry for each axis.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from math import pi, sin
from typing import TYPE_CHECKING

from teleop.errors import Refused, number, number_of

if TYPE_CHECKING:
    from teleop.scene.parts import Reference, Vector


@dataclass(frozen=True, kw_only=True, slots=True)
class Grip:
    """A hand that holds the master: `mass` (kg), spring `k` (N/m), damper `d` (N s/m) to a `reference`.

    Hand and master are one body, since the grip has no slack; all three may be 0.
    """

    mass: float
    k: float
    d: float
    reference: Reference

    def __post_init__(self) -> None:
        for name in ("mass", "k", "d"):
            object.__setattr__(self, name, number(name, getattr(self, name), low=0.0))
        if not callable(getattr(self.reference, "samples", None)):
            raise Refused(f"reference must be something that a hand can follow, not {self.reference!r}; "
                          "write for example reference=Rest(at=0.0)")


@dataclass(frozen=True, kw_only=True, slots=True)
class Sine:
    """Sinusoidal reference `amplitude sin(2 pi frequency t)`: amplitude in m (with a direction), frequency in Hz.

    Samples cannot show more than half their own rate: a faster sine is refused.
    """

    amplitude: Vector
    frequency: float

    def __post_init__(self) -> None:
        vector("amplitude", self.amplitude)
        number("frequency", self.frequency, low=0.0)

    def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> tuple[array[float], ...]:
        """For each axis the position (m) at the ticks first .. first+count-1."""
        if self.frequency * dt_ns > 0.5e9:
            raise Refused(f"a sine of {self.frequency:g} Hz is more than half the tick rate, {0.5e9 / dt_ns:g} Hz; "
                          "write a frequency of at most that, or a smaller dt")
        omega = 2.0 * pi * self.frequency
        wave = array("d", (sin(omega * (k * dt_ns / 1e9)) for k in range(first, first + count)))
        return tuple(array("d", (a * y for y in wave)) for a in along("amplitude", self.amplitude, axes))


@dataclass(frozen=True, kw_only=True, slots=True)
class Reach:
    """Minimum-jerk reach from `origin` to `to` (m, with a direction).

    It begins at `start` and takes `duration` (s), with rest before and after:
    `origin + (to - origin)(10 s^3 - 15 s^4 + 6 s^5)`, `s = (t - start)/duration` held to [0, 1]. Flash and
    Hogan, "The coordination of arm movements: an experimentally confirmed mathematical model", J. Neurosci.
    5 (1985).
    """

    to: Vector
    start: float = 0.0
    duration: float
    origin: Vector = 0.0

    def __post_init__(self) -> None:
        vector("to", self.to)
        number("start", self.start)
        number("duration", self.duration, above=0.0)
        vector("origin", self.origin)

    def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> tuple[array[float], ...]:
        """For each axis the position (m) at the ticks first .. first+count-1."""
        times = ((k * dt_ns / 1e9 - self.start) / self.duration for k in range(first, first + count))
        path = array("d", (min(s * s * s * (10.0 + s * (6.0 * s - 15.0)), 1.0) if 0.0 < s < 1.0 else float(s > 0.0)
                           for s in times))
        ends = zip(along("origin", self.origin, axes), along("to", self.to, axes), strict=True)
        # the last point is `to` itself, which origin + (to - origin) need not be
        return tuple(array("d", (b if y == 1.0 else a + (b - a) * y for y in path)) for a, b in ends)


@dataclass(frozen=True, kw_only=True, slots=True)
class Rest:
    """Constant reference at `at` (m, with a direction)."""

    at: Vector = 0.0

    def __post_init__(self) -> None:
        vector("at", self.at)

    def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> tuple[array[float], ...]:
        """For each axis the position (m) at the ticks first .. first+count-1."""
        return tuple(array("d", [a]) * count for a in along("at", self.at, axes))


def vector(name: str, value: Vector) -> tuple[float, ...]:
    """Convert `value` to a tuple of floats. Raises `Refused` if it is neither a number nor a tuple of numbers."""
    if not isinstance(value, tuple):
        return (number(name, value),)
    if not value:
        raise Refused(f"{name} must have an entry for each axis; write for example {name}=(0.1, 0.0, 0.0)")
    return tuple(number(f"{name}[{i}]", entry) for i, entry in enumerate(value))


def along(name: str, value: Vector, axes: int) -> tuple[float, ...]:
    """Extend `value` to one entry for each axis. Raises `Refused` for a tuple of another length."""
    entries = vector(name, value)
    if not isinstance(value, tuple):
        return entries + (0.0,) * (axes - 1)
    if len(entries) != axes:
        raise Refused(f"{name}={value} has {number_of(len(entries), 'entry', 'entries')}, the scene has axes={axes}; "
                      "write a number, which means along the first axis, or one entry for each")
    return entries
