"""Handover: a policy takes one joint over from the operator and gives it back, over a link, at a spring.

The operator's hand goes along with the handle while the policy moves it, for a hand that lets go is none of a run in
virtual time; from `grip` on it pulls back to where it began. On the page it is yours. A law that keeps its own defaults
gets the numbers of such a joint: those of a handle at the end of a lever of 0.3 m.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from channel import Delay
from master import Grip, Reach
from scenarios.pose import Moves, at_lever, with_gains
from slave import Wall
from teleop import Cap, Handover, Knob, Law, MassDamper, PositionPosition, Reference, Scene, Watchdog, knob

LEVER = 0.3  # m
GAINS = {"K": 6.0, "B": 0.3, "K_d": 0.3}  # N m/rad and N m s/rad, of laws that couple positions
Times = float | tuple[float, ...]


def scene(
    *,
    law: Law = PositionPosition(),
    delay: knob.LinkDelay = 0.02,
    axes: Annotated[int, Knob("", "joints, of which the spring is before the first", low=1, high=6)] = 1,
    actions: Annotated[Path | None, Knob(
        "", "file with the policy's motion: CSV of t, x (s, rad); none: it goes to `to`")] = None,
    to: Annotated[float | tuple[float, ...], Knob("rad", "angle that the policy takes each joint to")] = 0.65,
    takes: Annotated[Times | None, Knob(
        "s", "times at which the policy is switched on and off; none: by orders alone", low=0.0)] = (1.0, 3.0),
    silent: Annotated[Times, Knob("s", "times from and to which the policy sends nothing", low=0.0)] = (),
    rate: Annotated[float, Knob("Hz", "actions of the policy a second", above=0.0)] = 30.0,
    late: Annotated[float, Knob("s", "time that an action takes from the policy to the master", low=0.0)] = 0.05,
    Kp: Annotated[float, Knob("N m/rad", "stiffness by which the policy pulls the handle", low=0.0)] = 12.0,
    Bp: Annotated[float, Knob("N m s/rad", "damping by which it does", low=0.0)] = 0.5,
    pull: Annotated[float, Knob("N m", "most torque of the policy", above=0.0)] = 1.0,
    pull_slew: Annotated[float, Knob("N m/s", "most change of that torque", above=0.0)] = 20.0,
    leap: Annotated[float, Knob("rad", "farthest that an action may be from where the policy is", above=0.0)] = 0.9,
    ramp: Annotated[float, Knob("s", "time in which authority goes over", above=0.0)] = 0.2,
    tank: Annotated[float, Knob("J", "energy tank of the policy: the most work that it does at once", above=0.0)] = 0.3,
    tank_power: Annotated[float, Knob("W", "power that fills the tank", low=0.0)] = 0.6,
    grip: Annotated[float | None, Knob(
        "s", "time at which the hand pulls back, and so takes over by force; none: it does not", low=0.0)] = None,
    k_h: Annotated[float, Knob("N m/rad", "stiffness of the hand", above=0.0)] = 2.0,
    d_h: Annotated[float, Knob("N m s/rad", "damping of the hand", low=0.0)] = 0.2,
    spring: Annotated[float, Knob("N m/rad", "stiffness of the spring before the slave", low=0.0)] = 4.0,
    at: Annotated[float, Knob("rad", "angle at which that begins")] = 0.5,
    f_max: knob.MostForce = 20.0,
    slew: knob.MostSlew = 2000.0,
    timeout: knob.Timeout = 0.2,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 4.5,
) -> Scene:
    """A policy takes a joint over, moves it to a spring and gives it back; a hand may take it by force."""
    size = LEVER * LEVER
    goal = to if isinstance(to, tuple) else (to,) * axes
    along = Reach(to=tuple([0.9 * each for each in goal]), start=0.6, duration=1.6)
    policy: Reference = Reach(to=goal, start=0.5, duration=1.5)
    if actions is not None:
        from master import Recording

        policy = Recording(path=str(actions))
    back = () if grip is None else (Reach(to=tuple([-each - 1.0 for each in goal]), start=grip, duration=0.4),)
    return Scene(
        law=with_gains(law, GAINS, lambda law: at_lever(law, LEVER)),
        axes=axes,
        names=("joint",) if axes == 1 else (),
        units=("rad",) * axes,
        hand=Grip(mass=0.4 * size, k=k_h, d=d_h, reference=Moves((along, *back))),
        master=MassDamper(mass=0.1 * size, damping=0.5 * size),
        link=Delay(delay),
        slave=MassDamper(mass=0.5 * size, damping=size),
        environment=Wall(k=spring, d=0.05, at=at),
        watchdog=None if timeout is None else Watchdog(timeout=timeout),
        cap=Cap.of(f_max=f_max, slew=slew),
        handover=Handover(
            policy=policy, takes=() if takes is None else knob.spans("takes", takes),
            silent=knob.spans("silent", silent), rate=rate, late=late, leap=leap, Kp=Kp, Bp=Bp, f_max=pull,
            slew=pull_slew, ramp=ramp, energy=tank, power=tank_power),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
