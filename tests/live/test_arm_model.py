"""The dynamics of an arm by its MJCF or URDF: against closed forms, and what is refused of a file."""

from __future__ import annotations

from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import ArmModel, Refused, Scene, load_scene

pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")

PLANAR = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 -1 0" frictionloss="0.3" damping="0.2"/>
      <inertial pos="0.5 0 0" mass="2" diaginertia="1e-9 1e-9 1e-9"/>
      <body name="fore" pos="0.5 0 0"><joint name="elbow" axis="0 -1 0" frictionloss="0.1"/>
        <inertial pos="0.4 0 0" mass="1.5" diaginertia="1e-9 1e-9 1e-9"/>
        <body name="hand" pos="0.4 0 0"><joint name="wrist" axis="1 0 0"/>
          <inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def scene(names: str = "turn,lift,bend", units: str = "rad", **knobs: Any) -> Scene:
    return load_scene("bench_top", axes=str(len(names.split(","))), units=units, names=names, duration=2.0, **knobs)


def written(folder: Path, text: str, name: str = "arm.xml") -> str:
    (folder / name).write_text(text)
    return str(folder / name)


def test_of_two_links_it_is_the_textbooks(tmp_path: Path) -> None:
    """Point masses at the ends: M, and h of Coriolis, centrifugal and weight, in closed form; of a URDF too."""
    l1, l2, m1, m2, g = 0.5, 0.4, 2.0, 1.5, 9.81
    link = "<inertial><origin xyz='{at} 0 0'/><mass value='{m}'/><inertia ixx='1e-9' iyy='1e-9' izz='1e-9' " \
        "ixy='0' ixz='0' iyz='0'/></inertial><visual><geometry><mesh filename='package://gone/x.stl'/></geometry>" \
        "</visual><collision><geometry><mesh filename='package://gone/x.stl'/></geometry></collision>"
    joint = "<joint name='{name}' type='revolute'><parent link='{of}'/><child link='{to}'/><axis xyz='0 -1 0'/>" \
        "<origin xyz='{at} 0 0'/><limit lower='-3' upper='3' effort='9' velocity='9'/><dynamics friction='{f}'/>" \
        "</joint>"
    urdf = written(tmp_path, "<robot name='two'><link name='base'/>"
                   f"<link name='upper'>{link.format(at=l1, m=m1)}</link>"
                   f"<link name='fore'>{link.format(at=l2, m=m2)}</link>"
                   f"{joint.format(name='shoulder', of='base', to='upper', at=0, f=0.3)}"
                   f"{joint.format(name='elbow', of='upper', to='fore', at=l1, f=0.1)}</robot>", "arm.urdf")
    of = scene("shoulder,elbow")
    rng = np.random.default_rng(1)
    for file in (written(tmp_path, PLANAR), urdf):
        model = ArmModel(file, of)
        turned = ArmModel(file, scene("a,b"), ("-elbow", "shoulder"))
        assert model.friction.tolist() == [0.3, 0.1]
        for _ in range(20):
            (a, b), (da, db) = q, v = rng.uniform(-2.0, 2.0, (2, 2))
            m12 = m2 * l2 * (l2 + l1 * cos(b))
            M = [[(m1 + m2) * l1 ** 2 + m2 * l2 * (l2 + 2.0 * l1 * cos(b)), m12], [m12, m2 * l2 ** 2]]
            c = m2 * l1 * l2 * sin(b)
            tip = m2 * g * l2 * cos(a + b)
            h = [-c * (2.0 * da * db + db * db) + (m1 + m2) * g * l1 * cos(a) + tip, c * da * da + tip]
            now = model.at(q, v)
            np.testing.assert_allclose(now.inertia, M, rtol=1e-6, atol=1e-7)
            np.testing.assert_allclose(now.torque, h, rtol=1e-6, atol=1e-7)
            other = turned.at((-b, a), (-db, da))
            np.testing.assert_allclose(other.torque, [-h[1], h[0]], rtol=1e-6, atol=1e-7)
            np.testing.assert_allclose(other.inertia, [[M[1][1], -M[0][1]], [-M[0][1], M[0][0]]], rtol=1e-6)


def test_a_model_that_does_not_fit_the_scene_or_has_no_mass_is_refused_in_one_sentence(tmp_path: Path) -> None:
    file = written(tmp_path, PLANAR)
    light = written(tmp_path, PLANAR.replace('mass="2"', 'mass="0"').replace('mass="1.5"', 'mass="0"').replace(
        'mass="1e-9"', 'mass="0"'), "light.xml")
    broken = written(tmp_path, "<mujoco><worldbody><body><joint/></worldbody></mujoco>", "broken.xml")
    for path, of, joints, says in (
        (file, scene("shoulder,knee"), (), r"the scene's axes knee are no joints of .* \(it has shoulder in rad, "
         r"elbow in rad, wrist in rad\); write \?joints= with 2 of them in the scene's order"),
        (file, scene("a,b"), ("shoulder", "knee"), r"joints= knee are no joints"),
        (file, scene("a,b"), ("shoulder",), r"the scene has 2 axes, and joints= names shoulder; name one joint"),
        (file, scene("a,b"), ("elbow", "-elbow"), r"name one joint for each axis, each once"),
        (file, scene("shoulder,elbow", "m"), (), r"axis shoulder is in m, and the joint shoulder of .* is in rad"),
        (light, scene("shoulder,elbow"), (), r"light\.xml does not load as an MJCF \(.*mass and inertia of moving "
         "bodies must be larger"),
        (broken, scene("a"), (), r"broken\.xml does not load as an MJCF \(.*\); mend it there, or leave"),
        (str(tmp_path / "gone.xml"), scene("a"), (), r"there is no file .*gone\.xml, which should be the MJCF"),
    ):
        with pytest.raises(Refused, match=says) as refused:
            ArmModel(path, of, joints)
        assert "\n" not in str(refused.value)
