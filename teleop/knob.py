"""Knobs that declare themselves: unit, meaning and bounds stand in the annotation of the number.

    k_e: Annotated[float, Knob("N/m", "stiffness of the wall", low=0.0)] = 1000.0

So are the parameters of a scene declared, and the fields of a law, an effect or a velocity estimator. `teleop list`
shows what is declared, and a value out of bounds is refused in these terms. What is not declared has no unit and no
bounds, and works all the same. Below stand the knobs that most scenes have: `dt: knob.Tick = 1e-3`.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, MISSING, dataclass, fields
from functools import lru_cache, reduce
from operator import or_
from types import UnionType
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin, get_type_hints

from teleop.errors import Refused, nearest, number


@dataclass(frozen=True, slots=True)
class Knob:
    """Declaration of a knob. `low` and `high` are included in the range, `above` is not.

    Bounds say what is allowed, `span` where a search for a law's parameters looks (`teleop.studies.tune.strategy`).
    """

    unit: str = ""
    meaning: str = ""
    _: KW_ONLY
    low: float | None = None
    above: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()  # of a text; none: any text
    link: bool = False  # the knob sets the link of its scene and nothing else
    span: tuple[float, float] | None = None  # of a search: by equal ratios if it begins above 0; none: by the default
    stays: str = ""  # why no search turns it: what its value follows from

    def check(self, name: str, value: object) -> None:
        """Refuse a number, each number of a tuple, or a text that is not among the values of this knob."""
        for each in value if isinstance(value, tuple) else (value,):
            if isinstance(each, (int, float)) and not isinstance(each, bool):
                number(name, each, low=self.low, above=self.above, high=self.high, unit=self.unit)
            elif isinstance(each, str) and self.choices and each not in self.choices:
                raise Refused(f"{name} is one of {', '.join(self.choices)}, not {each!r}; "
                              f"{nearest(each, self.choices)}")


UNDECLARED = Knob()


class Declared(NamedTuple):
    """A knob with its type and its default, which is `...` where one must be given."""

    kind: Any
    default: Any
    knob: Knob


def declared(hint: Any) -> tuple[Any, Knob]:
    """Type in an annotation, without `Annotated`, and declaration of the knob.

    >>> declared(Annotated[float | None, Knob("s", "age of a message", above=0.0)])[1].unit
    's'
    """
    if get_origin(hint) is Annotated:
        kind, knob = declared(get_args(hint)[0])
        return kind, next((each for each in reversed(hint.__metadata__) if isinstance(each, Knob)), knob)
    if get_origin(hint) in (Union, UnionType):
        parts = [declared(part) for part in get_args(hint)]
        knobs = [knob for _, knob in parts if knob is not UNDECLARED]
        return reduce(or_, [kind for kind, _ in parts]), knobs[0] if knobs else UNDECLARED
    return hint, UNDECLARED


def knobs_of_fields(kind: Any) -> dict[str, Declared]:
    """Knobs of a dataclass by name: the fields that are given when one is made."""
    return _knobs_of_fields(kind)


@lru_cache(maxsize=256)
def _knobs_of_fields(kind: Any) -> dict[str, Declared]:
    settable = [field for field in fields(kind) if field.init]
    try:
        hints = get_type_hints(kind, include_extras=True)
    except Exception:  # a name in an annotation that cannot be found: the type is known as text alone
        hints = {field.name: field.type for field in settable}
    return {field.name: Declared(*_with_default(declared(hints[field.name]), field.default)) for field in settable}


def _with_default(kind_and_knob: tuple[Any, Knob], default: object) -> tuple[Any, Any, Knob]:
    return kind_and_knob[0], ... if default is MISSING else default, kind_and_knob[1]


def check_knobs(part: Any) -> None:
    """Refuse a dataclass with a number that is not finite, or a value that is out of the bounds that it declares."""
    for name, (kind, _, knob) in knobs_of_fields(type(part)).items():
        value = getattr(part, name)
        if kind in (float, int):
            number(name, value, low=knob.low, above=knob.above, high=knob.high, unit=knob.unit)
        else:
            knob.check(name, value)


LinkDelay = Annotated[float, Knob("s", "delay of the link, each way", low=0.0, link=True)]
Timeout = Annotated[float | None, Knob(
    "s", "silence after which the watchdogs ramp the force to zero; none: no watchdog", above=0.0)]
MessageAge = Annotated[float | None, Knob(
    "s", "age from which on a message that is played is no sign of the other end; none: at any age", above=0.0)]
MostForce = Annotated[float | None, Knob("N", "most force of either end; none: any", low=0.0)]
MostSlew = Annotated[float | None, Knob("N/s", "most change of either force; none: any, also a jump", above=0.0)]
MostSpeed = Annotated[float | None, Knob(
    "m/s", "speed from which on an end only brakes; none: it drives at any speed", low=1e-9)]
PowerBudget = Annotated[float | None, Knob(
    "W", "most power that either end gives out, with one second's worth in hand; none: no budget", above=0.0)]
ObserverBandwidth = Annotated[float | None, Knob(
    "1/s", "bandwidth of the observer of the hand's force; none: a force sensor", above=0.0)]
EnergyLedgers = Annotated[bool, Knob("", "record the energy ledgers")]
EncoderStep = Annotated[float | None, Knob(
    "m", "step of an encoder that rounds down; none: the position as it is", above=0.0)]
ControllerDamping = Annotated[float | None, Knob(
    "N s/m", "most damping of the passivity controller; none: no controller", low=0.0)]
ControllerRest = Annotated[float, Knob("m/s", "speed up to which the passivity controller adds no damping", low=0.0)]
MotorDamping = Annotated[float | None, Knob(
    "N s/m", "electrical damping of the motor, well above its cutoff; none: no such damping", low=0.0)]
MotorCutoff = Annotated[float, Knob("Hz", "frequency below which the electrical damping fades", above=0.0)]
Tolerance = Annotated[float, Knob("m", "error per tick that the integrator keeps to", above=0.0)]
Tick = Annotated[float, Knob("s", "length of a tick", low=1e-6, high=10.0)]
Duration = Annotated[float, Knob("s", "duration of the run", above=0.0)]


def spans(name: str, times: float | tuple[float, ...]) -> tuple[tuple[float, float], ...]:
    """Spans (from, to) out of times that begin and end one in turn. Raises `Refused` where one has no end."""
    times = times if isinstance(times, tuple) else (times,)
    if len(times) % 2:
        raise Refused(f"{name} names times in twos, from and to, and has {len(times)} of them; write for example "
                      f"{name}=2,3 or {name}=2,3,5,6")
    return tuple(zip(times[::2], times[1::2], strict=True))
