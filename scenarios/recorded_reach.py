"""A recorded motion in three axes, felt through projection-based force reflection."""

from __future__ import annotations

from pathlib import Path

from channel.delay import Delay
from master.hand import Grip
from master.recording import Recording
from slave.wall import Wall
from teleop.law import Law
from teleop.laws.pfra import PFRA
from teleop.plant import MassDamper
from teleop.safety import Cap, Watchdog
from teleop.scene import Scene


def scene(
    *,
    law: Law = PFRA(alpha=0.2),
    motion: Path = Path(__file__).with_name("reach.csv"),
    delay: float = 0.05,
    k_e: float = 2e3,
    d_e: float = 10.0,
    wall: float = 0.04,
    timeout: float = 0.2,
    f_max: float = 20.0,
    slew: float = 2000.0,
    observer: float | None = 200.0,
    energy: bool = True,
    dt: float = 1e-3,
    duration: float = 6.0,
) -> Scene:
    """A hand that follows a recording drives a slave along a wall; the reflected force is a vector."""
    return Scene(
        law=law,
        axes=3,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Recording(path=str(motion))),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=(Wall(k=k_e, d=d_e, at=wall), None, None),
        watchdog=Watchdog(timeout=timeout),
        cap=Cap(f_max=f_max, slew=slew),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
