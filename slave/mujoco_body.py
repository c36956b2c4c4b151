"""State of a MuJoCo model, stepped a tick at a time: forces in, places and contact forces out.

A force on the end effector is applied to the point itself (`xfrc_applied`), so that MuJoCo takes J^T f anew at every
sub-step, and what the force does is f dx to the order of the integrator. Torques go to `qfrc_applied`. `mj_step` leaves
positions and velocities of bodies a sub-step behind the state, so they are computed once more at each tick.
"""

from __future__ import annotations

from copy import copy
from math import hypot

from slave.mujoco_model import Loaded
from teleop.errors import DeviceError
from teleop.protocol.endpoint import Axes, Reading

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
        import numpy as np

        self.loaded, self._mujoco, self._model = model, mujoco, model.model
        self.data = mujoco.MjData(model.model)
        self.data.qpos[:] = model.qpos
        mujoco.mj_forward(self._model, self.data)
        self._velocity, self._wrench = np.zeros(6), np.zeros(6)
        self._force: Axes = (0.0,) * len(model.axes)
        self._besides: dict[bool, tuple[float, float, int, int]] = {}
        self._views()

    def __copy__(self) -> MuJoCoBody:
        other = MuJoCoBody.__new__(MuJoCoBody)
        other.__dict__.update(self.__dict__)
        other.data, other._besides = copy(self.data), {}
        other._views()
        return other

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
        """One tick. Raises `DeviceError` where MuJoCo gives up."""
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

    def read(self) -> Reading:
        """Where it is, how fast, and the force of its contacts on what it touches."""
        own = self.loaded
        if own.tip is None:
            x, v = self.data.qpos[own.places].tolist(), self.data.qvel[own.axes].tolist()
            return Reading(tuple(x), tuple(v), self._torque())
        where, speed = self._place.tolist(), self._speed()
        return Reading(tuple([where[i] - zero for i, zero in zip(own.axes, own.zero, strict=True)]),
                       tuple([speed[i] for i in own.axes]), self._touch())

    def warnings(self) -> list[str]:
        """What MuJoCo has warned of in this state, a sentence each."""
        names = {int(each): name.removeprefix("mjWARN_") for name, each in self._mujoco.mjtWarning.__members__.items()}
        return [f"MuJoCo warned of {names[i]} {count} {'time' if count == 1 else 'times'}: {_MEANS.get(names[i], '')}"
                for i, count in enumerate(self.data.warning.number.tolist()) if count]

    def _speed(self) -> list[float]:
        """The velocity of the end effector, m/s, along the world's axes."""
        self._mujoco.mj_objectVelocity(
            self._model, self.data, self._mujoco.mjtObj.mjOBJ_XBODY, self.loaded.tip, self._velocity, 0)
        found: list[float] = self._velocity[3:].tolist()
        return found

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
        """The sum of the contact forces of the end effector on what is not the robot, N, along the scene's axes."""
        data = self.data
        total = [0.0, 0.0, 0.0]
        for n in self._contacts():
            contact = data.contact[n]
            self._mujoco.mj_contactForce(self._model, data, n, self._wrench)
            sign = 1.0 if contact.geom[0] in self.loaded.geoms else -1.0  # it is the force of the first on the second
            force, frame = self._wrench.tolist(), contact.frame.tolist()
            for i in range(3):
                total[i] += sign * (force[0] * frame[i] + force[1] * frame[3 + i] + force[2] * frame[6 + i])
        return tuple([total[i] for i in self.loaded.axes])

    def _torque(self) -> Axes:
        """The torque (N m; N of a slide) that contacts with what is not the robot take from each joint of the scene."""
        data = self.data
        if not data.ncon:
            return (0.0,) * len(self.loaded.axes)
        import numpy as np

        contact = data.efc_type >= int(self._mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)
        counted = contact & np.isin(data.efc_id, self._contacts())
        found = np.zeros(self._model.nv)
        self._mujoco.mj_mulJacTVec(self._model, data, found, np.where(counted, data.efc_force, 0.0))
        return tuple((-found[self.loaded.axes]).tolist())

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
