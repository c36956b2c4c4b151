"""Holding soft tissue: a spring-damper that the slave is bonded to and can pull on."""

from __future__ import annotations

from channel.delay import Delay
from master.hand import Grip, Sine
from slave.tissue import Tissue
from teleop.law import Law
from teleop.laws.wave import Wave
from teleop.plant import MassDamper
from teleop.scene import Scene


def scene(
    *,
    law: Law = Wave(),
    delay: float = 0.05,
    k_e: float = 200.0,
    d_e: float = 2.0,
    amplitude: float = 0.05,
    frequency: float = 0.5,
    observer: float | None = 200.0,
    energy: bool = True,
    dt: float = 1e-3,
    duration: float = 10.0,
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
