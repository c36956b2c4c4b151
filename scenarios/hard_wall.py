"""Reach for a hard wall over a delay, press, and stay pressed."""

from __future__ import annotations

from channel.delay import Delay
from master.hand import Grip, Reach
from slave.wall import Wall
from teleop.law import Law
from teleop.laws.wave import Wave
from teleop.plant import MassDamper
from teleop.safety import Cap, Watchdog
from teleop.scene import Scene


def scene(
    *,
    law: Law = Wave(),
    delay: float = 0.05,
    k_e: float = 2e4,
    d_e: float = 10.0,
    wall: float = 0.03,
    to: float = 0.06,
    timeout: float = 0.2,
    f_max: float = 20.0,
    slew: float = 2000.0,
    observer: float | None = 200.0,
    energy: bool = True,
    dt: float = 1e-3,
    duration: float = 10.0,
) -> Scene:
    """A minimum-jerk reach takes the slave into a hard wall, which the hand then presses."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=to, start=0.5, duration=1.5)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=Wall(k=k_e, d=d_e, at=wall),
        watchdog=Watchdog(timeout=timeout),
        cap=Cap(f_max=f_max, slew=slew),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
