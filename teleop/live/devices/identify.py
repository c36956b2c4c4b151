"""Numbers of position servos from a bounded routine: `teleop identify robot NAME SCENE --reach 0.1 --inertia 0.03`.

Each joint in turn is given goals within +-reach of where it is: four steps, then a slow sine; the others hold. What
it did is fitted by what a `Servo` of these numbers does,

    J x'' + damping x' + friction sgn(x') = K (goal(t - d) - x),

by least squares over K/J, damping/J, friction/J and the lateness d of goal and reading together. Positions tell no
torque: J, typed, makes numbers of the ratios, so the joint carries something of a known moment of inertia. An encoder
at the shaft does not see backlash behind it: half a degree made K 12 % too great and friction 11 %. The uncertainty is
two standard deviations of the fit, with its errors taken to be as alike from one to the next as they are, and what one
count of the encoder makes of each number.
"""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import exp, log, pi, sin
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.errors import DeviceError, Refused, number, number_of
from teleop.live.devices.opening import close, find_device
from teleop.live.devices.position_servo import PositionBus, PositionServo
from teleop.physics.servo import turn
from teleop.scene.loading import load_scene
from teleop.terminal.answer import Answer
from teleop.terminal.options import knobs_from

Reals = NDArray[np.float64]
PERIOD_S = 0.005  # from one goal to the next
STEP_S, SINE_S = 0.5, 2.0  # a step, and the slow sine
GRID_S = 1e-3  # of a simulated motion
NOTHING = (0, 0.0, 0.0, 0.0, 1.0, 1.5, 0.0)  # what the shaft touches
GUESSES = tuple((k, 2.0 * zeta * k**0.5) for k in (100.0, 600.0, 4000.0) for zeta in (0.3, 1.5))
MOST_D = 0.1  # s
LEFT = 0.1  # of the motion's rms, above which the fit tells nothing
MOST_TURNS = 30
MOST_RECORDS, PAUSE_S = 3, 0.3


class JointRecord(NamedTuple):
    """Goals and readings of one joint, rad, at these times, s."""

    t: Reals
    goal: Reals
    x: Reals


class Identified(NamedTuple):
    """Numbers of one joint, each with its uncertainty."""

    values: dict[str, float]  # K, damping, friction, lateness, inertia
    errors: dict[str, float]


def goals(reach: float, start: float) -> Reals:
    """The routine's goals, rad, one each `PERIOD_S`: +reach, 0, -reach, 0, then the slow sine."""
    steps = np.repeat([reach, 0.0, -reach, 0.0], round(STEP_S / PERIOD_S))
    sines = [reach * sin(2.0 * pi * i * PERIOD_S / SINE_S) for i in range(round(SINE_S / PERIOD_S))]
    return start + np.concatenate([steps, sines])


def record(bus: PositionBus, joint: int, reach: float, clock: Callable[[], float] = time.monotonic,
           sleep: Callable[[float], None] = time.sleep) -> JointRecord:
    """Move one joint through the routine. Raises `DeviceError` where the bus is lost."""
    start = bus.read()
    rows, began = [], clock()
    for i, goal in enumerate(goals(reach, start[joint]).tolist()):
        sleep(max(0.0, began + i * PERIOD_S - clock()))
        bus.goal(tuple([goal if k == joint else x for k, x in enumerate(start)]))
        rows.append((clock() - began, goal, bus.read()[joint]))
    return JointRecord(*np.array(rows).T)


def whole_record(bus: PositionBus, joint: int, reach: float) -> JointRecord:
    """Record a joint without a gap, a few times where answers are lost. Raises `DeviceError` the last time."""
    for _ in range(MOST_RECORDS - 1):
        with suppress(DeviceError):
            return record(bus, joint, reach)
        time.sleep(PAUSE_S)
    return record(bus, joint, reach)


def response(motion: JointRecord, ratios: Sequence[float]) -> Reals:
    """Positions of a servo without lateness on a grid of `GRID_S`, from K/J, damping/J and friction/J."""
    count = int(motion.t[-1] / GRID_S) + 2
    wanted = motion.goal[np.maximum(0, np.searchsorted(motion.t, np.arange(count) * GRID_S, side="right") - 1)]
    K, damping, friction = ratios
    shaft = (K, damping, 1.0, 0.0, friction, float("inf"), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5 * GRID_S, 2)
    state: Any = (float(motion.x[0]), 0.0, float(motion.x[0]), 0.0, 0.0)
    places = [state[0]]
    for goal in wanted.tolist():
        state = turn(shaft, NOTHING, state, goal, 0.0, 0.0)
        places.append(state[0])
    return np.array(places)


def fit_servo(motion: JointRecord, inertia: float) -> Identified:
    """The numbers by which a servo makes this motion. Raises `Refused` where none does."""
    def left(q: Reals) -> Reals:
        places = response(motion, np.exp(np.clip(q[:3], -20.0, 20.0)).tolist())
        late: Reals = np.interp(motion.t - q[3], np.arange(len(places)) * GRID_S, places, left=float(motion.x[0]))
        return late - motion.x

    def size(q: Reals) -> float:
        return float(np.nan_to_num((left(q) ** 2).sum(), nan=np.inf))

    starts = [np.array([log(k), log(b), log(0.02 * k), d]) for k, b in GUESSES for d in (0.005, 0.02)]
    q = min(starts, key=size)
    step, best = 1e-2, size(q)
    for _ in range(MOST_TURNS):
        errors, J = left(q), _jacobian(left, q)
        normal = J.T @ J
        while step < 1e6:
            tried = q - np.linalg.solve(normal + step * np.diag(np.diag(normal) + 1e-12), J.T @ errors)
            tried[3] = min(max(tried[3], 0.0), MOST_D)
            if (now := size(tried)) < best:
                break
            step *= 4.0
        else:
            break
        q, gained, best, step = tried, best - now, now, step / 4.0
        if gained < 1e-9 * best:
            break
    spread = float(np.sqrt(np.mean((motion.x - motion.x.mean()) ** 2)))
    rms = (best / len(motion.t)) ** 0.5
    if not rms < LEFT * spread:
        raise Refused(f"it does not move as a position servo: {rms:.3g} rad rms are left of {spread:.3g} rad; see that "
                      "nothing is in its way, that its torque suffices, and type a smaller or larger --reach")
    J, errors = _jacobian(left, q), left(q)
    # Rounded readings and what the model lacks leave errors that go on: as many count for fewer.
    alike = min(0.99, max(0.0, float(errors[1:] @ errors[:-1]) / best)) if best > 0.0 else 0.0
    noise = best / max(1, len(motion.t) - 4) * (1.0 + alike) / (1.0 - alike)
    deviation = np.sqrt(np.maximum(0.0, np.diag(np.linalg.pinv(J.T @ J)) * noise))
    values = {name: inertia * exp(each) for name, each in zip(("K", "damping", "friction"), q, strict=False)}
    count = float(np.diff(np.unique(motion.x)).min(initial=np.inf, where=np.diff(np.unique(motion.x)) > 0.0))
    share = 4.0 * count / float(np.ptp(motion.goal))
    errors_of = {name: (2.0 * float(by) + share) * values[name] for name, by in zip(values, deviation, strict=False)}
    errors_of["friction"] += 0.5 * count * values["K"]
    return Identified({**values, "lateness": float(q[3]), "inertia": inertia},
                      {**errors_of, "lateness": 2.0 * float(deviation[3]) + GRID_S})


def _jacobian(function: Callable[[Reals], Reals], q: Reals) -> Reals:
    columns = []
    for i, step in enumerate((1e-3, 1e-3, 1e-2, 2e-4)):
        up, down = q.copy(), q.copy()
        up[i] += step
        down[i] -= step
        columns.append((function(up) - function(down)) / (2.0 * step))
    return np.array(columns).T


def toml_of(name: str, reach: float, joints: Sequence[Identified]) -> str:
    """The file that `servos_of_file` reads."""
    lines = [f"# Position servos of {name}, by teleop identify with a reach of {reach:g} rad; errors: two deviations"]
    for joint in joints:
        lines += ["", "[[joint]]", *[f"{key} = {value:.6g}" for key, value in joint.values.items()],
                  "errors = {" + ", ".join(f"{key} = {value:.2g}" for key, value in joint.errors.items()) + "}"]
    return "\n".join(lines) + "\n"


def command(args: Namespace) -> Answer:
    """Identify the joints of an arm of positions, and write their file. Raises `Refused`."""
    scene = load_scene(args.scene, **knobs_from(args))
    reach = number("reach", args.reach, above=0.0, high=0.5, unit="rad")
    inertias = tuple([number("inertia", float(each), above=0.0) for each in args.inertia.split(",")])
    if len(inertias) not in (1, scene.axes):
        raise Refused(f"--inertia has {number_of(len(inertias), 'number')}, and the scene has "
                      f"{number_of(scene.axes, 'axis', 'axes')}; write one for all joints or one for each")
    inertias = inertias * scene.axes if len(inertias) == 1 else inertias
    out = Path(args.out)
    if out.exists():
        raise Refused(f"{out} is there already; name another file with --out")
    device = find_device("m" if args.what == "device" else "s", args.name).open(scene)
    try:
        if not isinstance(device, PositionServo):
            raise Refused(f"{args.name} takes torques, and the numbers of a position servo are of one that takes "
                          "positions; leave mode= away from its address")
        joints = []
        for i, inertia in enumerate(inertias):
            try:
                joints.append(fit_servo(whole_record(device.bus, i, reach), inertia))
            except Refused as error:
                raise Refused(f"{scene.axis_names[i]}: {error}") from None
            except DeviceError as error:
                raise Refused(f"{scene.axis_names[i]} could not be moved: {error}") from None
    finally:
        failed = close(device)
    out.write_text(toml_of(args.name, reach, joints), encoding="utf-8")
    document = [{**joint.values, "errors": joint.errors} for joint in joints]
    lines = [f"{'joint':14s}  K, N m/rad       damping, N m s/rad  friction, N m    lateness, ms"]
    for name, joint in zip(scene.axis_names, joints, strict=True):
        cells = [f"{joint.values[key] * by:.4g} +- {joint.errors[key] * by:.1g}"
                 for key, by in (("K", 1.0), ("damping", 1.0), ("friction", 1.0), ("lateness", 1e3))]
        lines.append(f"{name:14s}  {cells[0]:15s}  {cells[1]:18s}  {cells[2]:15s}  {cells[3]}")
    notes = [f"closing it failed: {failed}"] if failed else []
    return Answer("\n".join([*lines, *notes, f"written to {out}; drive it with --set servo={out}"]),
                  {"device": args.name, "joints": document, "file": str(out)})
