"""Holding an instrument against a heart that beats: a wall that moves by itself."""

from __future__ import annotations

from channel import Delay
from master import Grip, Reach, Sine
from slave import Moving, Wall
from teleop import Law, MassDamper, Scene, Wave


def scene(
    *,
    law: Law = Wave(),  # control law: direct, pfra, wave or one of a plug-in
    delay: float = 0.02,  # s, each way
    k_e: float = 500.0,  # N/m, stiffness of the heart
    d_e: float = 5.0,  # N s/m, damping of the heart
    at: float = 0.03,  # m, where its surface is in the mean
    beat: float = 0.005,  # m, amplitude of its motion
    rate: float = 1.2,  # Hz, of its motion
    to: float = 0.04,  # m, where the hand reaches
    observer: float | None = 200.0,  # 1/s, bandwidth of the observer of the hand's force; none: a force sensor
    energy: bool = True,  # record the energy ledgers
    dt: float = 1e-3,  # s, the tick
    duration: float = 6.0,  # s
) -> Scene:
    """A hand rests the slave on a surface that moves to and fro, and feels it beat."""
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
