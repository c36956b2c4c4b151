"""A scene whose hand turns a tool about an axis that moves itself, for tests of rotations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from channel.delay import Delay
from master.hand import Grip
from teleop import MassDamper, PositionPosition, Scene
from teleop.physics.rotation import product, turned


@dataclass(frozen=True)
class Tumble:
    """phi of an angular velocity of 2.5 rad/s whose axis turns about z; at rest from `until` s on."""

    until: float = 3.0

    def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> tuple[list[float], ...]:
        t = np.arange(first, first + count) * dt_ns / 1e9
        s = self.until * np.clip(t / self.until, 0.0, 1.0)
        s = s * s * (3.0 - 2.0 * s / self.until) / self.until  # starts and stops without a jump
        return (0.75 * np.sin(2.0 * s)).tolist(), (0.75 * (1.0 - np.cos(2.0 * s))).tolist(), (2.0 * s).tolist()


def tumbling(**parts: Any) -> Scene:
    """Three axes that are a rotation; moments of inertia in kg m^2, stiffness in N m/rad."""
    return Scene(**{
        "law": PositionPosition(K=1.0, B=0.01), "axes": 3, "rotations": (0,),
        "hand": Grip(mass=0.001, k=2.0, d=0.05, reference=Tumble()), "master": MassDamper(mass=0.001, damping=0.005),
        "slave": MassDamper(mass=0.002, damping=0.005), "link": Delay(0.02), "energy": True, "duration": 5.0, **parts})


def orientations(trace: Any, e: str) -> np.ndarray:
    """The quaternion of an end at every tick as it is recorded: (ticks, 4)."""
    return np.stack([trace[f"q{part}_{e}"] for part in "wxyz"], axis=1)


def counted(phi: np.ndarray) -> np.ndarray:
    """The same by the increments of phi, (ticks, 3)."""
    q = [turned(1.0, 0.0, 0.0, 0.0, *phi[0])]
    for d in np.diff(phi, axis=0).tolist():
        q.append(turned(*q[-1], *d))
    return np.array(q)


def apart(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """The angle from one orientation to the other at every tick, rad."""
    w, x, y, z = product(*q.T, *(p * (1.0, -1.0, -1.0, -1.0)).T)
    return 2.0 * np.arctan2(np.sqrt(x * x + y * y + z * z), np.abs(w))
