"""Soft tissue: a spring-damper that the slave is bonded to and can pull on."""

from __future__ import annotations

from typing import Annotated

from channel import Delay
from master import Grip, Sine
from slave import Tissue
from teleop import Knob, Law, MassDamper, Scene, Wave, knob


def scene(
    *,
    law: Law = Wave(),
    delay: knob.LinkDelay = 0.05,
    k_e: Annotated[float, Knob("N/m", "stiffness of the tissue", low=0.0)] = 200.0,
    d_e: Annotated[float, Knob("N s/m", "damping of the tissue", low=0.0)] = 2.0,
    amplitude: Annotated[float, Knob("m", "amplitude of the hand's swing")] = 0.05,
    frequency: Annotated[float, Knob("Hz", "frequency of the hand's swing", low=0.0)] = 0.5,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 10.0,
) -> Scene:
    """A hand moves tissue to and fro through the slave that holds it."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=amplitude, frequency=frequency)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=Tissue(k=k_e, d=d_e),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
