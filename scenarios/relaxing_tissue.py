"""Relaxing tissue: a standard linear solid, stepped exactly with one more state."""

from __future__ import annotations

from typing import Annotated

from channel import Delay
from master import Grip, Reach
from slave import StandardLinearSolid
from teleop import Knob, Law, MassDamper, Scene, Wave, knob


def scene(
    *,
    law: Law = Wave(),
    delay: knob.LinkDelay = 0.02,
    k_e: Annotated[float, Knob("N/m", "stiffness in the long run", low=0.0)] = 150.0,
    k1: Annotated[float, Knob("N/m", "stiffness that relaxes", low=0.0)] = 400.0,
    tau: Annotated[float, Knob("s", "time in which it relaxes", above=0.0)] = 0.3,
    to: Annotated[float, Knob("m", "position that the hand reaches for")] = 0.03,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 4.0,
) -> Scene:
    """A quick reach into tissue whose force falls while the hand stays."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=to, start=0.2, duration=0.5)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=StandardLinearSolid(k=k_e, k1=k1, tau=tau),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
