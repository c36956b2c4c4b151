"""Wide-area network: delay, jitter with reordering, and some loss; waves fill the gaps by their integral."""

from __future__ import annotations

from typing import Annotated

from channel import Bernoulli, Delay, UniformJitter
from master import Grip, Reach
from slave import Wall
from teleop import Cap, Fixed, Integral, Knob, Law, MassDamper, Playout, Scene, Watchdog, Wave, knob


def scene(
    *,
    law: Law = Wave(),
    delay: knob.LinkDelay = 0.04,
    jitter: Annotated[float, Knob("s", "most that a packet is late", low=0.0, link=True)] = 0.02,
    loss: Annotated[float, Knob("", "probability that a packet is lost", low=0.0, high=1.0, link=True)] = 0.02,
    playout: Playout = Fixed(0.065, Integral()),
    k_e: Annotated[float, Knob("N/m", "stiffness of the wall", low=0.0)] = 5e3,
    d_e: Annotated[float, Knob("N s/m", "damping of the wall", low=0.0)] = 10.0,
    wall: Annotated[float, Knob("m", "position of its surface")] = 0.03,
    to: Annotated[float, Knob("m", "position that the hand reaches for, beyond the wall")] = 0.06,
    timeout: knob.Timeout = 0.2,
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
    """A hand reaches for a wall over a link with jitter and loss; a fixed playout delay restores the order."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=to, start=0.5, duration=1.5)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay) | UniformJitter(jitter) | Bernoulli(loss),
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
