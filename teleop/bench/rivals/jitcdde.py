"""jitcdde: the canonical scene as a delay differential equation, by its compiled C module.

What is compared. A robot's law is sampled: forces are held for a tick, and that is the scene that our engines solve,
exactly. jitcdde solves equations in continuous time, and jumps every millisecond would be all it does; so it is given
the scene with the law in continuous time, where it may take steps as long as its tolerance allows. Both are the same
scene with another idea of the controller, and the limit of ours for short ticks is what jitcdde solves (tested). Each
is held to 1e-6 m of its own exact solution: ours has rounding errors only, and jitcdde is compared with itself at a
tolerance that has converged to 2e-9 m. The two solutions are some 0.5 mm apart at a tick of 1 ms, which is what
sampling does and not an error of either. Who wants the continuous scene itself to 1e-6 m should take jitcdde: ours
comes to it only in proportion to the tick.

A scenario-step is 1 ms of the scene. Nothing is read out on the way, and compiling is not counted.

The equation is neutral: with w = (b v_d - f_s)/sqrt(2b), the wave that comes back holds the slave's own past velocity
x_d' = v_d, and with u = sqrt(2b) v_m - w,

    v_d = (sqrt(2b) u(t - T) - K (x_d - x_s) + B v_s)/(b + B)    u(t - T) = sqrt(2b) v_m(t - T) - w(t - 2T)
    f_m = b v_m - sqrt(2b) w(t - T)
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, redirect_stdout
from io import StringIO
from math import pi, sqrt
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from teleop.bench.rivals.rival import Absent, Rival, exact_positions, library, parts
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene

TOLERANCE, TIGHT = 1e-7, 1e-11  # absolute, in m and m/s: the loosest that keeps to 1e-6 m, and the reference's


def rival() -> Rival:
    """Raises `Absent`."""
    jit = library("jitcdde", "jitcdde")
    scene = load_scene("canonical")
    loose, reference = positions(jit, scene, TOLERANCE), positions(jit, scene, TIGHT)
    apart = float(np.abs(reference - exact_positions(scene)).max())
    return Rival("jitcdde, compiled, continuous time", 100, scene.ticks, lambda: _run(jit, scene, TOLERANCE),
                 float(np.abs(loose - reference).max()),
                 (("its scene and the sampled one differ by", f"{apart * 1e3:.2f} mm"),))


def positions(jit: Any, scene: Scene, tolerance: float) -> Any:
    """x_m and x_s (m) at the ticks."""
    solver = integrator(jit, scene, tolerance)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of reading out more often than it steps
        states = [np.zeros(5)] + [solver.integrate(k * scene.dt) for k in range(1, scene.ticks)]
    return np.array(states).T[[0, 2]]


def _run(jit: Any, scene: Scene, tolerance: float) -> Callable[[], Any]:
    solver = integrator(jit, scene, tolerance)
    return lambda: solver.integrate(scene.ticks * scene.dt)


def integrator(jit: Any, scene: Scene, tolerance: float) -> Any:
    """An integrator at t = 0, compiled. Raises `Absent` without a compiler."""
    law, hand, wall, slave = parts(scene)
    delay, swing = scene.link.delay, hand.reference  # type: ignore[union-attr]
    b, K, B, root = law.b, law.K, law.B, sqrt(2.0 * law.b)
    symbols = library("symengine", "jitcdde")
    y, dy, t = jit.y, jit.dy, jit.t
    x_m, v_m, x_s, v_s, x_d = (y(i) for i in range(5))

    def w(ago: float) -> Any:
        """The slave's wave of some time ago."""
        speed = dy(4, t - ago)
        return (b * speed - K * (y(4, t - ago) - y(2, t - ago)) - B * (speed - y(3, t - ago))) / root

    v_d = symbols.Symbol("v_d")  # worked out once a step
    helpers = [(v_d, (root * (root * y(1, t - delay) - w(2 * delay)) - K * (x_d - x_s) + B * v_s) / (b + B))]
    f_s = K * (x_d - x_s) + B * (v_d - v_s)
    f_m = b * v_m - root * w(delay)
    omega = 2.0 * pi * swing.frequency
    r, slope = swing.amplitude * symbols.sin(omega * t), swing.amplitude * omega * symbols.cos(omega * t)
    p = x_s - wall.at
    g = wall.k * p + wall.d * v_s
    push = symbols.Piecewise((symbols.Piecewise((g, g > 0), (0, True)), p > 0), (0, True))
    drag = scene.master.damping * v_m
    equations = [
        v_m, (hand.k * (r - x_m) + hand.d * (slope - v_m) - drag - f_m) / (scene.master.mass + hand.mass),
        v_s, (f_s - slave.damping * v_s - push) / slave.mass, v_d,
    ]
    delays = {"delays": [0, delay, 2 * delay], "max_delay": 2 * delay, "automatic_anchor_helpers": True}
    with _quietly():
        solver = jit.jitcdde(equations, helpers=helpers, verbose=False, **delays)
        try:
            solver.compile_C(simplify=False, verbose=False)
        except Exception as error:  # whatever setuptools, a compiler or a linker has to say
            raise Absent(f"jitcdde: it needs a C compiler, and setuptools ({type(error).__name__})") from error
    solver.constant_past([0.0] * 5)
    solver.set_integration_parameters(atol=tolerance, rtol=0.0, first_step=1e-4, min_step=1e-13, max_step=delay)
    solver.initial_discontinuities_handled = True  # the waves begin without a jump: small steps do
    return solver


@contextmanager
def _quietly() -> Iterator[None]:
    """Compile in an empty folder, without output: setuptools reads any pyproject.toml and turns on every log."""
    root = logging.getLogger()
    logging_before = root.level, root.handlers[:]
    try:
        with TemporaryDirectory() as folder, chdir(folder), redirect_stdout(StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        root.setLevel(logging_before[0])
        root.handlers[:] = logging_before[1]
