"""Nothing to touch: how well the slave follows over a delay."""

from __future__ import annotations

from channel.delay import Delay
from master.hand import Grip, Sine
from teleop.law import Law
from teleop.laws.wave import Wave
from teleop.plant import MassDamper
from teleop.scene import Scene


def scene(
    *,
    law: Law = Wave(),
    delay: float = 0.05,
    amplitude: float = 0.05,
    frequency: float = 0.5,
    observer: float | None = 200.0,
    energy: bool = True,
    dt: float = 1e-3,
    duration: float = 10.0,
) -> Scene:
    """A hand swings the master, the slave follows in free space."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=amplitude, frequency=frequency)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay),
        slave=MassDamper(mass=0.5, damping=1.0),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
