"""Figures of an arm's compensation by its model: what a hand still feels, the momentum observer, the cost of a tick.

`dynamics`: of the arms of this project, or with `--model FILE.xml` of others, an MJCF each whose hinges are the axes.
It needs the extra `mujoco`.

A hand leads each joint along a swing of `SWING` rad by a stiff spring. What it feels is held against what it feels of
the same arm without weight and friction: rms of the difference, of the joint that has most. Then the arm is pressed on
a block beside its last body, and the observer's torques are held against those of MuJoCo's contacts. Virtual time, the
same figures each time, but for the cost.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from copy import copy
from dataclasses import replace
from math import cos, pi, sin
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from teleop import ArmModel, Compensated, Reading, Scene, load_scene
from teleop.live.devices.opening import find_device
from teleop.scene.library import ROOT

Row = tuple[str, str, str]
OWN = tuple(ROOT / "slave" / name for name in ("arm.xml", "wrist.xml"))
SWING, SWING_HZ, SECONDS = 0.2, 0.25, 8.0  # rad, 1/s, s
OMEGA, DECAY = 30.0, 0.7  # rad/s and share of critical damping, of the hand's spring at each joint
BANDWIDTH = 100.0  # 1/s
DEPTH, BEFORE = 0.05, 0.01  # m, how far the hand leads towards the block, and how far before it the arm begins
BLOCK, FAR = "teleop_block", 9.0  # m
COUNT, SPEED_COUNT = 25.0 / 65535, 60.0 / 4095  # rad and rad/s, of a Damiao motor's frame
YARDSTICK_US = 30.0  # of a loop of 1000 multiplications and additions
TICKS = 2000  # of which a tick's cost is the mean


class Framed:
    """`device` as a motor's frames tell it: in counts, and a tick old."""

    def __init__(self, device: Any) -> None:
        self.device, self.last = device, None

    def read(self, k: int) -> Reading:
        """Read in counts what was read a tick before."""
        now = self.device.read(k)
        last, self.last = self.last or now, now
        return Reading(tuple([round(x / COUNT) * COUNT for x in last.x]),
                       tuple([round(v / SPEED_COUNT) * SPEED_COUNT for v in last.v]))

    def hold(self, force: tuple[float, ...]) -> None:
        """Hold `force`."""
        self.device.hold(force)


class Arm:
    """The arm of a file, and a scene whose axes are its hinges."""

    def __init__(self, file: Path, folder: Path) -> None:
        import mujoco

        self.mujoco, self.file, self.name = mujoco, str(file), file.stem
        self._free: Any = None
        spec = mujoco.MjSpec.from_file(self.file)
        hinges = [each.name for each in spec.joints if each.type == mujoco.mjtJoint.mjJNT_HINGE]
        self.scene: Scene = load_scene("bench_top", axes=str(len(hinges)), units="rad", names=",".join(hinges),
                                       duration=SECONDS)
        model = ArmModel(self.file, self.scene)
        home = model.data.qpos[[int(model.model.joint(each).qposadr[0]) for each in hinges]]
        ranges = np.array([model.model.joint(each).range for each in hinges])
        limited = np.array([bool(model.model.jnt_limited[model.model.joint(each).id]) for each in hinges])
        low, high = (np.where(limited, ranges[:, i], side * 9.0) for i, side in ((0, -1.0), (1, 1.0)))
        self.home = np.clip(home, low + 1.5 * SWING, high - 1.5 * SWING)
        self.scene = replace(self.scene, start_s=tuple(self.home.tolist()), start_m=tuple(self.home.tolist()))
        inertia = np.diag(model.at(self.home, np.zeros(len(hinges))).inertia)
        self.K, self.D = OMEGA ** 2 * inertia, 2.0 * DECAY * OMEGA * inertia
        model.data.qpos[[int(model.model.joint(each).qposadr[0]) for each in hinges]] = self.home
        joints = [model.model.joint(n) for n in range(model.model.njnt)]
        self.pose = "@q=" + ",".join(repr(float(model.data.qpos[each.qposadr[0]])) for each in joints)
        self.pressed = str(folder / file.name)
        spec.meshdir = str(file.parent / spec.meshdir)
        self._put_block(spec, hinges)
        Path(self.pressed).write_text(spec.to_xml())

    def _put_block(self, spec: Any, hinges: list[str]) -> None:
        """Put a block where the last body stands out most, and have that touch it, whatever the file's defaults say."""
        mujoco, ways = self.mujoco, [sign * np.eye(3)[i] for i in range(3) for sign in (1.0, -1.0)]
        for n in range(len(ways)):
            spec.worldbody.add_geom(name=f"{BLOCK}{n}", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.15] * 3)
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qpos[[int(model.joint(each).qposadr[0]) for each in hinges]] = self.home
        mujoco.mj_forward(model, data)
        last = int(model.jnt_bodyid[model.joint(hinges[-1]).id])
        hand = [n for n in range(model.ngeom) if model.geom_bodyid[n] >= last]
        hand = [n for n in hand if model.geom_contype[n]] or hand
        others = [n for n in range(model.ngeom) if 0 < model.geom_bodyid[n] < last]
        self.middle = data.geom_xpos[hand[-1]].copy()
        gaps = []
        for n, way in enumerate(ways):
            block = model.geom(f"{BLOCK}{n}").id
            data.geom_xpos[block] = self.middle + FAR * way
            gaps.append([min((mujoco.mj_geomDistance(model, data, each, block, 2.0 * FAR, None) for each in geoms),
                             default=FAR) for geoms in (hand, others)])
        best = max(range(len(ways)), key=lambda n: gaps[n][1] - gaps[n][0])
        self.way = ways[best]
        for each in spec.geoms:
            if each.id in hand:
                each.contype = each.conaffinity = 1
        for n in range(len(ways)):
            block = spec.geom(f"{BLOCK}{n}")
            if n != best:
                spec.delete(block)
                continue
            block.pos = self.middle + (FAR - gaps[n][0] + BEFORE) * self.way
            block.contype = block.conaffinity = 1
        spec.compile()

    def robot(self, *, ideal: bool = False) -> Any:
        """The arm in MuJoCo without contacts, at its start; `ideal`: without weight and friction too."""
        if self._free is None:
            self._free = self._open(self.file)
            self._loss = self._free._model.model.dof_frictionloss.copy()
        robot = copy(self._free)
        robot._body = copy(robot._body)
        model = robot._model.model
        model.opt.disableflags |= int(self.mujoco.mjtDisableBit.mjDSBL_CONTACT)
        robot.weightless = ideal
        model.body_gravcomp[1:], model.dof_frictionloss[:] = float(ideal), 0.0 if ideal else self._loss
        return robot

    def before_block(self) -> Any:
        """The arm in MuJoCo, with its weight, before the block that it is pressed on."""
        robot = self._open(self.pressed)
        robot._model.model.body_gravcomp[:] = 0.0
        robot.weightless = False
        return robot

    def _open(self, file: str) -> Any:
        return find_device("s", f"mujoco:{file}{self.pose}").open(self.scene)

    def compensated(self, device: Any, **settings: Any) -> Compensated:
        """The arm's device with its weight carried, from its first tick on."""
        arm = Compensated(device, ArmModel(self.file, self.scene), **settings)
        arm._gain, arm._carried = 1.0, arm.model.at(self.home, np.zeros(len(self.home))).torque
        return arm

    def led(self, device: Any, way: Any) -> tuple[Any, Any]:
        """Lead each joint along `way(t)`, rad; the hand's torques, and what the device read as f."""
        hand, touch, dt = [], [], self.scene.dt
        for k in range(round(SECONDS / dt)):
            reading = device.read(k)
            goal, ahead = way(k * dt), way((k + 1) * dt)
            torque = self.K * (goal - reading.x) + self.D * ((ahead - goal) / dt - reading.v)
            device.hold(tuple(torque.tolist()))
            hand.append(torque)
            touch.append(reading.f or (0.0,) * len(goal))
        return np.array(hand), np.array(touch)

    def swing(self, t: float) -> Any:
        """Position that the hand leads each joint to, rad."""
        phases = 0.9 * np.arange(len(self.home))
        return self.home + SWING * min(1.0, t) * np.sin(2.0 * pi * SWING_HZ * t + phases)


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(values ** 2, axis=0)).max())


def _residuals(arm: Arm) -> list[Row]:
    """Rows on what a hand feels of an arm that it leads."""
    ideal, _ = arm.led(arm.robot(ideal=True), arm.swing)
    later = round(2.0 / arm.scene.dt)

    def residual(device: Any) -> float:
        return _rms((arm.led(device, arm.swing)[0] - ideal)[later:])

    heavier = arm.compensated(arm.robot())
    heavier.model.model.body_mass[:] *= 0.95
    rows = [("  without compensation", residual(arm.robot())),
            ("  compensated", residual(arm.compensated(arm.robot()))),
            ("  and 0.9 of its friction", residual(arm.compensated(arm.robot(), friction=0.9))),
            ("  and read as a Damiao motor's frames, a tick old",
             residual(arm.compensated(Framed(arm.robot()), friction=0.9))),
            ("  by a model that is 5 % too light", residual(heavier))]
    head = (f"{arm.name}, {len(arm.home)} joints: rms of what a hand feels beside the arm without weight and friction",
            f"{_rms(ideal[later:]):.3g} N m itself", "")
    return [head, *[(what, f"{value:.3g} N m", "") for what, value in rows]]


def _touches(arm: Arm) -> list[Row]:
    """Rows on the momentum observer against MuJoCo's contacts."""
    robot = arm.before_block()
    model, data = robot._model.model, robot._body.data
    last = int(model.jnt_bodyid[model.joint(arm.scene.axis_names[-1]).id])
    J = np.zeros((3, model.nv))
    arm.mujoco.mj_jac(model, data, J, None, arm.middle, last)
    inverse = np.linalg.pinv(J[:, robot._model.axes], rcond=1e-2)
    ahead, across = inverse @ arm.way, inverse @ np.roll(arm.way, 1)

    def way(t: float) -> Any:
        return arm.home + ahead * DEPTH * 0.5 * (1.0 - cos(pi * t)) + across * 0.02 * sin(2.0 * pi * 0.7 * t)

    truth: list[Any] = []
    read = robot.read

    def sensed(k: int) -> Reading:
        reading: Reading = read(k)
        truth.append(reading.f)
        return reading

    robot.read = sensed
    _, estimate = arm.led(arm.compensated(robot, observer=BANDWIDTH), way)
    true = np.array(truth)
    slow, slower = _smooth(true), _smooth(estimate)
    delay = min(range(60), key=lambda n: _rms(slower[n:] - slow[:len(slow) - n]))
    a, f, passed = 1.0 - np.exp(-BANDWIDTH * arm.scene.dt), np.zeros(len(arm.home)), []
    for each in true:
        f = f + a * (each - f)
        passed.append(f)
    return [(f"  momentum observer of {BANDWIDTH:g}/s against contacts of {_rms(true):.3g} N m rms, "
             f"{abs(true).max():.3g} N m at most", f"{_rms(estimate - true):.2g} N m rms", ""),
            ("  and against them behind the same low-pass", f"{_rms(estimate - np.array(passed)):.2g} N m rms", ""),
            ("  its delay, of means over 50 ms", f"{delay * arm.scene.dt * 1e3:.0f} ms", f"1/K + dt/2 is "
             f"{1e3 / BANDWIDTH + 500.0 * arm.scene.dt:g} ms")]


def _smooth(values: Any) -> Any:
    """Means over 51 ticks around each."""
    return np.array([np.convolve(each, np.full(51, 1.0 / 51.0), "valid") for each in values.T]).T


def _cost(arm: Arm, rounds: int) -> Row:
    """Row on what a tick costs, beside the device's own."""
    home = tuple(arm.home.tolist())

    class StandingArm:
        def read(self, k: int) -> Reading:
            return Reading(home, (0.1,) * len(home))

        def hold(self, force: tuple[float, ...]) -> None:
            """Hold nothing."""

    took = []
    for _ in range(rounds):
        device = arm.compensated(StandingArm(), friction=0.5)
        began, x = time.process_time(), 1.0
        for _ in range(100_000):
            x = x * 1.0001 + 0.5
        yardstick = (time.process_time() - began) * 1e4
        began = time.process_time()
        for k in range(TICKS):
            device.read(k)
            device.hold(home)
        took.append((time.process_time() - began) / TICKS * 1e6 * YARDSTICK_US / yardstick)
    return f"  a tick with both, where 1000 `x=x*1.0001+0.5` take {YARDSTICK_US:g} us", f"{median(took):.0f} us", ""


def dynamics(rounds: int, models: Iterable[str] = ()) -> list[Row]:
    """Rows of (what, measured, bound), for each of the models."""
    rows = []
    with TemporaryDirectory() as folder:
        for file in [Path(each).absolute() for each in models] or OWN:
            arm = Arm(file, Path(folder))
            rows += [*_residuals(arm), *_touches(arm), _cost(arm, rounds)]
    return rows
