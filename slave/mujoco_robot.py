"""MuJoCo slave: an arm made by this project, or any model in an MJCF file, as a robot.

`mujoco-core` (the extra `mujoco`) is loaded when a robot is made. What the axes of a scene are to a model is in
`slave.mujoco_model`: translations of its end effector, or joints. Whatever actuators the file has are off: the motors
are those of the scene. Each body of the arm has its weight compensated at every sub-step (MuJoCo's `gravcomp`).
"""

from __future__ import annotations

from copy import copy
from math import inf, isfinite

from slave.mujoco_body import MuJoCoBody
from slave.mujoco_model import load
from teleop.protocol.deadline import DEADLINE
from teleop.protocol.endpoint import Axes, Reading
from teleop.scene.scene import Scene


class MuJoCoRobot:
    """A robot in MuJoCo, mujoco or mujoco:FILE.xml: its motion under a force that is held between the ticks.

    `file`: an MJCF, `FILE.xml` or `FILE.xml#NAME` with the name of the site or body that is its end effector, either
    with the pose that it begins in, `@KEYFRAME` or `@q=Q1,Q2,...` (see `slave.mujoco_pose`); left out: the arm of this
    project, three joints between a wall and a table. `notes` say in which pose it began, what was found when it was
    pressed against what it touches, which contacts f_env does not count, and what MuJoCo warned of. f_env is the force
    of the contacts of the end effector with what is not the robot, at the last sub-step
    before the tick. A force that is not renewed within its deadline lapses. A model that becomes unstable reads a place
    beyond any bounds, so that the run has diverged. Raises `Refused`.
    """

    deadline = DEADLINE
    senses = True
    simulated = True
    passive = True  # nothing moves it but its motors and what it touches

    def __init__(self, scene: Scene, file: str | None = None) -> None:
        from slave.pressing import pressed

        self._model = load(scene, file)
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
