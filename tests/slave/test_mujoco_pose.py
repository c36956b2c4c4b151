"""The pose that a robot in MuJoCo begins in, what counts as its environment, and robots that no push moves."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from master.device import SimulatedMaster
from slave.mujoco_robot import MuJoCoRobot
from teleop import Refused, load_scene
from teleop.live.in_process import run_stepped
from tests.slave.test_mujoco_robot import moved, scene

mujoco = pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")

# Three hinges that stand straight up, and are stretched, where all are at zero.
ARM = """
<mujoco>
  <compiler angle="radian"/>
  <default><joint armature="0.01" damping="0.1" {joint}/><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    {world}
    <body name="base">
      <geom name="base" type="box" size="0.05 0.05 0.02" contype="1" conaffinity="1"/>
      <body name="column" pos="0 0 0.1">
        <joint name="turn" axis="0 0 1"/><geom type="cylinder" size="0.03 0.03" mass="0.5"/>
        <site name="on_axis" pos="0 0 0.05"/>
        <body name="upper">
          <joint name="lift" axis="0 1 0" {lift}/><geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.02" mass="0.6"/>
          <body name="fore" pos="0 0 0.3">
            <joint name="bend" axis="0 1 0" {bend}/><geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.02" mass="0.4"/>
            <geom name="tip" pos="0 0 0.3" size="0.02" mass="0.05" contype="1" conaffinity="1"/>
            <site name="end_effector" pos="0 0 0.3"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  {more}
</mujoco>
"""
# A cart on a rail: `stop` is a part of its own base, or stands in the world.
CART = """
<mujoco>
  <worldbody>
    {stop}
    <body name="base">
      {own}
      <body name="cart">
        <joint name="rail" type="slide" axis="1 0 0"/><geom name="cart" size="0.01" mass="0.5"/>
        <site name="end_effector"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
STOP = '<geom name="stop" type="box" size="0.01 0.05 0.05" pos="0.05 0 0"/>'
KEYS = '<keyframe><key name="home" qpos="{home}"/><key name="up" qpos="0 0 0"/><key qpos="0.5 0.3 1.2"/></keyframe>'
BENT = (0.3, 0.5, 1.2)


def arm(folder: Path, *, world: str = "", joint: str = "", lift: str = "", bend: str = "", more: str = "") -> str:
    path = folder / "own.xml"
    path.write_text(ARM.format(world=world, joint=joint, lift=lift, bend=bend, more=more))
    return str(path)


def begins_at(robot: MuJoCoRobot) -> tuple[float, ...]:
    return tuple(robot._body.data.qpos[:3].tolist())


def singular(robot: MuJoCoRobot) -> float:
    """The smallest singular value of the Jacobian of the end effector, m/rad, of the test's own model."""
    J = np.zeros((3, robot._model.model.nv))
    mujoco.mj_jacBody(robot._model.model, robot._body.data, J, None, robot._model.tip)
    return float(np.linalg.svd(J, compute_uv=False)[-1])


class TestThePoseThatItBeginsIn:
    def test_all_began_at_zero_stretched_and_outside_the_limits(self, tmp_path: Path) -> None:
        """Limits that zero is not in, and at zero the arm is singular; the note on the pose, typed, is that pose."""
        file = arm(tmp_path, lift='range="0.2 1.4"', bend='range="0.5 2.5"')
        robot = MuJoCoRobot(scene(3), file)
        turn, lift, bend = begins_at(robot)
        assert 0.2 + 0.11 < lift < 1.4 - 0.11
        assert 0.5 + 0.19 < bend < 2.5 - 0.19
        # Of two links of 0.3 m in a plane it is at most sin(45 deg) of 0.3 m, the elbow bent by 90 degrees.
        assert singular(robot) > 0.1
        assert begins_at(MuJoCoRobot(scene(3), file)) == (turn, lift, bend)
        note, = [each for each in robot.notes if "searched for" in each]
        typed = note[note.index("@q="):]
        again = MuJoCoRobot(scene(3), file + typed)
        assert begins_at(again) == (turn, lift, bend)
        assert not [each for each in again.notes if "searched for" in each]

    def test_it_began_in_contact(self, tmp_path: Path) -> None:
        """A wide table just below the shoulder leaves the upper half of what the arm can reach.

        Where none is free of contact it is refused.
        """
        table = '<geom name="table" type="box" size="1 1 0.01" pos="0 0 0.09" contype="1" conaffinity="1"/>'
        for n in (0, 3):
            lift = f'range="{0.1 + 0.3 * n} {0.9 + 0.3 * n}"'
            robot = MuJoCoRobot(scene(3), arm(tmp_path, world=table, lift=lift, bend='range="0.3 2.8"'))
            assert robot._body.data.ncon == 0
            assert singular(robot) > 0.05
        shell = '<geom name="shell" size="2" contype="1" conaffinity="1"/>'
        with pytest.raises(Refused, match=r"none of 1001 poses .* far from singular and free of contact "
                                          r"\(world touches fore\); write --robot mujoco:.*@q=Q1"):
            MuJoCoRobot(scene(3), arm(tmp_path, world=shell))

    def test_the_files_own_positions_stay_where_they_are_sound(self, tmp_path: Path) -> None:
        file = arm(tmp_path).replace("own.xml", "bent.xml")
        Path(file).write_text(Path(tmp_path / "own.xml").read_text().replace(
            'name="bend"', 'name="bend" ref="1.2"').replace('name="lift"', 'name="lift" ref="0.5"').replace(
            '<body name="fore" pos="0 0 0.3">', '<body name="fore" pos="0 0 0.3" euler="0 1.2 0">').replace(
            '<body name="upper">', '<body name="upper" euler="0 0.5 0">'))
        robot = MuJoCoRobot(scene(3), file)
        assert begins_at(robot) == (0.0, 0.5, 1.2)
        assert not [each for each in robot.notes if "searched for" in each]

    def test_can_be_typed(self, tmp_path: Path) -> None:
        (folder := tmp_path / "a#b@c").mkdir()
        file = arm(folder, more=KEYS.format(home="0.3 0.5 1.2"))
        for pose, qpos in (("", BENT), ("@home", BENT), ("@2", (0.5, 0.3, 1.2)), ("@q=0.1,0.4,-1.3", (0.1, 0.4, -1.3))):
            for point in ("", "#end_effector"):
                robot = MuJoCoRobot(scene(3), f"{file}{point}{pose}")
                assert begins_at(robot) == qpos, pose
                assert robot.read(0).x == (0.0, 0.0, 0.0)

    def test_that_cannot_be_is_refused_with_what_to_type(self, tmp_path: Path) -> None:
        file = arm(tmp_path, bend='range="-2.8 2.8"', more=KEYS.format(home="0.3 0.5 1.2"))
        for pose, says in (
            ("@hom", r"has no keyframe hom \(it has home, up, 2\); write --robot mujoco:.*own\.xml@q=Q1,Q2,\.\.\. with "
                     r"a position, rad or m, for each of turn, lift, bend or @NAME of a keyframe"),
            ("@", "has no keyframe without a name"),
            ("@q=0.1,0.2", "@q=0.1,0.2 is not 3 finite numbers with commas between them, one for each joint of mujoco"),
            ("@q=0.1,nan,1.0", "is not 3 finite numbers"), ("@q=a,b,c", "is not 3 finite numbers"),
            ("@q=0,0.3,3.0", "outside the joint limits of .*: bend is at 3 and may be from -2.8 to 2.8; write --robot"),
            ("@up", "end_effector does not move under a push along [xyz].*: no motion of its joints does that in this"),
            ("@q=1.0,0.7,0", "end_effector does not move under a push along .*in this pose; write --robot .*@q=Q1"),
        ):
            with pytest.raises(Refused, match=says) as refused:
                MuJoCoRobot(scene(3), file + pose)
            assert "\n" not in str(refused.value), pose

    def test_of_a_keyframe_home_that_is_not_sound_is_left_with_a_note(self, tmp_path: Path) -> None:
        for home, why in (
            ("0 0 0", "a push does not move it there"), ("0.3 0.5 3", "bend is at 3 and may be from -2.8 to 2.8"),
            ("0 1.226 2.75", "fore touches base"),
        ):
            robot = MuJoCoRobot(scene(3), arm(tmp_path, bend='range="-2.8 2.8"', more=KEYS.format(home=home)))
            assert robot.notes[0] == f"the MuJoCo model did not begin in its keyframe home: {why}"
            assert "searched for" in robot.notes[1]
            assert singular(robot) > 0.1

    def test_of_joints_that_the_scene_begins_outside_their_limits_is_refused(self, tmp_path: Path) -> None:
        file = arm(tmp_path, bend='range="0.5 2.5"')
        own: dict[str, Any] = {"names": ("lift", "bend"), "units": ("rad", "rad")}
        with pytest.raises(Refused, match=r"begins outside the joint limits of .*: bend is at 0 and may be from 0\.5 "
                                          r"to 2\.5; write start_s in the scene"):
            MuJoCoRobot(scene(2, **own), file)
        with pytest.raises(Refused, match=r"axis lift of the scene begins at 0\.3, and @q=0,0\.4,1 has the joint at"):
            MuJoCoRobot(scene(2, start_s=(0.3, 1.0), **own), file + "@q=0,0.4,1")
        assert begins_at(MuJoCoRobot(scene(2, start_s=(0.3, 1.0), **own), file + "@q=0.7,0.3,1")) == (0.7, 0.3, 1.0)


class TestWhatIsNotTheRobot:
    @pytest.mark.parametrize("names", [(), ("rail",)])
    def test_contact_of_the_robot_with_itself_was_told_as_environment(
        self, names: tuple[str, ...], tmp_path: Path
    ) -> None:
        file = tmp_path / "cart.xml"
        for parts, force in (({"stop": STOP, "own": ""}, 5.0), ({"stop": "", "own": STOP}, 0.0)):
            file.write_text(CART.format(**parts))
            robot = MuJoCoRobot(scene(1, names=names), str(file))
            last = moved(robot, [(5.0,)] * 1500)[-1]
            assert last.f == pytest.approx((force,), rel=1e-3)
            assert abs(last.v[0]) < 1e-3
            notes = [each for each in robot.notes if "the robot touched itself" in each]
            assert bool(notes) == (force == 0.0)
        assert "cart against base" in notes[0]
        assert float(notes[0].split()[6]) >= 4.9

    def test_an_elbow_that_presses_is_a_note_and_not_what_the_end_effector_feels(self, tmp_path: Path) -> None:
        elbow = '<geom name="elbow" pos="0 0 0.3" size="0.03" contype="1" conaffinity="1"/>'
        wall = '<geom name="wall" type="box" size="0.01 0.5 0.05" pos="0.258 0 0.31" contype="1" conaffinity="1"/>'
        file = Path(arm(tmp_path, world=wall))
        file.write_text(file.read_text().replace('<body name="fore"', f'{elbow}<body name="fore"'))
        robot = MuJoCoRobot(scene(3), f"{file}@q=0,0.8,-1.5")
        assert {reading.f for reading in moved(robot, [(3.0, 0.0, -3.0)] * 100)} == {(0.0, 0.0, 0.0)}
        assert [each for each in robot.notes if "touched something before its end effector" in each]


class TestAPushThatDoesNotMoveIt:
    WELD = '<equality><weld name="hand" body1="mocap" body2="fore"/></equality>'

    def test_of_an_arm_welded_to_a_mocap_body_is_refused(self, tmp_path: Path) -> None:
        world = '<body name="mocap" mocap="true" pos="0.2 0 0.5"/>'
        with pytest.raises(Refused, match="end_effector does not move under a push along x, y and z: the file's "
                                          "<equality> welds or connects mocap to fore; take that out"):
            MuJoCoRobot(scene(3), arm(tmp_path, world=world, more=self.WELD))
        off = self.WELD.replace("body2", 'active="false" body2')
        assert begins_at(MuJoCoRobot(scene(3), arm(tmp_path, world=world, more=off)))

    def test_of_joints_that_the_file_holds_or_a_site_on_the_axis_of_joint_1_is_refused(self, tmp_path: Path) -> None:
        more = '<equality><joint joint1="bend" polycoef="1 0 0 0 0"/></equality>'
        own: dict[str, Any] = {"names": ("lift", "bend"), "units": ("rad", "rad"), "start_s": (0.2, 1.0)}
        with pytest.raises(Refused, match="not move under a push along bend: the file's <equality> couples its joints"):
            MuJoCoRobot(scene(2, **own), arm(tmp_path, more=more))
        with pytest.raises(Refused, match=r"on_axis does not move under a push: it stands on the axes of the joints "
                                          r"that carry it; write --robot mujoco:.*own\.xml#NAME"):
            MuJoCoRobot(scene(3), arm(tmp_path) + "#on_axis")

    def test_of_a_cart_that_has_no_rail_along_an_axis_of_the_scene_or_has_it_across_is_refused(
        self, tmp_path: Path
    ) -> None:
        """Across: the scene has no y, and the spring that holds it there would be what the hand feels."""
        file = tmp_path / "cart.xml"
        file.write_text(CART.format(stop="", own=""))
        with pytest.raises(Refused, match="end_effector does not move under a push along y: no motion of its joints"):
            MuJoCoRobot(scene(2), str(file))
        file.write_text(CART.format(stop="", own="").replace('axis="1 0 0"', 'axis="1 1 0"'))
        with pytest.raises(Refused, match="does not move under a push along x while it is held along y and z"):
            MuJoCoRobot(scene(1), str(file))

    @pytest.mark.usefixtures("pressing")
    def test_for_the_friction_of_its_joints_is_told_with_how_far_it_came(self, tmp_path: Path) -> None:
        """It was said to come upon nothing within 0.2 m, where 4 N had not moved it at all."""
        file = arm(tmp_path, joint='frictionloss="3"')
        robot = MuJoCoRobot(scene(3), file)
        note, = [each for each in robot.notes if "frictionloss" in each]
        J = np.zeros((3, 3))
        mujoco.mj_jacBody(robot._model.model, robot._body.data, J, None, robot._model.tip)
        assert f"of up to {(3.0 / abs(J[0]).max()):.2g} N along x" in note
        far, = [each for each in robot.notes if "came upon nothing" in each]
        assert float(far.partition("within ")[2].split()[0]) < 0.01


# Models of other packages: where each is, the end effector, and why it is refused; None: it runs.
GYMNASIUM = "gymnasium_robotics/envs"
ROBOSUITE = "robosuite/models/assets/robots"
MODELS = {
    "dm-control, jaco": ("dm_control/third_party/kinova/jaco_arm.xml", "wristsite", None),
    "gymnasium-robotics, franka": (
        f"{GYMNASIUM}/assets/kitchen_franka/kitchen_assets/kitchen_env_model.xml", "end_effector", None),
    "gymnasium-robotics, pusher": (f"{GYMNASIUM}/mujoco/assets/pusher.xml", "tips_arm", None),
    "gymnasium-robotics, fetch": (
        f"{GYMNASIUM}/assets/fetch/reach.xml", "robot0:grip", "welds or connects robot0:mocap to robot0:gripper_link"),
    **{f"robosuite, {name}": (f"{ROBOSUITE}/{name}/robot.xml", "right_hand", None)
       for name in ("panda", "ur5e", "jaco", "kinova3", "sawyer", "xarm7", "iiwa")},
    "robosuite, iiwa on its axis": (
        f"{ROBOSUITE}/iiwa/robot.xml", "right_center", "it stands on the axes of the joints that carry it"),
}


@pytest.mark.parametrize("name", MODELS)
def test_a_model_that_comes_with_a_package_runs_from_a_sound_pose_or_is_refused(name: str) -> None:
    """f_env is zero in the air: jaco had 1.1e8 N of it and panda 1,434 N, with the status ok."""
    path, point, refused = MODELS[name]
    package = name.partition(",")[0]
    home = find_spec(path.partition("/")[0])
    if home is None or not home.submodule_search_locations:
        pytest.skip(f"{package} is not installed: pip install --no-deps {package}")
    file = f"{Path(home.submodule_search_locations[0]).parent / path}#{point}"
    of = load_scene("arm", duration=2.0)
    if refused is not None:
        with pytest.raises(Refused, match=refused):
            MuJoCoRobot(of, file)
        return
    robot = MuJoCoRobot(of, file)
    model, data = robot._model.model, robot._body.data
    limited = model.jnt_limited.astype(bool)
    at = data.qpos[model.jnt_qposadr[limited]]
    assert ((model.jnt_range[limited, 0] <= at) & (at <= model.jnt_range[limited, 1])).all()
    assert not [each for each in data.contact
                if each.efc_address >= 0 and set(each.geom.tolist()) & robot._model.robot.geoms]
    assert singular(robot) > 0.05
    ran = run_stepped(of, {"m": SimulatedMaster, "s": lambda _: robot})
    assert ran.status == "ok"
    assert ran.metrics["f_env_max"] == 0.0
    assert np.ptp(ran.trace["x_s"][:, 0]) > 0.002  # jaco's least: its joints have a friction of 1 and 2 N m
