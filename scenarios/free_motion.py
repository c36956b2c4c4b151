"""Free motion: tracking over a delay, without any contact."""

from __future__ import annotations

from typing import Annotated

from channel import Delay
from master import Grip, Sine
from teleop import Knob, Law, MassDamper, Scene, Wave, knob


def scene(
    *,
    law: Law = Wave(),
    delay: knob.LinkDelay = 0.05,
    amplitude: Annotated[float, Knob("m", "amplitude of the hand's swing")] = 0.05,
    frequency: Annotated[float, Knob("Hz", "frequency of the hand's swing", low=0.0)] = 0.5,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 10.0,
) -> Scene:
    """A hand swings the master, the slave follows in free space."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=amplitude, frequency=frequency)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
