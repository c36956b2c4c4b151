"""No link: each end gets the other end's message of the last tick."""

from __future__ import annotations

from typing import Annotated

from master import Grip, Reach
from slave import Wall
from teleop import Knob, Law, MassDamper, Scene, Wave, knob


def scene(
    *,
    law: Law = Wave(),
    k_e: Annotated[float, Knob("N/m", "stiffness of the wall", low=0.0)] = 2e4,
    d_e: Annotated[float, Knob("N s/m", "damping of the wall", low=0.0)] = 10.0,
    wall: Annotated[float, Knob("m", "position of its surface")] = 0.03,
    to: Annotated[float, Knob("m", "position that the hand reaches for, beyond the wall")] = 0.06,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 10.0,
) -> Scene:
    """A hand reaches for a hard wall with a delay of one tick alone."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=to, start=0.5, duration=1.5)),
        master=MassDamper(mass=0.1, damping=0.5),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=Wall(k=k_e, d=d_e, at=wall),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
