"""The rivals of the bench run the scene that they are said to run, as accurately as they are said to."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from typing import Any

import numpy as np
import pytest

from teleop import Scene, load_scene, run
from teleop.bench.rivals import control, jitcdde, numpy_batch
from teleop.bench.rivals.numpy_batch import change, located, stepped
from teleop.bench.rivals.rival import Absent, exact_positions, library, stiffnesses
from teleop.physics.contact import events
from tests.programs import COMPILERS, program

ACCURACY = 1e-6  # m, of either handle's position


def short(seconds: float, **knobs: float) -> Scene:
    return load_scene("canonical", duration=seconds, **knobs)


def test_the_batch_reaches_the_accuracy_where_contact_is_located() -> None:
    assert numpy_batch.position_error(short(1.3)) < 0.01 * ACCURACY


def test_sub_steps_reach_it_only_by_their_number() -> None:
    few, many = (numpy_batch.position_error(short(0.55), partial(stepped, count=count)) for count in (2, 32))
    assert many < ACCURACY < few


def test_every_row_of_a_batch_is_its_own_scene() -> None:
    scene, k_e = short(1.3), stiffnesses(6)
    seen = np.zeros((scene.ticks, 2, 6))

    def watch(k: int, x_m: Any, x_s: Any, *_: Any) -> None:
        seen[k] = x_m, x_s

    rms, top = numpy_batch.batch(scene, k_e, located, watch)()
    for row, k in enumerate(k_e):
        own = short(1.3, k_e=float(k))
        assert np.abs(seen[:, :, row].T - exact_positions(own)).max() < 0.01 * ACCURACY
        found = run(own).metrics
        assert rms[row] == pytest.approx(found["x_err_rms"], abs=0.01 * ACCURACY)
        assert top[row] == pytest.approx(found["x_err_max"], abs=0.01 * ACCURACY)


def test_its_waves_are_those_of_the_scene() -> None:
    scene, waves = short(0.6), []

    def watch(*told: Any) -> None:
        waves.append([told[3][0], told[4][0]])

    numpy_batch.batch(scene, np.array([5000.0]), located, watch)()
    trace, root = run(scene).trace, 2.0  # sqrt(2 b)
    v_m, f_m, f_s = (trace[name].reshape(-1) for name in ("v_m", "f_m", "f_s"))
    u = (2.0 * v_m + f_m) / root
    come = np.concatenate([np.zeros(50), u[:-50]])
    assert np.abs(np.array(waves).T - [u, come - 2.0 / root * f_s]).max() < ACCURACY
    assert np.ptp(u) > 0.1


@pytest.mark.parametrize("state", [
    (-1e-4, 0.4, 1.0),  # it goes in
    (1e-4, -0.3, -1.0),  # it comes out
    (1e-4, -0.102, 60.0),  # it was let go and is pushed back
])
def test_a_change_of_mode_is_where_the_exact_wall_has_it(state: tuple[float, float, float]) -> None:
    m, b, d, k, dt = 0.5, 1.0, 5.0, 5000.0, 1e-3
    p, v, f = state
    was = p > 0.0 and k * p + d * v > 0.0
    alone = exact_flow(m, b + d * was, k * was, p, v, f, dt)
    arrays = [np.array([one]) for one in (p, v, f, *alone)]
    q, u, _ = change((m, b, d), np.array([k]), dt, *arrays, np.array([was]))
    q1, u1, _ = events(m, b, k, d, dt, p, v, f)
    assert q[0] == pytest.approx(q1, abs=1e-10)
    assert u[0] == pytest.approx(u1, abs=2e-7)


def exact_flow(m: float, c: float, k: float, p: float, v: float, f: float, t: float) -> tuple[float, float]:
    """By scipy's matrix exponential."""
    from scipy.linalg import expm

    step = expm(t * np.array([[0.0, 1.0, 0.0], [-k / m, -c / m, f / m], [0.0, 0.0, 0.0]]))
    after = step @ [p, v, 1.0]
    return float(after[0]), float(after[1])


def test_python_control_runs_the_same_scene() -> None:
    ct = pytest.importorskip("control")
    assert control.position_error(ct, short(0.4)) < 0.01 * ACCURACY


def test_what_jitcdde_solves_is_the_limit_of_short_ticks() -> None:
    jit = pytest.importorskip("jitcdde")
    program(*COMPILERS)  # it compiles its equations
    ticks = (2e-4, 1e-4, 5e-5)
    paths = [np.array(exact_positions(short(0.4, dt=dt)))[:, :: round(1e-3 / dt)] for dt in ticks]
    reference = jitcdde.positions(jit, short(0.4), jitcdde.TIGHT)
    errors = [np.abs(path - reference).max() for path in paths]
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.2)  # first order in the tick
    assert np.abs(2.0 * paths[2] - paths[1] - reference).max() < ACCURACY
    assert np.abs(jitcdde.positions(jit, short(0.4), jitcdde.TOLERANCE) - reference).max() < ACCURACY


def test_a_rival_that_is_not_installed_says_what_to_type() -> None:
    with pytest.raises(Absent, match="some-solver: pip install some_solver"):
        library("some_solver", "some-solver")


def test_the_benches_load_only_what_they_run() -> None:
    code = "import sys, teleop.bench.__main__, teleop.bench.live; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "teleop.bench.rivals"} & set(done.stdout.split())
