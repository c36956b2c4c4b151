"""Control laws: what their methods take and return, and how a law is found by name.

A law is a frozen, keyword-only dataclass of floats with both of its ends in one file, and it has no base
class. Its methods take the state of an end, its situation `at` and the message `rx` that came last, and
return the force in N, the message to send and the next state:

    master_start(at) -> state, Back        slave_start(at) -> state, Forth
    master(state, at, rx: Back) -> f_m, Forth, state
    slave(state, at, rx: Forth) -> f_s, Back, state

`Forth` (master to slave) and `Back` (slave to master) are NamedTuples of floats, and a packet carries their
fields. A state is a NamedTuple of floats too, or `()`. The message that a start returns is the one that this
end is given until the first message comes. A method is called for each axis by itself. An end that couples
the axes also has `master_sums(state, at, rx) -> Sums` (or `slave_sums`): a NamedTuple of floats that is
summed over the axes, left to right, and given to the end's method as a fourth argument `over`.

A one-port law, for a scene without a slave, has one end and no messages:

    start(at) -> state                     force(state, at) -> f_m, state

Each field of a message is of a kind, a wave, a total or a sample (`teleop.kind`). What else a law may offer is in
`teleop.law.offers`, the ledgers that it claims to keep among it, and what it may tell the analyses of itself in
`teleop.law.analysis_offers`.

Only those fields of `At` are computed that the lines of an end name; the others are NaN, so that a field read
in a way that `reads` cannot see shows in the force at once. `teleop.law.contract` checks a law when a scene
is made of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from inspect import getattr_static
from math import inf, nan
from types import CodeType, FunctionType
from typing import Any, NamedTuple, Protocol

from teleop.naming import find, known_places


class At(NamedTuple):
    """The situation of one end at one tick, in one axis. SI units.

    `f_held` and `dx` belong together: the force that the motor held over the last tick, after every stage behind
    the law (watchdog and force cap among them), and the motion under it. The last tick is the last that this end ran:
    one that could not be run in time is left out, and the force is held until the next. So `span` is dt, and a whole
    number of times dt after ticks that were left out; what a law integrates over time, it integrates over `span`.
    `gain` is what the watchdog had let the device have of the last force: a law that tells the other end of its force
    tells of that, see `teleop.laws.wave`. A field added later breaks no law.
    """

    x: float  # position, m
    v: float  # velocity, m/s
    f: float  # external force, N: f_h of the hand at the master (sensor or observer), f_env at the slave
    f_held: float  # force held over the last tick, N
    dx: float  # motion over the last tick, m
    fresh: bool  # True if a message is played at this tick
    age: float  # s since the newest message was sent, inf before the first
    dt: float  # s
    span: float = nan  # s since this end's last tick: dt, more after ticks that were left out
    gain: float = 1.0  # the watchdog's gain at the last tick, 0 to 1; 1 without a watchdog


class Law(Protocol):
    """The shape of a law with two ends. `claims`: the energy ledgers that it keeps, see `teleop.law.offers`."""

    @property
    def claims(self) -> Mapping[str, str]: ...

    def master_start(self, at: At, /) -> tuple[Any, Any]: ...
    def slave_start(self, at: At, /) -> tuple[Any, Any]: ...

    # Arguments: state, at, rx, and `over` if the end has sums. The types of state and messages are the law's own.
    def master(self, *args: Any, **kwargs: Any) -> tuple[float, Any, Any]: ...
    def slave(self, *args: Any, **kwargs: Any) -> tuple[float, Any, Any]: ...


class OnePortLaw(Protocol):
    """The shape of a law with one end, for a scene without a slave: it renders an impedance to the hand by itself."""

    @property
    def claims(self) -> Mapping[str, str]: ...

    def start(self, at: At, /) -> Any: ...
    def force(self, s: Any, at: At, /) -> tuple[float, Any]: ...


BUILT_IN = {
    "direct": "teleop.laws.direct:Direct",
    "four_channel": "teleop.laws.four_channel:FourChannel",
    "iss": "teleop.laws.iss:ISS",
    "model_mediated": "teleop.laws.model_mediated:ModelMediated",
    "p_d": "teleop.laws.p_d:PDamped",
    "pd_d": "teleop.laws.pd_d:PDDamped",
    "pfra": "teleop.laws.pfra:PFRA",
    "pp": "teleop.laws.pp:PositionPosition",
    "pspm": "teleop.laws.pspm:PSPM",
    "tdpa": "teleop.laws.tdpa:TDPA",
    "two_layer": "teleop.laws.two_layer:TwoLayer",
    "virtual_coupling": "teleop.laws.virtual_coupling:VirtualCoupling",
    "virtual_wall": "teleop.laws.virtual_wall:VirtualWall",
    "wave": "teleop.laws.wave:Wave",
    "wave_filter": "teleop.laws.wave_filter:WaveFilter",
    "wave_matched": "teleop.laws.wave_matched:WaveMatched",
    "wave_position": "teleop.laws.wave_position:WavePosition",
    "wave_prediction": "teleop.laws.wave_prediction:WavePrediction",
    "wave_scaled": "teleop.laws.wave_scaled:WaveScaled",
}


GROUP = "teleop.laws"  # of entry points


def known_laws() -> dict[str, str]:
    """Places of all laws, built in and of installed packages: `name -> "module:class"`. No law is imported."""
    return known_places(GROUP, BUILT_IN)


def two_port_laws() -> list[str]:
    """Names of every installed law with two ends, in order of the alphabet. Plug-ins are imported."""
    return sorted(name for name in known_laws() if hasattr(find_law(name), "slave"))


def find_law(name: str) -> Callable[..., Any]:
    """The class of the law `name`. Raises `Refused` with the nearest name if there is none.

    >>> find_law("wave")(b=2.0).b
    2.0
    """
    law: Callable[..., Any] = find("law", GROUP, BUILT_IN, name)
    return law


def law_name(law: object) -> str:
    """The name under which `find_law` finds this law; of a law that is not built in the name of its class."""
    return name_of_law(type(law))


def name_of_law(kind: type[Any]) -> str:
    """The same of the law's class; of one with stages around it as it is typed, "deadband | wave"."""
    known_as: str | None = vars(kind).get("known_as")
    return known_as or _built_in_name(kind) or kind.__name__


def is_built_in(law: object) -> bool:
    """True if the law, whatever stages stand around it, comes with this package."""
    return _built_in_name(innermost(type(law))) is not None


def innermost(kind: type[Any]) -> type[Any]:
    """The class of the law that stages stand around (`teleop.laws.around`); of any other law its own."""
    while (inner := vars(kind).get("inner_law")) is not None:
        kind = inner
    return kind


def _built_in_name(kind: type[Any]) -> str | None:
    where = f"{kind.__module__}:{kind.__name__}"
    return next((name for name, place in BUILT_IN.items() if place == where), None)


def start_at(x: float, v: float, f: float, dt: float) -> At:
    """The situation of an end before its first tick (m, m/s, N, s): no force held, no message yet."""
    return At(x, v, f, 0.0, 0.0, False, inf, dt, dt, 1.0)


def messages(law: Law, dt: float = 1e-3) -> tuple[type[Any], type[Any]]:
    """The law's message types `(Forth, Back)`: those of the messages that its two starts return. `dt` in s."""
    still = start_at(0.0, 0.0, 0.0, dt)
    return type(law.slave_start(still)[1]), type(law.master_start(still)[1])


class IdentityKey:
    """A law as a key of caches that is equal to itself alone; its attributes are the law's."""

    def __init__(self, law: Any) -> None:
        self._law = law

    def __getattr__(self, name: str) -> Any:
        return getattr(self._law, name)


def functions_of(law: Any) -> Any:
    """A key for the functions behind a law's methods: its class, or for a law that wraps another a key of its own."""
    kind: Any = type(law)
    return kind if _of_its_class(kind) else IdentityKey(law)


@lru_cache(maxsize=256)
def _of_its_class(kind: Any) -> bool:
    ends = ("master", "slave") if hasattr(kind, "master") or not hasattr(kind, "force") else ("force",)
    return all(isinstance(getattr_static(kind, end, None), FunctionType) for end in ends)


def reads(end: Callable[..., Any]) -> frozenset[str]:
    """Fields of `At` that the lines of an end name, and those of the plain functions that it calls.

    An end that calls the same end of another law has the fields of that one; where its class is not named, as with
    `super()` or a law that is kept, it has all but the external force, which takes an observer: that has to be named.
    """
    function = getattr(end, "__func__", end)
    return _reads(function) if isinstance(function, FunctionType) else frozenset()


@lru_cache(maxsize=256)
def _reads(function: FunctionType) -> frozenset[str]:
    names: set[str] = set()
    seen: set[CodeType] = set()
    waiting = _code(function)
    while waiting:
        code, around = waiting.pop()
        if code in seen:
            continue
        seen.add(code)
        names.update(name for name in code.co_names if name in At._fields)
        # Comprehensions and lambdas are code of their own; which of them are depends on the Python version.
        waiting.extend((inner, around) for inner in code.co_consts if isinstance(inner, CodeType))
        named = [around.get(name) for name in code.co_names]
        waiting.extend(each for thing in named for each in _code(thing))
        if function.__name__ in code.co_names:
            others = [each for kind in named if isinstance(kind, type)
                      for each in _code(getattr(kind, function.__name__, None))]
            waiting.extend(others)
            names.update(() if others else {*At._fields} - {"f"})
    return frozenset(names)


def _code(function: object) -> list[tuple[CodeType, dict[str, Any]]]:
    """The code of a plain function with its globals; an empty list for any other object."""
    return [(function.__code__, function.__globals__)] if isinstance(function, FunctionType) else []
