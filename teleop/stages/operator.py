"""The operator's clutch and the operator-present switch: a lossless transformer between the master and its law.

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

The switches are told by a schedule in virtual time and in a live run by the device too (`Reading.clutch`,
`Reading.present`): a device without one counts as closed, with its operator there. Recorded are `clutch_m` (1 while it
is held open), `present_m`, the modulus `g_clutch_m`, and `offset_m`, by how much the device has moved beyond what the
law was told; the tracking error compares the slave with x_m - offset_m.

Indexing (the clutch of a master of small reach) is as old as teleoperation; for the transformer as the lossless element
that scales a port see J. E. Colgate, "Robust impedance shaping telemanipulation", IEEE Trans. Robotics and Automation
9(4), 1993.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any, ClassVar, NamedTuple

from teleop.errors import Refused, WrongCount, number, number_of
from teleop.kind import positions
from teleop.law import At
from teleop.stages.end import SWITCHES, Axis, Column, End, Places, Record, Run, Stage, per_axis

MOST_SPANS = 64
PADDED = 4  # spans are kept in fours, so that scenes with a few of them share their lines

Spans = tuple[tuple[float, float], ...]


class SwitchLimits(NamedTuple):
    """Coefficients of the stage."""

    steps: float  # ticks from 0 to 1
    within: tuple[float, ...]  # m or rad, of each axis: how far apart the ends may be when it closes; inf: any way
    clutch: Spans  # ticks [from, to) in which it is held open
    absent: Spans  # ticks [from, to) in which nobody is there


@dataclass(frozen=True, kw_only=True, slots=True)
class Operator:
    """The operator's clutch and the operator-present switch, at the master.

    `clutch`: spans (from, to) in s in which the operator holds the clutch open; `absent`: spans in which nobody is
    there. In a live run the switches of the device count beside them. The force goes to zero over `ramp` seconds, and
    comes back over as long. `needs`: the switches, "clutch" or "present", without which a live device is refused.
    `closes_within`: the way (m, or rad) by which the ends of a law that compares positions may be apart when the clutch
    closes, one number or one for each axis; None: any.
    """

    clutch: Spans = ()
    absent: Spans = ()
    ramp: float = 0.05
    needs: tuple[str, ...] = ()
    closes_within: float | tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "clutch", spans_of("clutch", self.clutch))
        object.__setattr__(self, "absent", spans_of("absent", self.absent))
        object.__setattr__(self, "ramp", number("ramp", self.ramp, low=0.0, high=10.0, unit="s"))
        if not isinstance(self.needs, tuple) or not set(self.needs) <= {*SWITCHES}:
            raise Refused(f"needs are switches of a device, \"clutch\" or \"present\", not {self.needs!r}; write for "
                          "example needs=(\"present\",)")

        port = self.closes_within
        if port is not None:
            each = [number("closes_within", one, above=0.0) for one in (port if isinstance(port, tuple) else (port,))]
            object.__setattr__(self, "closes_within", tuple(each) if isinstance(port, tuple) else each[0])

    def within(self, axes: int) -> tuple[float, ...]:
        """`closes_within` of each of so many axes, m or rad; inf where it is left out. Raises `Refused`."""
        port = inf if self.closes_within is None else self.closes_within
        if isinstance(port, tuple) and len(port) != axes:
            raise WrongCount("closes_within", port, axes)
        return port if isinstance(port, tuple) else (port,) * axes

    def limits(self, dt: float, axes: int = 1) -> SwitchLimits:
        """Coefficients of the stage, at a tick of `dt` s."""
        return SwitchLimits(float(max(1, round(self.ramp / dt))), self.within(axes), in_ticks(self.clutch, dt),
                            in_ticks(self.absent, dt))


def spans_of(name: str, value: Any) -> Spans:
    """The value, if it is spans of time (s). Raises `Refused`."""
    example = f"{name}=((2.0, 3.0),)"
    if not isinstance(value, tuple) or not all(isinstance(each, tuple) and len(each) == 2 for each in value):
        raise Refused(f"{name} must be spans of time, (from, to) in s, not {value!r}; write for example {example}")
    if len(value) > MOST_SPANS:
        raise Refused(f"{name} has {number_of(len(value), 'span')}, and a schedule has {MOST_SPANS} at most; leave "
                      "some out")
    spans_found = []
    for span in value:
        start = number(f"{name}: the beginning of a span", span[0], low=0.0, unit="s", example=example)
        end = number(f"{name}: the end of a span", span[1], low=0.0, unit="s", example=example)
        if end <= start:
            raise Refused(f"{name}: the span from {start:g} s ends at {end:g} s, which is not later; give each span "
                          "its beginning first")
        spans_found.append((start, end))
    return tuple(spans_found)


def in_ticks(spans: Spans, dt: float) -> Spans:
    """The spans in ticks, filled up to a multiple of `PADDED` with such as no tick is in."""
    spans_found = [(float(round(start / dt)), float(round(end / dt))) for start, end in spans]
    return (*spans_found, *[(-1.0, -1.0)] * (-len(spans_found) % PADDED or PADDED * (not spans_found)))


def scheduled(spans: Spans, k: float) -> float:
    """1.0 while tick k lies in one of these spans, else 0.0."""
    for start, end in spans:
        if start <= k < end:
            return 1.0
    return 0.0


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
    if r < 1.0:
        x_law = x_law + r * dx
        return x_law, x - x_law
    return x - offset, offset


def of_port(r: float, f: float) -> float:
    """The force that the law's port had while f was held."""
    return f / r if r > 0.0 else f


class Held(Record):
    """The transformer of one axis."""

    g_told: float  # the modulus of the motion of the last tick
    x_law: float  # the position that the law was told, m
    offset: float  # how far it has moved beyond what its law was told, m
    apart: float  # how far that is from where the other end was, m


class OperatorStage(Stage):
    """The transformer between the master and its law; its modulus is the same for all axes."""

    name: ClassVar[str] = "operator"
    axis_kind: ClassVar[type[Record]] = Held
    wants_dx: ClassVar[bool] = True
    clutch: Any  # 1.0 while the operator holds the clutch open, else 0.0
    present: Any  # 1.0 while the operator is there, else 0.0
    g_clutch: Any  # the modulus between the master and its law
    c_switch: Any
    least_g: float  # modulus above 0
    ticks_by: Any  # ticks since the last
    released: float  # 1.0 while the clutch is open or nobody is there
    far: float  # how far the ends are apart, for how far they may be; the greatest of the axes
    n_clutch: float  # of the ramp's steps; below 0 before the first tick
    n_was: float  # the same before this tick
    g_was: float  # the modulus of the last tick

    @staticmethod
    def structure(end: Any) -> Any:
        """The position that a master receives, where the clutch closes by it, else "" ."""
        return positions(end.rx)[0] if end.scene.operator.closes_within is not None else ""

    def __init__(self, e: End, structure: Any) -> None:
        super().__init__(e, structure)
        self.rx_position = structure

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return scene.operator.limits(dt, scene.axes)

    def columns(self, e: End) -> tuple[Column, ...]:
        return (Column(f"clutch_{e.name}", ((self, "clutch"),)), Column(f"present_{e.name}", ((self, "present"),)),
                Column(f"g_clutch_{e.name}", ((self, "g_clutch"),)), per_axis(f"offset_{e.name}", self.axes, "offset"),
                *[per_axis(f"apart_{e.name}", self.axes, "apart")] * bool(self.rx_position))

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.c_switch = numbers
        self.least_g = 1.0 / self.c_switch.steps
        self.n_clutch = -1.0
        self.g_clutch = self.g_was = 1.0
        self.clutch = 0.0
        self.present = 1.0
        for a, port in zip(e.axes, self.axes, strict=True):
            port.offset = 0.0
            port.x_law = a.x_read
            if self.rx_position:
                port.apart = 0.0
        if self.rx_position:
            self.far = 0.0

    def late(self, run: Run, e: End, ticks: int, since: int) -> None:
        self.ticks_by = ticks

    def read(self, run: Run, e: End, k: int) -> None:
        if e.has.live:
            self.clutch = max(self.clutch, scheduled(self.c_switch.clutch, k))
            self.present = min(self.present, 1.0 - scheduled(self.c_switch.absent, k))
        else:
            self.clutch = scheduled(self.c_switch.clutch, k)
            self.present = 1.0 - scheduled(self.c_switch.absent, k)
        self.released = max(self.clutch, 1.0 - self.present)
        if self.rx_position:
            self.released = kept_open(self.n_clutch, self.released, self.far)
        self.g_was = self.g_clutch
        self.n_was = self.n_clutch
        self.n_clutch = ramped(
            self.c_switch.steps, self.n_was, self.released, self.ticks_by if e.has.leaves_out else 1.0)
        self.g_clutch = self.n_clutch / self.c_switch.steps
        self.g_was = at_first(self.n_was, self.g_clutch, self.g_was)

    def situate(self, run: Run, e: End) -> None:
        for a, port in zip(e.axes, self.axes, strict=True):
            transform(self, a, port)

    def act(self, run: Run, e: End, k: int) -> None:
        for a in e.axes:
            a.f_cmd = self.g_clutch * a.f_cmd
        if self.rx_position:
            self.far = 0.0
            for a, port in zip(e.axes, self.axes, strict=True):
                port.apart = port.x_law - getattr(a.rx, self.rx_position)
                self.far = max(abs(port.apart) / self.c_switch.within[a.i], self.far)


def transform(stage: OperatorStage, a: Axis, port: Held) -> None:
    """Put the transformer between the readings of one axis and its law."""
    port.g_told = modulus(stage.g_was, a.at.f_held, stage.least_g)
    port.x_law, port.offset = carried(port.g_told, a.at.x, a.at.dx, port.offset, port.x_law)
    a.at = At(port.x_law, port.g_told * a.at.v, port.g_told * a.at.f, of_port(port.g_told, a.at.f_held),
              port.g_told * a.at.dx, a.at.fresh, a.at.age, a.at.dt, a.at.span, a.at.gain)
