"""The scene that benchmarks and references speak of: waves over 50 ms each way against a hard wall."""

from __future__ import annotations

from channel import Delay
from master import Grip, Sine
from slave import Wall
from teleop import Law, MassDamper, Scene, Wave


def scene(
    *,
    law: Law = Wave(b=2.0, K=500.0, B=20.0),  # control law: direct, pfra, wave or one of a plug-in
    delay: float = 0.05,  # s, each way
    k_e: float = 5000.0,  # N/m, stiffness of the wall
    d_e: float = 5.0,  # N s/m, damping of the wall
    wall: float = 0.03,  # m, where its surface is
    amplitude: float = 0.05,  # m, of the hand's swing
    frequency: float = 1.0,  # Hz, of the hand's swing
    k_h: float = 200.0,  # N/m, stiffness of the hand's grip
    d_h: float = 5.0,  # N s/m, damping of the hand's grip
    observer: float | None = 200.0,  # 1/s, bandwidth of the observer of the hand's force; none: a force sensor
    energy: bool = True,  # record the energy ledgers
    dt: float = 1e-3,  # s, the tick
    duration: float = 10.0,  # s
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
