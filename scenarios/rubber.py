"""Rubber ball: a contact that stiffens with depth, for which no closed form exists."""

from __future__ import annotations

from typing import Annotated

from channel import Delay
from master import Grip, Reach
from slave import HuntCrossley
from teleop import Knob, Law, MassDamper, Scene, Wave, knob


def scene(
    *,
    law: Law = Wave(),
    delay: knob.LinkDelay = 0.02,
    k_e: Annotated[float, Knob("N/m^n", "stiffness of the rubber", low=0.0)] = 2e5,
    n: Annotated[float, Knob("", "exponent; 1.5 is Hertz's contact of two spheres", low=1.0, high=10.0)] = 1.5,
    lam: Annotated[float, Knob("s/m", "damping: of a blow at v comes back about 1 - (2/3) lam v", low=0.0)] = 0.5,
    at: Annotated[float, Knob("m", "position of the surface")] = 0.03,
    to: Annotated[float, Knob("m", "position that the hand reaches for, beyond the surface")] = 0.05,
    tolerance: knob.Tolerance = 1e-9,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 3.0,
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
