"""Orientation: on the three axes of a rotation a law's positions stand for a unit quaternion.

A rotation axis has the coordinate phi, the integral of the angular velocity along one of the world's directions: x
is phi (rad), v the angular velocity (rad/s), f the torque (N m). Bodies, waves and the work of a port are those of any
axis then, for the power of a torque f is the sum of f_i v_i: with f held over a tick its work is the sum of f_i times
the change of phi_i, to rounding, however the axis of the turn moves meanwhile. In simulation a body has the same
inertia about every axis, since only that has no gyroscopic torque: J w' = f on each axis by itself.

phi is no orientation, though: bodies that have the same phi may stand differently. So each end counts the unit
quaternion q by the increments of phi (`teleop.physics.rotation`), and a law's positions (`teleop.kind`) go by that:

    x in a message that is sent      the rotation vector of exp(x - phi) q, at most 2 pi long; for x = phi that of q
    x in one that is received        phi + log(q_x q^-1), at most 2 pi long
    x in the law's state             at the next tick phi + log(q_x q^-1), q_x = exp(x - phi) q as it was set

So to a law each place is its own phi and how far that place lies from it: K (x - rx.x) is K log(q q_rx^-1), and goes
on through pi. Without a new message q_rx stays. Velocities, forces and waves are told as they are: twist and wrench, in
the world's directions, which both ends have to share.

Energy. With theta = log(q_m q_s^-1), V = K |theta|^2/2, and the exponential's left and right Jacobians J_l and J_r,

    theta' = J_l(theta)^-1 w_m - J_r(theta)^-1 w_s,   J_l(theta) theta = theta,   J_r = J_l^T,   so
    V' = K theta . (w_m - w_s):

the torques K theta on one end and -K theta on the other, in the world's directions, are those of a potential, as with
translations; so a law of positions is passive on rotation axes under the conditions that it has elsewhere. That needs
one K for the three axes: the scene refuses laws that differ between the axes of a rotation. Sampled, with d_m and d_s
the turns of a tick and p = theta + d_m - d_s what a translation would come to,

    theta' = log(exp(d_m) exp(theta) exp(-d_s)),   |theta'|^2 = |p|^2 + theta . (d_m x d_s) + terms of fourth order.

The difference is 0 where both ends turn alike, d_m = d_s, and of either sign else. Beside the K |d_m - d_s|^2/2 of a
force that is held, which translations have too, it is as |theta| |d_s| to |d_m - d_s|, and what a damper takes in the
tick, B |d_m - d_s|^2/dt, is above it by the factor (B/(K dt)) |d_m - d_s|/(|theta| |d_s|).

Waves are tied by twist and wrench alone. A commanded point is counted as an orientation too, so a coupling comes to
rest where the tool stands as commanded; but the command has the hand's velocities and what reflections added to them,
and ways that differ while the axis moves end at another orientation. That stays, as after lost waves.

Beyond half a turn. q and -q are one orientation; as an end turns, though, q goes on without a jump, and its sign tells
an odd turn from an even one. So what is sent is the vector whose exponential is q and not -q, and log above is that of
the product with its sign: a relative rotation goes on through pi up to a whole turn, and, as nothing of the past is in
it, both ends have the same one whatever was lost on the way. (Each end could count by itself what it has heard. But
after a silence in which the ends turned apart by more than pi the one that turned would count on, the one that did not
would take the short way, and torques that do not add up to zero would spin both for ever.) An end begins with w >= 0;
ends that begin apart, each more than a quarter of a turn from 0, may so take the long way to each other.

Beyond a whole turn. There the axis is lost and log jumps from 2 pi u to -2 pi u. V is the same on both sides, so the
jump makes no energy; but the torque of a coupling that is turned so far changes its sign there. Where no
message comes an end goes on by its own turn, until the next. What an end turns by itself has no bound.

What differs from translations: x_err, and an environment or a hand's reference on a rotation axis, go by phi. A spring
between phi and a place is that about a fixed axis; about others it is as passive, and no spring to an orientation.

Recorded is q, as `qw_m, qx_m, qy_m, qz_m` for the first rotation of the master, `qw2_m` ... for the second; counted
from where the law's positions count from.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

from teleop.kind import positions
from teleop.physics.rotation import first_or_turned, heard_at, left_at, sent_at
from teleop.stages.end import Axis, Column, End, Record, Run, Stage


class Rotations(NamedTuple):
    """The rotations of an end: the first axis of each, the fields of its messages and its state, and the positions."""

    first: tuple[int, ...]
    tx_fields: tuple[str, ...]
    state_fields: tuple[str, ...]
    rx_positions: tuple[str, ...]
    tx_positions: tuple[str, ...]
    state_positions: tuple[str, ...]


class Followed(Record):
    """A position of an end's messages on the axes of a rotation, as a rotation vector (rad)."""

    x: float  # as it was told last
    y: float
    z: float

    def __init__(self, suffix: str, field: str) -> None:
        super().__init__(suffix)
        self.field = field


class Rotation(Record):
    """A rotation of an end: the three axes that turn it, and its orientation; see `teleop.stages.orientation`."""

    passing: ClassVar[tuple[str, ...]] = (
        "before_x", "before_y", "before_z", "dx", "dy", "dz", "px", "py", "pz")
    w: float  # its unit quaternion
    x: float
    y: float
    z: float
    phi_x: float  # the coordinates of its axes, as the law is told them, rad
    phi_y: float
    phi_z: float
    before_x: float  # at the tick before
    before_y: float
    before_z: float
    dx: float  # by how much it turned since
    dy: float
    dz: float
    px: float  # a position that is looked at
    py: float
    pz: float

    def __init__(self, suffix: str, axes: tuple[Axis, ...], fields: Rotations) -> None:
        super().__init__(suffix)
        self.a, self.b, self.c = axes
        self.heard = tuple([Followed(f"{suffix}_rx_{field}", field) for field in fields.rx_positions])
        self.sent = tuple([Followed(f"{suffix}_tx_{field}", field) for field in fields.tx_positions])


class OrientationStage(Stage):
    """Positions in messages and states, on the axes of rotations."""

    name: ClassVar[str] = "orientation"
    reading: ClassVar[bool] = True
    Sent: Callable[..., tuple[Any, ...]]
    State: Callable[..., tuple[Any, ...]]

    @staticmethod
    def structure(end: Any) -> Any:
        """The first axis of each rotation, the fields of messages and state, and which of them are positions."""
        state = end.state
        return Rotations(end.scene.rotations, end.tx._fields, getattr(state, "_fields", ()), positions(end.rx),
                         positions(end.tx), positions(state) if hasattr(state, "_fields") else ())

    def __init__(self, e: End, structure: Any) -> None:
        super().__init__(e, structure)
        self.fields: Rotations = structure
        self.rotations = tuple([Rotation(f"{e.name}_turn{i}", e.axes[i:i + 3], structure) for i in structure.first])

    def columns(self, e: End) -> tuple[Column, ...]:
        numbers = ["", *[str(n) for n in range(2, len(self.rotations) + 1)]]
        return tuple([Column(f"q{part}{n}_{e.name}", ((t, part),)) for n, t in zip(numbers, self.rotations, strict=True)
                      for part in ("w", "x", "y", "z")])

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        for t in self.rotations:
            t.w = t.x = t.y = t.z = 0.0
            t.phi_x = t.phi_y = t.phi_z = 0.0  # so the first turn is to where the end begins
            for one in t.heard:
                one.x = one.y = one.z = 0.0
            for one in t.sent:
                one.x = one.y = one.z = 0.0

    def situate(self, run: Run, e: End) -> None:
        for t in self.rotations:
            t.before_x, t.before_y, t.before_z = t.phi_x, t.phi_y, t.phi_z
            t.phi_x, t.phi_y, t.phi_z = t.a.at.x, t.b.at.x, t.c.at.x
            t.dx, t.dy, t.dz = t.phi_x - t.before_x, t.phi_y - t.before_y, t.phi_z - t.before_z
            t.w, t.x, t.y, t.z = first_or_turned(t.w, t.x, t.y, t.z, t.dx, t.dy, t.dz)

    def receive(self, run: Run, e: End) -> None:
        for t in self.rotations:
            for one in t.heard:
                hear(e, t, one)
            for field in self.fields.state_positions:
                stay(self, t, field)

    def act(self, run: Run, e: End, k: int) -> None:
        for t in self.rotations:
            for one in t.sent:
                tell(self, t, one)


def hear(e: End, t: Rotation, one: Any) -> None:
    """A position of the received message, as the law is told it."""
    t.px, t.py, t.pz = getattr(t.a.rx, one.field), getattr(t.b.rx, one.field), getattr(t.c.rx, one.field)
    if e.got:
        one.x, one.y, one.z = heard_at(t.w, t.x, t.y, t.z, t.px, t.py, t.pz, one.x, one.y, one.z)
    else:
        one.x, one.y, one.z = left_at(t.px - t.before_x, t.py - t.before_y, t.pz - t.before_z, t.dx, t.dy, t.dz)
    t.a.rx = with_position(t.a, "rx", e.Message, e.rx_fields, one.field, t.phi_x + one.x)
    t.b.rx = with_position(t.b, "rx", e.Message, e.rx_fields, one.field, t.phi_y + one.y)
    t.c.rx = with_position(t.c, "rx", e.Message, e.rx_fields, one.field, t.phi_z + one.z)


def stay(stage: OrientationStage, t: Rotation, field: str) -> None:
    """A position of the law's state, which stays where it is while the end turns."""
    t.px, t.py, t.pz = left_at(getattr(t.a.s, field) - t.before_x, getattr(t.b.s, field) - t.before_y,
                               getattr(t.c.s, field) - t.before_z, t.dx, t.dy, t.dz)
    t.a.s = with_position(t.a, "s", stage.State, stage.fields.state_fields, field, t.phi_x + t.px)
    t.b.s = with_position(t.b, "s", stage.State, stage.fields.state_fields, field, t.phi_y + t.py)
    t.c.s = with_position(t.c, "s", stage.State, stage.fields.state_fields, field, t.phi_z + t.pz)


def tell(stage: OrientationStage, t: Rotation, one: Any) -> None:
    """A position of the message that is sent: a rotation vector."""
    one.x, one.y, one.z = sent_at(
        t.w, t.x, t.y, t.z, getattr(t.a.tx, one.field) - t.phi_x, getattr(t.b.tx, one.field) - t.phi_y,
        getattr(t.c.tx, one.field) - t.phi_z, one.x, one.y, one.z)
    t.a.tx = with_position(t.a, "tx", stage.Sent, stage.fields.tx_fields, one.field, one.x)
    t.b.tx = with_position(t.b, "tx", stage.Sent, stage.fields.tx_fields, one.field, one.y)
    t.c.tx = with_position(t.c, "tx", stage.Sent, stage.fields.tx_fields, one.field, one.z)


def with_position(a: Axis, which: str, kind: Any, fields: tuple[str, ...], field: str, value: Any) -> Any:
    """A message or state of an axis, `rx`, `tx` or `s`, with another value of one field."""
    return kind(*[value if each == field else getattr(getattr(a, which), each) for each in fields])
