"""Pose: a tool with a place and an orientation, which is tilted, turned by one and a half turns and tilted back.

Masters, slaves and laws on the rotation axes are those of the translations at the end of a lever, so a radian there is
as far as `lever` metres: a mass is a moment of inertia of mass lever^2, and a gain that is given as one number goes
along. A law for each axis, as `--set law.K=100,100,100,0.2,0.2,0.2` makes it, is taken as it is.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from math import cos, pi, sin
from typing import Annotated, Any, get_type_hints

from channel import Delay
from master import Grip, Reach
from slave import Wall
from teleop import Cap, Knob, Law, MassDamper, PositionPosition, Scene, Watchdog, knob

AXES = ("x", "y", "z", "rx", "ry", "rz")
# What a metre, a newton and a kilogram become at the end of a lever, by the unit of a number: powers of its length.
POWERS = {"N/m": 2, "N s/m": 2, "kg": 2, "N": 1, "m": -1, "m/s": -1, "N s/(m J)": 2}


@dataclass(frozen=True)
class Moves:
    """A hand that makes several reaches, whose ways add up."""

    reaches: tuple[Reach, ...]

    def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> tuple[array[float], ...]:
        """For each axis the position (m or rad) at the ticks first .. first+count-1."""
        ways = [reach.samples(axes, count, dt_ns, first) for reach in self.reaches]
        return tuple([array("d", map(sum, zip(*each, strict=True))) for each in zip(*ways, strict=True)])


def scene(
    *,
    law: Law = PositionPosition(),
    delay: knob.LinkDelay = 0.01,
    turns: Annotated[float, Knob("", "turns of the tool about its tilted axis")] = 1.5,
    tilt: Annotated[float, Knob("rad", "angle by which the tool's axis is tilted about y meanwhile")] = 0.6,
    reach: Annotated[float, Knob("m", "way of the hand along x, and half as far along y")] = 0.06,
    wall: Annotated[float, Knob("m", "position of the wall's surface on x")] = 0.04,
    k_e: Annotated[float, Knob("N/m", "stiffness of the wall", low=0.0)] = 1000.0,
    d_e: Annotated[float, Knob("N s/m", "damping of the wall", low=0.0)] = 5.0,
    k_t: Annotated[float, Knob("N m/rad", "stiffness of what the tool twists, about each axis", low=0.0)] = 0.01,
    d_t: Annotated[float, Knob("N m s/rad", "damping of what the tool twists", low=0.0)] = 0.001,
    lever: Annotated[float, Knob("m", "metres of translation that are as far as a radian", above=0.0)] = 0.05,
    timeout: knob.Timeout = 0.2,
    f_max: knob.MostForce = 20.0,
    slew: knob.MostSlew = 2000.0,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 7.0,
) -> Scene:
    """A hand moves a tool to a wall while it tilts it, turns it against a torsion spring and tilts it back."""
    from slave import Tissue  # not at the top: handover takes parts of this file and has no tissue

    about = (0.0, 0.0, 0.0, 2.0 * pi * turns * sin(tilt), 0.0, 2.0 * pi * turns * cos(tilt))
    moves = Moves((Reach(to=(reach, 0.5 * reach, 0.0, 0.0, tilt, 0.0), start=0.3, duration=1.2),
                   Reach(to=about, start=1.5, duration=3.0),
                   Reach(to=(0.0, 0.0, 0.0, 0.0, -tilt, 0.0), start=4.5, duration=1.0)))
    size = lever * lever
    grips = [Grip(mass=0.4 * each, k=200.0 * each, d=5.0 * each, reference=moves) for each in (1.0, size)]
    slow = None if slew is None else slew * lever
    caps = (Cap(f_max=f_max, slew=slew), Cap(f_max=None if f_max is None else f_max * lever, slew=slow))
    return Scene(
        law=law if isinstance(law, tuple) else (*[law] * 3, *[at_lever(law, lever)] * 3),
        axes=len(AXES),
        names=AXES,
        rotations=(3,),
        hand=both(*grips),
        master=both(MassDamper(mass=0.1, damping=0.5), MassDamper(mass=0.1 * size, damping=0.5 * size)),
        link=Delay(delay),
        slave=both(MassDamper(mass=0.5, damping=1.0), MassDamper(mass=0.5 * size, damping=size)),
        environment=(Wall(k=k_e, d=d_e, at=wall), None, None, *[Tissue(k=k_t, d=d_t)] * 3),
        watchdog=None if timeout is None else Watchdog(timeout=timeout),
        cap=None if f_max is None and slew is None else both(*caps),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )


def both(translation: Any, rotation: Any) -> tuple[Any, ...]:
    """Make a part for each of x, y and z, and another for each of rx, ry and rz."""
    return (*[translation] * 3, *[rotation] * 3)


def at_lever(law: Any, lever: float) -> Any:
    """A law whose metre is 1/`lever` rad: each of its numbers in the units of a rotation, energies as they are."""
    units = {name: next((one.unit for one in getattr(hint, "__metadata__", ()) if isinstance(one, Knob)), "")
             for name, hint in get_type_hints(type(law), include_extras=True).items()}
    changes = {name: getattr(law, name) * lever ** POWERS[unit] for name, unit in units.items() if unit in POWERS}
    return replace(law, **changes)


def with_gains(law: Any, gains: Mapping[str, float], usual: Callable[[Any], Any] = lambda law: law) -> Any:
    """A law with these gains where it has its own defaults, the rest of which are as `usual` makes them.

    A law for each axis stays as it is.
    """
    if isinstance(law, tuple):
        return law
    made = usual(law)
    left = [each.name for each in fields(law) if each.init and getattr(law, each.name) == each.default]
    return replace(law, **{name: gains.get(name, getattr(made, name)) for name in left})
