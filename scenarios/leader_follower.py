"""Leader and follower: two arms of six joints, coupled in joint space; the follower's elbow draws a torsion spring.

The joints are free of gravity, as behind a controller that compensates it, and do not load each other. Their inertias,
damping and friction are of the size of small geared arms; they are of no make. `scenarios/README.md` says how the gains
were chosen.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Annotated, Any

from channel import Delay
from master import Grip, Reach
from slave import Tissue
from teleop import Cap, Knob, Law, MassDamper, PositionPosition, Scene, Watchdog, each_axis, knob

JOINTS = ("base", "shoulder", "elbow", "forearm", "wrist", "flange")
FOLLOWER = (0.12, 0.15, 0.06, 0.012, 0.01, 0.004)  # kg m^2
# The gains of a law by the names of its numbers: K and B make each joint a spring and damper of 50 rad/s, 0.7 of
# critical, with the follower's inertia; b is B/2; alpha_max takes a fifth of the leader's own speed in a tick.
GAINS = {
    "K": (300.0, 375.0, 150.0, 30.0, 25.0, 10.0),
    "B": (8.4, 10.5, 4.2, 0.84, 0.7, 0.28),
    "b": (4.2, 5.25, 2.1, 0.42, 0.35, 0.14),
    "alpha_max": (8.0, 8.0, 4.0, 1.0, 0.8, 0.4),
}
PerJoint = float | tuple[float, ...]


def scene(
    *,
    law: Law = PositionPosition(),
    delay: knob.LinkDelay = 0.01,
    inertia_m: Annotated[PerJoint, Knob("kg m^2", "inertia of the leader's joints", above=0.0)] = (
        0.04, 0.04, 0.02, 0.005, 0.004, 0.002),
    inertia_s: Annotated[PerJoint, Knob("kg m^2", "inertia of the follower's joints", above=0.0)] = FOLLOWER,
    damping_m: Annotated[PerJoint, Knob("N m s/rad", "viscous damping of the leader's joints", low=0.0)] = (
        0.2, 0.2, 0.1, 0.02, 0.02, 0.01),
    damping_s: Annotated[PerJoint, Knob("N m s/rad", "viscous damping of the follower's joints", low=0.0)] = (
        0.6, 0.8, 0.3, 0.06, 0.05, 0.02),
    friction_m: Annotated[PerJoint, Knob("N m", "Coulomb friction of the leader's joints", low=0.0)] = (
        0.05, 0.05, 0.03, 0.01, 0.01, 0.005),
    friction_s: Annotated[PerJoint, Knob("N m", "Coulomb friction of the follower's joints", low=0.0)] = (
        0.2, 0.2, 0.1, 0.03, 0.02, 0.01),
    hand_inertia: Annotated[PerJoint, Knob("kg m^2", "inertia of the hand at each joint", low=0.0)] = (
        0.06, 0.06, 0.03, 0.006, 0.005, 0.003),
    k_h: Annotated[PerJoint, Knob("N m/rad", "stiffness of the hand's grip at each joint", low=0.0)] = (
        30.0, 30.0, 15.0, 3.0, 2.5, 1.5),
    d_h: Annotated[PerJoint, Knob("N m s/rad", "damping of the hand's grip at each joint", low=0.0)] = (
        2.0, 2.0, 1.0, 0.2, 0.15, 0.1),
    to: Annotated[PerJoint, Knob("rad", "angle that the hand takes each joint to")] = (
        0.8, -0.5, 0.9, -0.4, 0.6, 1.2),
    k_e: Annotated[float, Knob("N m/rad", "stiffness of the spring at the follower's elbow", low=0.0)] = 10.0,
    d_e: Annotated[float, Knob("N m s/rad", "damping of the spring", low=0.0)] = 0.1,
    f_max: Annotated[PerJoint | None, Knob("N m", "most torque of either end at each joint; none: any", low=0.0)] = (
        20.0, 20.0, 10.0, 3.0, 3.0, 1.0),
    timeout: knob.Timeout = 0.2,
    tolerance: Annotated[float, Knob("rad", "error per tick that the integrator keeps to", above=0.0)] = 1e-9,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 4.0,
) -> Scene:
    """A hand takes each joint of a leader to an angle; a follower goes along, and feels its elbow's spring."""
    axes = len(JOINTS)
    reach = Reach(to=to if isinstance(to, tuple) else (to,) * axes, start=0.5, duration=1.5)
    return Scene(
        law=by_joint(law),
        axes=axes,
        names=JOINTS,
        units=("rad",) * axes,
        hand=each_axis(lambda mass, k, d: Grip(mass=mass, k=k, d=d, reference=reach), axes,
                       mass=hand_inertia, k=k_h, d=d_h),
        master=each_axis(MassDamper, axes, mass=inertia_m, damping=damping_m, friction=friction_m),
        link=Delay(delay),
        slave=each_axis(MassDamper, axes, mass=inertia_s, damping=damping_s, friction=friction_s),
        environment=(None, None, Tissue(k=k_e, d=d_e), None, None, None),
        watchdog=None if timeout is None else Watchdog(timeout=timeout),
        cap=None if f_max is None else each_axis(Cap, axes, f_max=f_max),
        tolerance=tolerance,
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )


def by_joint(law: Any) -> Any:
    """A law for each joint, with the `GAINS` of that joint where the law has its own default; a tuple as it is."""
    if isinstance(law, tuple):
        return law
    defaults = {each.name: each.default for each in fields(law)}
    left = [name for name in GAINS if name in defaults and getattr(law, name) == defaults[name]]
    return tuple([replace(law, **{name: GAINS[name][i] for name in left}) for i in range(len(JOINTS))])
