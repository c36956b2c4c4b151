"""Position and force scaling between a master and a slave of another size, as in microsurgery or with large machines.

A metre of the master is `scale_x` metres of the slave, and a newton of the master `scale_f` newtons of the slave (of an
axis that turns: a radian, a newton metre), on each axis with scales of its own where there is one `Scaling` for each:

    x_s = scale_x x_m        f_s = scale_f f_m

The law works in the master's units at both ends, and so do the messages and their waves. At the slave it is told

    x_s/scale_x,  v_s/scale_x,  dx_s/scale_x,  f_env/scale_f,  f_held/scale_f

and the force f that it answers is scale_f f at the slave; watchdog, caps and budget, which stand between it and the
motor, count in the slave's own newtons and metres. With a law that is transparent f_m = f_env/scale_f at
v_m = v_s/scale_x, so an environment Z_e = f_env/v_s feels like

    Z_m = f_m/v_m = Z_e scale_x/scale_f

and the power at the slave is that of the law times scale_x scale_f:

    f_s v_s = scale_x scale_f (f_s/scale_f) (v_s/scale_x).

Joules of both ports add up in the master's units alone: what is passive there is passive for the two devices together,
since each port is multiplied by a number above zero. So `E_port_s` is the work over the slave's motion divided by
scale_x scale_f, axis by axis, and E_port = E_port_m - E_port_s holds as without scaling. `x_err` and `f_err` compare
the ends in the master's units too. All other columns of the slave are its own: x_s, v_s, f_s, f_env, and what is left
of its budget.

**Axes with unlike p = scale_x scale_f.** The law is where the joules are the master's, so what it claims (of the sum
over its axes, which it may couple: `two_layer`, `tdpa`, `pspm` share one store) holds with any scales. Of the slave's
joules W_i it gets W_i/p_i. A slave and an environment that are passive on each axis by themselves stay passive as the
law meets them, so the whole does. Where the slave's body or what it touches couples axes, only the sum of the W_i is
passive: with unlike p it may take W on the axis of the greater p and give it back on that of the smaller, which the law
meets as energy made. (The mass matrix M is met as S_f^-1 M S_x, S of the scales on its diagonal, which has an energy
where it is symmetric, and that is where p_i = p_j for each pair of axes that M couples.) So give axes that an arm or a
surface couples the same scale_x scale_f. Their own ratio scale_x/scale_f, by which Z_m differs from Z_e, they may have.
Nor is the slave's side of a law that couples axes passive in the slave's own joules then; in the master's it is.

Source of the scaled two-port: J. E. Colgate, "Robust impedance shaping telemanipulation", IEEE Trans. Robotics and
Automation 9(4), 1993.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from teleop.errors import number
from teleop.law import At
from teleop.stages.end import End, Places, Record, Run, Stage


@dataclass(frozen=True, kw_only=True, slots=True)
class Scaling:
    """The slave's metres for a metre of the master, and its newtons for a newton of the master; both above 0."""

    scale_x: float = 1.0
    scale_f: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "scale_x", number("scale_x", self.scale_x, above=0.0))
        object.__setattr__(self, "scale_f", number("scale_f", self.scale_f, above=0.0))


def in_units_of_master(scale_x: float, scale_f: float, at: At) -> At:
    """`At` of the slave's end of the law, in the master's units."""
    return At(at.x / scale_x, at.v / scale_x, at.f / scale_f, at.f_held / scale_f, at.dx / scale_x, at.fresh, at.age,
              at.dt, at.span, at.gain)


class Scales(Record):
    """The scales of one axis."""

    scale_x: float  # slave's metres (or rad) for one of the master
    scale_f: float  # slave's newtons (or N m) for one of the master


class ScalingStage(Stage):
    """The conversion of units around the slave's end of the law: readings before it, its force after it."""

    name: ClassVar[str] = "scaling"
    axis_kind: ClassVar[type[Record]] = Scales

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return tuple([(each.scale_x, each.scale_f) for each in scene.per_axis("scaling")])

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        for a, scales in zip(e.axes, self.axes, strict=True):
            scales.scale_x, scales.scale_f = numbers[a.i]

    def situate(self, run: Run, e: End) -> None:
        for a, scales in zip(e.axes, self.axes, strict=True):
            a.at = in_units_of_master(scales.scale_x, scales.scale_f, a.at)

    def act(self, run: Run, e: End, k: int) -> None:
        for a, scales in zip(e.axes, self.axes, strict=True):
            a.f_cmd = scales.scale_f * a.f_cmd
