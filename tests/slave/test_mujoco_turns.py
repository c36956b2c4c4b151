"""Turns of an end effector in MuJoCo: torques by six rows of its Jacobian, and the scene `pose` on an arm."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from master.device import SimulatedMaster
from slave.mujoco_model import OWN, TURNS
from slave.mujoco_robot import MuJoCoRobot
from teleop import Direct, MassDamper, Refused, Scene, load_scene
from teleop.live.in_process import run_stepped
from teleop.physics.rotation import exp, product, turned
from teleop.simulation.metrics import angle_error

mujoco = pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")

WRENCHES = ((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.02, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, -0.02, 0.0),
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.02), (0.3, -0.2, 0.4, 0.01, 0.02, -0.01))


def pose(**knobs: Any) -> Scene:
    return load_scene("pose", **knobs)


def jacobian(model: Any, data: Any) -> Any:
    """Six rows of MuJoCo's own, of the site and not of the body that forces are applied to."""
    J = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, J[:3], J[3:], model.site("end_effector").id)
    return J


def test_a_wrench_accelerates_it_by_the_six_rows_of_its_jacobian() -> None:
    model = mujoco.MjModel.from_xml_path(str(TURNS))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    J, M = jacobian(model, data), np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    for wrench in WRENCHES:
        robot = MuJoCoRobot(pose())
        robot.read(0)
        robot.hold(wrench)
        expected = 1e-3 * J @ np.linalg.solve(M, J.T @ np.array(wrench))
        np.testing.assert_allclose(robot.read(1).v, expected, rtol=0.02, atol=1e-4 * abs(expected).max() + 1e-4)


def test_its_work_is_that_of_the_forces_and_torques_along_what_is_read_and_its_orientation_is_the_models() -> None:
    """Thrown about without friction, weight or contact: the kinetic energy is what was put in.

    The quaternion that the turns of every tick make is MuJoCo's own, from wherever the scene begins.
    """
    rng = np.random.default_rng(3)
    begins = (0.01, 0.0, 0.02, 0.3, -0.2, 0.1)
    robot = MuJoCoRobot(replace(pose(), start_s=begins))
    model, data = robot._model.model, robot._body.data
    model.dof_damping[:] = 0.0
    model.geom_contype[:] = model.geom_conaffinity[:] = 0
    first = data.xquat[robot._model.tip].copy()
    before = np.array(robot.read(0).x)
    np.testing.assert_allclose(before, begins, atol=1e-12)
    q, work, M = exp(*begins[3:]), 0.0, np.zeros((model.nv, model.nv))
    works, energies = [0.0], [0.0]
    for k in range(1500):
        if k % 40 == 0:
            wrench = np.concatenate((rng.normal(0.0, 1.0, 3) - 20.0 * before[:3], rng.normal(0.0, 0.02, 3)))
        robot.hold(tuple(wrench))
        reading = robot.read(k + 1)
        now = np.array(reading.x)
        work += float(wrench @ (now - before))
        q = turned(*q, *(now - before)[3:])
        before = now
        mujoco.mj_fullM(model, data, M)
        energies.append(0.5 * float(data.qvel @ M @ data.qvel))
        works.append(work)
        np.testing.assert_allclose(reading.v, jacobian(model, data) @ data.qvel, atol=1e-6)
    assert max(energies) > 0.02
    np.testing.assert_allclose(energies, works, atol=0.03 * max(energies))  # of MuJoCo's first-order steps
    assert abs(now[3:]).max() > 1.0
    w, x, y, z = first
    a, b, c, d = data.xquat[robot._model.tip].tolist()
    since = product(a, b, c, d, w, -x, -y, -z)
    assert abs(np.dot(q, product(*since, *exp(0.3, -0.2, 0.1)))) == pytest.approx(1.0, abs=1e-9)


def test_it_senses_the_torque_of_what_it_touches_about_its_point() -> None:
    """Pressed on the table and dragged along it: the constraint forces on the joints are the six rows' alone."""
    robot = MuJoCoRobot(pose())
    data, model = robot._body.data, robot._model.model
    seen = 0.0
    for k in range(900):
        reading = robot.read(k)
        assert reading.f is not None
        x, v = np.array(reading.x), np.array(reading.v)
        spring = np.array((*(300.0 * (np.array((0.02, 0.02 * np.sin(0.01 * k), -0.06)) - x[:3])), *(-0.5 * x[3:])))
        robot.hold(tuple(spring - np.array((20.0,) * 3 + (0.02,) * 3) * v))
        if k > 300 and np.linalg.norm(reading.f[3:]) > 0.004:
            held = jacobian(model, data).T @ -np.array(reading.f)
            np.testing.assert_allclose(held, data.qfrc_constraint, atol=0.02 * abs(data.qfrc_constraint).max())
            seen = max(seen, float(np.linalg.norm(reading.f[:3])))
    assert seen > 1.0


def test_the_scene_pose_runs_on_an_arm() -> None:
    """A tool of six joints comes to the wall, tilts and turns through more than half a turn, as the hand does."""
    result = run_stepped(pose(duration=3.2), {"m": SimulatedMaster, "s": MuJoCoRobot})
    assert result.status == "ok", result.sentence
    trace = result.trace
    about = trace["x_s"][:, 3:] @ (np.sin(0.6), 0.0, np.cos(0.6))
    assert about[-1] > 1.2 * np.pi
    assert angle_error(trace, np.arange(len(trace["t"])), 0).max() < 0.15
    assert trace["f_env"][-1, 0] > 1.0
    assert abs(trace["x_s"][-1, :3] - trace["x_m"][-1, :3]).max() < 0.02


def test_an_arm_of_three_joints_and_a_second_rotation_are_refused() -> None:
    with pytest.raises(Refused, match=r"end_effector does not move under a push along .*: no motion of its joints does "
                                      r"that in this pose"):
        MuJoCoRobot(pose(), str(OWN))
    two = Scene(law=Direct(), axes=6, master=MassDamper(mass=1.0), slave=MassDamper(mass=1.0), rotations=(0, 3))
    with pytest.raises(Refused, match="the scene has 2 rotations, and an end effector in MuJoCo has one; take a scene"):
        MuJoCoRobot(two)
