"""Leader and follower of low-cost position servos: six joints each, at 200 Hz, over a bus that is 5 ms late each way.

The servos are of the class of an SO-101 arm's: 17.8 N m/rad and 2.94 N m at the shaft, friction, half a degree of
backlash and 4096 counts a turn. Published models of one such servo differ 56-fold in K: measure yours (`teleop identify
robot`) before a hand holds it. `teleop/physics/servo.py` has the two drives and the conditions by which a scene is
refused.
"""

from __future__ import annotations

from math import inf
from typing import Annotated, Any

from channel import Delay
from master import Grip, Reach
from scenarios.pose import with_gains
from slave import Tissue, Wall
from teleop import Cap, Knob, Law, PositionPosition, Scene, Servo, Watchdog, each_axis, knob, servos_of_file

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
# Of a law by the names of its numbers, in N m/rad and N m s/rad, for a joint of 0.04 kg m^2.
GAINS = {"K": 10.0, "B": 0.4, "b": 0.5, "K_d": 0.4, "K_p": 10.0, "B_p": 0.4, "B_m": 0.2, "B_s": 0.4}
Drive = Annotated[str, Knob("", "how a torque becomes a position: offset or mass", choices=("offset", "mass"))]
PerJoint = float | tuple[float, ...]


def scene(
    *,
    law: Law = PositionPosition(),
    delay: knob.LinkDelay = 0.05,
    servo: Annotated[str, Knob("", "file of `teleop identify` with the follower's joints; none: as below")] = "",
    drive_m: Drive = "offset",
    drive_s: Drive = "offset",
    K: Annotated[PerJoint, Knob("N m/rad", "stiffness of a servo: the torque of its error", above=0.0)] = 17.8,
    damping: Annotated[PerJoint, Knob("N m s/rad", "damping of a servo", above=0.0)] = 0.6,
    friction: Annotated[PerJoint, Knob("N m", "Coulomb friction of a servo", low=0.0)] = 0.15,
    stall: Annotated[PerJoint | None, Knob("N m", "most torque of a servo; none: any", above=0.0)] = 2.94,
    backlash: Annotated[PerJoint, Knob("rad", "backlash of a servo, from stop to stop", low=0.0)] = 0.00873,
    counts: Annotated[int, Knob("", "counts of a servo's encoder in a turn; 0: no encoder", low=0)] = 4096,
    bus: Annotated[float, Knob("s", "time that a goal takes on the bus, and a reading", low=0.0)] = 0.005,
    every: Annotated[int, Knob("", "ticks from one exchange with the bus to the next", low=1)] = 1,
    M: Annotated[float, Knob("kg m^2", "virtual mass of a drive `mass`", above=0.0)] = 0.02,
    D: Annotated[float, Knob("N m s/rad", "damping of that mass", low=0.0)] = 0.06,
    dead: Annotated[float, Knob("N m", "dead zone of the torque that a servo's error shows", low=0.0)] = 0.15,
    k_h: Annotated[float, Knob("N m/rad", "stiffness of the hand's grip at each joint", low=0.0)] = 15.0,
    d_h: Annotated[float, Knob("N m s/rad", "damping of the hand's grip at each joint", low=0.0)] = 0.5,
    to: Annotated[PerJoint, Knob("rad", "angle that the hand takes each joint to")] = (0.6, -0.4, 0.6, -0.3, 0.5, 0.4),
    spring: Annotated[float, Knob("N m/rad", "stiffness of the spring at the follower's elbow", low=0.0)] = 10.0,
    stop: Annotated[float | None, Knob("rad", "angle of a hard stop of the follower's gripper; none: no stop")] = 0.2,
    f_max: Annotated[PerJoint | None, Knob("N m", "most torque of either end at each joint; none: any", low=0.0)] = 2.5,
    slew: Annotated[PerJoint | None, Knob("N m/s", "most change of either torque; none: any", above=0.0)] = None,
    timeout: knob.Timeout = 0.2,
    observer: knob.ObserverBandwidth = None,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 5e-3,
    duration: knob.Duration = 5.0,
) -> Scene:
    """A hand takes each joint of a leader to an angle; a follower presses on a spring and a hard stop."""
    axes = len(JOINTS)
    reach = Reach(to=to if isinstance(to, tuple) else (to,) * axes, start=0.5, duration=1.5)

    def servos(drive: str) -> Any:
        return each_axis(
            lambda **numbers: Servo(bus=(bus, bus), every=every, counts=counts, drive=drive, M=M, D=D,
                                    dead=dead, **numbers), axes,
            K=K, damping=damping, friction=friction, stall=inf if stall is None else stall, backlash=backlash)

    return Scene(
        law=with_gains(law, GAINS),
        axes=axes,
        names=JOINTS,
        units=("rad",) * axes,
        hand=Grip(mass=0.02, k=k_h, d=d_h, reference=reach),
        master=servos(drive_m),
        link=Delay(delay),
        slave=servos(drive_s) if not servo else servos_of_file(
            servo, axes, every=every, counts=counts, drive=drive_s, M=M, D=D, dead=dead,
            stall=inf if stall is None else stall),
        environment=(None, None, Tissue(k=spring, d=0.05), None, None,
                     None if stop is None else Wall(k=2000.0, d=5.0, at=stop)),
        watchdog=None if timeout is None else Watchdog(timeout=timeout),
        cap=each_axis(Cap.of, axes, f_max=f_max, slew=slew),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
