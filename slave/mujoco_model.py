"""A MuJoCo model for a scene: loaded from an MJCF, and what of it the axes of the scene are.

Axes that are called x, y, z are translations of the end effector along the world's axes of these names, and the three
axes of a rotation of the scene its turns about them; the scene's zero is where the end effector stands at the start
less the scene's start_s, so it begins where the scene says. Other axes are joints of their names, in rad or m, that
begin at start_s. The pose that the model begins in is in `slave.mujoco_pose`. Translations that the scene has no axis
for are held by a spring and a damper; turns are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any

from slave.mujoco_pose import Robot, start_pose
from teleop.errors import Refused
from teleop.live.devices.arm_model import (
    check_units,
    join_names,
    joint_units,
    load_mujoco,
    not_loaded,
    usable_joints,
)
from teleop.scene.scene import Scene

OWN, TURNS = (Path(__file__).parent / name for name in ("arm.xml", "wrist.xml"))  # the second of six joints, for turns
END = "end_effector"  # the site or body that is looked for
LETTERS = ("x", "y", "z")
HEAVY = "?gravcomp=0"  # behind the file: the robot has its weight
SUBSTEPS, MOST_SUBSTEPS = 4, 1000  # of a tick
TIP = "teleop_end_effector"  # a body without mass at that site, which forces are applied to


@dataclass(frozen=True, eq=False)
class Loaded:
    """A compiled model and the scene's axes in it.

    `names` and `units` are the scene's. `axes`: of an end effector translations along the world's axes (0, 1, 2) and
    turns about them (3, 4, 5), of joints their degrees of freedom; `places`: of joints, where they stand in qpos.
    `tip`: the body that forces are applied to; None: the axes are joints. `zero`: where in the world the scene's
    positions count from, m, 0 of turns; `turned`: by what rotation vector the scene begins, rad. `held`: world's axes
    without one of the scene, and where they are held. `geoms`: those of the end effector and of what hangs on it; where
    the axes are joints, all of the robot's. `robot`: the part of the model that is the robot. `notes`: on the pose that
    it begins in. `heavy`: it has its weight.
    """

    model: Any
    qpos: Any
    substeps: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    axes: list[int]
    places: list[int]
    tip: int | None
    zero: tuple[float, ...]
    turned: tuple[float, ...]
    held: tuple[tuple[int, float], ...]
    geoms: frozenset[int]
    robot: Robot
    notes: tuple[str, ...]
    heavy: bool


def load(scene: Scene, file: str | None = None) -> Loaded:
    """The model in `file` for `scene`: FILE.xml, FILE.xml#NAME with NAME of the end effector, or either with @POSE.

    POSE is that of `slave.mujoco_pose.start_pose`. `?gravcomp=0` behind all: its weight is not compensated. Raises
    `Refused`.
    """
    heavy = file is not None and file.endswith(HEAVY)
    file = file.removesuffix(HEAVY) if file else file
    mujoco = load_mujoco("the robot mujoco", "leave --robot out for the simulated one")
    path, name, pose = _parts(file or str(TURNS if scene.rotations else OWN))
    spec = _spec(mujoco, path)
    cartesian = _is_cartesian(scene)
    if cartesian:
        _add_tip(mujoco, spec, path, name)
    else:
        _check_joints(mujoco, scene, spec, path)
    try:
        for body in spec.bodies[1:]:
            if _is_carried(mujoco, body):
                body.gravcomp = 0.0 if heavy else 1.0
        model = spec.compile()
    except ValueError as error:
        raise _not_loaded(path, error) from error
    dt = scene.dt_ns / 1e9
    substeps = _substeps(path, dt, float(model.opt.timestep))
    model.opt.timestep = dt / substeps
    # Motors are the scene's; and a state that became unstable must not begin anew from the start, unseen.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION) | int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    starts = scene.vector("start_s", scene.start_s)
    label = "mujoco" if file is None else f"mujoco:{path}" + (f"#{name}" if name else "")
    if not cartesian:
        places, axes = ([int(at[model.joint(each).id]) for each in scene.axis_names]
                        for at in (model.jnt_qposadr, model.jnt_dofadr))
        robot = _robot(mujoco, model, label, name or path, None, scene.axis_names, axes,
                       dict(zip(places, starts, strict=True)))
        qpos, notes = start_pose(robot, pose)
        return Loaded(model, qpos, substeps, scene.axis_names, scene.axis_units, axes, places, None, (), (), (),
                      robot.geoms, robot, tuple(notes), heavy)
    tip = model.body(TIP).id
    axes = _cartesian_axes(scene)
    robot = _robot(mujoco, model, label, name or END, tip, scene.axis_names, axes, {})
    qpos, notes = start_pose(robot, pose)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    at = data.xpos[tip].tolist()
    return Loaded(
        model, qpos, substeps, scene.axis_names, scene.axis_units, axes, [], tip,
        tuple([at[i] - start if i < 3 else 0.0 for i, start in zip(axes, starts, strict=True)]),
        tuple([start for i, start in zip(axes, starts, strict=True) if i >= 3]),
        tuple([(i, at[i]) for i in robot.held]), _geoms_of(model, tip), robot, tuple(notes), heavy)


def _parts(file: str) -> tuple[str, str, str | None]:
    """The path of the MJCF, the name of the end effector ("": `END`), and the pose, None without one."""
    ends = [n for n, letter in enumerate(file) if letter in "#@"]
    end = next((n for n in (len(file), *reversed(ends)) if Path(file[:n]).is_file()), min(ends, default=len(file)))
    name, at, pose = file[end:].partition("@")
    return file[:end], name.removeprefix("#"), pose if at else None


def _robot(mujoco: Any, model: Any, label: str, point: str, tip: int | None, names: tuple[str, ...], axes: list[int],
           starts: dict[int, float]) -> Robot:
    """The part of a compiled model that is the robot: the kinematic trees of its end effector, or of its joints."""
    hinged = [tip] if tip is not None else [int(model.dof_bodyid[dof]) for dof in axes]
    roots = {int(model.body_rootid[body]) for body in hinged}
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    joints = [n for n in range(model.njnt)
              if model.jnt_type[n] in kinds and int(model.body_rootid[model.jnt_bodyid[n]]) in roots]
    carriers = set()
    body = tip or 0
    while body:
        carriers.add(body)
        body = int(model.body_parentid[body])
    carrying = [n for n in joints if tip is None or int(model.jnt_bodyid[n]) in carriers]
    geoms = [n for n in range(model.ngeom) if int(model.body_rootid[model.geom_bodyid[n]]) in roots]
    held = [] if tip is None else [i for i in range(3) if i not in axes]
    return Robot(mujoco, model, label, point, tuple(carrying), tuple([n for n in joints if n not in carrying]),
                 frozenset(geoms), tip, axes, held, starts, names)


def _is_cartesian(scene: Scene) -> bool:
    """True where the axes are translations of an end effector, and its rotation.

    Raises `Refused` where one of x, y, z is an angle, and for a second rotation.
    """
    names = [name for i, name in enumerate(scene.axis_names) if i not in scene.turning]
    if not set(names) <= set(LETTERS):
        return False
    if len(scene.rotations) > 1:
        raise Refused(f"the scene has {len(scene.rotations)} rotations, and an end effector in MuJoCo has one; take a "
                      "scene with one rotation")
    for i, (name, unit) in enumerate(zip(scene.axis_names, scene.axis_units, strict=True)):
        if unit != "m" and i not in scene.turning:
            raise Refused(f"the scene's axis {name} is in {unit}, and in MuJoCo an axis of this name is a translation "
                          "of the end effector; write units=(...) in the scene with m for it, or name the axis after "
                          "a joint")
    return True


def _cartesian_axes(scene: Scene) -> list[int]:
    """The scene's axes of an end effector: 0 to 2 its translations along the world's axes, 3 to 5 its turns."""
    turns = {first + i: 3 + i for first in scene.rotations for i in range(3)}
    return [turns[i] if i in turns else LETTERS.index(name) for i, name in enumerate(scene.axis_names)]


def _substeps(path: str, dt: float, timestep: float) -> int:
    """The sub-steps of a tick of dt seconds: `SUBSTEPS`, or as many as make them no longer than the file's timestep."""
    least = dt / MOST_SUBSTEPS
    if not timestep >= least:
        raise Refused(f"{path} has a timestep of {timestep:g} s, and a tick of {dt:g} s has at most {MOST_SUBSTEPS} "
                      f"sub-steps; write one of at least {least:g} in its <option>, or leave it out")
    return max(SUBSTEPS, ceil(dt / timestep - 1e-9))


def _spec(mujoco: Any, path: str) -> Any:
    if not Path(path).is_file():
        raise Refused(f"there is no file {path}; write --robot mujoco:FILE.xml with the path of an MJCF, or --robot "
                      "mujoco for the arm of this project")
    try:
        return mujoco.MjSpec.from_file(path)
    except ValueError as error:
        raise _not_loaded(path, error) from error


def _not_loaded(path: str, error: Exception) -> Refused:
    return not_loaded(path, error, "type --robot mujoco for the arm of this project")


def _add_tip(mujoco: Any, spec: Any, path: str, name: str) -> None:
    """Add a body without mass where the end effector is, which forces are applied to."""
    wanted = name or END
    site: Any = next((each for each in spec.sites if each.name == wanted), None)
    body: Any = next((each for each in spec.bodies[1:] if each.name == wanted), None)
    if site is None and body is None:
        sites, bodies = (join_names([part.name for part in parts]) for parts in (spec.sites, spec.bodies[1:]))
        raise Refused(f"{path} has no site and no body of the name {wanted}, to be its end effector; write --robot "
                      f"mujoco:{path}#NAME with one of its sites ({sites}) or bodies ({bodies})")
    holder = body if site is None else site.parent
    if not _is_carried(mujoco, holder):
        raise Refused(f"{wanted} of {path} is no end effector: no hinge, slide or ball moves it; write --robot "
                      f"mujoco:{path}#NAME with a site or body at the end of its joints")
    at = [0.0, 0.0, 0.0] if site is None else site.pos
    try:
        holder.add_body(name=TIP, pos=at, explicitinertial=True, mass=0.0, ipos=[0.0] * 3, inertia=[0.0] * 3)
    except ValueError as error:  # the name is taken
        raise _not_loaded(path, error) from error


def _check_joints(mujoco: Any, scene: Scene, spec: Any, path: str) -> None:
    """Refuse axes that are no joints of the model of these names, hinges in rad and slides in m."""
    units = joint_units(mujoco, spec)
    missing = [name for name in scene.axis_names if units.get(name) is None]
    if missing:
        raise Refused(f"the scene's axes {', '.join(missing)} are no joints of {path} (it has {usable_joints(units)}), "
                      "and axes that are not joints are called x, y, z, all of them, translations of an end effector; "
                      "write --robot mujoco:FILE.xml with a model that has such joints, or names=(...) in the scene")
    check_units(scene, scene.axis_names, units, path)


def _is_carried(mujoco: Any, body: Any) -> bool:
    """True of a body that hinges and slides carry, and no free joint: a part of an arm."""
    moved = False
    while body.name != "world":
        kinds = [joint.type for joint in body.joints]
        if mujoco.mjtJoint.mjJNT_FREE in kinds:
            return False
        moved = moved or bool(kinds)
        body = body.parent
    return moved


def _geoms_of(model: Any, tip: int) -> frozenset[int]:
    """The geoms that stand fast with the end effector, and those of what hangs on it."""
    weld = int(model.body_weldid[tip])
    parts = {weld}
    for body in range(weld + 1, model.nbody):  # a parent has a smaller number than its children
        if int(model.body_parentid[body]) in parts:
            parts.add(body)
    return frozenset(n for n in range(model.ngeom) if int(model.geom_bodyid[n]) in parts)
