"""What a control law is, and how one is found.

A law is a frozen, keyword-only dataclass of floats with both of its ends in one file. It has no base
class; this module says what the ends are given and what they answer.

    master_start(at) -> state, Back        slave_start(at) -> state, Forth
    master(state, at, rx: Back) -> f_m, Forth, state
    slave(state, at, rx: Forth) -> f_s, Back, state

`Forth` (master to slave) and `Back` are NamedTuples of floats: their fields are what the packet
carries. The states are NamedTuples of floats too (or `()`); the message that a `*_start` returns is
the one held before the first arrives. Everything is per axis. An end that couples the axes also has
`master_sums(state, at, rx) -> Sums` (or `slave_sums`), a NamedTuple of floats that is summed over the
axes, left to right, and is then given to the end as a fourth argument `over`.

A one-port law, for a scene without a slave, has one end and no messages:

    start(at) -> state                     force(state, at) -> f_m, state

An end pays only for the fields of `At` that its lines name: what it does not read is not computed and
is NaN, so a field read by a way that `reads` cannot see shows at once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from inspect import getattr_static
from types import CodeType, FunctionType
from typing import Any, NamedTuple, Protocol

from teleop.naming import find, known


class At(NamedTuple):
    """All that one end knows at one tick, in one axis. SI units.

    A field added later breaks no law. `f_held` and `dx` belong together: the force really held over
    the last tick (cap and watchdog included) and the motion under it.
    """

    x: float  # position, m
    v: float  # velocity, m/s
    f: float  # external force, N: f_h at the master (sensor or observer), f_env at the slave
    f_held: float  # N
    dx: float  # m
    fresh: bool  # is there a message to play at this tick
    age: float  # s since the newest message was sent, inf before the first
    dt: float  # s


class Law(Protocol):
    """The shape of a law; see the module's text. `claims` names the ledgers it keeps from going below zero."""

    @property
    def claims(self) -> frozenset[str]: ...

    def master_start(self, at: At, /) -> tuple[Any, Any]: ...
    def slave_start(self, at: At, /) -> tuple[Any, Any]: ...

    # Of (state, at, rx), or with `over` behind them: `Any` of all, for the messages' types are the law's own.
    def master(self, *args: Any, **kwargs: Any) -> tuple[float, Any, Any]: ...
    def slave(self, *args: Any, **kwargs: Any) -> tuple[float, Any, Any]: ...


class OnePortLaw(Protocol):
    """A law with one end, for a scene without a slave: it renders something to the hand by itself."""

    @property
    def claims(self) -> frozenset[str]: ...

    def start(self, at: At, /) -> Any: ...
    def force(self, s: Any, at: At, /) -> tuple[float, Any]: ...


BUILT_IN = {
    "direct": "teleop.laws.direct:Direct",
    "pfra": "teleop.laws.pfra:PFRA",
    "virtual_coupling": "teleop.laws.virtual_coupling:VirtualCoupling",
    "virtual_wall": "teleop.laws.virtual_wall:VirtualWall",
    "wave": "teleop.laws.wave:Wave",
}


GROUP = "teleop.laws"  # of entry points


def known_laws() -> dict[str, str]:
    """Every law that can be named: `name -> "module:class"`, built in and from plug-ins, none imported."""
    return known(GROUP, BUILT_IN)


def find_law(name: str) -> Callable[..., Any]:
    """The law's class, loaded now. Raises `Refused`, naming the nearest, if there is none of that name.

    >>> find_law("wave")(b=2.0).b
    2.0
    """
    law: Callable[..., Any] = find("law", GROUP, BUILT_IN, name)
    return law


def law_name(law: object) -> str:
    """The name under which `find_law` finds this law, or its class's name for one that is not listed."""
    kind = type(law)
    where = f"{kind.__module__}:{kind.__name__}"
    return next((name for name, place in BUILT_IN.items() if place == where), kind.__name__)


def start_at(x: float, v: float, f: float, dt: float) -> At:
    """What an end knows before the first tick: at rest in `f`, nothing held, nothing received."""
    return At(x, v, f, 0.0, 0.0, False, float("inf"), dt)


def messages(law: Law, dt: float = 1e-3) -> tuple[type[Any], type[Any]]:
    """The law's message types `(Forth, Back)`, as its two starts show them."""
    still = start_at(0.0, 0.0, 0.0, dt)
    return type(law.slave_start(still)[1]), type(law.master_start(still)[1])


class _Itself:
    """A law by itself: as a key it is no other, whether it has a hash or not."""

    def __init__(self, law: Any) -> None:
        self._law = law

    def __getattr__(self, name: str) -> Any:
        return getattr(self._law, name)


def functions_of(law: Any) -> Any:
    """What stands for the functions of a law: its class, or a thing of its own where it answers with another's."""
    kind: Any = type(law)
    return kind if _of_its_class(kind) else _Itself(law)


@lru_cache(maxsize=256)
def _of_its_class(kind: Any) -> bool:
    ends = ("master", "slave") if hasattr(kind, "master") or not hasattr(kind, "force") else ("force",)
    return all(isinstance(getattr_static(kind, end, None), FunctionType) for end in ends)


def reads(end: Callable[..., Any]) -> frozenset[str]:
    """Which fields of `At` an end's lines name, those of the plain functions it calls included."""
    function = getattr(end, "__func__", end)
    return _reads(function) if isinstance(function, FunctionType) else frozenset()


@lru_cache(maxsize=256)
def _reads(function: FunctionType) -> frozenset[str]:
    found: set[str] = set()
    seen: set[CodeType] = set()
    waiting = _code(function)
    while waiting:
        code, around = waiting.pop()
        if code in seen:
            continue
        seen.add(code)
        found.update(name for name in code.co_names if name in At._fields)
        # Comprehensions and lambdas are code of their own; which of them are depends on the Python version.
        waiting.extend((inner, around) for inner in code.co_consts if isinstance(inner, CodeType))
        for name in code.co_names:
            waiting.extend(_code(around.get(name)))
    return frozenset(found)


def _code(function: object) -> list[tuple[CodeType, dict[str, Any]]]:
    """A plain function's code and what it finds by name; nothing of anything else."""
    return [(function.__code__, function.__globals__)] if isinstance(function, FunctionType) else []
