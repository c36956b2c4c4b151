"""Cellular network: two recorded LTE links, up from the master, down to it; waves fill the gaps by their integral."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from channel import Delay, Link, Mahimahi
from master import Grip, Reach
from slave import Wall
from teleop import Cap, Fixed, Integral, Knob, Law, MassDamper, Playout, Scene, Watchdog, Wave, knob


def scene(
    *,
    up: Annotated[Path, Knob("", "file with the delivery trace from master to slave")],
    down: Annotated[Path, Knob("", "file with the delivery trace from slave to master")],
    law: Law = Wave(),
    delay: knob.LinkDelay = 0.02,
    queue: Annotated[int, Knob("packets", "room to wait", low=1, link=True)] = 300,
    start: Annotated[float, Knob("s", "time of the recordings to skip", low=0.0, link=True)] = 0.0,
    playout: Playout = Fixed(0.12, Integral()),
    k_e: Annotated[float, Knob("N/m", "stiffness of the wall", low=0.0)] = 5e3,
    d_e: Annotated[float, Knob("N s/m", "damping of the wall", low=0.0)] = 10.0,
    wall: Annotated[float, Knob("m", "position of its surface")] = 0.03,
    to: Annotated[float, Knob("m", "position that the hand reaches for, beyond the wall")] = 0.06,
    timeout: knob.Timeout = 0.5,
    age: knob.MessageAge = 2.5,
    f_max: knob.MostForce = 20.0,
    slew: knob.MostSlew = 2000.0,
    v_max: knob.MostSpeed = None,
    power: knob.PowerBudget = None,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 10.0,
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
        watchdog=None if timeout is None else Watchdog(timeout=timeout, age=age),
        cap=Cap.of(f_max=f_max, slew=slew, v_max=v_max, power=power),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
