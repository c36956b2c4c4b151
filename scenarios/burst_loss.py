"""Loss in bursts, as radio links have it (Gilbert-Elliott)."""

from __future__ import annotations

from channel.delay import Delay
from channel.gilbert_elliott import GilbertElliott
from master.hand import Grip, Reach
from slave.wall import Wall
from teleop.law import Law
from teleop.laws.wave import Wave
from teleop.plant import MassDamper
from teleop.playout import Fixed
from teleop.safety import Cap, Watchdog
from teleop.scene import Playout, Scene


def scene(
    *,
    law: Law = Wave(),
    delay: float = 0.03,
    to_bad: float = 0.005,
    to_good: float = 0.05,
    playout: Playout = Fixed(0.03),
    k_e: float = 5e3,
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
    """A hand reaches for a wall over a link that goes bad for some 20 packets at a time."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=to, start=0.5, duration=1.5)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay) | GilbertElliott(p_good_to_bad=to_bad, p_bad_to_good=to_good),
        playout=playout,
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=Wall(k=k_e, d=d_e, at=wall),
        watchdog=Watchdog(timeout=timeout),
        cap=Cap(f_max=f_max, slew=slew),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
