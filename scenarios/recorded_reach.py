"""A recorded motion in three axes, felt through projection-based force reflection."""

from __future__ import annotations

from pathlib import Path

from channel import Delay
from master import Grip, Recording
from slave import Wall
from teleop import PFRA, Cap, Law, MassDamper, Scene, Watchdog


def scene(
    *,
    law: Law = PFRA(alpha=0.2),  # control law: direct, pfra, wave or one of a plug-in
    motion: Path = Path(__file__).with_name("reach.csv"),  # file, the recorded motion: CSV of t, x, y, z
    delay: float = 0.05,  # s, each way
    k_e: float = 2e3,  # N/m, stiffness of the wall
    d_e: float = 10.0,  # N s/m, damping of the wall
    wall: float = 0.04,  # m, where its surface is
    timeout: float = 0.2,  # s of silence after which the watchdogs let go
    age: float | None = 2.5,  # s, from which on a message that is played is no sign of the other end; none: at any age
    f_max: float = 20.0,  # N, most force of either end
    slew: float = 2000.0,  # N/s, most change of either force
    v_max: float | None = None,  # m/s, speed from which on an end only brakes; none: it drives at any
    power: float | None = None,  # W, what either end may give out, and hold for a second; none: no budget
    observer: float | None = 200.0,  # 1/s, bandwidth of the observer of the hand's force; none: a force sensor
    energy: bool = True,  # record the energy ledgers
    dt: float = 1e-3,  # s, the tick
    duration: float = 6.0,  # s
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
        watchdog=Watchdog(timeout=timeout, age=age),
        cap=Cap(f_max=f_max, slew=slew, v_max=v_max, power=power),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
