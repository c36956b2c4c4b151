"""A robot in MuJoCo: forces and torques at its end effector or its joints, what it senses, and what is refused."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from master.device import SimulatedMaster
from slave.mujoco_model import OWN, TURNS, load
from slave.mujoco_robot import MuJoCoBody, MuJoCoRobot, pressed
from teleop import Direct, MassDamper, Refused, Scene, Wave, check_device, load_scene, run
from teleop.live.in_process import run_stepped
from teleop.physics.rotation import exp, product, turned
from teleop.simulation.metrics import angle_error

mujoco = pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")

SLIDER = """
<mujoco>
  <option gravity="0 0 -9.81" timestep="0.00025"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0" damping="{damping}"/>
      <geom name="cart" type="box" size="0.01 0.01 0.01" mass="0.5"/>
      <site name="{site}"/>
    </body>
    <body name="ball" pos="0 0.5 5"><freejoint name="free"/><geom type="sphere" size="0.01" mass="0.1"/></body>
    <site name="mark"/>
  </worldbody>
  {more}
</mujoco>
"""


def scene(axes: int = 1, **other: Any) -> Scene:
    parts: dict[str, Any] = {"law": Direct(), "master": MassDamper(mass=0.1), "slave": MassDamper(mass=0.5), **other}
    return Scene(axes=axes, **parts)


def slider(folder: Path, *, damping: float = 1.0, site: str = "end_effector", more: str = "") -> str:
    path = folder / "slider.xml"
    path.write_text(SLIDER.format(damping=damping, site=site, more=more))
    return str(path)


def moved(robot: Any, forces: Sequence[tuple[float, ...]]) -> list[Any]:
    readings = [robot.read(0)]
    for k, force in enumerate(forces):
        robot.hold(force)
        readings.append(robot.read(k + 1))
    return readings


class TestTheArm:
    def test_begins_at_rest_where_the_scene_says_and_stays_there_without_a_force(self) -> None:
        """Its weight is compensated."""
        for reading in moved(MuJoCoRobot(scene(3, start_s=(0.01, 0.02, 0.03))), [(0.0, 0.0, 0.0)] * 300)[::100]:
            np.testing.assert_allclose(reading.x, (0.01, 0.02, 0.03), atol=1e-9)
            np.testing.assert_allclose(reading.v, 0.0, atol=1e-9)
            assert reading.f == (0.0, 0.0, 0.0)

    def test_a_force_at_its_end_accelerates_it_by_the_jacobian_of_its_joints(self) -> None:
        """Of a model of the test's own, at rest: a = J M^-1 J^T f."""
        model = mujoco.MjModel.from_xml_path(str(OWN))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        J, joints = np.zeros((3, model.nv)), np.zeros((1, model.nv))
        mujoco.mj_jacSite(model, data, J, None, model.site("end_effector").id)
        for force in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.3, -0.4, 0.8)):
            mujoco.mj_solveM(model, data, joints, (J.T @ force)[None, :])
            last = moved(MuJoCoRobot(scene(3)), [force])[-1]
            np.testing.assert_allclose(last.v, 1e-3 * J @ joints[0], rtol=0.01, atol=1e-5)

    def test_along_what_the_scene_has_no_axis_for_it_is_held(self) -> None:
        robot = MuJoCoRobot(scene(1))
        readings = moved(robot, [(1.0,)] * 150 + [(-1.0,)] * 150)
        assert max(reading.x[0] for reading in readings) > 0.015
        away = robot._body.data.xpos[robot._model.tip] - (0.25, 0.0, 0.3)
        assert np.abs(away[1:]).max() < 1e-3

    def test_senses_the_force_with_which_it_presses(self) -> None:
        steady = moved(MuJoCoRobot(scene(1)), [(5.0,)] * 1500)[-1]
        assert steady.x[0] == pytest.approx(0.0302, abs=1e-4)  # the wall is at 0.03
        assert steady.f == pytest.approx((5.0,), rel=1e-3)
        below = moved(MuJoCoRobot(scene(3)), [(0.0, 0.0, -4.0)] * 1500)[-1]
        assert below.f[2] == pytest.approx(-4.0, rel=1e-3)
        assert below.x[2] == pytest.approx(-0.05, abs=1e-3)

    def test_it_and_what_it_touches_never_give_out_more_than_was_put_in(self) -> None:
        """The work of the forces that were held less the kinetic energy, by MuJoCo's own mass matrix, is lost for good.

        But for what a contact stores and gives back, which of a spring is F^2/(2 k). The forces throw it against wall
        and table.
        """
        rng = np.random.default_rng(4)
        robot = MuJoCoRobot(scene(3))
        data, model = robot._body.data, robot._model.model
        work, lost, hits, readings = 0.0, [0.0], [0.0], [robot.read(0)]
        M = np.zeros((model.nv, model.nv))
        for k in range(1500):
            if k % 50 == 0:
                force = tuple(rng.normal(0.0, 6.0, 3) + np.array((1.0, 0.0, -1.0)) - 30.0 * np.array(readings[-1].x))
            robot.hold(force)
            readings.append(robot.read(k + 1))
            work += float(np.dot(force, np.subtract(readings[-1].x, readings[-2].x)))
            mujoco.mj_fullM(model, data, M)
            lost.append(work - 0.5 * float(data.qvel @ M @ data.qvel))
            hits.append(float(np.linalg.norm(readings[-1].f)))
        assert np.count_nonzero(hits) > 50
        assert work > 0.3
        assert min(lost) > -1e-4
        for k in range(0, 1500, 50):
            stored = max(hits[max(0, k - 50):k + 50]) ** 2 / (2.0 * 15e3)
            assert lost[k + 50] - lost[k] > -stored - 2e-4

    def test_ticks_may_be_left_out_a_force_lapses_and_a_copy_of_a_state_goes_on_by_itself(self) -> None:
        """To the same bits under the same forces."""
        one, other = MuJoCoRobot(scene(1)), MuJoCoRobot(scene(1))
        for robot in (one, other):
            robot.hold((0.5,))
        for k in range(10):
            one.read(k)
        assert one.read(20) == other.read(20)
        assert np.argmax([one.read(k).v[0] for k in range(30, 191, 10)]) == 12, "which is not renewed, at tick 150"
        assert one.deadline == 0.15
        body = MuJoCoBody(load(scene(3)))
        apart = copy(body)
        apart.hold((3.0, 0.0, 0.0))
        for _ in range(50):
            apart.step()
        assert apart.read().x[0] > 1e-3
        assert body.read().x == (0.0, 0.0, 0.0)
        body.step()
        assert body.read().x[0] == pytest.approx(0.0, abs=1e-12)


JOINTS: dict[str, Any] = {"names": ("turn", "lift", "bend"), "units": ("rad", "rad", "rad")}
HOME = (0.0, np.pi / 3.0, -2.0 * np.pi / 3.0)  # of the arm, rad


class TestJoints:
    def test_axes_of_their_names_begin_at_the_angles_that_the_scene_says_in_any_order_and_fewer(self) -> None:
        robot = MuJoCoRobot(scene(3, start_s=(0.1, 1.1, -2.3), **JOINTS))
        for reading in moved(robot, [(0.0, 0.0, 0.0)] * 200)[::100]:
            np.testing.assert_allclose(reading.x, (0.1, 1.1, -2.3), atol=1e-9)
        robot = MuJoCoRobot(scene(2, start_s=(-2.3, 0.1), names=("bend", "turn"), units=("rad", "rad")))
        assert robot.read(0).x == (-2.3, 0.1)
        last = moved(robot, [(0.0, 0.2)] * 20)[-1]
        assert last.x[1] > 0.1001
        assert last.x[0] == pytest.approx(-2.3, abs=1e-4)

    def test_a_torque_accelerates_them_by_their_mass_matrix(self) -> None:
        robot = MuJoCoRobot(scene(3, start_s=HOME, **JOINTS))
        M, torque = np.zeros((3, 3)), np.array((0.1, -0.2, 0.15))
        mujoco.mj_fullM(robot._model.model, robot._body.data, M)
        last = moved(robot, [tuple(torque)])[-1]
        np.testing.assert_allclose(last.v, 1e-3 * np.linalg.solve(M, torque), rtol=0.01)

    def test_what_is_sensed_is_the_torque_that_the_contact_takes(self) -> None:
        """Drawn into the wall by the springs of its motors it slides on slowly: what the joints' damping leaves."""
        robot = MuJoCoRobot(scene(3, start_s=HOME, **JOINTS))
        now = robot.read(0)
        assert now.f == (0.0, 0.0, 0.0)
        for k in range(2000):
            torque = 20.0 * np.subtract((0.0, 0.9, -1.8), now.x) - 0.5 * np.array(now.v)
            robot.hold(tuple(torque))
            now = robot.read(k + 1)
        assert np.abs(torque).max() > 1.0
        np.testing.assert_allclose(now.f, torque - 0.1 * np.array(now.v), atol=5e-3)

    def test_axes_that_are_not_its_own_are_refused(self) -> None:
        for names, units, says in (
            (("turn", "wrist"), ("rad", "rad"),
             r"axes wrist are no joints of .* \(it has turn in rad, lift in rad, bend in rad\)"),
            (("turn", "lift"), (), r"axis turn is in m, and the joint turn of .* is in rad; write units="),
            (("x", "turn"), ("m", "rad"), "axes x are no joints"), (("x", "y"), ("m", "rad"), "axis y is in rad"),
        ):
            with pytest.raises(Refused, match=says):
                MuJoCoRobot(scene(2, names=names, units=units))


class TestAModelOfOnesOwn:
    def test_its_actuators_are_off_its_keyframe_home_is_where_it_begins_and_its_end_effector_may_have_another_name(
        self, tmp_path: Path
    ) -> None:
        more = ('<actuator><position joint="rail" kp="500" ctrlrange="-1 1"/></actuator>'
                '<keyframe><key name="home" qpos="0.3 0 0.5 5 1 0 0 0" ctrl="0.7"/></keyframe>')
        robot = MuJoCoRobot(scene(1), slider(tmp_path, more=more))
        assert robot._body.data.qpos[0] == 0.3
        assert moved(robot, [(0.0,)] * 50)[-1].x[0] == 0.0
        assert MuJoCoRobot(scene(1), f"{slider(tmp_path, site='gripper')}#gripper").read(0).x == (0.0,)
        (tmp_path / "a#b").mkdir()
        for point in ("", "#cart"):
            assert MuJoCoRobot(scene(1), f"{slider(tmp_path / 'a#b')}{point}").read(0).x == (0.0,)

    def test_a_cart_moves_as_mass_and_damper_do_and_a_long_tick_has_sub_steps_no_longer_than_its_own(
        self, tmp_path: Path
    ) -> None:
        file = slider(tmp_path)
        readings = moved(MuJoCoRobot(scene(1), file), [(2.0,)] * 500)
        assert readings[-1].v[0] == pytest.approx(2.0 * (1.0 - np.exp(-1.0)), rel=1e-3)
        assert [MuJoCoRobot(scene(1, dt=dt), file)._model.substeps for dt in (5e-4, 1e-3, 2e-3)] == [4, 4, 8]
        model = load(scene(1), file)
        assert "came upon nothing within 0.2 m of its start" in pressed(model, copy(MuJoCoBody(model)))[0]

    def test_what_cannot_be_a_robot_is_refused_in_one_sentence(self, tmp_path: Path) -> None:
        slider(tmp_path)
        (tmp_path / "broken.xml").write_text("<mujoco><worldbody><body><joint/></worldbody></mujoco>")
        sound = (tmp_path / "slider.xml").read_text()
        (tmp_path / "quick.xml").write_text(sound.replace("0.00025", "1e-12"))
        (tmp_path / "nowhere_home.xml").write_text(sound.replace(
            "</mujoco>", '<keyframe><key name="home" qpos="nan 0 0 0 1 0 0 0"/></keyframe></mujoco>'))
        for file, says in (
            ("nowhere.xml", r"there is no file .*nowhere\.xml; write --robot mujoco:FILE\.xml"),
            ("broken.xml", r"broken\.xml does not load as an MJCF \(.*Line number=1.*\); mend it"),
            ("slider.xml#hand", r"no site and no body of the name hand.*#NAME with one of its sites \(mark, "
                                r"end_effector\) or bodies \(cart, ball\)"),
            ("slider.xml#mark", "mark of .* is no end effector: no hinge, slide or ball"),
            ("slider.xml#ball", "ball of .* is no end effector: no hinge, slide or ball moves it"),
            ("quick.xml", "has a timestep of 1e-12 s, and a tick of 0.001 s has at most 1000 sub-steps; write one of"),
            ("nowhere_home.xml", "the keyframe home of .* has a place that is not finite"),
        ):
            with pytest.raises(Refused, match=says) as refused:
                MuJoCoRobot(scene(1), str(tmp_path / file))
            assert "\n" not in str(refused.value)

    def test_one_that_becomes_unstable_is_a_run_that_diverged(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """MuJoCo would begin anew from the start, and write MUJOCO_LOG.TXT where one stands."""
        monkeypatch.chdir(tmp_path)
        file = slider(tmp_path, damping=-400.0)
        of = scene(1, start_m=0.01, duration=1.0)
        ours = run_stepped(of, {"m": SimulatedMaster, "s": lambda of: MuJoCoRobot(of, file)})
        assert (ours.status, ours.ticks < 1000) == ("diverged", True)
        assert "x_s passed 1e+06 m" in ours.sentence
        assert [note for note in ours.notes if note.startswith("MuJoCo warned of BADQ")]
        assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_it_is_a_robot_as_check_device_asks_for_and_without_mujoco_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    found = check_device("mujoco", load_scene("arm"))
    assert (found.simulated, found.senses, found.deadline) == (True, True, 0.15)
    assert min(found.moved) > 1e-3
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(Refused, match=r"pip install 'bilateral-teleop\[mujoco\]'"):
        MuJoCoRobot(scene(1))


@pytest.mark.usefixtures("pressing")
def test_waves_stay_passive_against_its_contact_and_forces_reflected_as_they_are_do_not() -> None:
    """Worked out anew from places and forces: what both ends have taken up of law and link. It tells its stiffness."""
    put_in = {}
    for law in (Wave(b=20.0, K=1000.0, B=20.0), Direct(K=500.0, B=10.0)):
        ran = run_stepped(load_scene("arm", law=law, delay=0.1, duration=2.5),
                          {"m": SimulatedMaster, "s": MuJoCoRobot})
        t = ran.trace
        assert np.abs(t["f_env"]).max() > 3.0
        steps = [(t[f][:-1] * np.diff(t[x], axis=0)).sum(axis=1) for f, x in (("f_m", "x_m"), ("f_s", "x_s"))]
        put_in[type(law)] = np.cumsum(steps[0] - steps[1])
        assert [note for note in ran.notes if note.startswith("pressed slowly before the run along +x")]
        assert {"f_err_rms", "f_env_max", *["E_link_min"] * isinstance(law, Wave)} <= ran.metrics.keys()
    assert put_in[Wave].min() > -1e-9
    assert put_in[Direct].min() < -0.01


def test_six_joints_in_mujoco_move_as_the_bodies_that_are_stepped_exactly(tmp_path: Path) -> None:
    """Those of a scene whose follower has neither friction nor a spring: inertia and damping alone."""
    of = load_scene("leader_follower", friction_s=0.0, k_e=0.0, d_e=0.0, duration=1.5)
    joint = ('<body pos="{at} 0 0"><joint name="{name}" axis="0 0 1" damping="{b}" armature="{inertia}"/>'
             '<geom size="0.01" mass="1e-6" contype="0" conaffinity="0"/></body>')
    bodies = [joint.format(at=i, name=name, b=each.damping, inertia=each.mass)
              for i, (name, each) in enumerate(zip(of.axis_names, of.per_axis("slave"), strict=True))]
    file = tmp_path / "follower.xml"
    file.write_text(f"<mujoco><worldbody>{''.join(bodies)}</worldbody></mujoco>")
    ours = run_stepped(of, {"m": SimulatedMaster, "s": lambda of: MuJoCoRobot(of, str(file))}, seed=1)
    exact = run(of, seed=1)
    assert np.ptp(exact.trace["x_s"], axis=0).min() > 0.1
    np.testing.assert_allclose(ours.trace["x_s"], exact.trace["x_s"], atol=1e-4)
    np.testing.assert_allclose(ours.trace["f_m"], exact.trace["f_m"], atol=5e-4)
    assert ours.trace["f_env"].shape == (1500, 6)


# The stiffness of a contact, as it is told before a run, is what a press of the test's own finds


def told(file: str | None = None) -> tuple[str, list[float]]:
    """The sentence, and the two stiffnesses in it, N/m."""
    model = load(scene(3), file)
    text = pressed(model, copy(MuJoCoBody(model)))[0]
    return text, [float(each.replace(",", "")) for each in re.findall(r"([\d,]+) N/m at", text)]


def depth(force: float) -> float:
    """How far the arm stands along x when it has long been pushed by `force` alone, m."""
    body = MuJoCoBody(load(scene(3)))
    body.hold((force, 0.0, 0.0))
    for _ in range(6000):
        body.step()
    return body.read().x[0]


@pytest.mark.full
def test_a_stiffness_is_the_slope_of_force_over_depth_at_two_forces_and_goes_with_the_files_contact(
    tmp_path: Path
) -> None:
    """MuJoCo's stiffness goes as the time constant of a contact, here 0.02 s, to the power -2."""
    text, found = told()
    assert "along +x" in text
    for force, stiffness in zip((2.0, 10.0), found, strict=True):
        part = 0.2 * force
        assert stiffness == pytest.approx(2.0 * part / (depth(force + part) - depth(force - part)), rel=0.02)
    assert found[1] > 1.3 * found[0]  # not linear
    for time, low, high in ((0.04, 0.2, 0.5), (0.01, 2.0, 5.0)):
        other = tmp_path / "other.xml"
        other.write_text(OWN.read_text().replace('<geom contype="1"', f'<geom solref="{time} 1" contype="1"'))
        assert all(low < one / usual < high for one, usual in zip(told(str(other))[1], found, strict=True)), time


# Turns of an end effector: torques by six rows of its Jacobian, and the scene `pose` on an arm


WRENCHES = ((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.02, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, -0.02, 0.0),
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.02), (0.3, -0.2, 0.4, 0.01, 0.02, -0.01))


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
        got = moved(MuJoCoRobot(load_scene("pose")), [wrench])[-1].v
        expected = 1e-3 * J @ np.linalg.solve(M, J.T @ np.array(wrench))
        np.testing.assert_allclose(got, expected, rtol=0.02, atol=1e-4 * abs(expected).max() + 1e-4)


def test_its_work_is_that_of_the_forces_and_torques_along_what_is_read_and_its_orientation_is_the_models() -> None:
    """Thrown about without friction, weight or contact: the kinetic energy is what was put in.

    The quaternion that the turns of every tick make is MuJoCo's own, from wherever the scene begins.
    """
    rng = np.random.default_rng(3)
    begins = (0.01, 0.0, 0.02, 0.3, -0.2, 0.1)
    robot = MuJoCoRobot(replace(load_scene("pose"), start_s=begins))
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
    robot = MuJoCoRobot(load_scene("pose"))
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
    result = run_stepped(load_scene("pose", duration=3.2), {"m": SimulatedMaster, "s": MuJoCoRobot})
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
        MuJoCoRobot(load_scene("pose"), str(OWN))
    two = Scene(law=Direct(), axes=6, master=MassDamper(mass=1.0), slave=MassDamper(mass=1.0), rotations=(0, 3))
    with pytest.raises(Refused, match="the scene has 2 rotations, and an end effector in MuJoCo has one; take a scene"):
        MuJoCoRobot(two)
