"""Three-joint arm between a wall and a table, for a run with a robot in MuJoCo: `teleop run arm --robot mujoco`.

By itself, without `--robot`, its slave is a point with the arm's mass at its end, and wall and table are those of the
model (`slave/arm.xml`) with a stiffness that is known. Its gains are not searched for: they are those of `hard_wall`.
"""

from __future__ import annotations

from typing import Annotated

from channel import Delay
from master import Grip, Reach
from slave import Wall
from teleop import Cap, Knob, Law, MassDamper, Scene, Watchdog, Wave, knob


def scene(
    *,
    law: Law = Wave(b=20.0, K=1000.0, B=20.0),
    delay: knob.LinkDelay = 0.05,
    to: Annotated[float, Knob("m", "position that the hand reaches for along x, beyond the wall at 0.03")] = 0.06,
    along: Annotated[float, Knob("m", "how far it goes along y, beside the wall")] = 0.03,
    down: Annotated[float, Knob("m", "how far it goes down; the table is 0.05 below")] = 0.02,
    k_e: Annotated[float, Knob("N/m", "stiffness of wall and table, where the slave is simulated", low=0.0)] = 2e4,
    d_e: Annotated[float, Knob("N s/m", "damping of both, where the slave is simulated", low=0.0)] = 50.0,
    timeout: knob.Timeout = 0.2,
    age: knob.MessageAge = 2.5,
    f_max: knob.MostForce = 20.0,
    slew: knob.MostSlew = 2000.0,
    v_max: knob.MostSpeed = None,
    power: knob.PowerBudget = None,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 6.0,
) -> Scene:
    """A hand takes an arm's end into a wall, along it and down; the slave may be a robot in MuJoCo."""
    return Scene(
        axes=3,
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=(to, along, -down), start=0.5, duration=1.5)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=(Wall(k=k_e, d=d_e, at=0.03), None, Wall(k=k_e, d=d_e, at=-0.05, side=-1.0)),
        watchdog=None if timeout is None else Watchdog(timeout=timeout, age=age),
        cap=Cap.of(f_max=f_max, slew=slew, v_max=v_max, power=power),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
