"""The operator's clutch, presence switch and scale: a lossless transformer between the master and its law.

While the operator holds the clutch open, or is not there, the device is moved without the slave (to a place in reach,
or to a rest) and its force is released. Between the device, whose motion over tick k is dx(k) under the force F(k-1)
that was held over it, and its law, stands a transformer of modulus g in [0, 1], which ramps to 0 on opening and to 1 on
closing:

    dx_law(k) = g(k-1) dx(k)     x_law(k) = x_law(k-1) + dx_law(k)     v_law(k) = g(k-1) v(k)     F(k) = g(k) f_law(k).

**Lossless, tick by tick.** What the device reads at tick k is the left limit: it moved by dx(k) under the modulus and
the force of the tick before. So the motion that the law is told of has the modulus that its force was held with, and

    F(k-1) dx(k) = g(k-1) f_law(k-1) dx(k) = f_law(k-1) dx_law(k),

the work at the device's port is that at the law's port in each tick, whatever g does from one tick to the next: a
switch that bounces makes no energy. What comes after this stage (watchdog, caps, budget, a device that let go by
itself) makes another force of F = g f_law. The law is told as f_held what its port then really had,

    f_held(k) = F(k-1)/g(k-1),    so that    f_held(k) dx_law(k) = F(k-1) dx(k)

holds with any force that was held. Where g has come to 0 and a force is left, which a slew limit or a computation delay
may do for some ticks, its motion is told with the least modulus that the ramp has, until the force is 0. The
ledger `E_port_m` is of the device's port, and so of the law's. With g = 0 the law is told v = 0, dx = 0, f_held = 0:
the slave holds, by its port law, and what the law stores stays where it is. With g = 1 all numbers are what they are
without this stage, to the bit.

**Nothing jumps.** In a tick g changes by dt/ramp, down by the ticks that passed where some were left out. x_law is
continuous, for it sums up g dx: on closing positions count anew from where the device is. The force fades in, from 0.

**Ends that are far apart.** While the clutch is open a slave may have been moved, or held back. What a law that
compares positions would then do on closing is a pull that grows with the ramp, no jump, but towards a place that nobody
looked at. With `closes_within` (m, or rad; one number, or one for each axis) the clutch stays open while the ends of
such a law, x_law and the position that its newest message tells, are farther apart on any axis: it closes by itself
once they are not, as the slave is drawn to the master while it is free, and an event says what to do. A session that
begins anew counts both ends from where they are. Recorded is `apart_m`, by axis.

A hand's force that a law reads, f, is no variable of the port but a signal (four-channel laws feed it forward to the
slave): the law is told g f, so that a hand on an open clutch pushes no slave.

**A scale that is changed while it runs.** The modulus is g s, with s the scale of the motion: a metre of the handle is
s metres of the law, and a newton of the law s newtons in the hand, as of a lever whose pivot is moved. The proof above
asks of the modulus only that motion and force of a tick have the same one. So s may change at every tick, by an order
or a schedule, and makes and takes no energy. x_law is continuous, since it sums up increments. s goes to where it is
set by a factor of 2 in `scale_ramp` seconds, and is above 0: to hold the slave is what the clutch is for. f, a signal,
is told as g f/s, in the law's newtons. The axes of a rotation have no size, and keep s = 1. The law meets the handle as
a mass M/s^2 with damping B/s^2, so a condition on either is to hold at the greatest s.

Tried in three axes with an outage, a clutch that bounces and s set anew at each tick or at random, from 1/10 to 10: the
works of device and law differ by 1e-16 J a tick at most, and E_port of `wave` comes to -0.157 J, where s = 10 all the
time has -0.158 J, which is what the hold of its damper makes (`tests/teleop/stages/test_running_scale.py`).

The force alone is not scaled while it runs: with a factor q of the force beside s the work at the device is q(k-1)
times the law's, which no ledger of the law's bounds. Who pushes a spring of 1 J in at q = 0.5 and lets it out at q = 2
has made 1.5 J, again and again. `Scaling` has a fixed one.

**A clutch of some axes.** Where a scene has axes in m and axes in rad, each kind has a modulus of its own, and a clutch
is of all axes, of the translation alone or of the rotation alone. Each axis counts anew by its own offset.

Before it closes the law's position may be brought to the device's: see `teleop.stages.alignment`.

The switches are told by a schedule in virtual time and in a live run by the device too (`Reading.clutch`,
`Reading.present`): a device without one counts as closed, with its operator there. Recorded are `clutch_m` (1 while it
is held open, 2 that of the translation alone, 3 that of the rotation), `present_m`, the clutch's modulus `g_clutch_m`,
that of the rotation by itself `g_turn_m`, the scale `scale_m`, and `offset_m`, by how much the device has moved beyond
what the law was told; the tracking error compares the slave with x_m - offset_m.

Indexing (the clutch of a master of small reach) is as old as teleoperation; for the transformer as the lossless element
that scales a port see J. E. Colgate, "Robust impedance shaping telemanipulation", IEEE Trans. Robotics and Automation
9(4), 1993.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import inf
from typing import Any, ClassVar, NamedTuple

from teleop.errors import Refused, by_axis, number, number_of, numbers
from teleop.kind import positions
from teleop.law import At, messages
from teleop.physics.rotation import apart_after, log
from teleop.stages.alignment import BEHIND, LEAD, NEAR, Unlike, bring, look_ahead
from teleop.stages.end import SWITCHES, Axis, Column, End, Places, Record, Run, Stage, per_axis
from teleop.stages.scaling import check_scale, scale_at, scale_step
from teleop.stages.slave_units import places_of_slave

MOST_SPANS = 64
PADDED = 4  # spans are kept in fours, so that scenes with a few of them share their lines

TRANSLATION, ROTATION = 2.0, 3.0  # of a clutch: the axes that it opens; 1: all

Spans = tuple[tuple[float, float], ...]


class SwitchLimits(NamedTuple):
    """Coefficients of the stage."""

    steps: float  # ticks from 0 to 1
    within: tuple[float, ...]  # m or rad, of each axis: how far apart the ends may be when it closes; inf: any way
    clutch: Spans  # ticks [from, to) in which it is held open
    absent: Spans  # ticks [from, to) in which nobody is there
    parts: tuple[Spans, Spans] = ((), ())  # ticks in which the clutch of the translation, of the rotation is open
    scales: Spans = ()  # (tick, scale) from which on the scale is this
    factor: float = 1.0  # by which the scale changes within a tick
    speed: tuple[float, ...] = ()  # m or rad a tick, of each axis, of an alignment
    most: tuple[float, ...] = ()  # m or rad, of each axis: the longest way of one
    near: float = 0.0  # ticks at that speed within which it is over,
    behind: float = 0.0  # ... by which the slave may be behind then,
    lead: float = 0.0  # ... and by which it goes ahead of the slave
    start: tuple[float, ...] = ()  # where the law's positions begin, of each axis; none: where the device is


@dataclass(frozen=True, kw_only=True, slots=True)
class Operator:
    """The operator's clutch and the operator-present switch, at the master.

    `clutch`: spans (from, to) in s in which the operator holds the clutch open; `absent`: spans in which nobody is
    there. In a live run the switches of the device count beside them. The force goes to zero over `ramp` seconds, and
    comes back over as long. `clutch_translation`, `clutch_rotation`: the same of the axes in m, or in rad, alone.
    `scales`: (from, scale) in order, what the scale is set to and when, 1 before; it changes by a factor of 2 in
    `scale_ramp` seconds. `align`: the speed (m/s, or rad/s) by which the law's position is brought to the device's
    before the clutch closes, one number or one for each axis, 0 on an axis that counts anew; None: none is.
    `align_most`: the longest way (m, or rad) of that; None: any. `needs`: the switches, "clutch" or "present", without
    which a live device is refused. `closes_within`: the way (m, or rad) by which the ends of a law that compares
    positions may be apart when the clutch closes, one number or one for each axis; None: any.
    """

    clutch: Spans = ()
    absent: Spans = ()
    ramp: float = 0.05
    needs: tuple[str, ...] = ()
    closes_within: float | tuple[float, ...] | None = None
    clutch_translation: Spans = ()
    clutch_rotation: Spans = ()
    scales: Spans = ()
    scale_ramp: float = 0.5
    align: float | tuple[float, ...] | None = None
    align_most: float | tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("clutch", "absent", "clutch_translation", "clutch_rotation"):
            object.__setattr__(self, name, spans_of(name, getattr(self, name)))
        object.__setattr__(self, "scales", _scales(self.scales))
        object.__setattr__(self, "scale_ramp", number("scale_ramp", self.scale_ramp, above=0.0, high=10.0, unit="s"))
        object.__setattr__(self, "ramp", number("ramp", self.ramp, low=0.0, high=10.0, unit="s"))
        if not isinstance(self.needs, tuple) or not set(self.needs) <= {*SWITCHES}:
            raise Refused(f"needs are switches of a device, \"clutch\" or \"present\", not {self.needs!r}; write for "
                          "example needs=(\"present\",)")

        for name, low in (("closes_within", None), ("align", 0.0), ("align_most", None)):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, numbers(name, value, low=low, above=0.0 if low is None else None))

    def within(self, axes: int) -> tuple[float, ...]:
        """`closes_within` of each of so many axes, m or rad; inf where it is left out. Raises `Refused`."""
        return self.by_axis("closes_within", axes, inf)

    def by_axis(self, name: str, axes: int, without: float) -> tuple[float, ...]:
        """A number of each of so many axes; `without`: where it is left out. Raises `Refused`."""
        value = getattr(self, name)
        return by_axis(name, without if value is None else value, axes)

    def check(self, scene: Any) -> None:
        """Refuse what the axes of a scene or its law have not. Raises `Refused`."""
        for name in ("closes_within", "align", "align_most"):
            self.by_axis(name, scene.axes, 0.0)
        for name, unit, what in (("clutch_translation", "m", "moves along a line"),
                                 ("clutch_rotation", "rad", "turns")):
            if getattr(self, name) and set(scene.axis_units) != {"m", "rad"}:
                raise Refused(f"{name} opens the clutch of the axes in {unit} alone, and of the axes of this scene "
                              f"{'each' if unit in scene.axis_units else 'none'} {what}; write it as clutch, or leave "
                              "it out")
        speeds = self.by_axis("align", scene.axes, 0.0)
        for first in scene.rotations:
            if len(set(speeds[first:first + 3])) > 1:
                raise Refused("the axes of a rotation are aligned together, by one turn, and align names "
                              f"{', '.join(f'{each:g}' for each in speeds[first:first + 3])} rad/s for them; write one "
                              "speed for the three")

    def limits(self, dt: float, axes: int = 1) -> SwitchLimits:
        """Coefficients of the stage, at a tick of `dt` s."""
        return SwitchLimits(
            float(max(1, round(self.ramp / dt))), self.within(axes), in_ticks(self.clutch, dt),
            in_ticks(self.absent, dt),
            (in_ticks(self.clutch_translation, dt), in_ticks(self.clutch_rotation, dt)),
            _padded([(float(round(at / dt)), scale) for at, scale in self.scales]), 2.0 ** (dt / self.scale_ramp),
            tuple([speed * dt for speed in self.by_axis("align", axes, 0.0)]), self.by_axis("align_most", axes, inf),
            NEAR / dt, BEHIND / dt, LEAD / dt)


def _pairs(name: str, value: Any, what: str, example: str) -> None:
    """Refuse what is no schedule of pairs."""
    if not isinstance(value, tuple) or not all(isinstance(each, tuple) and len(each) == 2 for each in value):
        raise Refused(f"{name} must be {what}, not {value!r}; write for example {example}")
    if len(value) > MOST_SPANS:
        raise Refused(f"{name} has {number_of(len(value), 'span')}, and a schedule has {MOST_SPANS} at most; leave "
                      "some out")


def spans_of(name: str, value: Any) -> Spans:
    """The value, if it is spans of time (s). Raises `Refused`."""
    example, spans_found = f"{name}=((2.0, 3.0),)", []
    _pairs(name, value, "spans of time, (from, to) in s", example)
    for span in value:
        start = number(f"{name}: the beginning of a span", span[0], low=0.0, unit="s", example=example)
        end = number(f"{name}: the end of a span", span[1], low=0.0, unit="s", example=example)
        if end <= start:
            raise Refused(f"{name}: the span from {start:g} s ends at {end:g} s, which is not later; give each span "
                          "its beginning first")
        spans_found.append((start, end))
    return tuple(spans_found)


def _scales(value: Any) -> Spans:
    example = "scales=((2.0, 0.5),)"
    _pairs("scales", value, "times and scales, (from, scale)", example)
    times = tuple([(number("scales: a time", at, low=0.0, unit="s", example=example), check_scale(scale))
                   for at, scale in value])
    if any(b[0] <= a[0] for a, b in pairwise(times)):
        raise Refused(f"the times of scales are in order, each later than the last; write for example {example}")
    return times


def in_ticks(spans: Spans, dt: float) -> Spans:
    """The spans in ticks, filled up to a multiple of `PADDED` with such as no tick is in."""
    return _padded([(float(round(start / dt)), float(round(end / dt))) for start, end in spans])


def _padded(spans: list[tuple[float, float]]) -> Spans:
    return (*spans, *[(-1.0, -1.0)] * (-len(spans) % PADDED or PADDED * (not spans)))


def scheduled(spans: Spans, k: float) -> float:
    """1.0 while tick k lies in one of these spans, else 0.0."""
    for start, end in spans:
        if start <= k < end:
            return 1.0
    return 0.0


def opens(clutch: float, group: float) -> float:
    """1.0 if the device's clutch is open for these axes, else 0.0."""
    return 1.0 if clutch == 1.0 or clutch == group else 0.0  # noqa: PLR1714 - of which lanes know no `in`


def clutch_of(translation: float, rotation: float) -> float:
    """The state of a clutch of which these axes are open."""
    if translation > 0.0:
        return 1.0 if rotation > 0.0 else TRANSLATION
    return ROTATION if rotation > 0.0 else 0.0


def ramped(steps: float, n: float, released: float, passed: float) -> float:
    """Number of the ramp's `steps` at which the modulus is, `passed` ticks after it was at `n`; 0: it is open.

    A step of the way up is made at each tick that is run. An end begins (n < 0) where its switches are.
    """
    if n < 0.0:
        return 0.0 if released > 0.0 else steps
    if released > 0.0:
        return n - passed if n > passed else 0.0
    return n + 1.0 if n < steps else steps


def kept_open(n: float, released: float, far: float) -> float:
    """1.0 while it is released, or was and the ends are too far apart to close it, else 0.0."""
    return 1.0 if released > 0.0 or (n == 0.0 and not far <= 1.0) else 0.0


def at_first(n: float, g: float, g_was: float) -> float:
    """The modulus of the motion before a tick: before the first one (n < 0) that of the tick."""
    return g if n < 0.0 else g_was


def modulus(g: float, f: float, least: float) -> float:
    """The modulus with which the motion of a tick is told over which the force f was held: see the head of the file."""
    if g > 0.0:
        return g
    return least if f != 0.0 else 0.0  # also of NaN: it must be seen


def carried(r: float, x: float, dx: float, offset: float, x_law: float) -> tuple[float, float]:
    """Position for the law, and the device's offset from it (m), after a motion dx to x."""
    if r != 1.0:
        x_law = x_law + r * dx
        return x_law, x - x_law
    return x - offset, offset


def of_port(r: float, f: float) -> float:
    """The force that the law's port had while f was held."""
    return f / r if r > 0.0 else f


class OperatorShape(NamedTuple):
    """Structure of the stage, which decides its lines."""

    position: str  # the field of what the master receives that is one, where it is looked at, else ""
    closes: bool  # the clutch closes by it
    groups: tuple[tuple[float, tuple[int, ...]], ...]  # the axes in m, and those in rad: their clutch, and which
    unsized: frozenset[int]  # the axes that keep a scale of 1
    aligned: frozenset[int]  # those that are aligned,
    turns: tuple[int, ...]  # ... and the first of each rotation among them


class Held(Record):
    """The transformer of one axis."""

    g_told: float  # the clutch's modulus of the motion of the last tick
    r_told: float  # the same with the scale
    x_law: float  # the position that the law was told, m
    offset: float  # how far it has moved beyond what its law was told, m
    apart: float  # how far that is from where the other end was, m
    moved: float  # by how much the device moved, m
    way: float  # the way that an alignment has to go, m
    step: float  # what of it comes next
    jump: float  # by which it is put beside the slave at first
    f_answer: float  # what the law answered, N


class Group(Record):
    """The axes that a clutch opens together: those in m, or those in rad."""

    open: float  # 1.0 while the operator holds their clutch open
    released: float  # 1.0 while it is open or nobody is there
    far: float  # how far the ends, or law and device, are apart, for how far they may be; the greatest of the axes
    n: float  # of the ramp's steps; below 0 before the first tick
    n_was: float  # the same before this tick
    g: float  # the modulus between the master and its law
    g_was: float  # the same at the last tick
    drives: float  # 1.0 while the law's position is brought to the device's
    reach: float  # the longest way for how long it may be

    def __init__(self, suffix: str, i: int, code: float, axes: tuple[int, ...]) -> None:
        super().__init__(suffix)
        self.i, self.code, self.members = i, code, axes
        self.aligns = False


class OperatorStage(Stage):
    """The transformer between the master and its law; the clutch's modulus is the same for all axes of a group."""

    name: ClassVar[str] = "operator"
    axis_kind: ClassVar[type[Record]] = Held
    wants_dx: ClassVar[bool] = True
    clutch: Any  # 0.0 while it is closed, 1.0 while the operator holds it open; see `clutch_of`
    present: Any  # 1.0 while the operator is there, else 0.0
    scale: float  # between the motion of the master and that of its law
    scale_was: float  # the same at the last tick
    scale_set: Any  # what it is set to, by an order
    E_align: float  # J, put in by alignments,
    put_in: float  # ... in this tick
    unmet: float  # 1.0 until a message has told where the slave is
    c_switch: Any
    least_g: float  # modulus above 0
    ticks_by: Any  # ticks since the last

    @staticmethod
    def structure(end: Any) -> OperatorShape:
        """The groups of axes, and what of the slave is looked at."""
        scene, operator = end.scene, end.scene.operator
        units = scene.axis_units
        groups = [(code, tuple([i for i, each in enumerate(units) if each == unit]))
                  for code, unit in ((TRANSLATION, "m"), (ROTATION, "rad"))]
        aligned = frozenset([i for i, speed in enumerate(operator.by_axis("align", scene.axes, 0.0)) if speed > 0.0])
        closes = operator.closes_within is not None
        heard = positions(end.rx) if closes or aligned else ()
        return OperatorShape(heard[0] if heard else "", closes, tuple([each for each in groups if each[1]]),
                             scene.turning, aligned, tuple([first for first in scene.rotations if first in aligned]))

    def __init__(self, e: End, structure: Any) -> None:
        super().__init__(e, structure)
        self.shape: OperatorShape = structure
        self.groups = tuple([Group(f"{e.name}_{'line' if code == TRANSLATION else 'turn'}", i, code, axes)
                             for i, (code, axes) in enumerate(structure.groups)])
        self.several, self.rx_position = len(self.groups) > 1, structure.position
        self.starts = bool(structure.position and structure.aligned)
        for group in self.groups:
            group.aligns = not structure.aligned.isdisjoint(group.members)
        turning = {first + n for first in structure.turns for n in range(3)}
        for i, port in enumerate(self.axes):
            port.group = next(group for group in self.groups if i in group.members)
            port.sized, port.aligned, port.turns = i not in structure.unsized, i in structure.aligned, i in turning
        self.turns = tuple([Unlike(f"{e.name}_unlike{i}", e.axes[i:i + 3], self.axes[i:i + 3])
                            for i in structure.turns])

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        limits = scene.operator.limits(dt, scene.axes)
        if not any(limits.speed) or not positions(messages(scene.laws[0])[1]):
            return limits
        slave = places_of_slave(scene, scene.vector("start_s", scene.start_s))
        return limits._replace(start=tuple([
            far if speed > 0.0 else near for near, far, speed in zip(places, slave, limits.speed, strict=True)]))

    def columns(self, e: End) -> tuple[Column, ...]:
        groups = [Column(f"{name}_{e.name}", ((group, "g"),))
                  for name, group in zip(("g_clutch", "g_turn"), self.groups, strict=False)]
        return (Column(f"clutch_{e.name}", ((self, "clutch"),)), Column(f"present_{e.name}", ((self, "present"),)),
                *groups, Column(f"scale_{e.name}", ((self, "scale"),)),
                per_axis(f"offset_{e.name}", self.axes, "offset"),
                *[per_axis(f"apart_{e.name}", self.axes, "apart")] * bool(self.rx_position),
                *(per_axis(f"way_{e.name}", self.axes, "way"), Column(f"E_align_{e.name}", ((self, "E_align"),)))
                * bool(self.shape.aligned))

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.c_switch = numbers
        self.least_g = 1.0 / self.c_switch.steps
        self.scale, self.scale_was, self.scale_set = 0.0, 1.0, 1.0
        self.clutch = 0.0
        self.present = 1.0
        for group in self.groups:
            group.n, group.g, group.g_was, group.far, group.drives = -1.0, 1.0, 1.0, 0.0, 0.0
            if group.aligns:
                group.n, group.g, group.g_was, group.far, group.reach = 0.0, 0.0, 0.0, inf, inf
        for a, port in zip(e.axes, self.axes, strict=True):
            port.x_law = self.c_switch.start[a.i] if self.starts else a.x_read
            port.offset = a.x_read - port.x_law
            port.apart = port.moved = port.way = port.step = port.f_answer = 0.0
        if self.shape.aligned:
            self.E_align, self.unmet, self.ticks_by = 0.0, 1.0, 1
        for t in self.turns:
            t.w, t.x, t.y, t.z = apart_after(1.0, 0.0, 0.0, 0.0, t.a.x_read, t.b.x_read, t.c.x_read,
                                             t.p.x_law, t.q.x_law, t.r.x_law)

    def late(self, run: Run, e: End, ticks: int, since: int) -> None:
        self.ticks_by = ticks

    def read(self, run: Run, e: End, k: int) -> None:
        absent = scheduled(self.c_switch.absent, k)
        self.present = min(self.present, 1.0 - absent) if e.has.live else 1.0 - absent
        for group in self.groups:
            switch(self, e, group, k)
        self.clutch = clutch_of(self.groups[0].open, self.groups[1].open) if self.several else self.groups[0].open
        self.scale_was = self.scale
        self.scale = scale_step(self.c_switch.factor, self.scale, self.scale_set * scale_at(self.c_switch.scales, k))
        if self.scale_was <= 0.0:
            self.scale_was = self.scale

    def situate(self, run: Run, e: End) -> None:
        if self.shape.aligned:
            self.put_in = 0.0
        for a, port in zip(e.axes, self.axes, strict=True):
            transform(self, a, port)
            if port.aligned:
                bring(self, run, e, a, port)
        if self.shape.aligned:
            self.E_align = self.E_align + self.put_in
        for t in self.turns:
            t.w, t.x, t.y, t.z = apart_after(t.w, t.x, t.y, t.z, t.p.moved, t.q.moved, t.r.moved,
                                             t.a.at.dx, t.b.at.dx, t.c.at.dx)
            t.p.way, t.q.way, t.r.way = log(t.w, t.x, t.y, t.z)

    def act(self, run: Run, e: End, k: int) -> None:
        for a, port in zip(e.axes, self.axes, strict=True):
            if port.aligned:
                port.f_answer = a.f_cmd
            a.f_cmd = port.group.g * self.scale * a.f_cmd if port.sized else port.group.g * a.f_cmd
        if self.rx_position or self.shape.aligned:
            look_ahead(self, e)


def switch(stage: OperatorStage, e: End, group: Group, k: int) -> None:
    """Open or close the clutch of a group, and make a step of its ramp."""
    group.open = scheduled(stage.c_switch.clutch, k)
    if stage.several:
        group.open = max(group.open, scheduled(stage.c_switch.parts[group.i], k))
    if e.has.live:
        group.open = max(group.open, opens(stage.clutch, group.code))
    group.released = max(group.open, 1.0 - stage.present)
    if group.aligns:
        group.drives = 1.0 - group.released if group.n == 0.0 and group.far > 1.0 and group.reach <= 1.0 else 0.0
        for i in group.members:
            group.drives = group.drives if e.axes[i].f == 0.0 else 0.0
    if stage.shape.closes or group.aligns:
        group.released = kept_open(group.n, group.released, group.far)
    group.g_was = group.g
    group.n_was = group.n
    group.n = ramped(stage.c_switch.steps, group.n_was, group.released, stage.ticks_by if e.has.leaves_out else 1.0)
    group.g = group.n / stage.c_switch.steps
    group.g_was = at_first(group.n_was, group.g, group.g_was)


def transform(stage: OperatorStage, a: Axis, port: Any) -> None:
    """Put the transformer between the readings of one axis and its law."""
    port.g_told = modulus(port.group.g_was, a.at.f_held, stage.least_g)
    port.r_told = port.g_told * stage.scale_was if port.sized else port.g_told
    if port.turns:
        port.moved = a.at.dx
    port.x_law, port.offset = carried(port.r_told, a.at.x, a.at.dx, port.offset, port.x_law)
    a.at = At(port.x_law, port.r_told * a.at.v,
              port.g_told * a.at.f / stage.scale_was if port.sized else port.g_told * a.at.f,
              of_port(port.r_told, a.at.f_held), port.r_told * a.at.dx, a.at.fresh, a.at.age, a.at.dt, a.at.span,
              a.at.gain)
