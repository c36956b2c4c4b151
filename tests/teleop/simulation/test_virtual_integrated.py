"""The canonical scene against an independent reference: its equations, and integrators made by others."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin, sqrt
from typing import ClassVar

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from teleop.laws.wave import Wave
from teleop.scene.loading import load_scene
from teleop.simulation.virtual import run


@dataclass
class Reference:
    """The canonical scene as its equations say, by general-purpose integrators.

    The gripped master goes by a matrix exponential of the whole state (x, v, x_ref, v_ref, f), the slave by
    DOP853 with the changes of contact located as events; waves go through plain lists. Nothing of the stack
    is used.
    """

    b: float = 2.0
    K: float = 500.0
    B: float = 20.0
    delay: int = 50
    dt: float = 1e-3

    k_e: ClassVar[float] = 5000.0
    d_e: ClassVar[float] = 5.0
    at: ClassVar[float] = 0.03

    def __post_init__(self) -> None:
        M, b_m, k_h, d_h = 0.1 + 0.4, 0.5, 200.0, 5.0
        rates = np.zeros((5, 5))
        rates[0, 1] = rates[2, 3] = 1.0
        rates[1] = np.array([-k_h, -(d_h + b_m), k_h, d_h, -1.0]) / M
        self.master_step = expm(rates * self.dt)
        self.contacts = 0

    def slave_step(self, x: float, v: float, f: float) -> tuple[float, float]:
        """0.5 kg and 1 N s/m beside a wall that cannot pull, f held."""
        def push(y: np.ndarray) -> float:
            return self.k_e * (y[0] - self.at) + self.d_e * y[1]

        def depth(_: float, y: np.ndarray) -> float:
            return float(y[0] - self.at)

        def grip(_: float, y: np.ndarray) -> float:
            return push(y)

        depth.terminal = grip.terminal = True  # type: ignore[attr-defined]
        t, y = 0.0, np.array([x, v])
        inside = x > self.at or (x == self.at and v > 0.0)
        touching = inside and (x == self.at or push(y) > 0.0)
        while t < self.dt:
            depth.direction = -1.0 if inside else 1.0  # type: ignore[attr-defined]
            grip.direction = -1.0 if touching else 1.0  # type: ignore[attr-defined]
            events = [grip] if touching else [depth, grip] if inside else [depth]
            force = push if touching else lambda _: 0.0
            got = solve_ivp(
                lambda _, y, force=force: [y[1], (f - force(y) - y[1]) / 0.5], (t, self.dt), y,
                method="DOP853", rtol=1e-12, atol=1e-15, events=events,
            )
            t, y = got.t[-1], got.y[:, -1]
            if got.status == 1:
                self.contacts += 1
                if not inside:
                    inside = touching = True
                    y[0] = self.at
                elif touching:
                    touching = False
                else:
                    touching = len(got.t_events) > 1 and len(got.t_events[1]) > 0
                    inside = touching
        return float(y[0]), float(y[1])

    def run(self, ticks: int) -> dict[str, np.ndarray]:
        root, b, K, B, dt = sqrt(2.0 * self.b), self.b, self.K, self.B, self.dt
        x_m = v_m = x_s = v_s = x_d = 0.0
        u_sent, w_sent = [0.0] * self.delay, [0.0] * self.delay
        rows = []
        for k in range(ticks):
            w_m, u_s = w_sent[k], u_sent[k]
            f_m = b * v_m - root * w_m
            u_sent.append(root * v_m - w_m)
            v_d = (root * u_s - K * (x_d - x_s) + B * v_s) / (b + B + K * dt)
            x_d += dt * v_d
            f_s = root * u_s - b * v_d
            w_sent.append(u_s - sqrt(2.0 / b) * f_s)
            rows.append((x_m, v_m, f_m, x_s, v_s, f_s))
            r0, r1 = (0.05 * sin(2.0 * pi * dt * j) for j in (k, k + 1))
            x_m, v_m, *_ = self.master_step @ [x_m, v_m, r0, (r1 - r0) / dt, f_m]
            x_s, v_s = self.slave_step(x_s, v_s, f_s)
        return dict(zip(("x_m", "v_m", "f_m", "x_s", "v_s", "f_s"), np.array(rows).T, strict=True))


@pytest.mark.parametrize("reference", [
    Reference(), Reference(b=0.5, K=4000.0, B=30.0, delay=7), Reference(b=4.0, K=200.0, B=5.0, delay=1),
], ids=["canonical", "stiff", "soft"])
def test_the_canonical_scene_is_what_its_equations_say(reference: Reference) -> None:
    want = reference.run(2000)
    law = Wave(b=reference.b, K=reference.K, B=reference.B)
    got = run(load_scene("canonical", duration=2.0, law=law, delay=reference.delay * 1e-3)).trace
    assert reference.contacts >= 4
    assert got["f_env"].max() > 0.5
    assert got["f_env"].min() == 0.0  # it cannot pull
    for name, scale in (("x_m", 1.0), ("v_m", 10.0), ("f_m", 10.0), ("x_s", 1.0), ("v_s", 100.0), ("f_s", 100.0)):
        assert np.abs(got[name] - want[name]).max() < 1e-11 * scale, name
