"""What a scene is made of. None means left out: not imported, built, computed or recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

from teleop.errors import Refused, WrongNumber, number, whole_number
from teleop.law import law_name, messages
from teleop.protocol.inbox import Fixed, Hold, Zero

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from teleop.physics.implicit import Resistance
    from teleop.physics.plant import MassDamper, Plant
    from teleop.physics.relaxing import ElectricalDamping
    from teleop.stages.device import Device
    from teleop.stages.passivity_controller import PassivityController
    from teleop.stages.safety import Cap, Watchdog

MOST_TICKS = 100_000_000  # a day at 1 kHz; more is a slip of the keyboard, not a run
SHAPES = {  # what is asked of a part of a scene, and what to write for one
    "law": (("master_start", "master", "slave_start", "slave"), "Wave()"),
    "one-port law": (("start", "force"), "VirtualWall(K=500.0)"),
    "master": (("mass", "damping"), "MassDamper(mass=0.1)"),
    "slave": (("mass", "damping"), "MassDamper(mass=0.5)"),
    "hand": (("mass", "k", "d", "reference"), "Grip(mass=0.4, k=200.0, d=5.0, reference=Rest())"),
    "environment": (("plant",), "Wall(k=1e3)"),
    "link": (("arrivals",), "Delay(0.05)"),
    "watchdog": (("limits",), "Watchdog(timeout=0.1)"),
    "cap": (("limits",), "Cap(f_max=20.0)"),
    "device_m": (("encoder", "velocity", "every", "delay"), "Device(encoder=Encoder(step=1e-5))"),
    "device_s": (("encoder", "velocity", "every", "delay"), "Device(encoder=Encoder(step=1e-5))"),
    "passivity": (("limits",), "PassivityController(cap=0.8)"),
    "electrical": (("b", "cutoff"), "ElectricalDamping(b=1.0, cutoff=10.0)"),
}


class Reference(Protocol):
    """Where a hand wants to be."""

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[Sequence[float], ...]:
        """For each axis the position (m) at the ticks 0 .. count-1."""
        ...


class Hand(Protocol):
    """A grip: the mass, stiffness and damping between the master and a moving reference."""

    @property
    def mass(self) -> float: ...
    @property
    def k(self) -> float: ...
    @property
    def d(self) -> float: ...
    @property
    def reference(self) -> Reference: ...


class Exact(Protocol):
    """What the slave touches, in one axis, where its motion has a closed form.

    If the plant has an inner state, the environment has `inner = True`.
    """

    def plant(self, body: MassDamper, dt: float) -> Plant:
        """The exact step of `body` in this environment."""
        ...


class Integrated(Protocol):
    """What the slave touches where there is none, or where it goes with friction; see `teleop.physics.implicit`."""

    def resistance(self) -> Resistance:
        """What resists the body."""
        ...


class Moved(Protocol):
    """Any other environment, carried along a path."""

    @property
    def environment(self) -> Exact | Integrated: ...
    @property
    def path(self) -> Reference: ...


Environment = Exact | Integrated | Moved


class Arrivals(Protocol):
    """What comes out of one direction of a link, sorted by time."""

    @property
    def packet(self) -> NDArray[np.int64]: ...
    @property
    def time_ns(self) -> NDArray[np.int64]: ...


class Link(Protocol):
    """The water between the ends: two directions, 0 forth (master to slave) and 1 back."""

    def arrivals(self, direction: int, count: int, dt_ns: int, seed: int, size: int) -> Arrivals:
        """Packets 0 .. count-1 sent at the ticks, as (packet, time in ns) when they come out."""
        ...


Playout = Zero | Hold | Fixed
Vector = float | tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A hand, a master, a law, a link, a slave and what it touches, for a time. SI units.

    Without a slave it is a hand, a master and a one-port law, which renders something to the hand by itself.
    """

    law: Any  # Law, or OnePortLaw without a slave
    master: MassDamper
    slave: MassDamper | None = None
    hand: Hand | None = None
    environment: Environment | tuple[Environment | None, ...] | None = None  # one: on the first axis
    link: Link | None = None
    playout: Playout = Zero()
    observer: float | None = 200.0  # bandwidth L (1/s) of the human-force observer; None: a force sensor
    watchdog: Watchdog | None = None  # both ends
    cap: Cap | None = None  # both ends
    device_m: Device | None = None  # what stands between the master and the law: encoder, velocity estimator, ...
    device_s: Device | None = None  # the same at the slave
    passivity: PassivityController | None = None  # observer and controller on the master's port
    electrical: ElectricalDamping | None = None  # of the master's motor
    energy: bool = False  # sum E_link and E_port along the run
    axes: int = 1
    start_m: Vector = 0.0  # where the master starts, at rest, m
    start_s: Vector = 0.0  # where the slave starts, at rest, m
    dt: float = 1e-3
    duration: float = 10.0
    packet_size: int | None = None  # bytes on the wire; None: 100 for one axis, 200 for more
    x_limit: float = 1e6  # m; a run that passes it has diverged
    tolerance: float = 1e-9  # m a tick, for bodies that have no closed form
    name: str = "scene"
    knobs: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _shaped("master", self.master)
        self._check_ends()
        for name in ("hand", "link", "watchdog", "cap", "device_m", "device_s", "passivity", "electrical"):
            if getattr(self, name) is not None:
                _shaped(name, getattr(self, name))
        if not isinstance(self.playout, Zero | Hold | Fixed):
            raise Refused(f"playout must be Zero(), Hold() or Fixed(...), not {self.playout!r}; "
                          "write for example playout=Fixed(0.1)")
        if not isinstance(self.energy, bool):
            raise Refused(f"energy must be True or False, not {self.energy!r}; write energy=True")
        self._check_numbers()
        for each in self.environments:
            if each is not None and (
                    isinstance(each, type) or not (hasattr(each, "resistance") or hasattr(each, "path"))):
                _shaped("environment", each)
        if len(self.environments) != self.axes:
            raise Refused(f"environment names {len(self.environments)} axes, the scene has {self.axes}; "
                          "write None for an axis that touches nothing")

    def _check_ends(self) -> None:
        """Refuse a law that has not the ends that the scene has, and parts of a slave that is not there."""
        one_port = all(hasattr(self.law, each) for each in SHAPES["one-port law"][0])
        if self.slave is not None:
            if one_port and not hasattr(self.law, "slave"):
                raise Refused(f"law {law_name(self.law)} is a one-port law, which renders by itself, and the scene has "
                              "a slave; take a law with two ends, for example law=Wave(), or leave the slave out")
            _shaped("law", self.law)
            _shaped("slave", self.slave)
            return
        if not one_port and all(hasattr(self.law, each) for each in SHAPES["law"][0]):
            raise Refused(f"law {law_name(self.law)} has two ends and the scene has no slave; write for example "
                          "slave=MassDamper(mass=0.5), or take a one-port law such as law=VirtualWall(K=500.0)")
        _shaped("one-port law", self.law)
        for name in ("link", "environment", "watchdog", "device_s"):
            if getattr(self, name) is not None:
                raise Refused(f"a scene without a slave has no {name}; leave it out, or write for example "
                              "slave=MassDamper(mass=0.5)")

    def _check_numbers(self) -> None:
        """Refuse what is out of range; what is kept is a float or an int, whatever kind of number it came as."""
        checked: dict[str, object] = {
            "dt": number("dt", self.dt, low=1e-6, high=10.0),
            "duration": number("duration", self.duration, above=0.0),
            "x_limit": number("x_limit", self.x_limit, above=0.0),
            "tolerance": number("tolerance", self.tolerance, above=0.0),
            "observer": None if self.observer is None else number("observer", self.observer, above=0.0),
            "axes": whole_number("axes", self.axes, low=1, high=3),
            "packet_size": None if self.packet_size is None else whole_number(
                "packet_size", self.packet_size, low=64, high=1200),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        count = self.duration / self.dt  # may be inf, which `ticks` could not count
        if count > 2.0 * MOST_TICKS or not 1 <= self.ticks <= MOST_TICKS:
            raise Refused(f"duration={self.duration:g} s in ticks of dt={self.dt:g} s is {count:.10g} ticks; "
                          f"a run has 1 to {MOST_TICKS}: change duration or dt")
        self.vector("start_m", self.start_m)
        self.vector("start_s", self.start_s)

    @property
    def dt_ns(self) -> int:
        """The tick in whole nanoseconds: all time is counted in these."""
        return round(self.dt * 1e9)

    @property
    def ticks(self) -> int:
        """How many ticks the run has."""
        return round(self.duration * 1e9) // self.dt_ns

    @property
    def environments(self) -> tuple[Environment | None, ...]:
        """What the slave touches, for each axis."""
        if isinstance(self.environment, tuple):
            return self.environment
        return (self.environment, *[None] * (self.axes - 1))

    def vector(self, name: str, value: Vector) -> tuple[float, ...]:
        """`value` for each axis; a number means along the first, the others stay 0."""
        if self.axes == 1 and type(value) is float:  # nearly always
            return (number(name, value),)
        values = value if isinstance(value, tuple) else (value, *[0.0] * (self.axes - 1))
        if len(values) != self.axes:
            raise Refused(f"{name} has {len(values)} entries, the scene has {self.axes} axes; "
                          "write a number, which means along the first axis, or one entry for each")
        return tuple(number(name, entry) for entry in values)

    @property
    def wire_size(self) -> int:
        """Bytes of one DATA packet on the wire, whatever it carries."""
        return self.packet_size or (100 if self.axes == 1 else 200)

    @property
    def has_waves(self) -> bool:
        """Do the law's messages carry waves, so that the link has an energy ledger."""
        if self.slave is None:
            return False
        forth, back = messages(self.law)
        return "u" in forth._fields and "w" in back._fields

    def manifest(self) -> dict[str, str]:
        """What both ends of a live run must agree on, as text: the first exchange compares it.

        Every part of the scene, every knob, and what the files behind it hold: a scene or a law of the
        user's own is compared by its source, a recorded motion by its content.
        """
        from teleop.protocol.manifest import manifest

        return manifest(self)


def _shaped(name: str, part: object) -> None:
    """Refuse a part that lacks what the run will ask of it."""
    asked, example = SHAPES[name]
    if isinstance(part, type) or not all(hasattr(part, each) for each in asked):
        got = f"the class {part.__name__}" if isinstance(part, type) else repr(part)
        raise Refused(f"{name} must be something with {', '.join(asked)}, not {got}; "
                      f"write for example {name}={example}")


def both_ends(scene: Scene) -> Scene:
    """The scene, to be run by two processes. Refused if it has no slave: there is nothing to send to then."""
    if scene.slave is None:
        raise Refused(f"scene {scene.name} has no slave, so it has no link and no second end; run it in virtual time: "
                      f"teleop run {scene.name}")
    return scene


def load_scene(name: str, /, **knobs: object) -> Scene:
    """The scene `name` (built in, of a plug-in, or a path ending in .py) with its knobs set.

    `law` may be a law or a law's name; `law.FIELD` sets one of the law's own numbers; `x_limit` (m), beyond which a run
    has diverged, is a knob of every scene, and so is `link`, which takes a link
    or its text and replaces the scene's. Values may be texts, as on the command line. Raises `Refused`.

    >>> load_scene("canonical", delay=0.1).name
    'canonical'
    """
    from teleop.scene.library import scene_function

    if not isinstance(name, str):
        raise Refused(f"a scene is named by a text, not {name!r}; write for example load_scene('canonical')")
    return made_by(scene_function(name), name, knobs)


def made_by(function: Callable[..., Any], name: str, knobs: Mapping[str, object]) -> Scene:
    """The scene that a scene's function makes with its knobs set, as `load_scene` does."""
    from teleop.scene.knobs import settle

    settled, of_scene = settle(name, function, knobs)
    try:
        scene = function(**settled)
    except Refused as refused:
        raise _as_typed(refused, name, {key: settled[key] for key in knobs if key in settled}) from None
    except (Exception, SystemExit) as error:
        why = f"{type(error).__name__}: {error}"
        raise Refused(f"scene {name} stopped with {why}; mend it and run again") from error
    if not isinstance(scene, Scene):
        raise Refused(f"scene {name!r} returned {type(scene).__name__}; its function must return a teleop.Scene")
    stem = name.rsplit("/", 1)[-1].removesuffix(".py")
    shown = {key: shown for key, (shown, _) in of_scene.items()}
    parts: dict[str, Any] = {key: part for key, (_, part) in of_scene.items()}
    return _called(replace(scene, **parts) if parts else scene, stem, {**settled, **shown})


def _called(scene: Scene, name: str, knobs: Mapping[str, object]) -> Scene:
    """The same scene by a name; what was checked when it was made is not checked again."""
    called = object.__new__(Scene)
    called.__dict__.update(scene.__dict__, name=name, knobs=knobs)
    return called


def _as_typed(refused: Refused, name: str, given: Mapping[str, object]) -> Refused:
    """A part's refusal in the words of whoever set the knobs: the part may know a knob by another name."""
    if isinstance(refused, WrongNumber) and given.get(refused.name) != refused.value:
        same = [key for key, value in given.items() if type(value) in (int, float) and value == refused.value]
        if len(same) == 1:
            return refused.called(same[0])
    said = str(refused).replace("=", " ").split()
    if not given or any(key in said for key in given):
        return refused
    return Refused(f"{refused} (scene {name} with {', '.join(f'{key}={value}' for key, value in given.items())})")
