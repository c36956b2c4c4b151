"""A stage and the law that it stands around, made into one class as text.

A law that kept another as a field would be no flat dataclass of floats, and no engine that compiles could follow it. So
the class is written out: the fields of both, one flat state for each end, and for each method a few lines that call the
law's own function with the composed law in the law's place, which has all of its fields by their names.

    def slave(self, s, at, rx):
        f, tx, own = inner_slave(self, Inner_slave_state(s.x_d, s.v_d), at, rx)
        ...what the stage does at this end
        return f, Sent_slave(...), State_slave(own.x_d, own.v_d, ...)

The text is a module of its own, by the name of which numba and a traceback find it. Its class depends on the classes of
stage and law alone, so that it is made once for both, and rows of a sweep that differ in numbers share a kernel.
"""

from __future__ import annotations

import linecache
import sys
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from hashlib import sha256
from types import FunctionType, ModuleType
from typing import Any, NamedTuple, Protocol

from teleop import kind
from teleop.errors import Refused
from teleop.knob import check_knobs, knobs_of_fields
from teleop.law import law_name, name_of_law, start_at
from teleop.law.contract import check_contract

ENDS = {"master": "slave", "slave": "master"}
_KINDS = {"wave": "kind.Wave", "total": "kind.Total", "sample": "float", "position": "kind.Position"}


class InnerEnd(NamedTuple):
    """End of the law that a stage stands around."""

    name: str  # "master" or "slave"
    state: Mapping[str, str] | None  # the kind of each field of its state; None where the state is ()
    sends: Mapping[str, str]  # the kind of each field of the message that it sends
    hears: Mapping[str, str]  # the same of the one that it is given
    sums: tuple[str, ...] | None  # what it sums over the axes; None where it couples none


class EndLines(NamedTuple):
    """Work of a stage at one end, as lines of Python over `self`, `s`, `at`, `rx` and `over`.

    `before` comes before the law's own lines and may change `at`; after them `f` is the law's force and `tx_NAME` each
    field of its message, and `after` may change these. A field of the stage's own has a local variable of its name once
    `after` is done. Each name begins with that of the stage.
    """

    state: Mapping[str, str] = {}  # the fields of its own in the state of this end, and what each starts as
    sends: Mapping[str, tuple[str, str]] = {}  # those in the message that this end sends: kind, and what is known first
    sums: Mapping[str, str] = {}  # what it sums over the axes, each with its share of one axis
    before: tuple[str, ...] = ()  # of the sums over the axes too
    after: tuple[str, ...] = ()
    positions: tuple[str, ...] = ()  # the fields of its own in the state that are positions
    stored: str = ""  # the energy that this end keeps in place of the law's own, of its state `s`


class Around(Protocol):
    """The shape of a stage around a law: a frozen dataclass of its knobs, with these class methods."""

    name: str

    @classmethod
    def lines(cls, end: InnerEnd) -> EndLines: ...
    @classmethod
    def words(cls) -> Mapping[str, Any]: ...  # the plain functions and numbers that the lines name
    @classmethod
    def claims_of(cls, claims: Mapping[str, str]) -> Mapping[str, str]: ...  # of the law with the stage around it


def compose(stage: Any, law: Any) -> Any:
    """The law with one stage around it. Raises `Refused` for a law that has not two ends."""
    of_stage = {f"{stage.name}_{field.name}": getattr(stage, field.name) for field in fields(stage)}
    of_law = {field.name: getattr(law, field.name) for field in fields(law)} if is_dataclass(law) else {}
    return composed_class(type(stage), law)(**of_law, **of_stage)


def composed_class(stage: Any, law: Any) -> Any:
    """The class of a law of this class with this stage around it; the same one each time."""
    made = _MADE.get((stage, type(law)))
    if made is None:
        _check_law(stage, law)
        made = _MADE[stage, type(law)] = _build_class(stage, law)
    return made


def inner_of(law: Any) -> Any:
    """The law that the outermost stage of a composed law stands around."""
    inner = type(law).inner_law
    return inner(**{field.name: getattr(law, field.name) for field in fields(inner)})


def remade(stage: Any, inner: type[Any], values: Mapping[str, float]) -> Any:
    """A composed law, made again from its parts: so one is sent to another process."""
    law = inner(**{field.name: values[field.name] for field in fields(inner)})
    return composed_class(stage, law)(**values)


_MADE: dict[tuple[Any, type[Any]], Any] = {}


def _check_law(stage: Any, law: Any) -> None:
    name = law_name(law)
    if isinstance(law, type) or not is_dataclass(law):
        raise Refused(f"{stage.name} stands around a law that is a frozen dataclass, not {law!r}; write for example "
                      "around('deadband(0.1)', Wave())")
    if not hasattr(law, "master"):
        raise Refused(f"{stage.name} stands around a law with two ends, and {name} has one; take for example "
                      f"law='{stage.name} | wave', or leave the stage out")
    check_contract(law)
    if stage in stages_of(type(law)):
        raise Refused(f"the stage {stage.name} stands twice in {stage.name} | {name}; write it once")


def stages_of(kind_of_law: type[Any]) -> list[Any]:
    """The stages around a law, the outermost first; none of a law that stands alone."""
    stages = []
    while (inner := vars(kind_of_law).get("inner_law")) is not None:
        stages.append(vars(kind_of_law)["stage"])
        kind_of_law = inner
    return stages


def _build_class(stage: Any, law: Any) -> Any:
    kind_of_law = type(law)
    ends = {name: _inner_end(law, name) for name in ENDS}
    lines = {name: stage.lines(end) for name, end in ends.items()}
    _check_names(stage, kind_of_law, ends, lines)
    title = f"{stage.name} | {name_of_law(kind_of_law)}"
    words = {"kind": kind, "Inner": kind_of_law, "Stage": stage, **stage.words(), **_messages_of(law)}
    text = "\n".join([f'"""{title}: a law with a stage around it, written by `teleop.laws.around.compose`."""', "",
                      *_types(ends, lines, words, law), *_class(stage, law, ends, lines, words)])
    made = _module(title, text, words, kind_of_law)
    for name, thing in vars(kind_of_law).items():  # functions and constants that the law's own lines may name
        if not (name.startswith("__") or hasattr(made, name) or name in ("stage", "inner_law", "known_as")):
            setattr(made, name, thing)
    return made


def _inner_end(law: Any, name: str) -> InnerEnd:
    still = start_at(0.0, 0.0, 0.0, 1e-3)
    s, heard = getattr(law, f"{name}_start")(still)
    sent = getattr(law, f"{ENDS[name]}_start")(still)[1]
    sums = getattr(law, f"{name}_sums", None)
    state = kind.kinds(type(s)) if hasattr(s, "_fields") else None
    return InnerEnd(name, state, kind.kinds(type(sent)), kind.kinds(type(heard)),
                    None if sums is None else sums(s, still, heard)._fields)




def _messages_of(law: Any) -> dict[str, Any]:
    """The types of the law's states, messages and sums by the names that the text gives them."""
    still, types = start_at(0.0, 0.0, 0.0, 1e-3), {}
    for name, peer in ENDS.items():
        s, heard = getattr(law, f"{name}_start")(still)
        types[f"Inner_{name}_state"], types[f"Inner_{peer}_sent"] = type(s), type(heard)
        if hasattr(law, f"{name}_sums"):
            types[f"Inner_{name}_sums"] = type(getattr(law, f"{name}_sums")(s, still, heard))
    return types


def _check_names(stage: Any, kind_of_law: Any, ends: Mapping[str, InnerEnd], lines: Mapping[str, EndLines]) -> None:
    """Refuse a law that has names of the stage's own."""
    of_stage = {f"{stage.name}_{field.name}" for field in fields(stage)}
    taken = {field.name for field in fields(kind_of_law)}
    for name, end in ends.items():
        of_stage |= {*lines[name].state, *lines[name].sends, *lines[name].sums}
        taken |= {*(end.state or ()), *end.sends, *(end.sums or ())}
    if clash := sorted(of_stage & taken):
        raise Refused(f"law {name_of_law(kind_of_law)} has a field {clash[0]}, which is one of the stage {stage.name} "
                      "around it; give it another name in the law's file")


def _types(ends: Mapping[str, InnerEnd], lines: Mapping[str, EndLines], words: dict[str, Any], law: Any) -> list[str]:
    """The text of the states, messages and sums that are not the law's own."""
    text = ["from dataclasses import dataclass", "from typing import ClassVar, NamedTuple", ""]
    for name, end in ends.items():
        stage_lines = lines[name]
        state = {field: _KINDS[each] for field, each in (end.state or {}).items()}
        state |= {field: _KINDS["position" if field in stage_lines.positions else "sample"]
                  for field in stage_lines.state}
        text += _named_tuple(f"State_{name}", state) if state else []
        if stage_lines.sends:
            sends = {**end.sends, **{field: of_kind for field, (of_kind, _) in stage_lines.sends.items()}}
            text += _named_tuple(f"Sent_{name}", {field: _KINDS[each] for field, each in sends.items()})
        else:  # the message is the law's own
            words[f"Sent_{name}"] = words[f"Inner_{name}_sent"]
        if end.sums is not None or stage_lines.sums:
            text += _named_tuple(f"Sums_{name}", dict.fromkeys((*(end.sums or ()), *stage_lines.sums), "float"))
    for name in ENDS:
        for method in (f"{name}_start", name, f"{name}_sums", f"{name}_stored"):
            function = getattr(type(law), method, None)
            if isinstance(function, FunctionType):
                words[f"inner_{method}"] = function
    return text


def _named_tuple(name: str, annotated: Mapping[str, str]) -> list[str]:
    return [f"class {name}(NamedTuple):", *[f"    {field}: {each}" for field, each in annotated.items()], ""]


def _class(stage: Any, law: Any, ends: Mapping[str, InnerEnd], lines: Mapping[str, EndLines],
           words: dict[str, Any]) -> list[str]:
    """The text of the class."""
    kind_of_law = type(law)
    known = {**knobs_of_fields(kind_of_law),
             **{f"{stage.name}_{name}": knob for name, knob in knobs_of_fields(stage).items()}}
    name_of_class = f"{stage.__name__.removesuffix('Wrapper')}{kind_of_law.__name__}"
    text = ["@dataclass(frozen=True, kw_only=True)", f"class {name_of_class}:",
            f"    {_doc(stage, kind_of_law)!r}"]
    of_law = {field.name: field for field in fields(kind_of_law)}
    of_stage = {f"{stage.name}_{field.name}": field for field in fields(stage)}
    for name, declaration in known.items():
        field = of_law.get(name) or of_stage[name]
        words[f"type_{name}"] = _annotation(declaration)
        words[f"default_{name}"] = field.default
        text.append(f"    {name}: type_{name}" + (f" = default_{name}" if field.default is not MISSING else ""))
    words["claims"] = stage.claims_of(getattr(law, "claims", {}))
    words["shows"] = (*getattr(law, "shows", ()), *stage.shows)
    words["known_as"] = f"{stage.name} | {name_of_law(kind_of_law)}"
    text += [f"    {name}: ClassVar = {name}" for name in ("claims", "shows", "known_as")]
    text += ["    inner_law: ClassVar = Inner", "    stage: ClassVar = Stage", ""]
    for name in ENDS:
        text += _end_text(ends[name], lines[name], ends[ENDS[name]], lines[ENDS[name]], law)
    words |= {"settle": _settle, "again": _again, "inner_of": inner_of}
    text += ["    def __post_init__(self):", "        settle(self)", "",
             "    def __reduce__(self):", "        return again(self)", "",
             "    def inner(self):", "        return inner_of(self)", ""]
    for name, function in _OFFERS.items():
        if name == "linear" or hasattr(kind_of_law, name) or hasattr(stage, f"{name}_of"):
            words[f"offer_{name}"] = function
            facts = "" if name == "linear" else ", facts"
            text += [f"    def {name}(self{facts}):", f"        return offer_{name}(self{facts})", ""]
    return text


def _end_text(end: InnerEnd, stage_lines: EndLines, peer: InnerEnd, peer_lines: EndLines, law: Any) -> list[str]:
    """The text of one end's methods."""
    name = end.name
    inner_state = "()" if end.state is None else f"Inner_{name}_state({_of('s', end.state)})"
    heard = f"Inner_{peer.name}_sent({_of('rx', peer.sends)})" if peer_lines.sends else "rx"
    starts = [*[f"own.{field}" for field in end.state or ()], *stage_lines.state.values()]
    state = f"State_{name}({', '.join(starts)})" if starts else "()"
    known = [first for _, first in peer_lines.sends.values()]
    first = f"Sent_{peer.name}({_of('rx', peer.sends, *known)})" if known else "rx"
    text = [f"    def {name}_start(self, at):", f"        own, rx = inner_{name}_start(self, at)",
            f"        return {state}, {first}", ""]
    coupled = end.sums is not None or stage_lines.sums
    if coupled:
        text += [f"    def {name}_sums(self, s, at, rx):", *[f"        {line}" for line in stage_lines.before]]
        if end.sums is not None:
            text += [f"        own = inner_{name}_sums(self, {inner_state}, at, {heard})"]
        shares = ", ".join([*[f"own.{field}" for field in end.sums or ()], *stage_lines.sums.values()])
        text += [f"        return Sums_{name}({shares})", ""]
    over = f", Inner_{name}_sums({_of('over', end.sums)})" if end.sums is not None else ""
    text += [f"    def {name}(self, s, at, rx{', over' if coupled else ''}):",
             *[f"        {line}" for line in stage_lines.before],
             f"        f, tx, own = inner_{name}(self, {inner_state}, at, {heard}{over})",
             *[f"        tx_{field} = tx.{field}" for field in end.sends],
             *[f"        {line}" for line in stage_lines.after]]
    sent = ", ".join([*[f"tx_{field}" for field in end.sends], *stage_lines.sends])
    after = ", ".join([*[f"own.{field}" for field in end.state or ()], *stage_lines.state])
    text += [f"        return f, Sent_{name}({sent}), {f'State_{name}({after})' if after else '()'}", ""]
    if stage_lines.stored:
        text += [f"    def {name}_stored(self, s):", f"        return {stage_lines.stored}", ""]
    elif hasattr(law, f"{name}_stored"):
        text += [f"    def {name}_stored(self, s):", f"        return inner_{name}_stored(self, {inner_state})", ""]
    return text


def _of(thing: str, names: Any, *last: str) -> str:
    return ", ".join([*[f"{thing}.{name}" for name in names or ()], *last])


def _annotation(declaration: Any) -> Any:
    from typing import Annotated

    return Annotated[declaration.kind, declaration.knob]


def _doc(stage: Any, kind_of_law: type[Any]) -> str:
    """The first sentence of the stage, and what it stands around."""
    first = " ".join((stage.__doc__ or "").partition("\n\n")[0].split())
    return f"{first.rstrip('.')}, around the law {name_of_law(kind_of_law)}."


def _module(title: str, text: str, words: Mapping[str, Any], kind_of_law: type[Any]) -> Any:
    """Run the text as a module, where tracebacks and other processes' kernels find it; the class that it makes."""
    key = sha256(f"{text}\0{kind_of_law.__module__}:{kind_of_law.__qualname__}".encode()).hexdigest()[:12]
    name = f"teleop_around_{key}"
    file = f"<{title}>"
    linecache.cache[file] = len(text), None, text.splitlines(keepends=True), file
    module = sys.modules[name] = ModuleType(name, text.partition("\n")[0].strip('"'))
    vars(module).update(words)
    exec(compile(text, file, "exec", dont_inherit=True), vars(module))
    return next(thing for thing in vars(module).values() if isinstance(thing, type) and thing.__module__ == name
                and is_dataclass(thing))


def _settle(law: Any) -> None:
    """Refuse numbers that the law or the stage would refuse by themselves, by the names that they have here."""
    check_knobs(law)
    check_contract(inner_of(law))


def _again(law: Any) -> tuple[Any, ...]:
    kind_of_law = type(law)
    values = {field.name: getattr(law, field.name) for field in fields(law)}
    return remade, (kind_of_law.stage, kind_of_law.inner_law, values)


def _conditions(law: Any, facts: Any) -> tuple[str, ...]:
    inner, of_stage = inner_of(law), getattr(type(law).stage, "conditions_of", None)
    seen = getattr(type(law).stage, "facts_of", None)
    of_inner = facts if seen is None else seen(law, facts)
    sentences: tuple[str, ...] = tuple(inner.conditions(of_inner)) if hasattr(inner, "conditions") else ()
    return sentences if of_stage is None else tuple(of_stage(law, sentences, facts))


def _fitted(law: Any, facts: Any) -> Any:
    seen = getattr(type(law).stage, "facts_of", None)
    fitted = inner_of(law).fitted(facts if seen is None else seen(law, facts))
    return replace(law, **{field.name: getattr(fitted, field.name) for field in fields(fitted)})


def _linear(law: Any) -> Any:
    inner, stage = inner_of(law), type(law).stage
    linear = inner.linear() if hasattr(inner, "linear") else inner
    if not getattr(stage, "is_linear", False):
        return linear
    return compose(stage(**{field.name: getattr(law, f"{stage.name}_{field.name}") for field in fields(stage)}), linear)


_OFFERS = {"conditions": _conditions, "fitted": _fitted, "linear": _linear}
