"""Dry friction at both ends: a slow hand moves a handle and a robot that stick and slip."""

from __future__ import annotations

from channel import Delay
from master import Grip, Sine
from slave import Tissue
from teleop import Law, MassDamper, Scene, Wave


def scene(
    *,
    law: Law = Wave(),  # control law: direct, pfra, wave or one of a plug-in
    delay: float = 0.02,  # s, each way
    friction_m: float = 0.3,  # N, Coulomb friction of the master
    friction_s: float = 0.6,  # N, Coulomb friction of the slave
    k_e: float = 100.0,  # N/m, stiffness of the tissue that the slave holds
    d_e: float = 1.0,  # N s/m, damping of the tissue
    amplitude: float = 0.03,  # m, of the hand's swing
    frequency: float = 0.5,  # Hz, of the hand's swing
    tolerance: float = 1e-9,  # m, error per tick that the integrator keeps to
    observer: float | None = 200.0,  # 1/s, bandwidth of the observer of the hand's force; none: a force sensor
    energy: bool = True,  # record the energy ledgers
    dt: float = 1e-3,  # s, the tick
    duration: float = 4.0,  # s
) -> Scene:
    """A slow swing against dry friction: both ends stick at every turn and let go with a jerk."""
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
