"""Alignment: before the operator's clutch closes, the law's position is brought to that of the handle.

On closing, or when a session begins with an arm that stands elsewhere, the law's position may be brought to the
handle's first: with `align`, a speed for each axis (0: that axis counts anew), the clutch stays open and x_law goes to
x at that speed, while the operator is there and holds the clutch closed, and no longer. The force in the hand is 0
meanwhile, and the slave follows x_law by its law, within its caps. In a law that compares positions x_law waits where
it is half a second's way ahead of the slave. On the axes of a rotation the way is the rotation vector from the law's
orientation to the handle's, counted as

    q = exp(d_m) q exp(-d_law),    theta = log q,

which is the least turn whatever way both have come. It ends, and the clutch closes, where x_law is within 20 ms of that
speed, and the slave of such a law within 100 ms, or `closes_within`. A source moves the law's port then, so the law is
told of it as such, v and dx of x_law and f_held = f_law, and the energy that it puts in, the sum of f_law dx_law, is
recorded as `E_align_m`. E_port_m is of the law's port, and has it.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any

from teleop.law import At
from teleop.physics.rotation import apart_after, log
from teleop.stages.end import Axis, End, Record, Run

# s of an alignment's speed: when it is over, how far behind the slave may be then, and how far it goes ahead of it
NEAR, BEHIND, LEAD = 0.02, 0.1, 0.5


def step_to(way: float, speed: float, apart: float, lead: float) -> float:
    """The step of an alignment along one axis; none that leads farther ahead of a slave that is behind."""
    step = max(min(way, speed), -speed)
    return 0.0 if step * apart > 0.0 and abs(apart) > lead else step


def share_of(way: float, speed: float) -> float:
    """The share of a way that a step of this speed is, 1 at most."""
    return speed / way if way > speed else 1.0


class Unlike(Record):
    """The rotation from the law's orientation to the device's: a unit quaternion, over three axes."""

    w: float
    x: float
    y: float
    z: float
    size: float  # its angle, rad
    share: float

    def __init__(self, suffix: str, axes: tuple[Axis, ...], ports: tuple[Any, ...]) -> None:
        super().__init__(suffix)
        self.a, self.b, self.c = axes
        self.p, self.q, self.r = ports  # of class Held


def bring(stage: Any, run: Run, e: End, a: Axis, port: Any) -> None:
    """Bring the law's position of one axis a step nearer to the device's, while the operator has it so.

    The clutch is open then, and so what the law is told of the device's motion and force is 0.
    """
    step = port.group.drives * port.step
    port.x_law = port.x_law + step
    port.offset = port.offset - step
    stage.put_in = stage.put_in + port.f_answer * step
    a.at = At(port.x_law, a.at.v + step / (run.dt * stage.ticks_by if e.has.leaves_out else run.dt), a.at.f,
              a.at.f_held + port.group.drives * port.f_answer, a.at.dx + step, a.at.fresh, a.at.age, a.at.dt, a.at.span,
              a.at.gain)
    if not port.turns:
        port.way = port.offset


def stand_by(stage: Any, e: End) -> None:
    """Put the law's position to that of the slave, with the first message that tells of it."""
    for port in stage.axes:
        if port.aligned:
            port.jump = (stage.unmet if e.got else 0.0) * port.apart
            port.x_law = port.x_law - port.jump
            port.offset = port.offset + port.jump
            port.apart = port.apart - port.jump
            if not port.turns:
                port.way = port.offset
    for t in stage.turns:
        t.w, t.x, t.y, t.z = apart_after(t.w, t.x, t.y, t.z, 0.0, 0.0, 0.0, -t.p.jump, -t.q.jump, -t.r.jump)
        t.p.way, t.q.way, t.r.way = log(t.w, t.x, t.y, t.z)
    stage.unmet = 0.0 if e.got else stage.unmet


def look_ahead(stage: Any, e: End) -> None:
    """Measure how far all is from where the clutch closes, and take the next step of an alignment."""
    if stage.rx_position:
        for a, port in zip(e.axes, stage.axes, strict=True):
            port.apart = port.x_law - getattr(a.rx, stage.rx_position)
    if stage.starts:
        stand_by(stage, e)
    for group in stage.groups:
        group.far = inf if stage.starts and stage.unmet > 0.0 else 0.0
        if group.aligns:
            group.reach = 0.0
    for a, port in zip(e.axes, stage.axes, strict=True):
        if stage.shape.closes:
            port.group.far = max(abs(port.apart) / stage.c_switch.within[a.i], port.group.far)
        elif port.aligned and stage.rx_position:
            port.group.far = max(
                abs(port.apart) / (stage.c_switch.behind * stage.c_switch.speed[a.i]), port.group.far)
        if port.aligned and not port.turns:
            port.group.far = max(abs(port.way) / (stage.c_switch.near * stage.c_switch.speed[a.i]), port.group.far)
            port.group.reach = max(abs(port.way) / stage.c_switch.most[a.i], port.group.reach)
            port.step = step_to(port.way, stage.c_switch.speed[a.i], port.apart,
                                stage.c_switch.lead * stage.c_switch.speed[a.i])
    for t in stage.turns:
        turn_ahead(stage, t)


def turn_ahead(stage: Any, t: Unlike) -> None:
    """The same of the three axes of a rotation, whose way is a rotation vector."""
    t.size = sqrt(t.p.way * t.p.way + t.q.way * t.q.way + t.r.way * t.r.way)
    t.share = share_of(t.size, stage.c_switch.speed[t.a.i])
    t.p.group.far = max(t.size / (stage.c_switch.near * stage.c_switch.speed[t.a.i]), t.p.group.far)
    t.p.group.reach = max(t.size / stage.c_switch.most[t.a.i], t.p.group.reach)
    for port in (t.p, t.q, t.r):
        port.step = step_to(t.share * port.way, stage.c_switch.speed[t.a.i], port.apart,
                            stage.c_switch.lead * stage.c_switch.speed[t.a.i])
