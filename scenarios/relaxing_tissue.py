"""Pressing tissue that yields with time: a standard linear solid, stepped exactly with one more state."""

from __future__ import annotations

from channel import Delay
from master import Grip, Reach
from slave import StandardLinearSolid
from teleop import Law, MassDamper, Scene, Wave


def scene(
    *,
    law: Law = Wave(),  # control law: direct, pfra, wave or one of a plug-in
    delay: float = 0.02,  # s, each way
    k_e: float = 150.0,  # N/m, stiffness in the long run
    k1: float = 400.0,  # N/m, stiffness that relaxes
    tau: float = 0.3,  # s, in this time
    to: float = 0.03,  # m, where the hand reaches
    observer: float | None = 200.0,  # 1/s, bandwidth of the observer of the hand's force; none: a force sensor
    energy: bool = True,  # record the energy ledgers
    dt: float = 1e-3,  # s, the tick
    duration: float = 4.0,  # s
) -> Scene:
    """A quick reach into tissue whose force falls while the hand stays."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=to, start=0.2, duration=0.5)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=StandardLinearSolid(k=k_e, k1=k1, tau=tau),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
