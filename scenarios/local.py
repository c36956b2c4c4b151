"""No link at all: each end sees the other's message of the last tick."""

from __future__ import annotations

from master import Grip, Reach
from slave import Wall
from teleop import Law, MassDamper, Scene, Wave


def scene(
    *,
    law: Law = Wave(),  # control law: direct, pfra, wave or one of a plug-in
    k_e: float = 2e4,  # N/m, stiffness of the wall
    d_e: float = 10.0,  # N s/m, damping of the wall
    wall: float = 0.03,  # m, where its surface is
    to: float = 0.06,  # m, where the hand reaches, beyond the wall
    observer: float | None = 200.0,  # 1/s, bandwidth of the observer of the hand's force; none: a force sensor
    energy: bool = True,  # record the energy ledgers
    dt: float = 1e-3,  # s, the tick
    duration: float = 10.0,  # s
) -> Scene:
    """A hand reaches for a hard wall with nothing in between but one tick."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=to, start=0.5, duration=1.5)),
        master=MassDamper(mass=0.1, damping=0.5),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=Wall(k=k_e, d=d_e, at=wall),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
