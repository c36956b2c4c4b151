"""The link goes away for a while, and comes back."""

from __future__ import annotations

from channel import Blackout, Delay
from master import Grip, Reach
from slave import Wall
from teleop import Cap, Law, MassDamper, Scene, Watchdog, Wave


def scene(
    *,
    law: Law = Wave(),  # control law: direct, pfra, wave or one of a plug-in
    delay: float = 0.03,  # s, each way
    dark_from: float = 4.0,  # s, when the link goes
    dark_for: float = 1.0,  # s, how long it is gone
    k_e: float = 5e3,  # N/m, stiffness of the wall
    d_e: float = 10.0,  # N s/m, damping of the wall
    wall: float = 0.03,  # m, where its surface is
    to: float = 0.06,  # m, where the hand reaches, beyond the wall
    timeout: float = 0.2,  # s of silence after which the watchdogs let go
    age: float | None = 2.5,  # s, from which on a message that is played is no sign of the other end; none: at any age
    f_max: float = 20.0,  # N, most force of either end
    slew: float = 2000.0,  # N/s, most change of either force
    v_max: float | None = None,  # m/s, speed from which on an end only brakes; none: it drives at any
    power: float | None = None,  # W, what either end may give out, and hold for a second; none: no budget
    observer: float | None = 200.0,  # 1/s, bandwidth of the observer of the hand's force; none: a force sensor
    energy: bool = True,  # record the energy ledgers
    dt: float = 1e-3,  # s, the tick
    duration: float = 10.0,  # s
) -> Scene:
    """A hand presses a wall; for a second nothing gets through: the watchdogs let go, then take hold again."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=to, start=0.5, duration=1.5)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay) | Blackout(start=dark_from, duration=dark_for),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=Wall(k=k_e, d=d_e, at=wall),
        watchdog=Watchdog(timeout=timeout, age=age),
        cap=Cap(f_max=f_max, slew=slew, v_max=v_max, power=power),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
