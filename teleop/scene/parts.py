"""The parts of a scene as protocols: the methods and numbers that a run uses. A part needs no base class."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

from teleop.errors import Refused

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from teleop.physics.implicit import Resistance
    from teleop.physics.plant import MassDamper, Plant

SHAPES = {  # of each part of a scene: the attributes that a run uses, and an example
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
    "left_out_m": (("left_out",), "LeftOut(0.1)"),
    "left_out_s": (("left_out",), "LeftOut(0.1)"),
    "deadband": (("k", "floor", "keep_alive"), "Deadband(k=0.1)"),
    "operator": (("clutch", "absent", "ramp", "needs"), "Operator(clutch=((2.0, 3.0),))"),
    "handover": (("pulls", "rules", "takes", "actions"), "Handover(takes=((2.0, 4.0),))"),
    "scaling": (("scale_x", "scale_f"), "Scaling(scale_x=0.2, scale_f=0.5)"),
    "frame": (("matrix", "scale"), "Frame(rotation=(0.0, 0.0, 1.5708), scale=0.2)"),
    "electrical": (("b", "cutoff"), "ElectricalDamping(b=1.0, cutoff=10.0)"),
}


class Reference(Protocol):
    """The motion that a hand follows, or that carries an environment along.

    One whose `samples` has a parameter `first` more, 0 if it is left out, gives the positions at the ticks first ..
    first+count-1: a live end then samples it as it goes. Of one without it a live end takes the first 3.6 million
    samples, an hour at 1 kHz, and after that it stays where it is.
    """

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


class ExactEnvironment(Protocol):
    """An environment of the slave, in one axis, in which the motion of a body has a closed form.

    If the plant has an inner state, the environment has `inner = True`.
    """

    def plant(self, body: MassDamper, dt: float) -> Plant:
        """The exact step of `body` in this environment."""
        ...


class IntegratedEnvironment(Protocol):
    """An environment in which the motion of a body is integrated: it has no closed form, or the body has friction.

    See `teleop.physics.implicit`.
    """

    def resistance(self) -> Resistance:
        """The force that a body meets in this environment, as coefficients."""
        ...


class MovingEnvironment(Protocol):
    """Another environment that is carried along a path."""

    @property
    def environment(self) -> ExactEnvironment | IntegratedEnvironment: ...
    @property
    def path(self) -> Reference: ...


Environment = ExactEnvironment | IntegratedEnvironment | MovingEnvironment


class ArrivalsLike(Protocol):
    """The packets that arrive in one direction of a link, sorted by time."""

    @property
    def packet(self) -> NDArray[np.int64]: ...
    @property
    def time_ns(self) -> NDArray[np.int64]: ...


class LinkLike(Protocol):
    """A link between the ends: direction 0 is forward (master to slave), 1 is backward."""

    def arrivals(self, direction: int, count: int, dt_ns: int, seed: int, size: int) -> ArrivalsLike:
        """The arrivals of packets 0 .. count-1, sent at the ticks: packet numbers and times in ns.

        One with a parameter `sent` more, an array of truths, is told which of them are sent where an end leaves out
        ticks; of one without it all are drawn, and those that are not sent are dropped where they arrive.
        """
        ...


class LeftOutLike(Protocol):
    """The ticks that an end leaves out: see `channel.left_out`."""

    def left_out(self, end: int, count: int, seed: int) -> NDArray[np.bool_]:
        """For each of the ticks 0 .. count-1, is it left out, of end 0 (the master) or 1 (the slave)."""
        ...


def varies(link: LinkLike) -> bool:
    """True unless all that a link does, in both directions, is a constant delay."""
    of_direction = getattr(link, "in_direction", None)
    if of_direction is None:
        return True
    return any(getattr(effect, "constant_ns", None) is None for way in (0, 1) for effect in of_direction(way))


Vector = float | tuple[float, ...]


_WITH_ALL: set[tuple[str, type]] = set()  # parts whose class has the attributes, so that each is looked at once


def has_shape(name: str, part: object) -> bool:
    """True if a part has the attributes that a run uses."""
    kind = type(part)
    if (name, kind) in _WITH_ALL:
        return True
    attributes = SHAPES[name][0]
    if all(hasattr(kind, each) for each in attributes) and not isinstance(part, type):
        _WITH_ALL.add((name, kind))
    return not isinstance(part, type) and all(hasattr(part, each) for each in attributes)


def is_known_by_class(name: str, part: object) -> bool:
    """True if the class of a part, whose shape was looked at, has the attributes that a run uses."""
    return (name, type(part)) in _WITH_ALL


def check_shape(name: str, part: object) -> None:
    """Refuse a part that lacks an attribute which a run uses."""
    if not has_shape(name, part):
        attributes, example = SHAPES[name]
        missing = [each for each in attributes if not hasattr(part, each)]
        if 0 < len(missing) < len(attributes):
            raise Refused(f"{name}: {type(part).__name__} has no {', '.join(missing)}; such a part has "
                          f"{', '.join(attributes)}, write for example {name}={example}")
        got = f"the class {part.__name__}" if isinstance(part, type) else repr(part)
        raise Refused(f"{name} must be something with {', '.join(attributes)}, not {got}; "
                      f"write for example {name}={example}")
