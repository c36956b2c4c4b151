"""Dry friction at both ends: a slow hand moves a handle and a robot that stick and slip."""

from __future__ import annotations

from typing import Annotated

from channel import Delay
from master import Grip, Sine
from slave import Tissue
from teleop import Knob, Law, MassDamper, Scene, Wave, knob


def scene(
    *,
    law: Law = Wave(),
    delay: knob.LinkDelay = 0.02,
    friction_m: Annotated[float, Knob("N", "Coulomb friction of the master", low=0.0)] = 0.3,
    friction_s: Annotated[float, Knob("N", "Coulomb friction of the slave", low=0.0)] = 0.6,
    k_e: Annotated[float, Knob("N/m", "stiffness of the tissue that the slave holds", low=0.0)] = 100.0,
    d_e: Annotated[float, Knob("N s/m", "damping of the tissue", low=0.0)] = 1.0,
    amplitude: Annotated[float, Knob("m", "amplitude of the hand's swing")] = 0.03,
    frequency: Annotated[float, Knob("Hz", "frequency of the hand's swing", low=0.0)] = 0.5,
    tolerance: knob.Tolerance = 1e-9,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 4.0,
) -> Scene:
    """A slow swing against dry friction: both ends stick at every reversal and slip with a jerk."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=amplitude, frequency=frequency)),
        master=MassDamper(mass=0.1, damping=0.5, friction=friction_m),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0, friction=friction_s),
        environment=Tissue(k=k_e, d=d_e),
        tolerance=tolerance,
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
