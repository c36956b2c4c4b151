"""Scene: the parts of a run, with their checks. A part that is None is not imported, built, computed or recorded.

A rotation is three successive axes, on which a law's positions stand for an orientation.

    Scene(axes=6, names=("x", "y", "z", "rx", "ry", "rz"), rotations=(3,), ...)

is a rigid body, of which x, y and z are in m and the rotation, on the axes 3, 4 and 5, is about those three directions
in rad: its coordinates are integrals of the angular velocity, its forces are torques in N m. What an end makes of it is
`teleop.stages.orientation`. In simulation a master and a slave have the same moment of inertia about each direction,
since bodies move axis by axis: one that differs would be gyroscopic. The same law on all three axes is what gives the
torque of a coupling a potential.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from struct import Struct
from typing import TYPE_CHECKING, Any

from teleop import kind
from teleop.errors import Refused, number, number_of, whole_number
from teleop.kind import positions
from teleop.law import law_name, messages, reads, start_at
from teleop.law.contract import check_contract
from teleop.scene.axes import (
    MOST_AXES,
    NOTHING,
    PER_AXIS,
    axis_names,
    check_alike,
    check_names,
    distinct,
    parts_by_axis,
)
from teleop.scene.parts import (
    Environment,
    Hand,
    LeftOutLike,
    LinkLike,
    Reference,
    Vector,
    check_shape,
    has_shape,
    is_known_by_class,
    varies,
)
from teleop.scene.playout import Gaps, Integral, Playout, Zero, gaps_of, integrates

if TYPE_CHECKING:
    from teleop.physics.relaxing import ElectricalDamping
    from teleop.stages.deadband import Deadband
    from teleop.stages.handover import Handover
    from teleop.stages.operator import Operator
    from teleop.stages.passivity_controller import PassivityController
    from teleop.stages.scaling import Frame
    from teleop.stages.watchdog import Watchdog


MOST_DATA = 1200  # bytes: below every MTU in use, so that a packet is never cut into fragments
HEAD = Struct("!2sBBH")
CHECKSUM = 4
LEAST = HEAD.size + CHECKSUM
FLOAT = 9  # msgpack's size of a float, and of an integer of 64 bits


def least_size(width: int, *, energy: bool = True) -> int:
    """The bytes that a DATA packet of `width` numbers needs at most; `energy`: E_in is sent along.

    Bytes of UDP payload. Raises `Refused` if no packet can carry that many numbers.

    >>> least_size(5, energy=False)
    100
    """
    # The array, session, seq, sent_ns, echo, payload, and E_in or nil.
    payload = (1 if width < 16 else 3) + width * FLOAT
    body = 1 + FLOAT + 5 + FLOAT + (1 + 2 * FLOAT) + payload + (FLOAT if energy else 1)
    if LEAST + body > MOST_DATA:
        raise Refused(f"a packet carries at most {MOST_DATA} bytes, too few for {width} numbers; send fewer")
    return LEAST + body


BODY = "one moment of inertia and damping"
ALIKE = {"law": "one law", "master": BODY, "slave": BODY, "scaling": "one scale of each kind"}


def check_rotations(scene: Any) -> None:
    """Refuse a scene whose rotations are not three axes each, whose law has no orientation, or whose parts differ."""
    firsts = scene.rotations
    whole = isinstance(firsts, tuple) and all(type(each) is int for each in firsts)
    if not whole or any(b < a + 3 for a, b in zip((-3, *firsts), (*firsts, scene.axes), strict=True)):
        raise Refused(f"rotations={firsts!r} must be the index of the first axis of each rotation, in order, with "
                      f"three axes for each, and the scene has {number_of(scene.axes, 'axis', 'axes')}; write for "
                      "example axes=6, rotations=(3,)")
    if scene.slave is None:
        raise Refused("a scene without a slave has no rotations, since its law renders on each axis by itself; leave "
                      "them out, or write for example slave=MassDamper(mass=0.002)")
    if why := without_orientation(scene.laws[0]):
        raise Refused(f"law {law_name(scene.laws[0])} does not run on the axes of a rotation: {why}; take for example "
                      "law=pp or law=wave, or leave rotations out")
    for first in firsts:
        names = axis_names(scene.names, scene.axes)[first:first + 3]
        if any(unit != "rad" for unit in scene.axis_units[first:first + 3]):
            raise Refused(f"the axes {', '.join(names)} are those of a rotation, and their unit is rad, not "
                          f"{', '.join(scene.axis_units[first:first + 3])}; leave units out, or write rad for them")
        for part, one in ALIKE.items():
            parts = scene.per_axis(part)[first:first + 3]
            if any(each != parts[0] for each in parts):
                raise Refused(f"the axes {', '.join(names)} are those of a rotation, which has {one} for all three, "
                              f"and the {part} of one differs; give the three the same {part}")


def without_orientation(law: Any) -> str:
    """Why a law with two ends does not run on the axes of a rotation; empty if it does."""
    kind_of_law: Any = type(law)
    while kind_of_law is not None:
        for each in (vars(kind_of_law).get("stage"), kind_of_law):
            if why := getattr(each, "no_rotation", ""):
                return str(why)
        kind_of_law = vars(kind_of_law).get("inner_law")
    still = start_at(0.0, 0.0, 0.0, 1e-3)
    types = [*messages(law), *[type(getattr(law, f"{e}_start")(still)[0]) for e in ("master", "slave")]]
    if any(positions(each) for each in types if hasattr(each, "_fields")):
        return ""
    if "x" in reads(law.master) | reads(law.slave):
        return "it reads positions, and declares none of its messages or its state as one, as x: kind.Position does"
    return ""


MOST_TICKS = 100_000_000  # a day at 1 kHz; more is a slip of the keyboard, not a run
PARTS = ("hand", "link", "watchdog", "cap", "device_m", "device_s", "passivity", "electrical", "scaling",
         "left_out_m", "left_out_s", "deadband", "operator", "handover", "frame")  # or None

_NUMBERS = attrgetter("dt", "duration", "x_limit", "tolerance", "observer", "axes", "packet_size",
                      "start_m", "start_s", "names", "units", "rotations")
# The numbers of the last scene that passed its checks, by the classes of its parts: in a sweep they seldom change.
_PASSED: dict[tuple[type, ...], tuple[Any, ...]] = {}


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A hand, a master, a law, a link, a slave and its environment, for a duration. SI units.

    Without a slave it is a hand, a master and a one-port law, which renders something to the hand by itself.
    """

    # What is of type Any may be a tuple with one for each axis, see `teleop.scene.axes`.
    law: Any  # Law, or OnePortLaw without a slave
    master: Any  # MassDamper
    slave: Any = None  # MassDamper
    hand: Any = None  # Hand
    environment: Any = None  # Environment; one alone is on the first axis
    link: LinkLike | None = None
    playout: Playout | None = None  # None: see `played_as`
    observer: float | None = 200.0  # bandwidth L (1/s) of the human-force observer; None: a force sensor
    watchdog: Watchdog | None = None  # both ends
    cap: Any = None  # Cap, both ends
    device_m: Any = None  # Device, what stands between the master and the law: encoder, velocity estimator, ...
    device_s: Any = None  # the same at the slave
    passivity: PassivityController | None = None  # observer and controller on the master's port
    scaling: Any = None  # Scaling, the slave's metres and newtons for those of the master
    frame: Frame | None = None  # the rotation and size from the master's base to the slave's
    operator: Operator | None = None  # the clutch and the operator-present switch, at the master
    handover: Handover | None = None  # the policy that may take over at the master
    electrical: ElectricalDamping | None = None  # of the master's motor
    left_out_m: LeftOutLike | None = None  # the ticks that the master leaves out; None: it runs every tick
    left_out_s: LeftOutLike | None = None  # the same of the slave
    deadband: Deadband | None = None  # what of the messages is sent, at both ends; None: each of them
    energy: bool = False  # sum E_link and E_port along the run
    axes: int = 1
    names: tuple[str, ...] = ()  # of the axes; none: see `axis_names`
    units: tuple[str, ...] = ()  # of the axes, m or rad; none: m, and rad where they are a rotation's
    rotations: tuple[int, ...] = ()  # the first axis of each rotation, of three: see `teleop.scene.scene`
    start_m: Vector = 0.0  # where the master starts, at rest, m
    start_s: Vector = 0.0  # where the slave starts, at rest, m
    dt: float = 1e-3
    duration: float = 10.0
    packet_size: int | None = None  # bytes on the wire; None: 100 for one axis, 200 for more, or what messages need
    x_limit: float = 1e6  # m; a run that passes it has diverged
    tolerance: float = 1e-9  # m a tick, for bodies that have no closed form
    name: str = "scene"
    knobs: Mapping[str, object] = field(default_factory=dict)
    own_law: Any = None  # the law that the scene's function has by itself; None: there is none, or it is not known

    def __post_init__(self) -> None:
        kinds, numbers = self._kinds(), _NUMBERS(self)
        if _PASSED.get(kinds) == numbers:
            check_contract(self.law)
            return
        self._check()
        if kinds == self._kinds() and self._is_judged_by_classes():
            _PASSED[kinds] = numbers

    def _kinds(self) -> tuple[type, ...]:
        return (type(self), *map(type, vars(self).values()))

    def _is_judged_by_classes(self) -> bool:
        """True if the checks, which it passed, ask for no more than the classes of its parts and its numbers."""
        looked_at = any(each is not None for each in (
            self.deadband, self.operator, self.handover, self.frame, self.packet_size))
        if looked_at or self.names or self.units or self.rotations or any(
                isinstance(getattr(self, name), tuple) for name in (*PER_AXIS, "start_m", "start_s")):
            return False
        if any(hasattr(body, "check") for body in (self.master, self.slave)):  # by their numbers
            return False
        touched = self.environment is None or any(
            hasattr(type(self.environment), each) for each in ("plant", "resistance", "path"))
        law = "one-port law" if self.slave is None else "law"
        parts = [("master", self.master), (law, self.law), *[(name, getattr(self, name)) for name in ("slave", *PARTS)]]
        return touched and all(part is None or is_known_by_class(name, part) for name, part in parts)

    def _check(self) -> None:
        self._check_numbers()
        check_names(self.names, self.units, self.axes)
        self._check_part("master")
        self._check_ends()
        for law in distinct(self.laws):
            check_contract(law)
        for name in PARTS:
            if getattr(self, name) is not None:
                self._check_part(name)
        if self.playout is not None and not isinstance(self.playout, Playout):
            raise Refused(f"playout must be Zero(), Hold(), Integral(), Energy(), Scaled(...) or Fixed(...), not "
                          f"{self.playout!r}; write for example playout=Fixed(0.1)")
        if not isinstance(self.energy, bool):
            raise Refused(f"energy must be True or False, not {self.energy!r}; write energy=True")
        if self.rotations != ():
            check_rotations(self)
        if self.frame is not None:
            self.frame.triples(self)
        self._check_deadband()
        self._check_operator()
        if self.handover is not None:
            self.handover.pulls(self.dt_ns / 1e9, self.axes)
        self._check_packet()
        for each in self.environments:
            if each is not None and (
                    isinstance(each, type) or not (hasattr(each, "resistance") or hasattr(each, "path"))):
                check_shape("environment", each)

    def _check_part(self, name: str) -> None:
        """Refuse a part that lacks what a run uses, and parts of the axes that do not go together."""
        if name not in PER_AXIS:
            check_shape(name, getattr(self, name))
            return
        parts = self.per_axis(name)
        for each in distinct(parts):
            if each is not None or name not in NOTHING:
                check_shape(name, each)
        check_alike(name, parts)
        if name in ("master", "slave"):
            for each in distinct(parts):
                if hasattr(each, "check"):
                    each.check(self.dt_ns / 1e9)

    def _check_ends(self) -> None:
        """Refuse a law with other ends than the scene, and parts of a slave in a scene without one."""
        laws = self.laws
        one_port = has_shape("one-port law", laws[0])
        check_alike("law", laws)
        if self.slave is not None:
            if one_port and not hasattr(laws[0], "slave"):
                raise Refused(f"law {law_name(laws[0])} is a one-port law, which renders by itself, and the scene has "
                              "a slave; take a law with two ends, such as wave, or leave the slave out")
            check_shape("law", laws[0])
            self._check_part("slave")
            return
        if not one_port and has_shape("law", laws[0]):
            raise Refused(f"law {law_name(laws[0])} has two ends and the scene has no slave; take a "
                          "one-port law such as virtual_wall, or a scene with a slave")
        check_shape("one-port law", laws[0])
        for name in ("link", "environment", "watchdog", "device_s", "scaling", "frame", "left_out_s", "deadband",
                     "operator", "handover"):
            if getattr(self, name) is not None:
                raise Refused(f"a scene without a slave has no {name}; leave it out, or write for example "
                              "slave=MassDamper(mass=0.5)")

    def _check_operator(self) -> None:
        """Refuse a clutch that closes where the ends are near each other, of a law that does not tell where."""
        if self.operator is None:
            return
        if hasattr(self.operator, "check"):
            self.operator.check(self)
        if self.operator.closes_within is None:
            return
        if not kind.positions(messages(self.laws[0])[1]):
            raise Refused(f"law {law_name(self.laws[0])} does not tell the master where the slave is, so closes_within "
                          "cannot be kept; leave it out, or take a law that compares positions, such as law=pp")

    def _check_packet(self) -> None:
        """Refuse a law whose message has no room in a packet."""
        if self.slave is None:
            return
        least = self.least_packet
        if self.packet_size is not None and self.packet_size < least:
            law = law_name(self.laws[0])
            raise Refused(f"packet_size must be at least {least} bytes, which the message of law {law} "
                          f"in {number_of(self.axes, 'axis', 'axes')} needs, not {self.packet_size}; write "
                          f"packet_size={least}, or leave it out")

    def _check_deadband(self) -> None:
        """Refuse a deadband whose silence would be taken for a peer that is gone, or for waves that are zero."""
        band = self.deadband
        if band is None:
            return
        timeout = None if self.watchdog is None else getattr(self.watchdog, "timeout", None)
        if timeout is not None and (band.keep_alive is None or band.keep_alive >= timeout):
            keep = "sends nothing" if band.keep_alive is None else f"sends after {band.keep_alive:g} s"
            raise Refused(f"the deadband {keep} without a change, and the watchdog lets go after {timeout:g} s "
                          f"without a message; write for example Deadband(k={band.k:g}, keep_alive={0.2 * timeout:g})")
        if self.has_waves and isinstance(self.wave_playout, Zero):
            raise Refused("a deadband leaves gaps between the waves that it sends, and playout zero plays nothing in "
                          "them: the force would be a pulse for each message; write playout=integral, or leave the "
                          "playout out")

    def _check_numbers(self) -> None:
        """Refuse numbers out of range, and keep each as a float or an int, whatever type it was given as."""
        checked: dict[str, object] = {
            "dt": number("dt", self.dt, low=1e-6, high=10.0),
            "duration": number("duration", self.duration, above=0.0),
            "x_limit": number("x_limit", self.x_limit, above=0.0),
            "tolerance": number("tolerance", self.tolerance, above=0.0),
            "observer": None if self.observer is None else number("observer", self.observer, above=0.0),
            "axes": whole_number("axes", self.axes, low=1, high=MOST_AXES),
            "packet_size": None if self.packet_size is None else whole_number(
                "packet_size", self.packet_size, low=64, high=1200),
        }
        for name, value in checked.items():
            if value is not getattr(self, name):
                object.__setattr__(self, name, value)
        count = self.duration / self.dt  # may be inf, which `ticks` could not count
        if count > 2.0 * MOST_TICKS or not 1 <= self.ticks <= MOST_TICKS:
            raise Refused(f"duration={self.duration:g} s in ticks of dt={self.dt:g} s is {count:.10g} ticks; "
                          f"a run has 1 to {MOST_TICKS}: change duration or dt")
        self.vector("start_m", self.start_m)
        self.vector("start_s", self.start_s)

    @property
    def dt_ns(self) -> int:
        """Length of a tick in whole nanoseconds, in which all time is counted."""
        return round(self.dt * 1e9)

    @property
    def ticks(self) -> int:
        """Number of ticks of the run."""
        return round(self.duration * 1e9) // self.dt_ns

    @property
    def environments(self) -> tuple[Environment | None, ...]:
        """Environment of the slave for each axis, None where there is none."""
        return self.per_axis("environment")

    def per_axis(self, name: str) -> tuple[Any, ...]:
        """The part `name` of each axis, one of `teleop.scene.axes.PER_AXIS`: see `parts_by_axis`."""
        return parts_by_axis(name, getattr(self, name), self.axes)

    @property
    def laws(self) -> tuple[Any, ...]:
        """The law of each axis; all are of one class."""
        return self.per_axis("law")

    @property
    def reference(self) -> Reference | None:
        """The motion that the hand follows, of all axes; None without a hand."""
        return next((hand.reference for hand in self.per_axis("hand") if hand is not None), None)

    @property
    def axis_names(self) -> tuple[str, ...]:
        """The name of each axis; where the scene gives none, x, y, z or axis1, axis2, ..."""
        return axis_names(self.names, self.axes)

    @property
    def axis_units(self) -> tuple[str, ...]:
        """The unit of the position of each axis, m or rad."""
        return self.units or tuple(["rad" if i in self.turning else "m" for i in range(self.axes)])

    @property
    def turning(self) -> frozenset[int]:
        """The axes that are those of rotations."""
        return frozenset([first + i for first in self.rotations for i in range(3)])

    def leaves_out(self, e: str) -> LeftOutLike | None:
        """The ticks that the end `e` leaves out: the scene's own, or those that its link brings along; None: none."""
        skipped: LeftOutLike | None = self.left_out_m if e == "m" else self.left_out_s
        bring = None if skipped is not None else getattr(self.link, "leaves_out", None)
        return skipped if bring is None else bring(0 if e == "m" else 1, self.dt_ns)

    def vector(self, name: str, value: Vector) -> tuple[float, ...]:
        """`value` for each axis; a number means along the first, the others stay 0."""
        if self.axes == 1 and type(value) is float:  # nearly always
            return (number(name, value),)
        values = value if isinstance(value, tuple) else (value, *[0.0] * (self.axes - 1))
        if len(values) != self.axes:
            raise Refused(f"{name} has {number_of(len(values), 'entry', 'entries')}, the scene has "
                          f"{number_of(self.axes, 'axis', 'axes')}; write a number, "
                          "which means along the first axis, or one entry for each")
        return tuple(number(name, entry) for entry in values)

    @property
    def wire_size(self) -> int:
        """Bytes of one DATA packet on the wire, whatever it carries.

        What the scene says; else 100 for one axis and 200 for more, or as many as its messages need.
        """
        usual = 100 if self.axes == 1 else 200
        return self.packet_size or (usual if self.slave is None else max(usual, self.least_packet))

    @property
    def least_packet(self) -> int:
        """The bytes that the largest packet of this scene needs. Raises `Refused` if none can carry its message."""
        along = self.has_waves and integrates(self.played_as)  # T, and U and E of each axis, behind the law's messages
        width = max(len(message._fields) for message in messages(self.laws[0])) * self.axes
        return least_size(width + (1 + 2 * self.axes) * along, energy=self.energy and not along)

    @property
    def has_waves(self) -> bool:
        """True if the law's messages carry waves, so that the link has an energy ledger."""
        return self.slave is not None and all(map(kind.wave, messages(self.laws[0])))

    @property
    def played_as(self) -> Playout:
        """The playout of a run: the scene's; where it names none, `Integral` for waves over a link that varies.

        A link varies unless it does no more than a constant delay, and where an end leaves out ticks. Otherwise it is
        `Zero`, which then plays the same.
        """
        if self.playout is not None:
            return self.playout
        late = self.left_out_m is not None or self.left_out_s is not None or self.deadband is not None
        return Integral() if self.has_waves and (late or (self.link is not None and varies(self.link))) else Zero()

    @property
    def wave_playout(self) -> Gaps | None:
        """Rule by which waves are played; None where the law's messages have none."""
        return gaps_of(self.played_as) if self.has_waves else None


def both_ends(scene: Scene) -> Scene:
    """Return the scene if two processes can run it. Raises `Refused` if it has no slave, so no second end."""
    if scene.slave is None:
        raise Refused(f"scene {scene.name} has no slave, so it has no link and no second end; run it in virtual time: "
                      f"teleop run {scene.name}")
    deadband = scene.deadband
    if deadband is not None and (deadband.keep_alive is None or deadband.keep_alive > 0.1):
        raise Refused("a live end takes a peer that is silent for long to be gone, so its deadband sends every 0.1 s "
                      f"at least: write for example Deadband(k={deadband.k:g}, keep_alive=0.01)")
    if scene.leaves_out("m") is not None or scene.leaves_out("s") is not None:
        raise Refused("ticks are left out by order in virtual time alone; a live end leaves out those that it cannot "
                      "run in time: leave left_out away (of a recorded link write left_out=False), or type teleop run")
    return scene


def on_axis(scene: Scene, i: int) -> Scene:
    """The scene of one axis alone, that with index i, with its own parts, its name and its unit.

    Its hand follows the reference of that axis. What couples the axes of the scene is not in it.
    """
    if scene.axes == 1:
        return scene
    parts: dict[str, Any] = {name: scene.per_axis(name)[i] for name in PER_AXIS if getattr(scene, name) is not None}
    if parts.get("hand") is not None:
        parts["hand"] = OwnGrip(parts["hand"], OneAxis(scene.reference, scene.axes, i))  # type: ignore[arg-type]  # there is one
    for name in ("start_m", "start_s"):
        parts[name] = scene.vector(name, getattr(scene, name))[i]
    if scene.frame is not None:  # its rotation couples axes, and its size is that of each
        from teleop.stages.scaling import Scaling
        from teleop.stages.slave_units import scales

        scale_x, scale_f = scales(scene)[i]
        parts |= {"frame": None, "scaling": Scaling(scale_x=scale_x, scale_f=scale_f)}
    return replace(scene, axes=1, rotations=(), names=(scene.axis_names[i],), units=(scene.axis_units[i],),
                   packet_size=None, **parts)


class OneAxis:
    """A reference of several axes along one of them, the one with index i."""

    def __init__(self, reference: Reference, axes: int, i: int) -> None:
        self.reference, self.axes, self.i = reference, axes, i

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[Sequence[float], ...]:
        """The position of that axis at the ticks 0 .. count-1, in m or rad; `axes` is 1."""
        return (self.reference.samples(self.axes, count, dt_ns)[self.i],)


class OwnGrip:
    """A hand's mass, stiffness and damping with another reference."""

    def __init__(self, hand: Hand, reference: Reference) -> None:
        self.mass, self.k, self.d, self.reference = hand.mass, hand.k, hand.d, reference

