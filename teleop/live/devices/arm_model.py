"""Dynamics of an arm from an MJCF or a URDF, by MuJoCo's own inverse dynamics; and how such a file is read.

With q the joints' positions and v their velocities an arm obeys

    M(q) v' + h(q, v) + friction = u + f,        h = C(q, v) v + g(q),

u its motors' torques and f those of whatever touches it. `ArmModel.at` gives M by the composite rigid body algorithm
and h by the recursive Newton-Euler one (Featherstone, "Rigid Body Dynamics Algorithms", 2008), both MuJoCo's. Joints
that are not the scene's stand where the file has them, in its keyframe `home` if it has one, and are part of the load.

Geometry has no part in it: a file whose meshes are not there is read without them, if its bodies have their inertia.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from teleop.errors import Refused
from teleop.scene.scene import Scene

LISTED = 12  # names that a sentence has
POSES, SEED = 500, 0  # by which the greatest load is found, drawn evenly
SPEED = 1.0  # rad/s or m/s, of each joint at most meanwhile
UNLIMITED = 3.2  # rad or m to either side, of a joint without limits


def load_mujoco(what: str, instead: str) -> Any:
    """Load MuJoCo. `what`: that needs it; `instead`: what else to do. Raises `Refused`."""
    try:
        import mujoco
    except ImportError as error:
        raise Refused(f"{what} needs mujoco-core: pip install 'bilateral-teleop[mujoco]', or {instead}") from error
    # Without one, MuJoCo writes each warning to stderr and into a file MUJOCO_LOG.TXT; here they become notes.
    mujoco.set_mju_user_warning(lambda _warning: None)
    return mujoco


def not_loaded(path: str, error: Exception, instead: str) -> Refused:
    """Make the refusal of a file that MuJoCo does not take. `instead`: what else to type, as a clause."""
    why = " ".join(str(error).split())
    return Refused(f"{path} does not load as an MJCF ({why}); mend it there, or {instead}")


def joint_units(mujoco: Any, spec: Any) -> dict[str, str | None]:
    """Return the unit of each joint by its name: rad of a hinge, m of a slide, None of others."""
    kinds = {mujoco.mjtJoint.mjJNT_HINGE: "rad", mujoco.mjtJoint.mjJNT_SLIDE: "m"}
    return {each.name: kinds.get(each.type) for each in spec.joints if each.name}


def check_units(scene: Scene, joints: Sequence[str], units: dict[str, str | None], file: str) -> None:
    """Refuse axes whose joints, one for each, have another unit in `file`."""
    for axis, unit, joint in zip(scene.axis_names, scene.axis_units, joints, strict=True):
        if units[joint] != unit:
            raise Refused(f"the scene's axis {axis} is in {unit}, and the joint {joint} of {file} is in "
                          f"{units[joint]}; write units=(...) in the scene, one for each axis")


def usable_joints(units: dict[str, str | None]) -> str:
    """Return the hinges and slides as a sentence has them: "lift in rad, rail in m"."""
    return join_names([f"{name} in {unit}" for name, unit in units.items() if unit is not None])


def join_names(names: list[str]) -> str:
    """Return the first `LISTED` of the names that are not empty, as a sentence has them."""
    known = [name for name in names if name]
    return ", ".join([*known[:LISTED], *["..."] * (len(known) > LISTED)]) or "none has a name"


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Dynamics at one state: `inertia` M, kg m^2 (of slides kg), and `torque` h, N m (of slides N)."""

    inertia: Any
    torque: Any


class ArmModel:
    """Inverse dynamics of the joints that the axes of a scene are, from `file`, an MJCF or a URDF. Raises `Refused`.

    `joints`: the names of the model's joints in the scene's order, `-NAME` of one that the scene counts the other way;
    left out: the scene's axes have their names. `units` are the scene's. `friction` and `damping` of each are the
    file's (`frictionloss`, N m; `damping`, N m s/rad). `most`: the greatest |h| of each among `POSES` states inside the
    limits.
    """

    def __init__(self, file: str, scene: Scene, joints: Sequence[str] = ()) -> None:
        import numpy as np

        self.file = file
        self._mujoco = mujoco = load_mujoco("compensation by a model", "leave it out")
        spec = self._spec()
        joints = tuple(joints) or scene.axis_names
        self.names = tuple([each.removeprefix("-") for each in joints])
        self.units = scene.axis_units
        self._check_joints(spec, scene, typed=joints != scene.axis_names)
        self.model = model = self._compiled(spec)
        self._dofs = np.array([int(model.joint(name).dofadr[0]) for name in self.names])
        self._places = np.array([int(model.joint(name).qposadr[0]) for name in self.names])
        self._signs = np.array([-1.0 if each.startswith("-") else 1.0 for each in joints])
        self._square = np.outer(self._signs, self._signs)
        self._among = np.ix_(self._dofs, self._dofs)
        self.friction, self.damping = (of[self._dofs].copy() for of in (model.dof_frictionloss, model.dof_damping))
        self.data = mujoco.MjData(model)
        key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
        if key >= 0:
            mujoco.mj_resetDataKeyframe(model, self.data, key)
            self.data.qvel[:] = 0.0
        self._M, self._h = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
        self.most = self._most()

    def at(self, x: Any, v: Any) -> Dynamics:
        """Compute the dynamics at the positions x (rad or m) and the velocities v of the scene's axes."""
        mujoco, model, data, signs = self._mujoco, self.model, self.data, self._signs
        data.qpos[self._places] = signs * x
        data.qvel[self._dofs] = signs * v
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, self._h)
        mujoco.mj_fullM(model, data, self._M)
        return Dynamics(self._square * self._M[self._among], signs * self._h[self._dofs])

    def _spec(self) -> Any:
        if not Path(self.file).is_file():
            raise Refused(f"there is no file {self.file}, which should be the MJCF or URDF of the arm; write "
                          "compensated:FILE.xml | DEVICE")
        try:
            return self._mujoco.MjSpec.from_file(self.file)
        except ValueError as error:
            raise self._not_loaded(error) from error

    def _not_loaded(self, error: Exception) -> Refused:
        return not_loaded(self.file, error, "leave the compensation out")

    def _compiled(self, spec: Any) -> Any:
        """Compile the file; without its meshes where they are not there and the bodies' inertia is."""
        try:
            return spec.compile()
        except ValueError as error:
            first = error
        spec, mesh = self._spec(), self._mujoco.mjtGeom.mjGEOM_MESH
        for geom in list(spec.geoms):
            if geom.type == mesh and geom.parent.explicitinertial:
                spec.delete(geom)
        used = {geom.meshname for geom in spec.geoms if geom.type == mesh}
        for each in list(spec.meshes):
            if each.name not in used:
                spec.delete(each)
        try:
            return spec.compile()
        except ValueError:
            raise self._not_loaded(first) from first

    def _check_joints(self, spec: Any, scene: Scene, *, typed: bool) -> None:
        """Refuse axes that are no joints of the model, hinges in rad and slides in m, each once."""
        units = joint_units(self._mujoco, spec)
        if len(self.names) != scene.axes or len(set(self.names)) != len(self.names):
            raise Refused(f"the scene has {scene.axes} axes, and joints= names {', '.join(self.names)}; name one joint "
                          "for each axis, each once")
        if missing := [name for name in self.names if units.get(name) is None]:
            whose = "joints=" if typed else "the scene's axes"
            raise Refused(f"{whose} {', '.join(missing)} are no joints of {self.file} (it has {usable_joints(units)}); "
                          f"write ?joints= with {scene.axes} of them in the scene's order, or names=(...) in the scene")
        check_units(scene, self.names, units, self.file)

    def _most(self) -> Any:
        """Find the greatest |h| of each joint among states that are drawn inside the limits."""
        import numpy as np

        rng, model = np.random.default_rng(SEED), self.model
        numbers = [int(model.joint(name).id) for name in self.names]
        spans = np.array([model.jnt_range[n] if model.jnt_limited[n] else (-UNLIMITED, UNLIMITED) for n in numbers])
        most = np.zeros(len(numbers))
        for _ in range(POSES):
            q = spans[:, 0] + rng.random(len(numbers)) * (spans[:, 1] - spans[:, 0])
            v = SPEED * rng.uniform(-1.0, 1.0, len(numbers))
            most = np.maximum(most, abs(self.at(self._signs * q, v).torque))
        return most
