"""The velocity cap: a force that drives its device fades as that nears its greatest velocity.

A force *drives* its device where it pushes the way that goes: f_s v_s > 0 at the slave and, as f_m is against the
hand, -f_m v_m > 0 at the master. Otherwise it brakes. The cap takes driving force away and nothing else, so what
it adds to a law is dissipation, but for what the hold and the slew limit make of any change of force.
"""

from __future__ import annotations

from math import inf
from typing import Any, ClassVar, NamedTuple

from teleop.stages.end import End, Places, Run, Stage


class SpeedLimits(NamedTuple):
    v_max: float  # m/s
    slope: float  # s/m, of the fading
    f_max: float  # N


FADES_FROM = 0.9  # of v_max
NO_LIMIT = SpeedLimits(1e300, 1e-299, inf)  # of an axis without a greatest velocity beside one that has: fades nothing


def limit_speed(c: SpeedLimits, f: float, along: float) -> float:
    """`f` within f_max, with what drives the device faded linearly from 0.9 v_max on, to zero at v_max. Per axis.

    A force that brakes is as it was, at any speed. A body of mass M that was below v_max is not driven above it by the
    force of one tick if f_max dt <= 0.1 M v_max, and otherwise at most to 0.9 v_max + f_max dt/M; that is of the
    velocity as it is read, and without a slew limit, with which the force takes up to f_max/slew s to fade. Whatever
    else moves the device (the hand, what it touches) is not in the stack's power. What is faded is the force within
    f_max: of a law that asks for a hundred times that, no more than the last hundredth of the band would take any.

    NaN of force or velocity stays NaN: it must be seen.
    """
    v_max, slope, f_max = c
    forth = max(min((v_max - along) * slope, 1.0), 0.0)
    back = max(min((v_max + along) * slope, 1.0), 0.0)
    return forth * max(min(f, f_max), 0.0) + back * min(max(f, -f_max), 0.0)


class VelocityCapStage(Stage):
    """The velocity cap of `Cap(v_max=...)`, axis by axis."""

    name: ClassVar[str] = "velocity_cap"
    c_speed: tuple[SpeedLimits, ...]  # for each axis

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return tuple([NO_LIMIT if each is None or each.v_max is None else each.speed()
                      for each in scene.per_axis("cap")])

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.c_speed = numbers

    def act(self, run: Run, e: End, k: int) -> None:
        for a in e.axes:
            a.f_cmd = limit_speed(self.c_speed[a.i], a.f_cmd, -a.v_read if e.name == "m" else a.v_read)
