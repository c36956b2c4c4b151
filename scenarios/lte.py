"""A moving phone: two recorded LTE links, up from the master, down to it."""

from __future__ import annotations

from pathlib import Path

from channel import Delay, Link, Mahimahi
from master import Grip, Reach
from slave import Wall
from teleop import Cap, Fixed, Law, MassDamper, Playout, Scene, Watchdog, Wave


def scene(
    *,
    up: Path,  # file, delivery trace from master to slave
    down: Path,  # file, delivery trace from slave to master
    law: Law = Wave(),  # control law: direct, pfra, wave or one of a plug-in
    delay: float = 0.02,  # s, each way
    queue: int = 300,  # packets that find room to wait
    start: float = 0.0,  # s of the recordings to skip
    playout: Playout = Fixed(0.12),  # zero, hold, or fixed:SECONDS from sending to playing
    k_e: float = 5e3,  # N/m, stiffness of the wall
    d_e: float = 10.0,  # N s/m, damping of the wall
    wall: float = 0.03,  # m, where its surface is
    to: float = 0.06,  # m, where the hand reaches, beyond the wall
    timeout: float = 0.5,  # s of silence after which the watchdogs let go
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
    """A hand reaches for a wall over recorded packet-delivery traces (mahimahi format)."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=to, start=0.5, duration=1.5)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Link(
            fwd=Mahimahi(str(up), queue=queue, start=start) | Delay(delay),
            bwd=Mahimahi(str(down), queue=queue, start=start) | Delay(delay),
        ),
        playout=playout,
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=Wall(k=k_e, d=d_e, at=wall),
        watchdog=Watchdog(timeout=timeout, age=age),
        cap=Cap(f_max=f_max, slew=slew, v_max=v_max, power=power),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
