"""MuJoCo slave: an arm made by this project, or any model in an MJCF file, as a robot.

`mujoco-core` (the extra `mujoco`) is loaded when a robot is made. What the axes of a scene are to a model is in
`slave.mujoco_model`: translations of its end effector, or joints. Whatever actuators the file has are off: the motors
are those of the scene. Each body of the arm has its weight compensated at every sub-step (MuJoCo's `gravcomp`).

A force on the end effector, and a torque about it, is applied to the point itself (`xfrc_applied`), so that MuJoCo
takes J^T f anew at every sub-step, and the work is f dx to the order of the integrator. Its turns are counted by
`RotationAxes`, as of any device that tells a quaternion. Torques of joints go to `qfrc_applied`. `mj_step`
leaves positions and velocities of bodies a sub-step behind the state, so they are computed once more at each tick.

MuJoCo's contacts are soft by how they are computed, and their stiffness goes with the force. So it is measured before
the run, never promised: pressed slowly in a copy of the state, along the first axis with a contact, at two forces.
"""

from __future__ import annotations

from copy import copy
from math import hypot, inf, isfinite, nan
from typing import TYPE_CHECKING

import numpy as np

from slave.mujoco_model import Loaded, load
from slave.mujoco_pose import ON_AXIS, jacobian
from teleop.errors import DeviceError
from teleop.physics.rotation import Quaternion, RotationAxes, exp, product
from teleop.protocol.endpoint import Axes, Reading
from teleop.protocol.guard import DEADLINE
from teleop.scene.axes import FORCE_UNIT
from teleop.scene.scene import Scene

if TYPE_CHECKING:
    from slave.mujoco_model import Loaded

HOLD_K, HOLD_D = 1000.0, 40.0  # N/m and N s/m, along the translations that the scene has no axis for
_UNSTABLE = "the model became unstable; a smaller dt, gain or timestep in its file may hold it"
_MEANS = {
    "BADQPOS": _UNSTABLE, "BADQVEL": _UNSTABLE, "BADQACC": _UNSTABLE,
    "INERTIA": "the inertia of its joints is nearly singular; give its bodies more mass, or its joints armature",
    "CONTACTFULL": "there were more contacts than it has room for; give <size memory> in its file more",
    "CNSTRFULL": "there were more constraints than it has room for; give <size memory> in its file more",
}


class MuJoCoBody:
    """The state of a model, stepped a tick at a time; a copy of it goes on by itself."""

    def __init__(self, model: Loaded) -> None:
        import mujoco

        self.loaded, self._mujoco, self._model = model, mujoco, model.model
        self.data = mujoco.MjData(model.model)
        self.data.qpos[:] = model.qpos
        mujoco.mj_forward(self._model, self.data)
        self._velocity, self._wrench = np.zeros(6), np.zeros(6)
        self._rotation = RotationAxes()
        self._begun: Quaternion | None = None  # what turns its quaternion into the scene's
        if model.turned:
            w, x, y, z = self._quaternion()
            self._begun = product(w, -x, -y, -z, *exp(*model.turned))
        self._force: Axes = (0.0,) * len(model.axes)
        self._besides: dict[bool, tuple[float, float, int, int]] = {}
        self._views()
        self._turns = self._turned()

    def __copy__(self) -> MuJoCoBody:
        body = MuJoCoBody.__new__(MuJoCoBody)
        body.__dict__.update(self.__dict__)
        body.data, body._besides, body._rotation = copy(self.data), {}, copy(self._rotation)
        body._views()
        return body

    def _views(self) -> None:
        """Keep the arrays of the state that each tick reads and writes: looking up costs as much."""
        tip = self.loaded.tip
        if tip is None:
            return
        self._place, self._applied = self.data.xpos[tip], self.data.xfrc_applied[tip]

    def hold(self, force: Axes) -> None:
        """Apply `force` (N or N m, per axis) from now on."""
        self._force = force
        if self.loaded.tip is None:
            self.data.qfrc_applied[self.loaded.axes] = force
            return
        self._applied[self.loaded.axes] = force

    def step(self) -> None:
        """Step one tick. Raises `DeviceError` where MuJoCo gives up."""
        mujoco, model, data = self._mujoco, self._model, self.data
        if self.loaded.held:
            self._hold_the_others()
        try:
            mujoco.mj_step(model, data, self.loaded.substeps)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
        except mujoco.FatalError as error:
            raise DeviceError(f"MuJoCo gave up: {error}") from error
        self._turns = self._turned()

    def read(self) -> Reading:
        """Read position, velocity, and the force of its contacts on the environment."""
        loaded = self.loaded
        if loaded.tip is None:
            x, v = self.data.qpos[loaded.places].tolist(), self.data.qvel[loaded.axes].tolist()
            return Reading(tuple(x), tuple(v), self._torque())
        where, speed = [*self._place.tolist(), *self._turns], self._speed()
        return Reading(tuple([where[i] - zero for i, zero in zip(loaded.axes, loaded.zero, strict=True)]),
                       tuple([speed[i] for i in loaded.axes]), self._touch())

    def warnings(self) -> list[str]:
        """Sentences for MuJoCo's warnings in this state."""
        names = {int(each): name.removeprefix("mjWARN_") for name, each in self._mujoco.mjtWarning.__members__.items()}
        return [f"MuJoCo warned of {names[i]} {count} {'time' if count == 1 else 'times'}: {_MEANS.get(names[i], '')}"
                for i, count in enumerate(self.data.warning.number.tolist()) if count]

    def _speed(self) -> list[float]:
        """The velocity of the end effector, m/s along the world's axes, and rad/s about them."""
        self._mujoco.mj_objectVelocity(
            self._model, self.data, self._mujoco.mjtObj.mjOBJ_XBODY, self.loaded.tip, self._velocity, 0)
        speed: list[float] = self._velocity.tolist()
        return [*speed[3:], *speed[:3]]

    def _quaternion(self) -> Quaternion:
        """The unit quaternion of the end effector."""
        w, x, y, z = self.data.xquat[self.loaded.tip].tolist()
        return w, x, y, z

    def _turned(self) -> tuple[float, ...]:
        """The coordinates of the end effector's rotation, rad, which begin where the scene does; none without one."""
        if self._begun is None:
            return ()
        quaternion = self._quaternion()
        if not isfinite(sum(quaternion)):  # of a model that became unstable
            return (nan,) * 3
        return self._rotation.phi(product(*quaternion, *self._begun))

    def _hold_the_others(self) -> None:
        """Hold the end effector where it began along the translations that the scene has no axis for."""
        where, speed = self._place, self._speed()
        for i, home in self.loaded.held:
            self._applied[i] = HOLD_K * (home - where[i]) - HOLD_D * speed[i]

    def contact_notes(self) -> list[str]:
        """The contacts at the ticks that were read and that f_env does not count, a sentence for each kind."""
        robot, notes = self.loaded.robot, []
        for of_robot, (force, when, first, second) in sorted(self._besides.items()):
            what = "the robot touched itself" if of_robot else "the robot touched something before its end effector"
            notes.append(f"{what}: up to {force:.4g} N, {robot.body_name(first)} against {robot.body_name(second)} at "
                         f"t = {when:.3f} s; f_env does not count it")
        return notes

    def _touch(self) -> Axes:
        """The sum of the contact forces of the end effector on what is not the robot, N, along the scene's axes.

        About those of its rotation the sum of their torques about the end effector, N m.
        """
        data = self.data
        total = [0.0] * 6
        turns = self._begun is not None
        for n in self._contacts():
            contact = data.contact[n]
            self._mujoco.mj_contactForce(self._model, data, n, self._wrench)
            sign = 1.0 if contact.geom[0] in self.loaded.geoms else -1.0  # it is the force of the first on the second
            force, frame = self._wrench.tolist(), contact.frame.tolist()
            along = [sign * (force[0] * frame[i] + force[1] * frame[3 + i] + force[2] * frame[6 + i])
                     for i in range(3)]
            for i, each in enumerate(along):
                total[i] += each
            if turns:
                x, y, z = (contact.pos - self._place).tolist()
                by_arm = y * along[2] - z * along[1], z * along[0] - x * along[2], x * along[1] - y * along[0]
                for i, each in enumerate(by_arm):
                    total[3 + i] += each + sign * (
                        force[3] * frame[i] + force[4] * frame[3 + i] + force[5] * frame[6 + i])
        return tuple([total[i] for i in self.loaded.axes])

    def _torque(self) -> Axes:
        """The torque (N m; N of a slide) that contacts with what is not the robot take from each joint of the scene."""
        data = self.data
        if not data.ncon:
            return (0.0,) * len(self.loaded.axes)
        contact = data.efc_type >= int(self._mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)
        counted = contact & np.isin(data.efc_id, self._contacts())
        torque = np.zeros(self._model.nv)
        self._mujoco.mj_mulJacTVec(self._model, data, torque, np.where(counted, data.efc_force, 0.0))
        return tuple((-torque[self.loaded.axes]).tolist())

    def _contacts(self) -> list[int]:
        """The contacts that f_env counts: of `geoms` with what is not the robot. The largest of the others are kept."""
        data, loaded, counted = self.data, self.loaded, []
        for n in range(data.ncon):
            first, second = data.contact[n].geom.tolist()
            inside = (first in loaded.robot.geoms) + (second in loaded.robot.geoms)
            if inside == 0:
                continue
            if inside == 1 and (first in loaded.geoms or second in loaded.geoms):
                counted.append(n)
                continue
            self._mujoco.mj_contactForce(self._model, data, n, self._wrench)
            force = hypot(*self._wrench[:3].tolist())
            if force > self._besides.get(inside == 2, (0.0,))[0]:
                self._besides[inside == 2] = (force, data.time, first, second)
        return counted


class MuJoCoRobot:
    """A robot in MuJoCo, mujoco or mujoco:FILE.xml: its motion under a force that is held between the ticks.

    `file`: an MJCF, `FILE.xml` or `FILE.xml#NAME` with the name of the site or body that is its end effector, either
    with the pose that it begins in, `@KEYFRAME` or `@q=Q1,Q2,...` (see `slave.mujoco_pose`); `?gravcomp=0` behind all
    leaves it its weight. Left out: an arm of this project between a wall and a table, of three joints, or of six for a
    scene with a rotation. `notes` say in which pose it began, what was found when it was pressed against what it
    touches, which contacts f_env does not count, and what MuJoCo warned of. f_env is the force of the contacts of the
    end effector with what is not the robot, at the last sub-step before the tick, and about the axes of a rotation
    their torque. A force that is not renewed within its deadline lapses. A model that becomes unstable reads a place
    beyond any bounds, so that the run has diverged. Raises `Refused`.
    """

    deadline = DEADLINE
    senses = True
    simulated = True
    passive = True  # nothing moves it but its motors and what it touches

    def __init__(self, scene: Scene, file: str | None = None) -> None:
        self._model = load(scene, file)
        self.weightless = not self._model.heavy
        self._body = MuJoCoBody(self._model)
        self._axes = scene.axes
        self._k = self._renewed = 0
        self._lapse = max(1, round(DEADLINE * 1e9 / scene.dt_ns))
        self._lost = False
        self._press_notes = pressed(self._model, copy(self._body))

    def read(self, k: int) -> Reading:
        """Position, velocity and contact force, the left limit at tick k. Ticks may be left out."""
        body = self._body
        while self._k < k:
            if self._k - self._renewed >= self._lapse:
                body.hold((0.0,) * self._axes)
            body.step()
            self._k += 1
        reading = body.read()
        if self._lost or not isfinite(sum(reading.x) + sum(reading.v)):
            self._lost = True
            return Reading((inf,) * self._axes, (0.0,) * self._axes, (0.0,) * self._axes)
        return reading

    def hold(self, force: Axes) -> None:
        """Hold `force` (N or N m, per axis) from now on."""
        self._body.hold(force)
        self._renewed = self._k

    @property
    def notes(self) -> list[str]:
        """Sentences for the summary: the pose, what was pressed, contacts beside f_env, what MuJoCo warned of."""
        return [*self._model.notes, *self._press_notes, *self._body.contact_notes(), *self._body.warnings()]


FORCES = (2.0, 10.0)  # N or N m, at which it is told
PART = 0.2  # of each: the stiffness is that between a force less and one more by so much
APPROACH = 4.0  # N or N m, against ...
DAMPING = {"m": 20.0, "rad": 2.0}  # ... so much, N s/m or N m s/rad
SPRING = {"m": 1000.0, "rad": 50.0}  # N/m or N m/rad, which hold the other axes,
TURN = 0.1  # ... and so much of both for the turns of an end effector, which is lighter than joints
REACH = {"m": 0.2, "rad": 0.6}  # how far from the start it is looked for
LEAST_FRICTION = 0.5  # N or N m, that is worth a note
SEEKS, SETTLES = 1.5, 0.4  # s, for the way there, and for each force


def pressed(model: Loaded, body: MuJoCoBody) -> list[str]:
    """Sentences on the stiffness of what `body`, a copy of the start, comes upon, and on the friction of its joints."""
    from copy import copy

    reached: dict[str, float] = {}
    friction = friction_notes(model, body)
    for i, unit in enumerate(model.units):
        if model.turned and unit == "rad":  # what a tool twists is no wall
            continue
        for sign in (1.0, -1.0):
            stiffness, way = _along(model, copy(body), i, sign)
            if stiffness is not None:
                force = FORCE_UNIT[unit]
                at = " and ".join(f"{each:,.0f} {force}/{unit} at {load:g} {force}"
                                  for each, load in zip(stiffness, FORCES, strict=True))
                along = f"{'+' if sign > 0.0 else '-'}{model.names[i]}"
                return [f"pressed slowly before the run along {along}, the contact of the MuJoCo model had {at}: it is "
                        "softer than a rigid body, and not linear", *friction]
            reached[unit] = min(reached.get(unit, REACH[unit]), way)
    within = " or ".join(f"{way:.2g} {unit}" for unit, way in sorted(reached.items()))
    return [f"pressed before the run along each axis, the MuJoCo model came upon nothing within {within} of its start: "
            "the stiffness of its contacts is not known", *friction]


def friction_notes(model: Loaded, body: MuJoCoBody) -> list[str]:
    """The note on the pushes (N or N m) along each axis that the friction of the joints holds at the start."""
    loss = model.model.dof_frictionloss
    J = jacobian(model.robot, body.data)
    with np.errstate(divide="ignore", invalid="ignore"):
        holds = np.nanmin(np.where(abs(J) > ON_AXIS, loss / abs(J), np.inf), axis=1)
    large = [f"{force:.2g} {FORCE_UNIT[unit]} along {name}"
             for force, unit, name in zip(holds.tolist(), model.units, model.names, strict=True)
             if force >= LEAST_FRICTION]
    return [f"the friction of its joints (frictionloss in its file) holds the MuJoCo model at the start against a push "
            f"of up to {', '.join(large)}"] if large else []


def _along(model: Loaded, body: MuJoCoBody, i: int, sign: float) -> tuple[tuple[float, ...] | None, float]:
    """The stiffness at each of `FORCES` of what is along axis i, and how far it came, m or rad.

    The stiffness is None of nothing, and of what does not hold still.
    """
    dt = model.model.opt.timestep * model.substeps
    home = body.read().x
    try:
        if not _push(model, body, home, i, sign * APPROACH, round(SEEKS / dt), seeks=True):
            return None, abs(body.read().x[i] - home[i])
        stiffness = []
        for force in FORCES:
            at = []
            for load in (force * (1.0 - PART), force * (1.0 + PART)):
                if not _push(model, body, home, i, sign * load, round(SETTLES / dt)):
                    return None, abs(body.read().x[i] - home[i])
                at.append(sign * body.read().x[i])
            if not at[1] > at[0]:
                return None, abs(at[1] - sign * home[i])
            stiffness.append(2.0 * PART * force / (at[1] - at[0]))
    except DeviceError:
        return None, 0.0
    return tuple(stiffness), abs(at[1] - sign * home[i])


def _push(model: Loaded, body: MuJoCoBody, home: tuple[float, ...], i: int, force: float, ticks: int, *,
          seeks: bool = False) -> bool:
    """Push along axis i for so many ticks; True if what is there then takes that force, to 5 %.

    `seeks`: it ends as soon as there is something, or beyond `REACH`.
    """
    unit = model.units
    part = [TURN if model.turned and each == "rad" else 1.0 for each in unit]
    for _ in range(ticks):
        x, v, f = body.read()[:3]
        if not abs(x[i] - home[i]) < REACH[unit[i]]:
            return False
        if f is not None and seeks and abs(f[i] - force) < 0.2 * abs(force) and abs(v[i]) < 0.01:
            return True
        held = [force if j == i else part[j] * SPRING[unit[j]] * (home[j] - x[j]) for j in range(len(x))]
        body.hold(tuple([each - part[j] * DAMPING[unit[j]] * v[j] for j, each in enumerate(held)]))
        body.step()
    x, _, f = body.read()[:3]
    return f is not None and abs(f[i] - force) < 0.05 * abs(force)
