"""Records that the tick is written over: a run, its ends, their axes, and the stages between a device and its law."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple


class Record:
    """A run, an end, an axis, a stage. What it is made with is known beforehand; the rest its class declares.

    `suffix` tells its variables from those of others: the field x of a record with the suffix m0 is x_m0.
    """

    suffix: str
    passing: ClassVar[tuple[str, ...]] = ()  # fields that each tick sets before it reads them

    def __init__(self, suffix: str = "") -> None:
        self.suffix = suffix

    def word(self, field: str) -> str:
        """The name of a field's variable."""
        return f"{field}_{self.suffix}" if self.suffix else field


_DECLARED: dict[type[Record], dict[str, str]] = {}


def declared(kind: type[Record]) -> dict[str, str]:
    """The fields that a class of records declares and has no value for, with their types as they are written."""
    if kind not in _DECLARED:
        written = [vars(each).get("__annotations__", {}) for each in kind.__mro__]
        _DECLARED[kind] = {name: type_ for each in written for name, type_ in each.items()
                           if not hasattr(kind, name)}
    return _DECLARED[kind]


def function_fields(kind: type[Record]) -> tuple[str, ...]:
    """Fields of a record that are functions; it is made with them."""
    return tuple([name for name, written in declared(kind).items() if written.startswith("Callable")])


Places = list[float]
SWITCHES = ("clutch", "present")  # of an operator, at the master
CLUTCHES = {None: 0.0, False: 0.0, True: 1.0, "translation": 2.0, "rotation": 3.0}  # state of a clutch, as a number


class RunHas(NamedTuple):
    """Features of a run, decided when its loop is made."""

    slave: bool = True  # no slave: a one-port law, which renders by itself
    hand: bool = False
    link: bool = False
    repeats: bool = False  # playout: the last message is played again in the gaps
    integral: bool = False  # playout: waves by what they have come to, which is sent along
    energy: bool = False  # the ledgers of the ports are kept,
    waves: bool = False  # ... and that of the link, whose messages carry waves,
    stored: bool = False  # ... and that of the law, which says how much it keeps
    own_laws: bool = False  # each axis has a law of its own, of one class
    deadband: bool = False  # what is sent is decided by content


class EndHas(NamedTuple):
    """Features of one end, decided when the loop is made."""

    live: bool = False  # runs by itself, without the other end
    leaves_out: bool = False  # ticks may be left out at it, so the time from one to the next varies
    inner: bool = False  # its body has an inner state beside position and velocity
    touch: bool = False  # its law reads the external force,
    sensed: bool = False  # ... from a force sensor
    felt: bool = False  # the external force is worked out, for the law or for the record
    age: bool = False  # its law reads the age of the newest message
    newest: bool = False  # the number of the newest message is kept
    dx: bool = False  # the motion of a tick is worked out
    sums: bool = False  # its law sums over the axes
    span: bool = False  # its law reads the time since its last tick,
    gain: bool = False  # ... and the watchdog's gain at that tick


class Axis(Record):
    """Axis of an end. SI units."""

    passing: ClassVar[tuple[str, ...]] = ("at",)
    i: int
    # the body
    x: float  # position
    v: float
    f: float  # the held force, N
    f_ext: float  # external force: f_h at the master, f_env at the slave
    c: Any  # its coefficients
    z: Any  # its inner state
    slope: float  # of the hand's reference over the last tick, m/s
    r: Any  # the hand's reference at the ticks
    overflowed: Any  # 1 if the last tick had more contact events than are followed
    # what the device reads
    x_read: float
    v_read: float
    f_read: float
    x_before: float  # as it was read at the tick before
    dx: float
    # the law
    at: Any  # teleop.law.At
    s: Any  # its state
    rx: Any  # the message that it received
    tx: Any  # the message that it sends
    sums: Any
    f_cmd: float  # the force that it commands, and what the stages make of it
    heard: Any  # what the other end's waves had come to with the newest message
    sent: Any  # what its own have come to
    ring: Any  # messages on their way

    move: Callable[..., Any]  # the functions of its body
    force: Callable[..., Any]

    def __init__(self, suffix: str, i: int) -> None:
        super().__init__(suffix)
        self.i = i


class Shown(Record):
    """A field of the law's state in one axis, which the law asks to be recorded."""

    value: float

    def __init__(self, suffix: str, a: Axis, field: str) -> None:
        super().__init__(suffix)
        self.a, self.field = a, field


class End(Record):
    """The master's end or the slave's."""

    name: str  # m or s
    has: EndHas
    axes: tuple[Axis, ...]
    stages: tuple[Stage, ...]  # in their order
    stage: Any  # each by its name, None in place of one that the end does not have
    cells: tuple[tuple[Record, str], ...]  # of a row of its record
    memory: tuple[tuple[Record, str], ...]  # what it keeps from tick to tick
    shown: tuple[Shown, ...]  # of its law's state, what is recorded
    fields: tuple[str, ...]  # of its law's sums
    tx_wave: str  # the field of its messages that is a wave, "" if none is
    rx_wave: str
    rx_fields: tuple[str, ...]  # of the messages that it receives
    got: Any  # is there a message to play at this tick
    newest: Any  # number of the newest message that was played, -1 before the first
    age: float  # of the newest message, s
    span: float  # since its last tick, s
    ran: Any  # number of its last tick, in virtual time

    begin: Callable[..., Any]  # the functions of its law
    law: Callable[..., Any]
    total: Callable[..., Any]
    Sums: Callable[..., Any]
    Message: Callable[..., tuple[Any, ...]]

    def __init__(self, name: str, axes: int, has: EndHas) -> None:
        super().__init__(name)
        self.name, self.has = name, has
        self.axes = tuple([Axis(f"{name}{i}", i) for i in range(axes)])


class Run(Record):
    """Both ends, or one of a live run."""

    has: RunHas
    m: End
    s: End
    ends: tuple[End, ...]
    recorder: Recorder
    dt: float
    half_dt: float
    law: Any  # of all axes, or a tuple with that of each
    capped: Any  # ticks with more contact events than are followed

    grip_force: Callable[..., Any]
    held_force: Callable[..., Any]
    move_gripped: Callable[..., Any]
    move_free: Callable[..., Any]
    move_held: Callable[..., Any]


class Recorder(Record):
    """Recorder of a run."""

    def begin(self, run: Run, request: Any, size: int) -> None:
        """Before the first tick. `asked`: where to put it; `size`: how many ticks messages are on their way."""

    def step(self, run: Run, k: int) -> None:
        """After both ends' tick k."""

    def lost(self, run: Run, x_limit: Any, k: int) -> Any:
        """True if the run left its bounds in tick k, and ends with it."""
        return not all(-x_limit < a.x < x_limit for e in run.ends for a in e.axes)

    def outcome(self, run: Run, ticks: int, complete: bool) -> Any:
        """Value that the run returns after so many ticks; `complete`: it came to its end."""


class Column(NamedTuple):
    """A column of an end's record: its name, with @ where it stands once for each axis, and where its numbers are."""

    name: str
    cells: tuple[tuple[Record, str], ...]


class Stage(Record):
    """Stage between a device and its law, or between the law and the motor.

    A subclass says in one file which numbers it is given, what it keeps in variables of its own, what it does in a
    tick, and what of it is recorded. At a tick the stages `read` in their order, then `situate`, then `receive`; then
    the law answers, and they `act`. `teleop.stages.order` says which ends have it.
    """

    name: ClassVar[str]
    axis_kind: ClassVar[type[Record]] = Record  # what it keeps in each axis
    reading: ClassVar[bool] = False  # its columns stand before those of the forces
    wants_dx: ClassVar[bool] = False

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        """Its numbers; `places` are those where the end starts, as the stages before read them (m, per axis)."""
        return ()

    @staticmethod
    def structure(end: Any) -> Any:
        """Hashable value that decides its lines; `end` is a `teleop.stages.order.Asked`."""
        return None

    def __init__(self, e: End, structure: Any) -> None:
        """Make its records for an end that has its axes already; `structure` is what `structure` returned."""
        super().__init__(e.name)
        self.axes: tuple[Any, ...] = tuple([self.axis_kind(a.suffix) for a in e.axes])

    def columns(self, e: End) -> tuple[Column, ...]:
        """Columns of the record that it has."""
        return ()

    def memory(self, e: End) -> tuple[tuple[Record, str], ...]:
        """Fields that are states of the loop, where that is linear."""
        return ()

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        """Before the first tick."""

    def late(self, run: Run, e: End, ticks: int, since: int) -> None:
        """Before the tick of an end that leaves out ticks: `ticks` have passed since it last ran.

        `since`: how many since its force was set; of a live end, which sets one without asking its law, fewer.
        """

    def read(self, run: Run, e: End, k: int) -> None:
        """Change what the device reads."""

    def situate(self, run: Run, e: End) -> None:
        """Change what the law is told."""

    def receive(self, run: Run, e: End) -> None:
        """Change the message that the law is told."""

    def act(self, run: Run, e: End, k: int) -> None:
        """Change the force that the law commands."""


def per_axis(name: str, records: tuple[Record, ...], field: str) -> Column:
    """A column that stands once for each axis."""
    return Column(f"{name}@", tuple([(each, field) for each in records]))


def elapsed(run: Run, e: End) -> Any:
    """The time since the last tick of an end, s: dt, and more after ticks that were left out."""
    return e.span if e.has.leaves_out else run.dt


def held_of_law(e: End, a: Axis) -> Any:
    """The law's part of the held force of one axis, N: all of it where no policy pulls beside it."""
    return e.stage.handover.axes[a.i].f_port if e.stage.handover and not e.stage.handover.moves else a.f


def law_of(run: Run, a: Axis) -> Any:
    """The law of an axis: that of all, or its own."""
    return run.law[a.i] if run.has.own_laws else run.law
