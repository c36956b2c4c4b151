"""Differences between two runs of a scene: errors of its quantities, and contacts that one of them missed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.scene.scene import Scene
from teleop.simulation.integrators.parts import slave_of
from teleop.simulation.metrics import magnitude

SERIES = {"x_s": "m", "x_m": "m", "f_env": "N"}
NEAR = 10  # ticks: contacts nearer than this are one, and another run's may be off by as much


class Error(NamedTuple):
    """Error of one quantity: the largest, the root mean square, and that at the last tick (NaN: it ended before)."""

    max: float
    rms: float
    end: float


def distance(name: str, got: Mapping[str, Any], want: Mapping[str, Any]) -> NDArray[np.float64]:
    """Magnitude of the difference at every tick that both runs had."""
    n = min(len(got["t"]), len(want["t"]))
    with np.errstate(all="ignore"):
        size: NDArray[np.float64] = magnitude(got[name][:n] - want[name][:n])
    return size


def errors(got: Mapping[str, Any], want: Mapping[str, Any]) -> dict[str, Error]:
    """The error of every quantity of `SERIES`."""
    by_series = {}
    for name in SERIES:
        size = distance(name, got, want)
        with np.errstate(all="ignore"):
            rms = float(np.sqrt(np.mean(size * size)))
        end = float(size[-1]) if len(size) == len(want["t"]) else float("nan")
        by_series[name] = Error(float(size.max()), rms, end)
    return by_series


def peak_ratio(got: Mapping[str, Any], want: Mapping[str, Any]) -> float | None:
    """The largest force on the environment over that of the other run; None where that is 0 or infinite."""
    with np.errstate(all="ignore"):
        mine, theirs = (float(magnitude(trace["f_env"]).max()) for trace in (got, want))
        ratio = mine / theirs if theirs else float("nan")
    return ratio if np.isfinite(ratio) else None


def touching(scene: Scene, trace: Mapping[str, Any]) -> NDArray[np.bool_]:
    """True at ticks where the environment takes a force, at the tick or at any time before the next.

    A contact between two ticks is known from the momentum that is missing: `f_s dt - M dv - b dx` is the impulse on the
    environment. Runge-Kutta methods keep it exactly, being linear in the state; the split ones to `b dt dv`.
    An impulse that friction may have made is not counted.
    """
    body = slave_of(scene)
    m, b, dt = body.mass, body.damping, scene.dt_ns / 1e9
    touching: NDArray[np.bool_] = magnitude(trace["f_env"]) > 0.0
    with np.errstate(all="ignore"):
        dx, dv, push = np.diff(trace["x_s"], axis=0), np.diff(trace["v_s"], axis=0), trace["f_s"][:-1] * dt
        impulse = magnitude(push - m * dv - b * dx)
        size = m * magnitude(trace["v_s"])
        noise = 1e-6 * (size[1:] + size[:-1] + magnitude(push)) + 1.01 * b * dt * magnitude(dv) + 1e-15
        noise += body.friction * dt * scene.axes**0.5
        touching[:-1] |= impulse > noise
    return touching


def contacts(touching: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last tick of every contact: a stretch in which the environment takes a force, short gaps included."""
    at = np.flatnonzero(touching)
    if not len(at):
        return []
    apart = np.flatnonzero(np.diff(at) > NEAR)
    first, last = at[np.concatenate([[0], apart + 1])], at[np.concatenate([apart, [len(at) - 1]])]
    return list(zip(first.tolist(), last.tolist(), strict=True))


def missed(touching: NDArray[np.bool_], touches: list[tuple[int, int]]) -> int:
    """Number of these contacts that a run lasted through and never touched, `NEAR` ticks before and after included."""
    lived = [(first, last) for first, last in touches if last < len(touching)]
    return sum(not touching[max(first - NEAR, 0) : last + NEAR + 1].any() for first, last in lived)


@dataclass(slots=True)
class Steps:
    """Comparison of single steps: their count, and the largest differences.

    A step is one body in one axis over one tick.
    """

    count: int = 0
    integrated: int = 0  # by the stack itself, without a closed form
    changes: int = 0  # steps in which the reference located a change of contact or of sticking
    gave_up: int = 0  # steps that the reference's integrator did not finish
    x: float = 0.0  # largest difference, m
    v: float = 0.0  # largest difference, m/s

    def add(self, stack: tuple[float, float], reference: tuple[float, float], *, changed: bool, integrated: bool = False
            ) -> None:
        """Count one step: (x, v) after the stack's own and after the reference's. What diverged is not compared."""
        self.count += 1
        self.changes += changed
        self.integrated += integrated
        if not all(map(isfinite, stack)):
            return
        dx, dv = abs(stack[0] - reference[0]), abs(stack[1] - reference[1])
        if isfinite(dx + dv):
            self.x, self.v = max(self.x, dx), max(self.v, dv)
        else:
            self.gave_up += 1
