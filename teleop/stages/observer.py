"""The human-force observer: f_h from the master's estimate motion, where there is no force sensor.

Derivation. Without the hand the master obeys M_m dv/dt + b_m v = f_h - f_m with f_m held over a tick.
Over one tick, with e = exp(-b_m dt/M_m),

    v(k) = e v(k-1) + (1 - e)/b_m (f_bar - f_m(k-1)),

where f_bar is the mean of f_h over the tick weighted with exp(-b_m (t_k - t)/M_m). Solved for it,

    f_bar(k) = b_m (v(k) - e v(k-1))/(1 - e) + f_m(k-1)      (b_m = 0: M_m (v(k) - v(k-1))/dt + f_m(k-1)),

exact for exact velocities and the force really held. A first-order filter of bandwidth L follows:
f_h_hat += (1 - exp(-L dt)) (f_bar - f_h_hat). M_m and b_m are the device's estimate, without the hand.
"""

from __future__ import annotations

from math import exp, expm1
from typing import Any, ClassVar, NamedTuple

from teleop.stages.end import Column, End, Places, Record, Run, Stage, per_axis


class Coefficients(NamedTuple):
    e: float  # exp(-b_m dt/M_m)
    gain: float  # b_m/(1 - e), or M_m/dt for b_m = 0; kg/s
    rate: float  # 1 - exp(-L dt)


def coefficients(L: float, mass: float, damping: float, dt: float) -> Coefficients:
    """The numbers one tick needs: bandwidth L (1/s), device mass (kg) and damping (N s/m), tick (s)."""
    decay = damping * dt / mass
    # (1 - e)/decay -> 1 for a vanishing damping: the gain is then M_m/dt.
    gain = damping / -expm1(-decay) if decay > 0.0 else mass / dt
    return Coefficients(exp(-decay), gain, -expm1(-L * dt))


def observe(c: Coefficients, f_h_hat: float, v_before: float, v: float, f_held: float) -> float:
    """`f_h_hat` after the tick over which the velocity went from `v_before` to `v` under `f_held`. N."""
    e, gain, rate = c
    return f_h_hat + rate * (gain * (v - e * v_before) + f_held - f_h_hat)


class Observed(Record):
    """The observer in one axis."""

    v_before: float  # as it was read at the tick before, m/s
    c_obs: Coefficients


class ObserverStage(Stage):
    """Estimate of the hand's force, which the law reads. Recorded as `f_h_hat`."""

    name: ClassVar[str] = "observer"
    axis_kind: ClassVar[type[Record]] = Observed
    c_tick: tuple[Coefficients, ...]  # for each axis, over one tick
    device: tuple[tuple[float, float, float], ...]  # L, mass, damping

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        bodies = [getattr(each, "body", each) for each in scene.per_axis("master")]
        devices = tuple([(scene.observer, body.mass, body.damping) for body in bodies])
        return tuple([coefficients(*device, dt) for device in devices]), devices

    def columns(self, e: End) -> tuple[Column, ...]:
        return (per_axis("f_h_hat", e.axes, "f_read"),)

    def memory(self, e: End) -> tuple[tuple[Record, str], ...]:
        return tuple([cell for a, estimate in zip(e.axes, self.axes, strict=True)
                      for cell in ((estimate, "v_before"), (a, "f_read"))])

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        if e.has.leaves_out:
            self.c_tick = numbers[0]
            self.device = numbers[1]
        for a, estimate in zip(e.axes, self.axes, strict=True):
            estimate.c_obs = numbers[0][a.i]
            estimate.v_before = a.v_read
            a.f_read = 0.0

    def late(self, run: Run, e: End, ticks: int, since: int) -> None:
        # After ticks that were left out the force was held over all of them.
        for a, estimate in zip(e.axes, self.axes, strict=True):
            estimate.c_obs = self.c_tick[a.i] if ticks == 1 else coefficients(
                self.device[a.i][0], self.device[a.i][1], self.device[a.i][2], e.span)

    def read(self, run: Run, e: End, k: int) -> None:
        for a, estimate in zip(e.axes, self.axes, strict=True):
            a.f_read = observe(estimate.c_obs, a.f_read, estimate.v_before, a.v_read, a.f)
            estimate.v_before = a.v_read
