"""Scenes without a slave: sampled virtual walls whose passivity, stability and limit cycles are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from master.hand import Grip, Rest
from scenarios import encoder_wall, virtual_coupling, virtual_wall
from teleop import Scene, load_scene, run
from teleop.laws.virtual_coupling import VirtualCoupling
from teleop.laws.virtual_wall import VirtualWall
from teleop.physics.relaxing import ElectricalDamping
from teleop.simulation.bodies import exact_bodies
from teleop.stages.encoder import Encoder
from teleop.stages.force_cap import Cap
from teleop.stages.passivity_controller import PassivityController


def work_of_the_hand(scene: Scene) -> np.ndarray:
    """The energy (J) that the hand has put into the device and all behind it, up to every tick, exactly.

    For a finger without mass, k and d to a tip that runs straight with slope s between ticks: with e = r - x the
    momentum gives int f_h dt = m [v] + b [x] + f_m dt, the energy of e gives J = int e'^2 dt, and the work is
    s int f_h dt - k/2 [e^2] - d J.
    """
    assert scene.hand is not None
    assert (scene.hand.mass, scene.master.friction) == (0.0, 0.0)
    trace = run(scene).trace
    x, v, f_m = trace["x_m"], trace["v_m"], trace["f_m"][:-1]
    r = np.array(scene.hand.reference.samples(1, len(x), scene.dt_ns)[0])
    m, b, k, d = scene.master.mass, scene.master.damping, scene.hand.k, scene.hand.d
    s, e = np.diff(r) / scene.dt, r - x
    spring = 0.5 * k * np.diff(e * e)
    moving = 0.5 * m * ((s - v[1:]) ** 2 - (s - v[:-1]) ** 2)
    J = ((b * s + f_m) * np.diff(e) - spring - moving) / (b + d)
    given = s * (m * np.diff(v) + b * np.diff(x) + f_m * scene.dt) - spring - d * J
    return np.concatenate([[0.0], np.cumsum(given)])


def test_the_work_of_the_hand_is_the_integral_of_its_force_and_velocity() -> None:
    scene = virtual_wall.scene(dt=2e-5, duration=0.8, d=3.0)
    trace = run(scene).trace
    power = trace["f_h"] * trace["v_m"]
    by_trapezoid = float(((power[1:] + power[:-1]) / 2.0 * np.diff(trace["t"])).sum())
    assert work_of_the_hand(scene)[-1] == pytest.approx(by_trapezoid, rel=1e-3)


@pytest.mark.parametrize("law", [
    VirtualWall(K=1590.0, at=0.03),  # K dt/2 = 0.795
    VirtualCoupling(K=1000.0, B=0.29, at=0.03, k_e=1e5),
    *(pytest.param(law, marks=pytest.mark.full) for law in (
        VirtualWall(K=800.0, B=0.39, at=0.03), VirtualCoupling(K=1590.0, B=0.0, at=0.03, k_e=1e9, d_e=1e3),
        VirtualCoupling(K=1590.0, B=0.0, mass=0.0, at=0.03, k_e=1e9))),
])
def test_enough_device_damping_makes_no_energy(law: Any) -> None:
    for k, d in ((50.0, 0.0), (400.0, 0.05), (3000.0, 0.1)):
        work = work_of_the_hand(virtual_wall.scene(law=law, b=0.8, k=k, d=d))
        assert work.min() > -1e-12
        assert work[-1] > 1e-5


@pytest.mark.parametrize("law", [
    VirtualWall(K=2200.0, at=0.03),
    *(pytest.param(law, marks=pytest.mark.full) for law in (
        VirtualWall(K=800.0, B=100.0, at=0.03), VirtualCoupling(K=2200.0, B=0.0, at=0.03, k_e=1e9, d_e=1e3))),
    VirtualCoupling(K=1000.0, B=0.2, mass=0.1, at=0.03, k_e=1e4, theta_f=0.0, theta_x=0.0),
])
def test_too_little_makes_energy_that_a_finger_draws_for_ever(law: Any) -> None:
    work = work_of_the_hand(virtual_wall.scene(law=law, b=0.8, k=400.0, d=0.2, duration=6.0))
    assert work[3000] < -0.01
    assert work[-1] < work[3000] - 0.03


def test_the_ledger_of_the_port_shows_the_holds_leak_of_a_passive_wall_too() -> None:
    scene = virtual_wall.scene(law=VirtualWall(K=800.0, at=0.03), k=400.0, d=0.0, duration=4.0)
    t = run(scene).trace
    f_m, x = t["f_m"], t["x_m"]
    np.testing.assert_allclose(t["E_port"][1:], np.cumsum(f_m[:-1] * np.diff(x)), atol=1e-15)
    stored = 400.0 * max(x[-1] - 0.03, 0.0) ** 2
    assert t["E_port"][-1] < stored - 1e-6


def rate(scene: Scene) -> float:
    """How a small oscillation about a steady press grows, as the ratio of late to early peaks, in logarithm."""
    x = run(scene).trace["x_m"]
    x = np.abs(x - x.mean())
    early, late = len(x) // 4, len(x) - len(x) // 4
    return float(np.log(x[late:].max() / x[early: 2 * early].max()))


def pressed(K: float, B: float, delay: int) -> Scene:
    """A device of 0.04 kg and 0.8 N s/m pressed with a steady 20 N into a wall, 1e-6 of the way off balance."""
    push = Grip(mass=0.0, k=1e-4 * K, d=0.0, reference=Rest(at=20.0 / (1e-4 * K)))
    rest = 20.0 / (K + 1e-4 * K)
    scene = virtual_wall.scene(law=VirtualWall(K=K, B=B), delay=delay, duration=20.0, energy=False)
    return replace(scene, hand=push, start_m=rest * (1.0 + 1e-6), law=VirtualWall(K=K, B=B))


@pytest.mark.parametrize(("B", "delay", "critical"), [
    (0.0, 0, 1605.35), (0.8, 5, 282.69), *(pytest.param(0.0, *each, marks=pytest.mark.full)
                                          for each in ((1, 536.28), (5, 148.08), (10, 78.75))),
])
def test_a_pressed_wall_is_stable_up_to_the_stiffness_of_the_sampled_models_eigenvalues(
    B: float, delay: int, critical: float
) -> None:
    assert rate(pressed(0.995 * critical, B, delay)) < 0.0
    assert rate(pressed(1.005 * critical, B, delay)) > 0.0


# wall N/m, renewed every .. ticks, most damping of the controller: peak mm, peak-to-peak mm in the last 0.5 s and
# energy mJ in the readings, as published for 40 semi-implicit sub-steps a tick; then exactly.
RUNS = {
    "A": ((400.0, 1, None), (33.53, 0.001, -0.32), (33.533, 0.0011, -0.335)),
    "B": ((2500.0, 1, None), (31.79, 1.658, -17.6), (31.790, 1.574, -17.30)),
    "C": ((2500.0, 1, 0.8), (31.79, 0.080, -1.81), (31.790, 0.065, -1.907)),
    "D": ((400.0, 5, None), (34.07, 5.277, -69.7), (34.069, 5.266, -69.78)),
    "E": ((400.0, 5, 0.8), (33.90, 0.001, -1.44), (33.898, 0.0015, -1.442)),
}


def sub_steps(c: Any, x: float, v: float, f_m: float, r0: float, r1: float) -> tuple[float, float]:
    """`move_gripped` for a finger that stands still, by 40 steps of semi-implicit Euler."""
    assert r0 == r1
    _, _, _, _, _, _, dt, b, k, _, _, mass = c
    for _ in range(40):
        v += dt / 40.0 * ((k * (r0 - x) - b * v - f_m) / mass)
        x += dt / 40.0 * v
    return x, v


def figures(scene: Scene, **instead: Any) -> tuple[float, float, float]:
    """Peak (mm), peak-to-peak over the last 0.5 s (mm), energy in the readings (mJ)."""
    t = run(scene, bodies=exact_bodies(scene)._replace(instead=instead)).trace
    energy = float((t["f_m"][:-1] * np.diff(t["q_m"])).sum())
    return 1e3 * float(t["x_m"].max()), 1e3 * float(np.ptp(t["x_m"][1000:])), 1e3 * energy


@pytest.mark.parametrize("name", RUNS)
def test_an_encoder_wall_has_the_published_limit_cycle(name: str) -> None:
    (K, every, cap), published, exactly = RUNS[name]
    scene = encoder_wall.scene(K=K, every=every, cap=cap)
    found = figures(scene, move_gripped=sub_steps)
    digits = (2, 3, 2 if abs(published[2]) < 10.0 else 1)
    assert tuple(round(each, n) for each, n in zip(found, digits, strict=True)) == published
    assert figures(scene) == pytest.approx(exactly, rel=0.01, abs=6e-5)


def test_without_its_encoder_the_soft_wall_takes_no_less_than_the_controller_sees() -> None:
    t = run(encoder_wall.scene(step=None, K=400.0, cap=0.8)).trace
    assert "q_m" not in t
    assert np.ptp(t["x_m"][-500:]) < 2e-6


def test_a_stiff_tool_wall_is_felt_as_the_coupling_in_series() -> None:
    t = run(virtual_coupling.scene()).trace
    felt = t["f_m"][-1] / (t["x_m"][-1] - 0.03)
    assert felt == pytest.approx(1e5 * 1000.0 / (1e5 + 1000.0), rel=1e-6)
    assert np.ptp(t["x_m"][-200:]) < 1e-9


def test_the_same_wall_without_the_coupling_shakes() -> None:
    t = run(virtual_coupling.scene(law=VirtualWall(K=1e5, at=0.03))).trace
    assert np.ptp(t["x_m"][-200:]) > 1e-3


def test_the_walls_knobs_reach_their_parts() -> None:
    scene = virtual_wall.scene(m=0.1, b=0.2, friction=0.3, k=5.0, d=6.0, step=1e-5, every=3, delay=2,
                               observer=50.0)
    assert (scene.master.mass, scene.master.damping, scene.master.friction) == (0.1, 0.2, 0.3)
    assert scene.hand is not None
    assert (scene.hand.k, scene.hand.d, scene.hand.mass) == (5.0, 6.0, 0.0)
    device = scene.device_m
    assert device is not None
    assert (device.encoder, device.every, device.delay) == (Encoder(step=1e-5), 3, 2)
    assert (scene.slave, scene.observer) == (None, 50.0)


@pytest.mark.parametrize("name", ["virtual_wall", "virtual_coupling"])
def test_controller_saturation_and_electrical_damping_have_knobs_and_are_left_out_unless_asked_for(name: str) -> None:
    scene = load_scene(name, v_min=0.01, cutoff=5.0)  # of what is not there
    assert (scene.passivity, scene.cap, scene.electrical) == (None, None, None)
    scene = load_scene(name, cap="0.7", v_min="0.01", f_max="3", b_e="0.6", cutoff="20")
    assert scene.passivity == PassivityController(cap=0.7, v_min=0.01)
    assert scene.cap == Cap(f_max=3.0)
    assert scene.electrical == ElectricalDamping(b=0.6, cutoff=20.0)
    assert load_scene(name, b_e=0.6).electrical == ElectricalDamping(b=0.6, cutoff=10.0)
    assert load_scene(name, cap=0.7).passivity == PassivityController(cap=0.7)
    most = float(np.abs(run(load_scene(name, f_max=2.0)).trace["f_m"]).max())
    assert most == 2.0 < float(np.abs(run(load_scene(name)).trace["f_m"]).max())


def test_a_wall_that_hums_is_calmed() -> None:
    law = VirtualWall(K=2200.0, at=0.03)
    hum, *calm = (np.ptp(run(scene).trace["x_m"][-300:]) for scene in (
        virtual_wall.scene(law=law, d=0.0), virtual_wall.scene(law=law, d=0.0, b_e=1.6, cutoff=1.0),
        virtual_wall.scene(law=law, d=0.0, cap=0.8)))
    assert max(calm) < 0.2 * hum


def test_a_controller_leaves_velocities_below_v_min_alone() -> None:
    bare, deaf = run(encoder_wall.scene(K=2500.0)).trace, run(encoder_wall.scene(K=2500.0, cap=0.8, v_min=10.0)).trace
    np.testing.assert_array_equal(bare["x_m"], deaf["x_m"])
    assert np.ptp(run(encoder_wall.scene(K=2500.0, cap=0.8, v_min=1e-6)).trace["x_m"][-500:]) < 1e-4
    assert encoder_wall.scene(cap=0.8, v_min=0.02).passivity == PassivityController(cap=0.8, v_min=0.02)
