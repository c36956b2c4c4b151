"""A stage and the law that it stands around, made into one class.

A law that kept another as a field would be no flat dataclass of floats, and no engine that compiles could follow it. So
the class has the fields of both, and for its methods the functions `_start` to `_law_stored` below. They take flat
records apart and call the law's own functions with the composed law in the law's place, whose fields have its names.
`bind` gives each class its own of them, with other things behind the names around them: engines, evaluator and digests
follow those as they follow the names in a module. The class depends on the classes of stage and law alone, so rows of a
sweep that differ in numbers share a kernel. It stands in a module of its own, by the name of which kernels find it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, field, fields, is_dataclass, make_dataclass, replace
from hashlib import sha256
from types import FunctionType, ModuleType
from typing import Annotated, Any, Generic, NamedTuple, TypeVar

from teleop import kind
from teleop.errors import Refused
from teleop.knob import check_knobs, knobs_of_fields
from teleop.law import At, law_name, name_of_law, start_at
from teleop.law.contract import check_contract
from teleop.law.declarations import Wrong, check_names

ENDS = {"master": "slave", "slave": "master"}
Knobs = TypeVar("Knobs")
State = TypeVar("State")
Hears = TypeVar("Hears")
Sums = TypeVar("Sums")
Message = tuple[float, ...]


def nothing(*_values: Any) -> Any:
    """No record."""
    return ()


class StageEnd(NamedTuple, Generic[Knobs, State, Hears, Sums]):
    """Work of a stage at one end: plain functions over records, NamedTuples of floats or ().

    A field is known by the stage's name and its own, as `guard_H`. `Knobs` is the stage, or its knobs as a tuple.
    """

    start: Callable[[Knobs, At], tuple[State, Hears]]  # `Hears`: what stands for the message until one comes
    after: Callable[[Knobs, State, At, Hears, Sums, float, Message], tuple[float, Message, Message, State]]
    before: Callable[[Knobs, State, At], tuple[At, State]] = lambda _, s, at: (at, s)  # the law's situation
    share: Callable[[Knobs, State, At], Sums] = nothing  # of one axis in what is summed over the axes
    stored: Callable[[State], float] | None = None  # the energy that this end keeps in place of the law's own, J


def compose(stage: Any, law: Any) -> Any:
    """The law with one stage around it. Raises `Refused` for a law that has not two ends."""
    key = type(stage), type(law)
    if key not in _MADE:
        _check_law(type(stage), law)
        _MADE[key] = _build_class(stage, law)
    of_stage = {f"{stage.name}_{each.name}": getattr(stage, each.name) for each in fields(stage)}
    return _MADE[key](**{each.name: getattr(law, each.name) for each in fields(law)}, **of_stage)


def inner_of(law: Any) -> Any:
    """The law that the outermost stage of a composed law stands around."""
    inner = type(law).inner_law
    return inner(**{each.name: getattr(law, each.name) for each in fields(inner)})


def stage_of(law: Any) -> Any:
    """The outermost stage of a composed law."""
    stage = type(law).stage
    return stage(**{each.name: getattr(law, f"{stage.name}_{each.name}") for each in fields(stage)})


def bind(function: Any, label: str, **names: Any) -> Any:
    """The function with these names around it; `label` tells its code from that of others which are bound."""
    code = function.__code__.replace(co_consts=(*function.__code__.co_consts, label))
    return FunctionType(code, {**function.__globals__, **names}, function.__name__)


def flat_record(name: str, kinds: Mapping[str, str]) -> Any:
    """The NamedTuple with these fields, each of its kind."""
    new: Any = NamedTuple
    return new(name, [(each, getattr(kind, of_kind.capitalize())) for each, of_kind in kinds.items()])


# The methods of a composed law, and the names around them that `bind` gives them

law_start = law_end = law_sums = law_stored = start = before = share = after = stored = nothing
LawState = LawHeard = LawSums = StageState = StageHeard = StageSums = StageKnobs = nothing  # records of either
FlatState = FlatHeard = FlatSums = FlatSent = nothing  # records of both
low = high = n = m = k = 0  # the stage's knobs among all; how many fields the law's state, message and sums have


def _start(self: Any, at: At) -> Any:
    s, rx = law_start(self, at)
    stage_s, stage_rx = start(StageKnobs(*self[low:high]), at)
    return FlatState(*(s[:] + stage_s[:])), FlatHeard(*(rx[:] + stage_rx[:]))


def _sums(self: Any, s: Any, at: At, rx: Any) -> Any:
    knobs = StageKnobs(*self[low:high])
    law_at, stage_s = before(knobs, StageState(*s[n:]), at)
    return FlatSums(*(law_sums(self, LawState(*s[:n]), law_at, LawHeard(*rx[:m]))[:] + share(knobs, stage_s, at)[:]))


def _stage_sums(self: Any, s: Any, at: At, _rx: Any) -> Any:  # where the law sums nothing
    knobs = StageKnobs(*self[low:high])
    return FlatSums(*share(knobs, before(knobs, StageState(*s[n:]), at)[1], at)[:])


def _end(self: Any, s: Any, at: At, rx: Any, over: Any) -> Any:
    knobs = StageKnobs(*self[low:high])
    law_at, stage_s = before(knobs, StageState(*s[n:]), at)
    f, tx, law_s = law_end(self, LawState(*s[:n]), law_at, LawHeard(*rx[:m]), LawSums(*over[:k]))
    f, tx, stage_tx, stage_s = after(knobs, stage_s, at, StageHeard(*rx[m:]), StageSums(*over[k:]), f, tx)
    return f, FlatSent(*(tx[:] + stage_tx[:])), FlatState(*(law_s[:] + stage_s[:]))


def _end_alone(self: Any, s: Any, at: At, rx: Any) -> Any:  # one that sums nothing over the axes
    return _end(self, s, at, rx, ())


def _law_alone(self: Any, s: Any, at: At, rx: Any, _over: Any) -> Any:
    return law_end(self, s, at, rx)


def _stored(_self: Any, s: Any) -> Any:
    return stored(StageState(*s[n:]))


def _law_stored(self: Any, s: Any) -> Any:
    return law_stored(self, LawState(*s[:n]))


_MADE: dict[tuple[type[Any], type[Any]], Any] = {}


def _check_law(stage: Any, law: Any) -> None:
    name = law_name(law)
    if isinstance(law, type) or not is_dataclass(law):
        raise Refused(f"{stage.name} stands around a law that is a frozen dataclass, not {law!r}; write for example "
                      "around('deadband(0.1)', Wave())")
    if not hasattr(law, "master"):
        raise Refused(f"{stage.name} stands around a law with two ends, and {name} has one; take for example "
                      f"law='{stage.name} | wave', or leave the stage out")
    check_contract(law)
    if stage.name in name.split(" | ")[:-1]:
        raise Refused(f"the stage {stage.name} stands twice in {stage.name} | {name}; write it once")


def _build_class(stage: Any, law: Any) -> Any:
    kind_of_law, kind_of_stage = type(law), type(stage)
    known = {**knobs_of_fields(kind_of_law),
             **{f"{stage.name}_{name}": knob for name, knob in knobs_of_fields(kind_of_stage).items()}}
    title = f"{stage.name} | {name_of_law(kind_of_law)}"
    name = f"{kind_of_stage.__name__.removesuffix('Wrapper')}{kind_of_law.__name__}"
    key = f"teleop_around_{sha256(repr([kind_of_stage, kind_of_law, *known]).encode()).hexdigest()[:12]}"
    module = sys.modules[key] = ModuleType(key, title)
    first = " ".join((stage.__doc__ or "").partition("\n\n")[0].split()).rstrip(".")
    words = {
        # functions and constants that the law's own lines may name
        **{each: thing for each, thing in vars(kind_of_law).items() if not each.startswith("__")},
        "__module__": key, "__doc__": f"{first}, around the law {name_of_law(kind_of_law)}.", "__post_init__": _settle,
        "__reduce__": lambda self: (compose, (stage_of(self), inner_of(self))),
        "__getitem__": lambda self, part: self._numbers[part],  # where it is compiled it is a tuple
        "inner": inner_of, "inner_law": kind_of_law, "stage": kind_of_stage, "known_as": title,
        "claims": stage.claims_of(getattr(law, "claims", {})), "shows": (*getattr(law, "shows", ()), *stage.shows),
        **{offer: function for offer, function in _OFFERS.items()
           if offer == "linear" or hasattr(law, offer) or hasattr(stage, f"{offer}_of")},
        **_methods(stage, law, name, module)}
    made = make_dataclass(name, [
        (each, Annotated[knob.kind, knob.knob], field(default=MISSING if knob.default is ... else knob.default))
        for each, knob in known.items()], namespace=words, frozen=True, kw_only=True)
    setattr(module, name, made)
    return made


def _methods(stage: Any, law: Any, name: str, module: ModuleType) -> dict[str, Any]:
    """The methods of both ends."""
    still, knobs, methods = start_at(0.0, 0.0, 0.0, 1e-3), [each.name for each in fields(stage)], {}
    starts = {e: getattr(law, f"{e}_start")(still) for e in ENDS}
    of_law, of_stage, flat, work = {}, {}, {}, {}
    for e, peer in ENDS.items():  # the state, the message that is heard first, and the sums over the axes
        of_law[e] = (*starts[e], getattr(law, f"{e}_sums", nothing)(starts[e][0], still, starts[e][1]))
        work[e] = stage.end(e, kind.kinds(type(starts[peer][1])))
        s, rx = work[e].start(stage, still)
        of_stage[e] = s, rx, work[e].share(stage, s, still)
        flat[e] = [_flat(stage, module, *each) for each in zip(
            (f"State_{e}", f"Sent_{peer}", f"Sums_{e}"), of_law[e], of_stage[e], strict=True)]
    _check_names(stage, law, [*of_law["master"], *of_law["slave"]], [*of_stage["master"], *of_stage["slave"]])
    for e, peer in ENDS.items():
        low, (n, m, k) = len(fields(law)), map(len, of_law[e])
        words = {**work[e]._asdict(), "low": low, "high": low + len(knobs), "n": n, "m": m, "k": k,
                 "StageKnobs": flat_record("Knobs", dict.fromkeys(knobs, "sample")), "FlatSent": flat[peer][1],
                 "law_end": getattr(type(law), e)}
        words |= {f"law_{each}": getattr(type(law), f"{e}_{each}", nothing) for each in ("start", "sums", "stored")}
        for part, *records, both in zip(("State", "Heard", "Sums"), of_law[e], of_stage[e], flat[e], strict=True):
            words |= {f"Law{part}": _record(records[0]), f"Stage{part}": _record(records[1]), f"Flat{part}": both}
        if words["law_sums"] is nothing:
            words["law_end"] = bind(_law_alone, f"{name}.{e} law", **words)
        words["_end"] = bind(_end, f"{name}.{e} end", **words)
        made = {"_start": _start, "": _end, "_sums": _stage_sums if words["law_sums"] is nothing else _sums}
        if words["law_sums"] is words["share"] is nothing:
            made = {"_start": _start, "": _end_alone}
        if work[e].stored or hasattr(law, f"{e}_stored"):
            made["_stored"] = _stored if work[e].stored else _law_stored
        for suffix, function in made.items():
            methods[e + suffix] = method = bind(function, f"{name}.{e}{suffix}", **words)
            method.__name__, method.__qualname__, method.__module__ = e + suffix, f"{name}.{e}{suffix}", module.__name__
    return methods


def _record(values: Any) -> Any:
    return type(values) if hasattr(values, "_fields") else nothing


def _flat(stage: Any, module: ModuleType, name: str, of_law: Any, of_stage: Any) -> Any:
    """The record of both, the law's own where the stage has none."""
    if of_stage == ():
        return _record(of_law)
    stage_kinds = {f"{stage.name}_{each}": of_kind for each, of_kind in kind.kinds(type(of_stage)).items()}
    made = flat_record(name, {**(kind.kinds(type(of_law)) if of_law else {}), **stage_kinds})
    made.__module__ = module.__name__
    setattr(module, name, made)
    return made


def _check_names(stage: Any, law: Any, of_law: list[Any], records: list[Any]) -> None:
    """Refuse a law that has names of the stage's own, and a stage that has names of `At`."""
    of_stage = [each.name for each in fields(stage)] + [each for one in records for each in getattr(one, "_fields", ())]
    taken = {each.name for each in fields(law)} | {each for one in of_law for each in getattr(one, "_fields", ())}
    if clash := sorted({f"{stage.name}_{each}" for each in of_stage} & taken):
        raise Refused(f"law {law_name(law)} has a field {clash[0]}, which is one of the stage {stage.name} around it; "
                      "give it another name in the law's file")
    try:
        check_names({"record": records})
    except Wrong as wrong:
        raise Refused(f"the stage {stage.name} {wrong}") from None


def _settle(law: Any) -> None:
    """Refuse numbers that the law or the stage would refuse by themselves, by the names that they have here."""
    check_knobs(law)
    check_contract(inner_of(law))
    object.__setattr__(law, "_numbers", tuple([getattr(law, each.name) for each in fields(law)]))


def _facts(law: Any, facts: Any) -> Any:
    """Facts of a scene for the law inside."""
    seen = getattr(type(law).stage, "facts_of", None)
    return facts if seen is None else seen(law, facts)


def _conditions(law: Any, facts: Any) -> tuple[str, ...]:
    inner, of_stage = inner_of(law), getattr(type(law).stage, "conditions_of", None)
    sentences = tuple(inner.conditions(_facts(law, facts))) if hasattr(inner, "conditions") else ()
    return sentences if of_stage is None else tuple(of_stage(law, sentences, facts))


def _fitted(law: Any, facts: Any) -> Any:
    fitted = inner_of(law).fitted(_facts(law, facts))
    return replace(law, **{each.name: getattr(fitted, each.name) for each in fields(fitted)})


def _linear(law: Any) -> Any:
    inner = inner_of(law)
    linear = inner.linear() if hasattr(inner, "linear") else inner
    return compose(stage_of(law), linear) if getattr(type(law).stage, "is_linear", False) else linear


_OFFERS = {"conditions": _conditions, "fitted": _fitted, "linear": _linear}
