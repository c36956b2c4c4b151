"""The check of a law against teleop/law/__init__.py: `check_law(MyLaw())` passes, or refuses with one sentence.

The probes are drawn from a fixed sequence, so a law that passes once passes always.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from math import inf, isfinite, nan
from typing import Any, NamedTuple

from teleop.checks.conformance import try_conformance
from teleop.checks.engines import try_engines
from teleop.checks.probing import (
    REACHES,
    TICKS,
    answer,
    ask_again,
    check_blind_start,
    situation,
    unseen,
    value,
    without,
)
from teleop.checks.search import try_worst
from teleop.checks.trials import spread, try_claims
from teleop.errors import Refused
from teleop.knob import knobs_of_fields
from teleop.law import At, reads
from teleop.law.contract import REST, Method, check_contract, in_bits

ENDS = ("master", "slave")
TWO_PORT = ("master_start", "master", "slave_start", "slave")
ONE_PORT = ("start", "force")


def check_law(law: Any, *, compiled: bool = True) -> None:
    """Raise `Refused` with one sentence for the first thing in which `law` is not a law; else return.

    Tried are: the class and its knobs; the contract that every scene holds its law to (`teleop.law.contract`); types
    and shapes of all answers, tick after tick; purity; finite answers to finite inputs, and no exception for any input;
    that an end reads no field of `At` but those that `reads` sees; signs, starts, messages and what its conditions
    tell to type (`teleop.checks.conformance`); the claims (`teleop.checks.trials`): that an end draws no more from
    the waves than they brought, that in closed loops with random masses, walls and links no ledger that the law claims
    goes below zero, and that the energy that it keeps came in by its ports; the same where an adversary chooses gains,
    bodies, hand, walls and link (`teleop.checks.search`); and that every engine of a sweep gives the
    figures of a single run to the bit (`teleop.checks.engines`). `compiled=False` leaves out the compiled engines,
    which take some seconds. A one-port law (`start`, `force`) is tried in the same spirit, see
    `teleop.checks.one_port`.
    """
    if is_one_port(law):
        from teleop.checks.one_port import probe, try_port

        _check_class(law, ONE_PORT)
        check_contract(law)
        probe(law)
        try_port(law)
        try_worst(law)
        return
    _check_class(law, TWO_PORT)
    check_contract(law)
    for name in ENDS:
        _probe(LawEnd.of(law, name))
    try_conformance(law)
    try_claims(law)
    try_worst(law)
    try_engines(law, compiled=compiled)


def is_one_port(law: Any) -> bool:
    """True if the law has a part of a one-port law, and none of a law with two ends."""
    return any(hasattr(law, name) for name in ONE_PORT) and not any(hasattr(law, name) for name in TWO_PORT)


def _check_class(law: Any, parts: tuple[str, ...]) -> None:
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
    if not isinstance(claims, Mapping):
        raise Refused(f"{name}.claims is {claims!r}; write claims: ClassVar[dict[str, str]] = {{}}, or "
                      '{"E_link": "any link"}')
    kinds = {name: found.kind for name, found in knobs_of_fields(kind).items()}
    for knob in fields(law):
        _check_knob(law, name, knob.name, kinds.get(knob.name, knob.type), keyword=knob.kw_only is True)


def _check_knob(law: Any, name: str, knob: str, kind: object, *, keyword: bool) -> None:
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
    """The arguments of one tick of one end."""

    s: Any
    at: At
    rx: Any
    beside: Any  # the sums of another axis, or None


@dataclass(frozen=True, kw_only=True, slots=True)
class LawEnd:
    """One end of a law under test."""

    law: Any
    name: str
    start: Method
    tick: Method
    sums: Method | None
    seen: frozenset[str]  # the fields of At that it reads
    rx: type[Any]
    kinds: dict[str, type]  # of its state and of the message that it sends

    @classmethod
    def of(cls, law: Any, end: str) -> LawEnd:
        """The end `end` of `law`, its types taken from the two starts."""
        starts = {each: answer(Method(law, f"{each}_start"), REST) for each in ENDS}
        other = ENDS[1 - ENDS.index(end)]
        sums = Method(law, f"{end}_sums") if hasattr(law, f"{end}_sums") else None
        seen = reads(getattr(law, end)) | (reads(getattr(law, sums.name)) if sums else frozenset())
        return cls(law=law, name=f"{type(law).__name__}.{end}", start=Method(law, f"{end}_start"),
                   tick=Method(law, end), sums=sums, seen=seen, rx=type(starts[end][1]),
                   kinds={"state": type(starts[end][0]), "message": type(starts[other][1])})

    def arguments(self, call: Call) -> tuple[Any, ...]:
        """The arguments of the end's method; with sums over the axes, those of this axis and of the one beside it."""
        own = self.own(call)
        if own is None:
            return call.s, call.at, call.rx
        over = own
        if call.beside is not None:
            over = type(own)(*[a + b for a, b in zip(own, call.beside, strict=True)])
        return call.s, call.at, call.rx, over

    def own(self, call: Call) -> Any:
        """The sums of this axis alone; None for an end without."""
        return None if self.sums is None else answer(self.sums, call.s, call.at, call.rx, finite=False)


def _probe(end: LawEnd) -> None:
    """Ask an end in many situations, tick after tick, and again in another order."""
    asked: list[tuple[tuple[Any, ...], str]] = []
    dice = spread(end.name)
    before = repr(end.law)
    for reach in REACHES:
        at = situation(dice, reach)._replace(f_held=0.0, dx=0.0, fresh=False, age=inf)
        began = answer(end.start, at, finite=False)
        check_blind_start(end.start, end.tick, at, end.seen, in_bits(began))
        s, beside = began[0], None
        for _ in range(TICKS):
            at = situation(dice, reach)
            rx = end.rx(*[value(dice, reach) for _ in end.rx._fields])
            call = Call(s, at, rx, beside)
            arguments = end.arguments(call)
            got = answer(end.tick, *arguments, kinds=end.kinds, finite=inf not in reach)
            bits = in_bits(got)
            ask_again(end.tick, arguments, bits)
            _check_unseen(end, call, bits)
            asked.append((arguments, bits))
            s, beside = got[2], end.own(call)
            if not all(map(isfinite, s)):
                s = began[0]
    for arguments, bits in reversed(asked):
        ask_again(end.tick, arguments, bits)
    if repr(end.law) != before:
        raise Refused(f"{end.name} changed the law from {before} to {end.law!r}; use the state")


def _check_unseen(end: LawEnd, call: Call, bits: str) -> None:
    """Refuse an end whose answer depends on a field that it does not visibly read."""
    for field in At._fields:
        if field in end.seen:
            continue
        arguments = end.arguments(call._replace(at=without(call.at, field)))
        if in_bits(end.tick.call(*arguments)) != bits:
            raise unseen(end.tick, field)
