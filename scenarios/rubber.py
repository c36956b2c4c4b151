"""A ball of rubber: a contact that stiffens with depth, for which no closed form exists."""

from __future__ import annotations

from channel import Delay
from master import Grip, Reach
from slave import HuntCrossley
from teleop import Law, MassDamper, Scene, Wave


def scene(
    *,
    law: Law = Wave(),  # control law: direct, pfra, wave or one of a plug-in
    delay: float = 0.02,  # s, each way
    k_e: float = 2e5,  # N/m^n, stiffness of the rubber
    n: float = 1.5,  # exponent; 1.5 is Hertz's contact of two spheres
    lam: float = 0.5,  # s/m, damping: of a blow at v comes back about 1 - (2/3) lam v
    at: float = 0.03,  # m, where its surface is
    to: float = 0.05,  # m, where the hand reaches, beyond the surface
    tolerance: float = 1e-9,  # m, error per tick that the integrator keeps to
    observer: float | None = 200.0,  # 1/s, bandwidth of the observer of the hand's force; none: a force sensor
    energy: bool = True,  # record the energy ledgers
    dt: float = 1e-3,  # s, the tick
    duration: float = 3.0,  # s
) -> Scene:
    """A minimum-jerk reach presses the slave into a Hunt-Crossley body, which stiffens with depth."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=to, start=0.2, duration=1.0)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=HuntCrossley(k=k_e, n=n, lam=lam, at=at),
        tolerance=tolerance,
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
