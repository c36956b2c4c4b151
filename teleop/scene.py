"""What a scene is made of. None means left out: not imported, built, computed or recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

from teleop.errors import Refused, number
from teleop.law import Law, law_name, messages
from teleop.playout import Fixed, Hold, Zero

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from teleop.plant import MassDamper, Plant
    from teleop.safety import Cap, Watchdog

MOST_TICKS = 100_000_000  # a day at 1 kHz; more is a slip of the keyboard, not a run


class Reference(Protocol):
    """Where a hand wants to be."""

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[list[float], ...]:
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


class Environment(Protocol):
    """What the slave touches, in one axis."""

    def plant(self, body: MassDamper, dt: float) -> Plant:
        """The exact step of `body` in this environment."""
        ...


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
    """A hand, a master, a law, a link, a slave and what it touches, for a time. SI units."""

    law: Law
    master: MassDamper
    slave: MassDamper
    hand: Hand | None = None
    environment: Environment | tuple[Environment | None, ...] | None = None  # one: on the first axis
    link: Link | None = None
    playout: Playout = Zero()
    observer: float | None = 200.0  # bandwidth L (1/s) of the human-force observer; None: a force sensor
    watchdog: Watchdog | None = None  # both ends
    cap: Cap | None = None  # both ends
    energy: bool = False  # sum E_link and E_port along the run
    axes: int = 1
    start_m: Vector = 0.0  # where the master starts, at rest, m
    start_s: Vector = 0.0  # where the slave starts, at rest, m
    dt: float = 1e-3
    duration: float = 10.0
    packet_size: int | None = None  # bytes on the wire; None: 100 for one axis, 200 for more
    x_limit: float = 1e6  # m; a run that passes it has diverged
    name: str = "scene"
    knobs: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        number("dt", self.dt, low=1e-6, high=10.0)
        number("duration", self.duration, above=0.0)
        number("x_limit", self.x_limit, above=0.0)
        if self.observer is not None:
            number("observer", self.observer, above=0.0)
        if self.axes not in (1, 2, 3):
            raise Refused(f"axes must be 1, 2 or 3, not {self.axes!r}")
        if not self.ticks or self.ticks > MOST_TICKS:
            raise Refused(
                f"{self.duration:g} s in ticks of {self.dt:g} s are {self.ticks} ticks; a run has 1 to "
                f"{MOST_TICKS}: change duration or dt"
            )
        self.vector("start_m", self.start_m)
        self.vector("start_s", self.start_s)
        if len(self.environments) != self.axes:
            raise Refused(f"environment names {len(self.environments)} axes, the scene has {self.axes}")

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
        values = value if isinstance(value, tuple) else (value, *[0.0] * (self.axes - 1))
        if len(values) != self.axes:
            raise Refused(f"{name} has {len(values)} entries, the scene has {self.axes} axes")
        return tuple(number(name, entry) for entry in values)

    @property
    def wire_size(self) -> int:
        """Bytes of one DATA packet on the wire, whatever it carries."""
        return self.packet_size or (100 if self.axes == 1 else 200)

    @property
    def has_waves(self) -> bool:
        """Do the law's messages carry waves, so that the link has an energy ledger."""
        forth, back = messages(self.law)
        return "u" in forth._fields and "w" in back._fields

    def manifest(self) -> dict[str, str]:
        """What both ends of a live run must agree on, as text: the first exchange compares it."""
        from teleop.packet import VERSION

        fixed = {
            "wire version": VERSION, "scene": self.name, "law": f"{law_name(self.law)} {self.law}",
            "dt": self.dt, "duration": self.duration, "axes": self.axes, "playout": self.playout,
            "packet_size": self.wire_size, "watchdog": self.watchdog, "cap": self.cap, "energy": self.energy,
            "observer": self.observer, "start_m": self.start_m, "start_s": self.start_s,
        }
        return {key: fingerprint(value) for key, value in {**self.knobs, **fixed}.items()}


def fingerprint(value: object) -> str:
    """A knob as text; a file by its name and what is in it, for it may lie elsewhere on the other machine."""
    from os import PathLike

    if not isinstance(value, PathLike):
        return str(value)
    from hashlib import sha256
    from pathlib import Path

    path = Path(value)
    return f"{path.name} ({sha256(path.read_bytes()).hexdigest()[:12]})"


def load_scene(name: str, /, **knobs: object) -> Scene:
    """The scene `name` (built in, of a plug-in, or a path ending in .py) with its knobs set.

    `law` may be a law or a law's name; `law.FIELD` sets one of the law's own numbers; `link` takes a link
    or its text and replaces the scene's. Values may be texts, as on the command line. Raises `Refused`.

    >>> load_scene("canonical", delay=0.1).name
    'canonical'
    """
    from teleop.knobs import settle
    from teleop.library import scene_function

    function = scene_function(name)
    settled, link = settle(name, function, knobs)
    try:
        scene = function(**settled)
    except Refused as refused:  # a part of the scene may know a knob by another name
        if not knobs or any(key in str(refused) for key in knobs):
            raise
        asked = ", ".join(f"{key}={value}" for key, value in knobs.items())
        raise Refused(f"{refused} (asked for: {asked})") from None
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        raise Refused(f"scene {name} stopped with {why}; mend it and run again") from error
    if not isinstance(scene, Scene):
        raise Refused(f"scene {name!r} returned {type(scene).__name__}; its function must return a teleop.Scene")
    stem = name.rsplit("/", 1)[-1].removesuffix(".py")
    if link is None:
        return replace(scene, name=stem, knobs=settled)
    return replace(scene, name=stem, knobs={**settled, "link": str(link[0])}, link=link[1])
