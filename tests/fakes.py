"""One stand-in of each kind, with knobs: a law, a device, an effect of a link, a wire, a clock, a terminal.

A knob is a keyword of the constructor or, in a subclass, an attribute of the class. A callable knob says what happens:
`raising(error, after)` is one that fits everywhere.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, make_dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
import pytest

from channel import Effect, Ints, Rng, by_time
from teleop import At, Reading

if TYPE_CHECKING:
    from teleop.live.net.wire import Wire


def usually(names: str, cases: Iterable[Any], *usual: Any) -> pytest.MarkDecorator:
    """Parametrize `names` by the cases: those among `usual` run in every suite, the others with `-m full` alone."""
    values = [case if "," in names else (case,) for case in cases]
    named = [case if "," in names else (case,) for case in usual]
    assert all(case in values for case in named), "each is one of the cases"
    return pytest.mark.parametrize(names, [
        pytest.param(*case, marks=[] if case in named else pytest.mark.full) for case in values])


def raising(error: BaseException, after: int = 0) -> Callable[..., Any]:
    """A function of any arguments that returns its last one `after` times, and raises `error` from then on."""
    calls = iter(range(after))

    def call(*arguments: Any, **_: Any) -> Any:
        if next(calls, None) is None:
            raise error.with_traceback(None)
        return arguments[-1] if arguments else None

    return call


# Laws


class Motion(NamedTuple):
    x: float  # m
    v: float  # m/s


@dataclass(frozen=True, kw_only=True)
class Springs:
    """A position-position law: each end is tied to the other by a spring K and a damper B, and damped by Bd."""

    K: float = 400.0
    B: float = 4.0
    Bd: float = 0.0

    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At) -> tuple[tuple[()], Motion]:
        return (), Motion(at.x, 0.0)

    def slave_start(self, at: At) -> tuple[tuple[()], Motion]:
        return (), Motion(at.x, 0.0)

    def master(self, s: tuple[()], at: At, rx: Motion) -> tuple[float, Motion, tuple[()]]:
        return self.K * (at.x - rx.x) + self.B * (at.v - rx.v) + self.Bd * at.v, Motion(at.x, at.v), s

    def slave(self, s: tuple[()], at: At, rx: Motion) -> tuple[float, Motion, tuple[()]]:
        return self.K * (rx.x - at.x) + self.B * (rx.v - at.v) - self.Bd * at.v, Motion(at.x, at.v), s


@dataclass(frozen=True, kw_only=True)
class OneSpring:
    """A one-port law: a spring and a damper at x = 0."""

    K: float = 400.0
    B: float = 0.0

    claims: ClassVar[dict[str, str]] = {}

    def start(self, at: At) -> tuple[()]:
        return ()

    def force(self, s: tuple[()], at: At) -> tuple[float, tuple[()]]:
        return self.K * at.x + self.B * at.v, s


def law_of(base: type[Any] = Springs, *, name: str = "", knobs: Iterable[Any] = (), **parts: Any) -> Any:
    """The class of `base` with other parts: methods, `claims`, `shows`...; `knobs`: (name, type, default) each.

    >>> law_of(master=lambda self, s, at, rx: (self.b * at.v, rx, s), knobs=[("b", float, 1.0)])(b=2.0).b
    2.0
    """
    every = [*[(one.name, one.type, one.default) for one in fields(base)], *knobs]  # a law has no base class
    methods = {part: vars(base)[part] for part in vars(base) if not part.startswith("_") and part not in
               {one.name for one in fields(base)}}
    made = make_dataclass(name or base.__name__, every, namespace={**methods, **parts}, frozen=True, kw_only=True)
    made.__module__ = __name__
    return made


# Devices and robots


class Body:
    """A device or robot: a mass of 1 kg that nothing but its motor moves; `mass=None`: it stands still.

    It is its own maker: `Body` and `partial(Body, x=0.1)` are called with a scene, which is not looked at.
    """

    mass: float | None = 1.0  # kg
    dt = 1e-3  # s
    axes = 1
    x: Any = 0.0  # m, where it starts, of all axes
    v: Any = 0.0  # m/s; of one that stands still what it reads all the same
    f: Any = None  # N that it senses; None: no sensor
    way = 1.0  # -1: its force acts the other way
    jumps = 0.0  # m/N by which a force moves it at once
    scale_x = scale_v = 1.0  # of what it reads
    late = 0  # readings by which what it reads is old
    inner: Any = None  # a device that moves in place of the mass
    reads: Callable[[int, Reading], Any] | None = None  # what is read in place of this at tick k; it may raise or hang
    holds: Callable[[Any], Any] | None = None  # what is held in place of this force; it may raise
    closes: Callable[[], Any] | None = None
    deadline: float | None = 0.15  # s
    simulated = True

    def __init__(self, _scene: Any = None, **knobs: Any) -> None:
        assert all(hasattr(self, name) for name in knobs), knobs
        self.__dict__.update(knobs)
        self.k = self.at = 0  # the tick up to which it moved; that of the newest reading
        self.closed = 0
        self.held: list[tuple[float, ...]] = []  # every force, and at which tick
        self.ticks: list[int] = []
        self.past: list[Reading] = []
        self.force: tuple[float, ...] = (0.0,) * self.axes
        if self.mass is not None:
            self.x, self.v = [self.x] * self.axes, [self.v] * self.axes

    def read(self, k: int) -> Any:
        self.at = k
        reading = self.inner.read(k) if self.inner is not None else self.moved(k)
        if self.late:
            self.past.append(reading)
            reading = self.past[max(0, len(self.past) - 1 - self.late)]
        return reading if self.reads is None else self.reads(k, reading)

    def moved(self, k: int) -> Reading:
        """What is read of the mass at tick k."""
        while self.k < k:
            self.k += 1
            if self.mass is not None:
                for i, force in enumerate(self.force):
                    self.v[i] += self.dt * self.way * force / self.mass
                    self.x[i] += self.dt * self.v[i]
        x, v = (n if isinstance(n, list | tuple) else [n] * self.axes for n in (self.x, self.v))
        f = self.f if self.f is None or isinstance(self.f, tuple) else (self.f,) * self.axes
        return Reading(tuple(self.scale_x * one for one in x), tuple(self.scale_v * one for one in v), f)

    def hold(self, force: tuple[float, ...]) -> None:
        if self.holds is not None:
            force = self.holds(force)
        self.held.append(force)
        self.ticks.append(self.at)
        self.force = force
        if self.jumps:
            self.x = [x + self.jumps * one for x, one in zip(self.x, force, strict=True)]
        if self.inner is not None:
            self.inner.hold(force)

    def close(self) -> None:
        self.closed += 1
        if self.closes is not None:
            self.closes()


def at_tick(k: int, act: Callable[[], object]) -> Callable[[int, Reading], Reading]:
    """`reads` of a device that does something at its first reading from tick k on."""
    due = [act]

    def reads(now: int, reading: Reading) -> Reading:
        if now >= k and due:
            due.pop()()
        return reading

    return reads


WELL = Reading((0.1,), (0.2,), (0.3,))
standing = partial(Body, mass=None, x=0.5, v=0.25)  # nothing moves it, whatever it says; f: what its sensor has, N


def always(found: Any) -> Callable[[int, Reading], Any]:
    """`reads` of a device that has this for its reading, or an error that it raises, or a function of the tick."""
    def reads(k: int, _reading: Reading) -> Any:
        now = found(k) if callable(found) else found
        if isinstance(now, BaseException):
            raise now.with_traceback(None)
        return now

    return reads


def reading(found: Any = WELL, **knobs: Any) -> Body:
    return Body(reads=always(found), **knobs)


# The way between


@dataclass(frozen=True)
class ByNumber(Effect):
    """An effect by the packet's number alone: `late(k)` in ns; None: it is lost. `entered` keeps when each came in."""

    late: Callable[[int], int | None] = lambda _k: 0

    @cached_property
    def entered(self) -> list[int]:
        return []

    def begin(self, rng: Rng) -> None:
        """No state."""

    def carry(self, state: None, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, None]:
        self.entered.extend(time_ns.tolist())
        late = {k: self.late(k) for k in packet.tolist()}
        kept = np.array([late[k] is not None for k in packet.tolist()], bool)
        delay = np.array([late[k] for k in packet[kept].tolist()], np.int64)
        return *by_time(packet[kept], time_ns[kept] + delay), None


def wire_of(drops: Callable[[bytes], bool] = lambda _data: False) -> type[Wire]:
    """A class of real wires that keep what comes in (`taken`) and lose what they are to send where `drops` says so."""
    from teleop.live.net.wire import Wire

    class Tapped(Wire):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self.taken: list[bytes] = []

        def send(self, data: bytes) -> None:
            if not drops(data):
                super().send(data)

        def receive(self) -> Any:
            got = super().receive()
            if got is not None and got[0] is not None:
                self.taken.append(got[0])
            return got

    return Tapped


# Clock and terminal


class Clock:
    """A clock in ns that goes on by `step` at every look. It stands in for a function or for the module `time`."""

    def __init__(self, now: int = 0, step: int = 0) -> None:
        self.now, self.step = now, step

    def __call__(self) -> int:
        self.now += self.step
        return self.now

    monotonic_ns = perf_counter_ns = time_ns = process_time_ns = __call__

    def seconds(self) -> float:
        return self() * 1e-9

    monotonic = perf_counter = time = process_time = seconds

    def sleep(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)


class Terminal(io.StringIO):
    """A terminal, or with `is_terminal=False` a stream that is none; `lines`: what stands on it after every CR."""

    def __init__(self, *, is_terminal: bool = True) -> None:
        super().__init__()
        self.is_terminal = is_terminal

    def isatty(self) -> bool:
        return self.is_terminal

    def fileno(self) -> int:
        return 1

    def lines(self) -> list[str]:
        shown = []
        for line in self.getvalue().split("\n"):
            screen = ""
            for text in line.split("\r"):
                screen = text + screen[len(text):]
            shown.append(screen)
        return shown
