"""The robot from the side: where its outlines are, against the kinematics of arms that are written down here."""

from __future__ import annotations

import json
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")

from teleop import Refused, load_scene
from teleop.live.page.controls import Controls
from teleop.live.page.page import Page
from teleop.live.page.session import PageParts, Start
from teleop.live.page.side_view import SideView
from teleop.live.process.interrupt import Interrupt

SHAPES = """<mujoco><default><geom contype="0" conaffinity="0" mass="0.01"/></default><worldbody>
  <geom type="plane" size="1 1 0.1"/><geom type="box" pos="0.5 0 0.1" size="0.1 0.2 0.05"/>
  <body pos="0 0 0.5"><joint name="base" axis="0 0 1"/><geom type="sphere" size="0.04"/>
  <body><joint name="shoulder" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
  <body pos="0.3 0 0"><joint name="elbow" axis="0 -1 0"/><geom type="box" pos="0.1 0 0" size="0.1 0.01 0.02"/>
  <body pos="0.2 0 0"><joint name="forearm" axis="1 0 0"/><geom type="cylinder" size="0.03 0.05"/>
  <body><joint name="wrist" axis="0 -1 0"/><geom type="ellipsoid" size="0.05 0.01 0.02"/>
  <body><joint name="flange" axis="1 0 0"/><geom type="sphere" size="0.01"/>
  </body></body></body></body></body></body>
</worldbody></mujoco>"""


def test_the_end_of_a_jointed_arm_is_where_its_angles_put_it_and_the_masters_picture_beside_it(tmp_path: Path) -> None:
    file = tmp_path / "six.xml"
    file.write_text(SHAPES)
    view = SideView(load_scene("leader_follower"), f"mujoco:{file}")
    model = view.shapes
    assert [shape["radius"] for shape in model["shapes"]] == [0.04, 0.02, 0.0, 0.0, 0.0, 0.01]
    assert len(model["world"]) == 1, "the box; a plane has no end"
    assert np.ptp(model["world"][0]["points"], axis=0) == pytest.approx([0.2, 0.1])
    rng = np.random.default_rng(3)
    for _ in range(20):
        m, s = rng.uniform(-1.5, 1.5, (2, 6))
        slave, master = view.poses(tuple(m), tuple(s))
        for q, poses in ((s, slave), (m, master)):
            out = 0.3 * cos(q[1]) + 0.2 * cos(q[1] + q[2])
            at = [cos(q[0]) * out, 0.5 + 0.3 * sin(q[1]) + 0.2 * sin(q[1] + q[2])]
            assert poses[-1][6:] == pytest.approx(at, abs=2e-5)
            turned = np.array(poses[2][:6]).reshape(2, 3)  # the box of the forearm
            assert turned @ [1.0, 0.0, 0.0] == pytest.approx(
                [cos(q[0]) * cos(q[1] + q[2]), sin(q[1] + q[2])], abs=2e-5)


def test_the_view_is_of_the_pose_that_the_model_begins_in() -> None:
    """It was of the pose in which a page was opened or a law switched, so each browser had a view of its own."""
    view, controls = SideView(load_scene("arm"), "mujoco"), Controls("arm", {}, "mujoco")
    page = Page(controls, PageParts(Path(), {}), Start("arm", 0), Interrupt(), lambda: 0.0, view)
    before = json.loads(page._hello())["arm"]
    view.poses((0.0, 0.0, 0.0), (0.1, 0.1, 0.1))
    assert json.loads(page._hello())["arm"] == before


def test_the_joints_of_an_arm_whose_end_is_coupled_are_found_for_every_position() -> None:
    """The tip's picture is where the end effector was told to be, from the bundled arm's own numbers."""
    view = SideView(load_scene("arm"), "mujoco")
    t = np.linspace(0.0, 2.0 * pi, 60)
    for x, y, z in np.stack([0.03 * np.sin(t), 0.05 * np.cos(t), -0.04 * np.sin(2.0 * t)], axis=1):
        [poses] = view.poses((0.0, 0.0, 0.0), (x, y, z))
        assert poses[-1][6:] == pytest.approx([0.25 + x, 0.3 + z], abs=1e-4)
    reach = [view.poses((), (10.0, 0.0, 0.0))[0][-1][6:] for _ in range(3)][-1]
    assert 0.45 < np.hypot(reach[0], reach[1] - 0.3) < 0.501, "stretched out towards it, and no further"


def test_outlines_hold_their_shapes(tmp_path: Path) -> None:
    """A cylinder's and an ellipsoid's points lie on them; a mesh's are vertices of it, the furthest ones."""
    file = tmp_path / "six.xml"
    file.write_text(SHAPES)
    shapes = SideView(load_scene("leader_follower"), f"mujoco:{file}").shapes["shapes"]
    x, y, z = np.array(shapes[3]["points"]).T
    assert np.hypot(x, y) == pytest.approx(np.full(len(x), 0.03), abs=1e-4)
    assert set(np.round(np.abs(z), 5)) == {0.05}
    x, y, z = np.array(shapes[4]["points"]).T
    assert (x / 0.05) ** 2 + (y / 0.01) ** 2 + (z / 0.02) ** 2 == pytest.approx(np.ones(len(x)), abs=2e-3)
    corners = "  ".join(f"{a} {b} {c}" for a in (0, 1) for b in (0, 2) for c in (0, 3))
    asset = f'<asset><mesh name="m" vertex="{corners}"/></asset><worldbody>'
    with_mesh = SHAPES.replace('type="sphere" size="0.01"', 'type="mesh" mesh="m"')
    file.write_text(with_mesh.replace("<worldbody>", asset, 1))
    points = SideView(load_scene("leader_follower"), f"mujoco:{file}").shapes["shapes"][-1]["points"]
    assert len(points) == 8
    assert sorted(np.ptp(points, axis=0)) == pytest.approx([1.0, 2.0, 3.0], abs=1e-4)


def test_a_model_without_the_scenes_joints_is_refused_before_anything_starts() -> None:
    with pytest.raises(Refused, match="no joints of"):
        SideView(load_scene("leader_follower"), "mujoco")
