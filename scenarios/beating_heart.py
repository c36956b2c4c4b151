"""Beating heart: contact with a wall that moves by itself."""

from __future__ import annotations

from typing import Annotated

from channel import Delay
from master import Grip, Reach, Sine
from slave import Moving, Wall
from teleop import Knob, Law, MassDamper, Scene, Wave, knob


def scene(
    *,
    law: Law = Wave(),
    delay: knob.LinkDelay = 0.02,
    k_e: Annotated[float, Knob("N/m", "stiffness of the heart", low=0.0)] = 500.0,
    d_e: Annotated[float, Knob("N s/m", "damping of the heart", low=0.0)] = 5.0,
    at: Annotated[float, Knob("m", "position of the surface in the mean")] = 0.03,
    beat: Annotated[float, Knob("m", "amplitude of its motion")] = 0.005,
    rate: Annotated[float, Knob("Hz", "frequency of its motion", low=0.0)] = 1.2,
    to: Annotated[float, Knob("m", "position that the hand reaches for")] = 0.04,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 6.0,
) -> Scene:
    """A hand holds the slave against a surface that moves to and fro, and feels its motion."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=to, start=0.2, duration=1.0)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=Moving(environment=Wall(k=k_e, d=d_e, at=at), path=Sine(amplitude=beat, frequency=rate)),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
