"""Scale and base between a master and a slave: another size, as in microsurgery, and a base that is turned.

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

**A base that is turned.** `Frame(rotation, scale)` is a fixed transform: a motion u of the master, in the directions of
its base, is scale R u in those of the slave's base. With S_x and S_f the slave's scales on their diagonals, S_x times
`scale` and S_f divided by it on axes along lines, each three axes x of the slave are told to the law as

    x = R^T S_x^-1 x_s,   and v, dx alike,      f = R^T S_f^-1 f_env,   f_held alike,      f_s = S_f R f_law.

R^T R = 1, so the power of three axes is the same in either base: f_law . v = (R f_law) . (R v), which is the sum of
f_s,i v_s,i/p_i that E_port_s adds up axis by axis. So a frame makes and takes no energy, whatever the scales are, and
with `scale` alone p = 1: the slave's joules are the master's, as of a lever. The condition is that R is a rotation, R^T
R = 1 with determinant 1, which is checked, and stays the same over the run. The scales stay those of the slave's own
axes, beside the device, and so do watchdog, caps and budget, which stand behind. Angles have no size: `scale` leaves
the axes of a rotation alone.

On the axes of a rotation R turns the angular velocity and the torque in the same way. The law's orientation is counted
from what the law is told (`teleop.stages.orientation`, behind this stage), and exp(R^T d) = r^-1 exp(d) r with r the
quaternion of R, so it is r^-1 q_s r: conjugated, with nothing more to do; `qw_s`, ... are recorded so.

Three axes are those of each rotation of the scene, and of the others each three in a row, in m: a joint is no
direction. Whatever the slave is, the law meets it as R^T Z R: on axes alike the same; on axes that differ it couples
the law's, and an analysis of one axis by itself is not that of the scene.

Source of the scaled two-port: J. E. Colgate, "Robust impedance shaping telemanipulation", IEEE Trans. Robotics and
Automation 9(4), 1993.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, sqrt
from typing import Any, ClassVar, NamedTuple

from teleop.errors import Refused, number
from teleop.law import At
from teleop.stages.end import Axis, End, Places, Record, Run, Stage
from teleop.stages.slave_units import scales

ENTRIES = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")  # of a matrix, row by row
LEAST, MOST = 0.01, 100.0  # of a scale that is set while it runs
OFF = 1e-6  # by which the entries of a rotation may be off


@dataclass(frozen=True, kw_only=True, slots=True)
class Scaling:
    """The slave's metres for a metre of the master, and its newtons for a newton of the master; both above 0."""

    scale_x: float = 1.0
    scale_f: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "scale_x", number("scale_x", self.scale_x, above=0.0))
        object.__setattr__(self, "scale_f", number("scale_f", self.scale_f, above=0.0))


@dataclass(frozen=True, kw_only=True, slots=True)
class Frame:
    """A fixed transform from the master's base to the slave's: a rotation, and a size.

    `rotation`: a rotation vector (rad), a unit quaternion (w, x, y, z), or the three rows of a matrix; a motion u of
    the master is R u of the slave, each in the directions of its own base. `scale`: metres of the slave for one of the
    master, whose newtons are as many times less, so that both have the same joules. Angles and torques have no size.
    """

    rotation: tuple[Any, ...] = (0.0, 0.0, 0.0)
    scale: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "scale", number("scale", self.scale, above=0.0))
        self.matrix  # noqa: B018 - which checks the rotation

    @property
    def matrix(self) -> tuple[float, ...]:
        """The nine entries of the matrix R, row by row. Raises `Refused` where it is no rotation."""
        R, example = self.rotation, "rotation=(0.0, 0.0, 1.5708)"
        if isinstance(R, tuple) and len(R) == 3 and all(isinstance(row, tuple) and len(row) == 3 for row in R):
            m = tuple([number("an entry of rotation", each, example=example) for row in R for each in row])
            off = [sum([m[3 * i + n] * m[3 * j + n] for n in range(3)]) - (i == j) for i in range(3) for j in range(3)]
            det = sum([m[i] * (m[3 + (i + 1) % 3] * m[6 + (i + 2) % 3] - m[3 + (i + 2) % 3] * m[6 + (i + 1) % 3])
                       for i in range(3)])
            if max(map(abs, [*off, det - 1.0])) > OFF:
                raise Refused("rotation is a matrix whose columns are not at right angles and 1 long, or which mirrors "
                              f"(determinant {det:.6g}); write one of a rotation, or a rotation vector in rad, for "
                              f"example {example}")
            return m
        if not isinstance(R, tuple) or len(R) not in (3, 4):
            raise Refused("rotation must be a rotation vector of three numbers (rad), a quaternion of four or a matrix "
                          f"of three rows, not {R!r}; write for example {example}")
        parts = [number("a number of rotation", each, example=example) for each in R]
        if len(parts) == 4:
            size = sqrt(sum([each * each for each in parts]))
            if not abs(size - 1.0) <= OFF:
                raise Refused(f"rotation is a quaternion {size:.6g} long, and one of a rotation is 1 long; divide it "
                              f"by that, or write a rotation vector in rad, for example {example}")
            w, x, y, z = [each / size for each in parts]
        else:
            from teleop.physics.rotation import exp

            w, x, y, z = exp(*parts)
            if not isfinite(w):
                raise Refused(f"rotation={R!r} is no angle of a rotation; write one in rad, for example {example}")
        return (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
                2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
                2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))

    def triples(self, scene: Any) -> tuple[int, ...]:
        """The first of each three axes that the frame turns together. Raises `Refused` where axes are left over."""
        lines = [i for i in range(scene.axes) if i not in scene.turning]
        firsts = lines[::3]
        in_a_row = all(lines[3 * n:3 * n + 3] == [i, i + 1, i + 2] for n, i in enumerate(firsts))
        if not in_a_row or any(scene.axis_units[i] != "m" for i in lines):
            named = zip(scene.axis_names, scene.axis_units, strict=True)
            axes = [f"{name} in {unit}" for name, unit in named]
            raise Refused("a frame turns three axes in a row, those of a rotation or three directions in m, and the "
                          f"axes of this scene are {', '.join(axes)}; leave the frame out, or write for example "
                          "axes=3, or axes=6 with rotations=(3,)")
        return tuple(sorted((*firsts, *scene.rotations)))


def in_units_of_master(scale_x: float, scale_f: float, at: At) -> At:
    """`At` of the slave's end of the law, in the master's units."""
    return At(at.x / scale_x, at.v / scale_x, at.f / scale_f, at.f_held / scale_f, at.dx / scale_x, at.fresh, at.age,
              at.dt, at.span, at.gain)


def axis_of_master(p: At, q: At, r: At, a: float, b: float, c: float) -> At:
    """Axis of the master's base, made of the three of the slave's: a, b, c are its column of R."""
    return At(a * p.x + b * q.x + c * r.x, a * p.v + b * q.v + c * r.v, a * p.f + b * q.f + c * r.f,
              a * p.f_held + b * q.f_held + c * r.f_held, a * p.dx + b * q.dx + c * r.dx, p.fresh, p.age, p.dt, p.span,
              p.gain)


def check_scale(value: Any) -> float:
    """A scale that may be set while it runs. Raises `Refused`."""
    scale = number("scale", value, example="scale=0.5")
    if not LEAST <= scale <= MOST:
        raise Refused(f"a scale is from {LEAST:g} to {MOST:g}, metres of the slave for one of the handle, not "
                      f"{scale:g}; to hold the slave open the clutch")
    return scale


def scale_at(scales: tuple[tuple[float, float], ...], k: float) -> float:
    """The scale that a schedule sets at tick k; 1.0 before its first."""
    scale = 1.0
    for start, value in scales:
        if value > 0.0 and start <= k:
            scale = value
    return scale


def scale_step(factor: float, scale: float, to: float) -> float:
    """The scale a tick later, on its way to another; at once where there is none yet (0)."""
    if scale <= 0.0:
        return to
    return min(scale * factor, to) if scale < to else max(scale / factor, to)


class Scales(Record):
    """The scales of one axis."""

    scale_x: float  # slave's metres (or rad) for one of the master
    scale_f: float  # slave's newtons (or N m) for one of the master
    turn: Any = None  # the three axes that it is one of, and which
    column: tuple[str, ...] = ()  # the entries of R that it is seen by


class Turned(Record):
    """Three axes of the slave that are turned together, and the matrix R by which."""

    xx: float
    xy: float
    xz: float
    yx: float
    yy: float
    yz: float
    zx: float
    zy: float
    zz: float

    def __init__(self, suffix: str, axes: tuple[Axis, ...]) -> None:
        super().__init__(suffix)
        self.a, self.b, self.c = axes


def to_master(t: Turned) -> None:
    """Turn what the law is told of three axes into the master's base."""
    p, q, r = t.a.at, t.b.at, t.c.at
    t.a.at = axis_of_master(p, q, r, t.xx, t.yx, t.zx)
    t.b.at = axis_of_master(p, q, r, t.xy, t.yy, t.zy)
    t.c.at = axis_of_master(p, q, r, t.xz, t.yz, t.zz)


def to_slave(t: Turned) -> None:
    """Turn the law's force of three axes into the slave's base."""
    f, g, h = t.a.f_cmd, t.b.f_cmd, t.c.f_cmd
    t.a.f_cmd = t.xx * f + t.xy * g + t.xz * h
    t.b.f_cmd = t.yx * f + t.yy * g + t.yz * h
    t.c.f_cmd = t.zx * f + t.zy * g + t.zz * h


def of_master(stage: ScalingStage, a: Axis, name: str, scale: str) -> Any:
    """Value by this name of the slave on one axis of the master's base, in the master's units by this scale."""
    of = stage.axes[a.i]
    if not of.turn:
        return getattr(a, name) / getattr(of, scale)
    t = of.turn
    return (getattr(t, of.column[0]) * (getattr(t.a, name) / getattr(stage.axes[t.a.i], scale))
            + getattr(t, of.column[1]) * (getattr(t.b, name) / getattr(stage.axes[t.b.i], scale))
            + getattr(t, of.column[2]) * (getattr(t.c, name) / getattr(stage.axes[t.c.i], scale)))


class FrameNumbers(NamedTuple):
    """Numbers of the stage: the scales of each axis, and the entries of the rotation, none without a frame."""

    scales: tuple[tuple[float, float], ...]
    entries: tuple[float, ...]


class ScalingStage(Stage):
    """The conversion of units and directions around the slave's end of the law: readings before it, its force after."""

    name: ClassVar[str] = "scaling"
    axis_kind: ClassVar[type[Record]] = Scales

    @staticmethod
    def structure(end: Any) -> Any:
        """The first of each three axes that are turned together."""
        return () if end.scene.frame is None else end.scene.frame.triples(end.scene)

    def __init__(self, e: End, structure: Any) -> None:
        super().__init__(e, structure)
        self.turned = tuple([Turned(f"{e.name}_frame{i}", e.axes[i:i + 3]) for i in structure or ()])
        for i, t in zip(structure or (), self.turned, strict=True):
            for n in range(3):
                self.axes[i + n].turn, self.axes[i + n].column = t, ENTRIES[n::3]

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return FrameNumbers(scales(scene), () if scene.frame is None else scene.frame.matrix)

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        for a, of in zip(e.axes, self.axes, strict=True):
            of.scale_x, of.scale_f = numbers.scales[a.i]
        for t in self.turned:
            t.xx, t.xy, t.xz, t.yx, t.yy, t.yz, t.zx, t.zy, t.zz = numbers.entries

    def situate(self, run: Run, e: End) -> None:
        for a, of in zip(e.axes, self.axes, strict=True):
            a.at = in_units_of_master(of.scale_x, of.scale_f, a.at)
        for t in self.turned:
            to_master(t)

    def act(self, run: Run, e: End, k: int) -> None:
        for t in self.turned:
            to_slave(t)
        for a, of in zip(e.axes, self.axes, strict=True):
            a.f_cmd = of.scale_f * a.f_cmd
