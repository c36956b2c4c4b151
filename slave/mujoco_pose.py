"""Start pose of a robot in MuJoCo: a keyframe, joint positions, or a pose that is searched for.

A pose is sound if each joint is inside its limits, no geom of the robot touches anything, and a push moves the robot
along every axis of the scene. The last goes by the inverse effective mass J M^-1 J^T (Khatib, "A unified approach for
motion and force control of robot manipulators", IEEE J. Robotics and Automation 3 (1987)), a radian counting as
`LEVER` metres, with M^-1 projected on the
motions that the equality constraints of the file leave: a weld to a mocap body leaves none. Far from singular is where
the smallest singular value of J alone is large (Yoshikawa, "Manipulability of robotic mechanisms", Int. J. Robotics
Research 4 (1985)), next to the largest that was found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, pi, sqrt
from typing import Any

import numpy as np

from teleop.errors import Refused, enumerated
from teleop.live.devices.arm_model import join_names

POSES, SEED = 1000, 0  # of the search, drawn evenly
MARGIN = 0.1  # of the range of a joint, to either of its limits
PART = 0.5  # of the largest manipulability found: a pose with less is too near to a singular one
LEVER = 0.1  # m, of an end effector, that its turn by a radian is compared with
BLOCKED = 1e-4  # of the inverse effective mass along the lightest direction: what has less does not move
ON_AXIS = 1e-6  # m/rad: a point that is moved by less stands on the axes of its joints
RANK = 1e-6  # of the largest eigenvalue: constraints that are weaker are none
OUTSIDE = 1e-4  # rad or m, beyond a limit, by which a position is rounded
APART = 1e-3  # m or rad by which an equality constraint may be broken
DIGITS = 4  # of a pose that was found, so that it can be typed


@dataclass(frozen=True, eq=False)
class Robot:
    """The part of a compiled model that is the robot.

    `label`: the robot as it is typed, without a pose; `point`: the site or body that is its end effector. `joints`: the
    hinges and slides that carry it, in the order of the file; where the axes are joints, all of the robot. `others`:
    those of the same tree that do not. `geoms`: those of the tree. `tip`: the body that forces are applied to; None:
    the axes are joints. `axes`, `held`: the world's axes that the scene has, turns from 3 on, and translations that it
    has not, or degrees of freedom. `starts`:
    where in qpos the scene says a position, and which. `names`: of the scene's axes.
    """

    mujoco: Any
    model: Any
    label: str
    point: str
    joints: tuple[int, ...]
    others: tuple[int, ...]
    geoms: frozenset[int]
    tip: int | None
    axes: Sequence[int]
    held: Sequence[int]
    starts: dict[int, float]
    names: tuple[str, ...]

    def joint_name(self, joint: int) -> str:
        """The name of a joint, or its number where it has none."""
        return self.model.joint(joint).name or f"joint {joint}"

    def body_name(self, geom: int) -> str:
        """The name of the body of a geom, or its number where it has none."""
        body = int(self.model.geom_bodyid[geom])
        return self.model.body(body).name or f"body {body}"

    def limits(self, joint: int) -> tuple[float, float] | None:
        """The limits of a joint, rad or m; None where it has none."""
        low, high = self.model.jnt_range[joint].tolist()
        return (low, high) if self.model.jnt_limited[joint] else None

    def outside(self, qpos: Any) -> list[str]:
        """The joints that are not inside their limits, each in words."""
        wrong = []
        for joint in (*self.joints, *self.others):
            at, limits = float(qpos[self.model.jnt_qposadr[joint]]), self.limits(joint)
            if limits is not None and not limits[0] - OUTSIDE <= at <= limits[1] + OUTSIDE:
                wrong.append(f"{self.joint_name(joint)} is at {at:.4g} and may be from {limits[0]:.4g} to "
                             f"{limits[1]:.4g}")
        return wrong

    def obstacle(self, data: Any) -> str:
        """The contact of the robot, or the constraint that is broken, in words; empty where neither is.

        `data`: positions and constraints of the pose are computed in it.
        """
        for contact in data.contact:
            first, second = contact.geom.tolist()
            if not contact.exclude and (first in self.geoms or second in self.geoms):
                return f"{self.body_name(first)} touches {self.body_name(second)}"
        if data.ne and float(abs(data.efc_pos[:data.ne]).max()) > APART:
            return "an equality constraint of the file is broken"
        return ""


def start_pose(robot: Robot, pose: str | None) -> tuple[Any, list[str]]:
    """The positions qpos that the model begins in, and the notes on how they were found.

    `pose`: a keyframe by its name or number, or `q=` and positions of `robot.joints`, rad or m; None: the keyframe
    `home` if it is sound, the file's own positions if they are, else a pose that is searched for, the same one each
    time. Raises `Refused` for a pose outside the limits or one that a push does not move, and where none is found.
    """
    data = robot.mujoco.MjData(robot.model)
    home = _keyframe(robot, data, "home")
    if pose is not None:
        return _pose_of(robot, data, pose, home), []
    if home is None:
        return _searched(robot, data, robot.model.qpos0.copy())
    for place, at in robot.starts.items():
        home[place] = at
    _place(robot, data, home)
    wrong = robot.outside(home) or [robot.obstacle(data)]
    if not wrong[0] and not _blocked(robot, data):
        return home, []
    qpos, notes = _searched(robot, data, home)
    why = wrong[0] or "a push does not move it there"
    return qpos, [f"the MuJoCo model did not begin in its keyframe home: {why}", *notes]


def _keyframe(robot: Robot, data: Any, name: str) -> Any:
    """The positions of the keyframe of a name or a number; None if there is none. Raises `Refused`."""
    mujoco, model = robot.mujoco, robot.model
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, name)
    if key < 0 and name.isdecimal() and int(name) < model.nkey:
        key = int(name)
    if key < 0:
        return None
    mujoco.mj_resetDataKeyframe(model, data, key)
    if not isfinite(sum(data.qpos.tolist())):
        raise Refused(f"the keyframe {name} of {robot.label} has a place that is not finite; mend it there")
    return data.qpos.copy()


def _pose_of(robot: Robot, data: Any, pose: str, home: Any) -> Any:
    """The positions of a pose as it is typed. Raises `Refused`."""
    if pose.startswith("q="):
        qpos = _others_inside(robot, robot.model.qpos0.copy() if home is None else home)
        for joint, at in zip(robot.joints, _positions(robot, pose), strict=True):
            qpos[robot.model.jnt_qposadr[joint]] = at
    else:
        qpos = _keyframe(robot, data, pose)
        if qpos is None:
            raise Refused(f"{robot.label} has no keyframe {pose or 'without a name'} ({_keyframes(robot)}); "
                          f"{_to_type(robot)}")
    for place, start in robot.starts.items():
        if abs(qpos[place] - start) > OUTSIDE:
            name = robot.joint_name(robot.model.jnt_qposadr.tolist().index(place))
            raise Refused(f"the axis {name} of the scene begins at {start:g}, and @{pose} has the joint at "
                          f"{qpos[place]:.4g}; write start_s in the scene, or leave the pose out")
        qpos[place] = start
    if outside := robot.outside(qpos):
        raise Refused(f"@{pose} is outside the joint limits of {robot.label}: {'; '.join(outside)}; {_to_type(robot)}")
    _place(robot, data, qpos)
    if why := _blocked(robot, data):
        raise Refused(why)
    return qpos


def _positions(robot: Robot, pose: str) -> list[float]:
    """The numbers of a pose `q=...`, one for each joint. Raises `Refused`."""
    try:
        positions = [float(each) for each in pose.removeprefix("q=").split(",")]
    except ValueError:
        positions = []
    if len(positions) != len(robot.joints) or not isfinite(sum(positions)):
        raise Refused(f"@{pose} is not {len(robot.joints)} finite numbers with commas between them, one for each joint "
                      f"of {robot.label}; {_to_type(robot)}")
    return positions


def _searched(robot: Robot, data: Any, reference: Any) -> tuple[Any, list[str]]:
    """A pose that is sound, and the note on it; `reference`: the file's own positions. Raises `Refused`."""
    model, rng = robot.model, np.random.default_rng(SEED)
    for place, at in robot.starts.items():
        reference[place] = at
    inside = _others_inside(robot, reference.copy())
    spans = {place: span for joint in robot.joints if (place := int(model.jnt_qposadr[joint])) not in robot.starts
             and (span := _span(robot, joint)) is not None}
    for place, (low, high) in spans.items():
        inside[place] = min(max(low, inside[place]), high)
    if outside := robot.outside(inside):  # only what the scene says can be
        raise Refused(f"the scene begins outside the joint limits of {robot.label}: {'; '.join(outside)}; write "
                      "start_s in the scene, inside them")
    poses = [inside]
    for draw in rng.random((POSES if spans else 0, len(spans))):
        poses.append(inside.copy())
        for part, (place, (low, high)) in zip(draw.tolist(), spans.items(), strict=True):
            poses[-1][place] = round(low + part * (high - low), DIGITS)
    values = _manipulabilities(robot, data, poses)
    best = int(np.argmax(values))
    _place(robot, data, poses[best])
    if why := _blocked(robot, data):
        raise Refused(why)
    first = 0 if (inside == reference).all() else None  # the file's own positions, where they are sound
    order = sorted(range(len(poses)), key=lambda n: (n != first, -values[n]))
    far = [n for n in order if values[n] >= PART * values[best]]
    touches = ""
    for n in far:
        _place(robot, data, poses[n])
        why = robot.obstacle(data)
        if not why:
            return poses[n], [_search_note(robot, poses[n])] if (poses[n] != reference).any() else []
        touches = touches or why
    raise Refused(f"none of {len(poses)} poses of {robot.label} inside its joint limits is both far from singular and "
                  f"free of contact ({touches}); {_to_type(robot)}")


def _search_note(robot: Robot, qpos: Any) -> str:
    """The note on a pose that was found, with what to type for it."""
    typed = ",".join(f"{round(float(qpos[robot.model.jnt_qposadr[joint]]), DIGITS):g}" for joint in robot.joints)
    return ("the MuJoCo model began in a pose that was searched for, inside its joint limits, free of contact and "
            f"far from singular: @q={typed}")


def _others_inside(robot: Robot, qpos: Any) -> Any:
    """`qpos` with the joints that do not carry the end effector inside their limits."""
    for joint in robot.others:
        place, limits = int(robot.model.jnt_qposadr[joint]), robot.limits(joint)
        if limits is not None:
            qpos[place] = min(max(limits[0], qpos[place]), limits[1])
    return qpos


def _span(robot: Robot, joint: int) -> tuple[float, float] | None:
    """The positions of a joint that are searched, rad or m; None of a slide without limits, which stays."""
    if (limits := robot.limits(joint)) is not None:
        keep = MARGIN * (limits[1] - limits[0])
        return limits[0] + keep, limits[1] - keep
    hinge = robot.model.jnt_type[joint] == int(robot.mujoco.mjtJoint.mjJNT_HINGE)
    return (-pi, pi) if hinge else None


def _place(robot: Robot, data: Any, qpos: Any) -> None:
    data.qpos[:] = qpos
    robot.mujoco.mj_fwdPosition(robot.model, data)


def _manipulabilities(robot: Robot, data: Any, poses: Sequence[Any]) -> list[float]:
    """The smallest singular value of the Jacobian at each pose, m/rad; 1.0 where the axes are joints."""
    if robot.tip is None:
        return [1.0] * len(poses)
    model, contact = robot.model, int(robot.mujoco.mjtDisableBit.mjDSBL_CONTACT)
    flags, values = model.opt.disableflags, []
    model.opt.disableflags |= contact  # which takes most of the time, and does not bear on it
    for qpos in poses:
        _place(robot, data, qpos)
        J, held, equal = _jacobians(robot, data)
        least = np.linalg.eigvalsh(_mobility(J, np.eye(model.nv), np.vstack((held, equal))))[0]
        values.append(sqrt(max(0.0, float(least))))
    model.opt.disableflags = flags
    return values


def _jacobians(robot: Robot, data: Any) -> tuple[Any, Any, Any]:
    """Rows of length nv: of the scene's axes, of the translations that are held, of the equality constraints."""
    mujoco, model = robot.mujoco, robot.model
    equal = np.zeros((data.ne, model.nv))  # equality constraints are the first rows
    for n in range(data.ne):
        row = np.zeros(data.nefc)
        row[n] = 1.0
        mujoco.mj_mulJacTVec(model, data, equal[n], row)
    J = jacobian(robot, data)
    if robot.tip is not None:
        J[[i >= 3 for i in robot.axes]] *= LEVER
    return J, jacobian(robot, data, robot.held), equal


def jacobian(robot: Robot, data: Any, axes: Sequence[int] | None = None) -> Any:
    """The Jacobian of the axes, of the scene unless others are given, rows of length nv."""
    axes = list(robot.axes if axes is None else axes)
    if robot.tip is None:
        return np.eye(robot.model.nv)[axes]
    J = np.zeros((6, robot.model.nv))
    robot.mujoco.mj_jacBody(robot.model, data, J[:3], J[3:], robot.tip)
    return J[axes]


def _mobility(J: Any, inverse: Any, constraints: Any) -> Any:
    """J P J^T, where P is the inverse mass matrix on the motions that the constraints leave."""
    if not len(constraints):
        return J @ inverse @ J.T
    held = inverse @ constraints.T
    return J @ (inverse - held @ np.linalg.pinv(constraints @ held, rcond=RANK, hermitian=True) @ held.T) @ J.T


def _blocked(robot: Robot, data: Any) -> str:
    """Why a push along some axis of the scene does not move the robot, and what to type; empty where each does."""
    J, held, equal = _jacobians(robot, data)
    M = np.zeros((robot.model.nv, robot.model.nv))
    robot.mujoco.mj_fullM(robot.model, data, M)
    inverse = np.linalg.inv(M)
    free, beside, left = (_mobility(J, inverse, each) for each in (held[:0], held, np.vstack((held, equal))))
    if robot.tip is None:
        welded = [name for name, now, then in zip(robot.names, np.diag(left), np.diag(free), strict=True)
                  if not now > BLOCKED * then]
        return _welded(robot, data, welded) if welded else ""
    if np.linalg.norm(J, 2) < ON_AXIS:
        return (f"{robot.point} does not move under a push: it stands on the axes of the joints that carry it; write "
                f"{_sites(robot)}, one that is further out")
    needed = BLOCKED * np.linalg.eigvalsh(free)[-1]
    values, ways = np.linalg.eigh(left)
    if values[0] > needed:
        return ""
    along = [name for name, part in zip(robot.names, abs(ways[:, 0]), strict=True)
             if part > 0.3 or not values[-1] > needed]
    if np.linalg.eigvalsh(beside)[0] > needed:
        return _welded(robot, data, along)
    if np.linalg.eigvalsh(free)[0] > needed:
        return (f"{robot.point} does not move under a push along {enumerated(along)} while it is held along "
                f"{enumerated(['xyz'[i] for i in robot.held])}, for which the scene has no axis; give the scene these "
                "axes too, or write names=(...) with the one that it moves along")
    return (f"{robot.point} does not move under a push along {enumerated(along)}: no motion of its joints does that "
            f"in this pose; {_to_type(robot)}, or leave out of the scene the axes that it cannot move along")


def _welded(robot: Robot, data: Any, along: list[str]) -> str:
    """The sentence on equality constraints that hold the robot."""
    mujoco, model = robot.mujoco, robot.model
    bodies = (int(mujoco.mjtEq.mjEQ_WELD), int(mujoco.mjtEq.mjEQ_CONNECT))
    names = []
    for n in range(model.neq):
        if data.eq_active[n] and model.eq_type[n] in bodies and model.eq_objtype[n] == int(mujoco.mjtObj.mjOBJ_BODY):
            names.append(" to ".join(model.body(int(each)).name or "the world"
                                     for each in (model.eq_obj1id[n], model.eq_obj2id[n])))
    what = f"welds or connects {join_names(names)}" if names else "couples its joints"
    return (f"{robot.point} does not move under a push along {enumerated(along)}: the file's <equality> {what}; take "
            "that out of the file, or write active=\"false\" there")


def _to_type(robot: Robot) -> str:
    """The words on what to type for another pose."""
    joints = join_names([robot.joint_name(joint) for joint in robot.joints])
    keys = " or @NAME of a keyframe" if robot.model.nkey else ""
    return f"write --robot {robot.label}@q=Q1,Q2,... with a position, rad or m, for each of {joints}{keys}"


def _keyframes(robot: Robot) -> str:
    names = [robot.model.key(n).name or str(n) for n in range(robot.model.nkey)]
    return f"it has {join_names(names)}" if names else "it has none"


def _sites(robot: Robot) -> str:
    return f"--robot {robot.label.partition('#')[0]}#NAME with another of its sites or bodies"
