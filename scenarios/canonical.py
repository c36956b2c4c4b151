"""Reference scene of benchmarks and pages: waves over 50 ms each way against a hard wall."""

from __future__ import annotations

from typing import Annotated

from channel import Delay
from master import Grip, Sine
from slave import Wall
from teleop import Knob, Law, MassDamper, Scene, Wave, knob


def scene(
    *,
    law: Law = Wave(b=2.0, K=500.0, B=20.0),
    delay: knob.LinkDelay = 0.05,
    k_e: Annotated[float, Knob("N/m", "stiffness of the wall", low=0.0)] = 5000.0,
    d_e: Annotated[float, Knob("N s/m", "damping of the wall", low=0.0)] = 5.0,
    wall: Annotated[float, Knob("m", "position of its surface")] = 0.03,
    amplitude: Annotated[float, Knob("m", "amplitude of the hand's swing")] = 0.05,
    frequency: Annotated[float, Knob("Hz", "frequency of the hand's swing", low=0.0)] = 1.0,
    k_h: Annotated[float, Knob("N/m", "stiffness of the hand's grip", low=0.0)] = 200.0,
    d_h: Annotated[float, Knob("N s/m", "damping of the hand's grip", low=0.0)] = 5.0,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 10.0,
) -> Scene:
    """A hand swings a master at 1 Hz; the slave meets a wall that it cannot pull on."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=k_h, d=d_h, reference=Sine(amplitude=amplitude, frequency=frequency)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=Wall(k=k_e, d=d_e, at=wall),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
