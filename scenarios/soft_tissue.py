"""Holding soft tissue: a spring-damper that the slave is bonded to and can pull on."""

from __future__ import annotations

from channel import Delay
from master import Grip, Sine
from slave import Tissue
from teleop import Law, MassDamper, Scene, Wave


def scene(
    *,
    law: Law = Wave(),  # control law: direct, pfra, wave or one of a plug-in
    delay: float = 0.05,  # s, each way
    k_e: float = 200.0,  # N/m, stiffness of the tissue
    d_e: float = 2.0,  # N s/m, damping of the tissue
    amplitude: float = 0.05,  # m, of the hand's swing
    frequency: float = 0.5,  # Hz, of the hand's swing
    observer: float | None = 200.0,  # 1/s, bandwidth of the observer of the hand's force; none: a force sensor
    energy: bool = True,  # record the energy ledgers
    dt: float = 1e-3,  # s, the tick
    duration: float = 10.0,  # s
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
