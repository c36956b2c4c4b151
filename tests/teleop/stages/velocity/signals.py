"""Motions with known velocities, read through an encoder, and what an estimator makes of the readings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import cos, floor, pi, sin, sqrt
from typing import Any

T = 1e-3  # s


def velocities(estimator: Any, readings: Sequence[float], dt: float = T) -> list[float]:
    """The estimate at each reading, zero at the first, which is the start."""
    c, s = estimator.coefficients(dt), estimator.start(readings[0])
    found = [0.0]
    for x in readings[1:]:
        v, s = estimator.step(c, s, x, dt)
        found.append(v)
    return found


def ramp(v: float, count: int, dt: float = T) -> list[float]:
    return [v * (k * dt) for k in range(count)]


def driven(accelerations: Iterable[float], v: float = 0.0, dt: float = T) -> tuple[list[float], list[float]]:
    """Positions and velocities at the ticks under accelerations held for a tick each, exactly, from 0 m."""
    x, xs, vs = 0.0, [], []
    for a in accelerations:
        xs.append(x)
        vs.append(v)
        x, v = x + dt * (v + 0.5 * dt * a), v + dt * a
    return xs, vs


def sine(count: int, amplitude: float = 0.01, frequency: float = 1.0) -> tuple[list[float], list[float]]:
    omega = 2.0 * pi * frequency
    times = [k * T for k in range(count)]
    return [amplitude * sin(omega * t) for t in times], [amplitude * omega * cos(omega * t) for t in times]


def floored(xs: Iterable[float], step: float, phase: float = 0.0) -> list[float]:
    return [step * floor(x / step + phase) for x in xs]


def rms(found: Sequence[float], true: Sequence[float]) -> float:
    return sqrt(sum((a - b) ** 2 for a, b in zip(found, true, strict=True)) / len(found))
