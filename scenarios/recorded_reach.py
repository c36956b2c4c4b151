"""A recorded motion in three axes, felt through projection-based force reflection."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from channel import Delay
from master import Grip, Recording
from slave import Wall
from teleop import PFRA, Cap, Knob, Law, MassDamper, Scene, Watchdog, knob


def scene(
    *,
    law: Law = PFRA(alpha=0.2),
    motion: Annotated[Path, Knob(
        "", "file with the recorded motion: CSV of t, x, y, z")] = Path(__file__).with_name("reach.csv"),
    delay: knob.LinkDelay = 0.05,
    k_e: Annotated[float, Knob("N/m", "stiffness of the wall", low=0.0)] = 2e3,
    d_e: Annotated[float, Knob("N s/m", "damping of the wall", low=0.0)] = 10.0,
    wall: Annotated[float, Knob("m", "position of its surface")] = 0.04,
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
    """A hand that follows a recording drives a slave along a wall; the reflected force is a vector."""
    return Scene(
        law=law,
        axes=3,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Recording(path=str(motion))),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=(Wall(k=k_e, d=d_e, at=wall), None, None),
        watchdog=None if timeout is None else Watchdog(timeout=timeout, age=age),
        cap=Cap.of(f_max=f_max, slew=slew, v_max=v_max, power=power),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
