"""python-control: `input_output_response` of the whole loop as one nonlinear block with the scene's tick.

That is the fastest form it has: blocks joined by `interconnect` are evaluated one by one and again for every loop
between them. Its continuous systems know no delay but a Pade approximation, far from the accuracy asked for, so the
delays are lines of past waves in the block's state. The bodies move by this package's own exact functions, so what is
measured is that library's loop at least, and little of what a user would have to write for contact.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np

from teleop.bench.rivals.rival import Rival, delay_ticks, exact_positions, library, parts
from teleop.physics.contact import move_wall
from teleop.physics.plant import move_gripped
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.bodies import exact_bodies, reference_samples


def rival() -> Rival:
    """Raises `Absent`."""
    ct = library("control", "python-control")
    scene = load_scene("canonical")
    return Rival("python-control, one discrete block", 500, scene.ticks, lambda: response(ct, scene),
                 position_error(ct, scene))


def position_error(ct: Any, scene: Scene) -> float:
    """The greatest error of either handle (m) against the exact bodies."""
    return float(np.abs(response(ct, scene)() - exact_positions(scene)).max())


def response(ct: Any, scene: Scene) -> Callable[[], Any]:
    """A run of the scene: it returns the positions x_m, x_s at the ticks."""
    law, *_ = parts(scene)
    lag, dt = delay_ticks(scene), scene.dt
    b, K, B, root = law.b, law.K, law.B, sqrt(2.0 * law.b)
    bodies = exact_bodies(scene)
    grip, wall = bodies.master[0], bodies.slaves[0].c
    path = np.asarray((reference_samples(scene) or ())[0])

    def tick(t: float, state: Any, inputs: Any, _: Any) -> Any:
        x_m, v_m, x_s, v_s, x_d = state[:5].tolist()
        at = 5 + round(t / dt) % lag
        u, w = state[at], state[at + lag]
        r0, r1 = inputs.tolist()
        v_d = (root * u - K * (x_d - x_s) + B * v_s) / (b + B + K * dt)
        x_d += dt * v_d
        f_s = K * (x_d - x_s) + B * (v_d - v_s)
        after = state.copy()
        after[at], after[at + lag] = root * v_m - w, u - 2.0 / root * f_s
        x_m, v_m = move_gripped(grip, x_m, v_m, b * v_m - root * w, r0, r1)
        x_s, v_s, _ = move_wall(wall, x_s, v_s, f_s)
        after[:5] = x_m, v_m, x_s, v_s, x_d
        return after

    def seen(_t: float, state: Any, _inputs: Any, _params: Any) -> Any:
        return state[0:4:2]

    loop = ct.nlsys(tick, seen, states=5 + 2 * lag, inputs=2, outputs=2, dt=dt)
    times, inputs = np.arange(scene.ticks) * dt, np.stack([path[:-1], path[1:]])
    return lambda: ct.input_output_response(loop, times, inputs, np.zeros(5 + 2 * lag)).outputs
