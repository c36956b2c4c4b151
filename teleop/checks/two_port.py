"""Does a law keep what teleop/law.py asks of it? `check_law(MyLaw())` says so in one line, or what to mend.

The probes are drawn from a fixed sequence, so a law that passes once passes always.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from math import inf, isfinite, isnan, nan
from struct import pack
from typing import Any, NamedTuple

from teleop.checks.trials import spread, try_claims
from teleop.errors import Refused, nearest
from teleop.knob import knobs_of_fields
from teleop.law import At, reads

LEDGERS = frozenset({"E_link", "E_port"})
ENDS = ("master", "slave")
TWO_PORT = ("master_start", "master", "slave_start", "slave")
ONE_PORT = ("start", "force")
AWKWARD = (0.0, -0.0, 1e-300, -1e-300, 5e-324, 1e50, -1e50)
BEYOND = (inf, -inf, nan, 1e300, -1e300)  # what a run that diverges comes to in its last tick
TICKS = 60  # of each probing run


def check_law(law: Any) -> None:
    """Raise `Refused` with one sentence for the first thing in which `law` is not a law; else return.

    Tried are: the class and its knobs; types and shapes of all that the ends answer, tick after tick;
    purity; finite answers to finite inputs, and no exception for any input; that an end reads no field of
    `At` but those that `reads` sees; and what the law claims (see `teleop.checks.trials`): that its ends draw no more
    from the waves than they brought, and in closed loops with random masses, walls and links that no ledger
    it claims goes below zero.
    A one-port law (`start`, `force`) is tried in the same spirit, see `teleop.checks.one_port`.
    """
    if is_one_port(law):
        from teleop.checks.one_port import probe, try_port

        _class(law, ONE_PORT)
        probe(law)
        try_port(law)
        return
    _class(law, TWO_PORT)
    for name in ENDS:
        _probe(End.of(law, name))
    try_claims(law)


def is_one_port(law: Any) -> bool:
    """Was the law meant to have one end: has it part of one, and nothing of two?"""
    return any(hasattr(law, name) for name in ONE_PORT) and not any(hasattr(law, name) for name in TWO_PORT)


def _class(law: Any, parts: tuple[str, ...]) -> None:
    """A frozen, keyword-only dataclass of floats, final, with `parts`; where it checks its knobs it refuses NaN."""
    if isinstance(law, type):
        raise Refused(f"check_law takes a law, not its class; write check_law({law.__name__}())")
    kind = type(law)
    name = kind.__name__
    if not is_dataclass(law) or not kind.__dataclass_params__.frozen:
        raise Refused(f"{name} is no frozen dataclass; write @dataclass(frozen=True, kw_only=True) above it")
    if kind.__bases__ != (object,):
        raise Refused(f"{name} inherits from {kind.__bases__[0].__name__}; write both ends out, "
                      "a law has no base class")
    for needed in parts:
        if not callable(getattr(law, needed, None)):
            kind_of_law = "a law" if parts == TWO_PORT else "a one-port law"
            raise Refused(f"{name} has no {needed}; {kind_of_law} has {', '.join(parts[:-1])} and {parts[-1]}")
    claims = getattr(law, "claims", None)
    if not isinstance(claims, frozenset):
        raise Refused(f"{name}.claims is {claims!r}; write claims: ClassVar[frozenset[str]] = frozenset()")
    for claim in sorted(claims - LEDGERS, key=str):
        raise Refused(f"{name} claims {claim!r}, which is no ledger; {nearest(str(claim), LEDGERS)}")
    kinds = {name: found.kind for name, found in knobs_of_fields(kind).items()}
    for knob in fields(law):
        _knob(law, name, knob.name, kinds.get(knob.name, knob.type), keyword=knob.kw_only is True)


def _knob(law: Any, name: str, knob: str, kind: object, *, keyword: bool) -> None:
    value = getattr(law, knob)
    if kind not in (float, "float") or isinstance(value, bool) or not isinstance(value, (int, float)):
        shown = getattr(kind, "__name__", kind)
        raise Refused(f"{name}.{knob} is {value!r} of {shown}; every field of a law is a number: "
                      f"declare {knob}: float")
    if not keyword:
        raise Refused(f"{name}.{knob} may be given by position; add kw_only=True to the dataclass")
    try:
        same = replace(law, **{knob: value})
    except Exception as error:
        raise Refused(f"{name} does not accept its own {knob}={value}: {error}; "
                      "mend __post_init__") from error
    if same != law:
        raise Refused(f"{name} made again with the same {knob} is another law; "
                      "let __post_init__ check and change nothing")
    if not hasattr(law, "__post_init__"):
        return  # checks nothing; what comes from a command line was checked there
    try:
        replace(law, **{knob: nan})
    except Refused:
        return
    except Exception as error:
        raise Refused(f"{name} meets {knob}=nan with {type(error).__name__}; "
                      f"let number({knob!r}, self.{knob}) of teleop refuse it") from error
    raise Refused(f"{name} accepts {knob}=nan; "
                  f"call number({knob!r}, self.{knob}) of teleop in __post_init__")


class Call(NamedTuple):
    """One tick of one end, as it was asked."""

    s: Any
    at: At
    rx: Any
    beside: Any  # the sums of another axis, or None


@dataclass(frozen=True, kw_only=True, slots=True)
class End:
    """One end of a law under test."""

    law: Any
    name: str
    start: Callable[[At], Any]
    tick: Callable[..., Any]
    sums: Callable[..., Any] | None
    seen: frozenset[str]  # the fields of At that it reads
    tx: type[Any]
    rx: type[Any]

    @classmethod
    def of(cls, law: Any, end: str) -> End:
        """The end `end` of `law`, its message types taken from the two starts."""
        name = f"{type(law).__name__}.{end}"
        tick, sums = getattr(law, end), getattr(law, f"{end}_sums", None)
        kinds = {}
        for each in ENDS:
            began = guarded(f"{type(law).__name__}.{each}_start", getattr(law, each + "_start"), REST)
            kinds[each] = _start(f"{type(law).__name__}.{each}_start", began)
        other = ENDS[1 - ENDS.index(end)]
        return cls(law=law, name=name, start=getattr(law, f"{end}_start"), tick=tick, sums=sums,
                   seen=reads(tick) | (reads(sums) if sums else frozenset()), tx=kinds[other], rx=kinds[end])

    def answer(self, call: Call) -> Any:
        """What the end answers; `Refused` if it raises."""
        if self.sums is None:
            return guarded(self.name, self.tick, call.s, call.at, call.rx)
        over = own = self.own(call)
        if call.beside is not None:
            over = type(own)(*[a + b for a, b in zip(own, call.beside, strict=True)])
        return guarded(self.name, self.tick, call.s, call.at, call.rx, over)

    def own(self, call: Call) -> Any:
        """The sums of this axis alone, checked; None for an end without."""
        if self.sums is None:
            return None
        sums = guarded(f"{self.name}_sums", self.sums, call.s, call.at, call.rx)
        _floats(f"{self.name}_sums", "Sums", sums)
        return sums


REST = At(0.0, 0.0, 0.0, 0.0, 0.0, False, inf, 1e-3)


def guarded(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """What the function answers; `Refused` if it raises."""
    try:
        return function(*arguments)
    except Exception as error:
        raise Refused(f"{name} raised {type(error).__name__}: {error}, given {arguments}; {_cure(error)}") from error


def _cure(error: Exception) -> str:
    """What to do about what a law's function raised."""
    if isinstance(error, AttributeError) and isinstance(error.obj, tuple) and hasattr(error.obj, "_fields"):
        kind = type(error.obj)
        own = f"has {', '.join(kind._fields)}" if kind._fields else "has no fields"
        return f"{'an At' if kind is At else kind.__name__} {own}"
    if isinstance(error, ArithmeticError | ValueError):
        return "guard denominators with max(.., eps), write x*x for x**2, keep sqrt and exp in their range"
    return "mend that line"


def _start(name: str, began: Any) -> type[Any]:
    """Check what a start answered; the type of its message."""
    if not isinstance(began, tuple) or len(began) != 2:
        raise Refused(f"{name} answered {began!r}; it answers (state, message held before the first comes)")
    check_state(name, began[0])
    _floats(name, "the message", began[1])
    return type(began[1])


def _floats(name: str, what: str, value: Any) -> None:
    if not isinstance(value, tuple) or not hasattr(value, "_fields"):
        raise Refused(f"{name}: {what} is {value!r}; make it a NamedTuple of floats")
    for field, entry in zip(value._fields, value, strict=True):
        if type(entry) is not float:
            raise Refused(f"{name}: {what} has {field}={entry!r} of type {type(entry).__name__}; "
                          "write it as a float")


def check_state(name: str, state: Any) -> None:
    """Refuse a state that is neither `()` nor a NamedTuple of floats."""
    if state != () or type(state) is not tuple:
        _floats(name, "the state", state)


def _probe(end: End) -> None:
    """Ask an end in many situations, tick after tick, and again in another order."""
    asked: list[tuple[Call, str]] = []
    dice = spread(end.name)
    before = repr(end.law)
    for reach in ((), (), AWKWARD, AWKWARD, AWKWARD + BEYOND):
        finite = inf not in reach
        at = situation(dice, reach)._replace(f_held=0.0, dx=0.0, fresh=False, age=inf)
        began = guarded(f"{end.name}_start", end.start, at)
        _start(f"{end.name}_start", began)
        _blind(end, began, at)
        s, beside = began[0], None
        for _ in range(TICKS):
            call = Call(s, situation(dice, reach), end.rx(*[_value(dice, reach) for _ in end.rx._fields]), beside)
            got = end.answer(call)
            _answered(end, call, got, finite=finite)
            _again(end, call, in_bits(got))
            _unseen(end, call, got)
            asked.append((call, in_bits(got)))
            s, beside = got[2], end.own(call)
            if not all(map(isfinite, s)):
                s = began[0]
    for call, bits in reversed(asked):
        _again(end, call, bits)
    if repr(end.law) != before:
        raise Refused(f"{end.name} changed the law from {before} to {end.law!r}; use the state")


def _again(end: End, call: Call, bits: str) -> None:
    """The same arguments have the same answer."""
    if in_bits(end.answer(call)) != bits:
        raise Refused(f"{end.name} answers the same arguments differently the second time; "
                      "keep what it remembers in its state, and nowhere else")


def _answered(end: End, call: Call, got: Any, *, finite: bool) -> None:
    """Type and shape of an answer, the same as ever, and finite."""
    if not isinstance(got, tuple) or len(got) != 3:
        raise Refused(f"{end.name} answered {got!r}; it answers (force, message, state)")
    f, tx, s = got
    if type(f) is not float:
        raise Refused(f"{end.name}: the force is {f!r} of type {type(f).__name__}; answer a float")
    _floats(end.name, "the message", tx)
    check_state(end.name, s)
    for what, now, ever in (("a message", type(tx), end.tx), ("a state", type(s), type(call.s))):
        if now is not ever:
            raise Refused(f"{end.name} answered {what} of type {now.__name__} where the start gave "
                          f"{ever.__name__}; use one type throughout")
    if finite and not all(map(isfinite, (f, *tx, *s))):
        raise Refused(f"{end.name} answered {got!r} to finite arguments {call.at}, {call.rx}, {call.s}; "
                      "guard denominators with max(.., eps)")


def _unseen(end: End, call: Call, got: Any) -> None:
    """What an end does not visibly read may be anything."""
    for field in At._fields:
        if field in end.seen:
            continue
        if in_bits(end.answer(call._replace(at=without(call.at, field)))) != in_bits(got):
            raise Refused(f"{end.name} reads {field} where it cannot be seen; write at.{field} in {end.name} "
                          "itself or in a plain function that it calls by name")


def _blind(end: End, began: Any, at: At) -> None:
    """A start may read `f` only if its end does: else nobody measures it."""
    if "f" not in end.seen and in_bits(end.start(without(at, "f"))) != in_bits(began):
        raise Refused(f"{end.name}_start reads f, but {end.name} does not, so nobody measures it; "
                      "start without it")


def without(at: At, field: str) -> At:
    """`at` with one field made to show: NaN, or for `fresh` the opposite."""
    changed: Mapping[str, Any] = {"fresh": not at.fresh} if field == "fresh" else {field: nan}
    return at._replace(**changed)


def _value(dice: Iterator[float], reach: tuple[float, ...]) -> float:
    """One of `reach`, or a number of either sign between 1e-4 and 10."""
    if reach and next(dice) < 0.5:
        return reach[int(next(dice) * len(reach))]
    size: float = 10.0 ** (5.0 * next(dice) - 4.0)
    return size if next(dice) < 0.5 else -size


def situation(dice: Iterator[float], reach: tuple[float, ...]) -> At:
    """A situation; the tick and the age keep to what they can be."""
    x, v, f, f_held, dx = (_value(dice, reach) for _ in range(5))
    age = (inf, 0.0, 1e-3, 0.05, 1e5)[int(next(dice) * 5)]
    return At(x, v, f, f_held, dx, next(dice) < 0.5, age, (1e-3, 1e-3, 1e-6, 10.0)[int(next(dice) * 4)])


def in_bits(answer: Any) -> str:
    """An answer's floats to the bit, with what they are in; NaN equals itself, 0.0 is not -0.0."""
    if isinstance(answer, float):
        return pack("<d", answer).hex() if not isnan(answer) else "nan"
    return f"{type(answer).__name__}({','.join(in_bits(each) for each in answer)})"
