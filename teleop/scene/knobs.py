"""The keyword parameters of a scene, read from texts or from Python, each checked by name, type and bounds.

Knobs that every scene takes beside its own are `COMMON`: each replaces a part of the scene that its function made.
Where a scene has a knob of the same name, that one is set.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from functools import lru_cache, partial
from inspect import Parameter, signature
from numbers import Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_type_hints

from teleop.errors import Refused, WrongNumber, enumerated, nearest, number, number_of, whole_number
from teleop.knob import UNDECLARED, Declared, Knob, declared, knobs_of_fields
from teleop.law import BUILT_IN, Law, OnePortLaw, find_law, innermost, name_of_law
from teleop.laws.around.names import LawText, arguments_of_law, around, law_text, read_stage
from teleop.scene.axes import each_axis
from teleop.scene.library import file_law, file_named, import_bundled
from teleop.scene.playout import Playout, Zero, as_typed, integrates, read_playout
from teleop.scene.scene import Scene

_SCALES = ("scale_x", "scale_f")
COMMON = {
    "x_limit": Declared(float, Scene.x_limit, Knob(
        "m", "position beyond which a run has diverged, of master and slave", above=0.0)),
    "scale_x": Declared(float | tuple[float, ...], 1.0, Knob(
        "", "metres (or rad) of the slave, where there is one, for one of the master; one number, or one an axis",
        above=0.0)),
    "scale_f": Declared(float | tuple[float, ...], 1.0, Knob(
        "", "newtons (or N m) of the slave, where there is one, for one of the master; one number, or one an axis",
        above=0.0)),
    "frame": Declared(float | tuple[float, ...] | None, "the scene's", Knob(
        "", "rotation from the master's base to the slave's: a rotation vector in rad, or a quaternion w,x,y,z")),
    "left_out": Declared(float, 0.0, Knob(
        "", "share of its ticks that each end leaves out, at random", low=0.0, high=1.0)),
    "deadband": Declared(float, 0.0, Knob(
        "", "share by which a value differs from the last that was sent before a message is sent; 0: each is",
        low=0.0, high=1.0)),
    "clutch_ramp": Declared(float | None, "the scene's", Knob(
        "s", "time in which the force fades out, and in, where the operator's clutch opens or nobody is there; "
        "none: no switches are heeded", low=0.0)),
    "playout": Declared(Playout, "the scene's", Knob(
        "", "message that a tick plays, where there is a link: see `teleop list playout`")),
    "link": Declared("Link | None", "the scene's", Knob(
        "", "link in place of the scene's, where there is a slave, as --link takes it; none: no link")),
    "hand": Declared("HandRecording", "the scene's", Knob(
        "", "folder of a live page whose hand the scene's moves as, for as long where duration is not set")),
}


def read_link(value: object) -> tuple[str, Any]:
    """A link as it is shown, and the link. Raises `Refused`."""
    module = import_bundled("channel.link")
    if value is None or value == "none":
        return "none", None
    if isinstance(value, str):
        link = module.parse_link(value)
        return module.record_text(value, link), link
    return module.describe(value), value  # what is no link, the scene refuses


def read_hand(value: object) -> tuple[str, Any]:
    """The folder of a recorded hand, and the reference that it holds. Raises `Refused`."""
    kind = import_bundled("master.hand_record").HandRecording
    reference = value if isinstance(value, kind) else kind(value)
    return reference.path, reference


def with_common(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The scene with knobs of `COMMON` set. Raises `Refused`."""
    parts = {key: value for key, value in values.items() if key not in _SCALES}
    scaling = {key: value for key, value in values.items() if key in _SCALES}
    if scaling:
        from teleop.stages.scaling import Scaling
        from teleop.stages.slave_units import scales

        usual = [one if isinstance(scene.scaling, tuple) else one[0] for one in zip(*scales(scene), strict=True)]
        parts["scaling"] = each_axis(Scaling, scene.axes, **{**dict(zip(_SCALES, usual, strict=True)), **scaling})
    if parts.get("frame") is not None:
        from teleop.stages.scaling import Frame

        turn = parts["frame"] if isinstance(parts["frame"], tuple) else (parts["frame"],)
        parts["frame"] = Frame(rotation=turn, scale=1.0 if scene.frame is None else scene.frame.scale)
    if "left_out" in parts:
        share = parts.pop("left_out")
        ticks = import_bundled("channel.left_out").LeftOut(share) if share > 0.0 else None
        parts |= {"left_out_m": ticks, "left_out_s": ticks if scene.slave is not None else None}
    if "deadband" in parts:
        from teleop.stages.deadband import Deadband

        k = parts.pop("deadband")
        parts["deadband"] = None if k == 0.0 else replace(scene.deadband or Deadband(), k=k)
    if "clutch_ramp" in parts:
        from teleop.stages.operator import Operator

        ramp = parts.pop("clutch_ramp")
        parts["operator"] = None if ramp is None else replace(scene.operator or Operator(), ramp=ramp)
    if "hand" in parts:
        if scene.hand is None:
            raise Refused(f"hand={parts['hand'].path} moves nothing in a scene without a hand; leave it out, or take "
                          "a scene with one")
        parts["hand"].check(scene.axes, scene.dt_ns)
        grip, moved = import_bundled("master.hand").Grip, parts["hand"]
        hands = [hand and grip(mass=hand.mass, k=hand.k, d=hand.d, reference=moved) for hand in scene.per_axis("hand")]
        parts["hand"] = tuple(hands) if isinstance(scene.hand, tuple) else hands[0]
    made = replace(scene, **parts)
    along = made.has_waves and integrates(made.played_as)  # what waves have come to is sent without a link too
    if "playout" in parts and made.link is None and not along:
        cure = "" if made.slave is None else ", or write for example link='delay(0.05)'"
        raise Refused(f"playout={as_typed(values['playout'])} sets nothing in a scene without a link; leave it "
                      f"out{cure}")
    return made


_PLAIN = Declared(float, ..., UNDECLARED)  # a number of which nothing else is known
PARTS: dict[str, Callable[[object], tuple[str, Any]]] = {"link": read_link, "hand": read_hand}  # of `COMMON`
_TRUTH = {"true": True, "yes": True, "on": True, "1": True, "false": False, "no": False, "off": False, "0": False}


@lru_cache(maxsize=64)
def knobs_of(function: Callable[..., Any]) -> dict[str, Declared]:
    """Knobs of a scene's function, by name. Raises `Refused` for a parameter that cannot be given by its name.

    A knob without an annotation is of its default's type; one without a default too is a number.
    """
    try:
        hints = get_type_hints(function, include_extras=True)
    except Exception as error:
        raise Refused(f"the types of a scene's knobs cannot be read ({error}); import them at the top of its file, "
                      "outside of `if TYPE_CHECKING:`") from error
    knobs = {}
    for p in signature(function).parameters.values():
        if p.kind not in (Parameter.KEYWORD_ONLY, Parameter.POSITIONAL_OR_KEYWORD):
            raise Refused(f"a scene takes each knob by its name, so `{p}` cannot be one; "
                          "write for example `def scene(*, k_e: float = 1e3) -> Scene:`")
        default = ... if p.default is p.empty else p.default
        kind, knob = declared(hints[p.name]) if p.name in hints else (_kind(p.name, default), UNDECLARED)
        knobs[p.name] = Declared(kind, default, knob)
    return knobs


def _kind(name: str, default: Any) -> Any:
    """The type of a knob that has no annotation."""
    if name == "law" or _is_law(default):
        return Law | OnePortLaw
    if isinstance(default, Playout):
        return Playout
    if isinstance(default, (bool, str, Path)):
        return Path if isinstance(default, Path) else type(default)
    if default is None:
        return float | None
    if default is ... or isinstance(default, Real):
        return float  # of a whole number too: who writes k=1000 does not mean that k counts something
    if isinstance(default, tuple) and all(isinstance(each, Real) for each in default):
        return float | tuple[float, ...]
    if all(hasattr(default, each) for each in ("coefficients", "start", "step")):
        from teleop.stages.device import VelocityEstimator

        return VelocityEstimator
    return type(default)


def settle(
    name: str, function: Callable[..., Any], typed: Mapping[str, object]
) -> tuple[dict[str, object], dict[str, tuple[object, Any]]]:
    """Values of a scene's own knobs; and of those knobs of `COMMON` that are given, as (shown, value).

    Raises `Refused` for an unknown knob, for a value that is none or out of the knob's bounds, and for a knob that sets
    the scene's own link where that link is replaced: it would be turned, shown, and change nothing.
    """
    known = knobs_of(function)
    values: dict[str, Any] = {key: knob.default for key, knob in known.items() if knob.default is not ...}
    of_scene: dict[str, tuple[object, Any]] = {}
    of_law = {key.removeprefix("law."): value for key, value in typed.items() if key.startswith("law.")}
    of_law = of_law if "law" in known else {}
    left = known.keys() - typed.keys()
    for key, value in typed.items():
        if key == "law" and of_law and isinstance(value, str):
            scenes = _own_as_named(value, known[key].default)
            values[key] = (_by_axis(partial(_named_law, value), of_law) if scenes is None else
                           _tuned_by_axis(scenes, of_law))
        elif key in known:
            values[key] = read_knob(key, value, known[key])
        elif key in PARTS:
            of_scene[key] = PARTS[key](value)
            values |= {"duration": of_scene[key][1].duration} if key == "hand" and "duration" in left else {}
        elif key in COMMON:
            of_scene[key] = (checked := read_knob(key, value, COMMON[key])), checked
        elif key.removeprefix("law.") not in of_law:
            raise Refused(f"scene {name} has no knob {key!r}; {nearest(key, [*known, *COMMON])}")
    missing = [key for key in known if key not in values]
    if missing:
        cure = " ".join(f"--set {key}={'FILE' if known[key].kind is Path else 'VALUE'}" for key in missing)
        raise Refused(f"scene {name} needs {', '.join(missing)}: add {cure}")
    if of_law and not isinstance(typed.get("law"), str):
        values["law"] = _tuned_by_axis(values["law"], of_law)
    if "link" in of_scene:
        for key in typed:
            if key in known and known[key].knob.link:
                text = f"delay({values[key]})" if key == "delay" else "delay(0.04) | uniform(0.02) | bernoulli(0.02)"
                raise Refused(f"{key} sets nothing but the link of scene {name}, and link={of_scene['link'][0]} takes "
                              f"that link's place; leave {key} out and write the whole link, for example "
                              f"link='{text}'")
    return values, of_scene


def check_text(key: str, text: str, known: Mapping[str, Declared]) -> None:
    """Refuse a text that is no value of a knob, whatever the others are; `known`: the scene's own knobs.

    Bounds, and whether a law has a field, are for the scene that is made of it.
    """
    if key == "law":
        parts = law_text(text)
        for stage in parts.stages:
            read_stage(stage)
        _arguments(parts)
    elif key in PARTS and key not in known:
        PARTS[key](text)
    elif key.startswith("law."):
        _number(key, text, _PLAIN, whole=False, vector=True)
    elif (declaration := known.get(key) or COMMON.get(key)) is not None:
        read(key, text, declaration.kind, declaration)


def read_knob(key: str, value: object, declaration: Declared) -> object:
    """Convert the value of a knob to its type. Raises `Refused`, also for a value that is out of its bounds."""
    knob = declaration.knob
    if declaration.kind is float and type(value) is float:  # nearly always
        return number(key, value, low=knob.low, above=knob.above, high=knob.high, unit=knob.unit)
    converted = read(key, value, declaration.kind, declaration)
    knob.check(key, converted)
    return converted


def read(key: str, value: object, hint: Any, declaration: Declared = _PLAIN) -> object:
    """Convert `value`, a text or already of the type, to the type `hint` of the knob `key`. Raises `Refused`.

    The sentence has the unit and, as the example, the default of the knob that is declared as `own`.
    """
    kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
    if NoneType in kinds and (value is None or value == "none"):
        return None
    if bool in kinds:
        return _truth(key, value)
    if Path in kinds:
        return _path(key, value)
    if Zero in kinds:
        return read_playout(key, value)
    if float in kinds or int in kinds:
        return _number(key, value, declaration, whole=float not in kinds, vector=any(get_args(kind) for kind in kinds),
                       none=NoneType in kinds)
    if key == "law" or Law in kinds or OnePortLaw in kinds:
        return _law(key, value, declaration.default)
    if any(getattr(kind, "__name__", "") == "VelocityEstimator" for kind in kinds) and isinstance(value, str):
        from teleop.stages.velocity import ESTIMATORS

        return ESTIMATORS.read(value)
    if str in kinds and isinstance(value, str):
        return value
    if isinstance(value, str):
        raise Refused(f"{key} cannot be written as text; set it from Python")
    return value


def _truth(key: str, value: object) -> bool:
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value.lower() in _TRUTH:
        return _TRUTH[value.lower()]
    raise Refused(f"{key} is true or false, not {value!r}; write {key}=true")


def _path(key: str, value: object) -> Path:
    if isinstance(value, (str, Path)) and str(value):
        return Path(value)
    raise Refused(f"{key} is the path of a file, not {value!r}")


def _number(
    key: str, value: object, declaration: Declared, *, whole: bool, vector: bool, none: bool = False
) -> object:
    if vector and isinstance(value, str) and "," in value:
        return tuple(_number(key, part, declaration, whole=whole, vector=False) for part in value.split(","))
    if vector and isinstance(value, tuple):
        return tuple(_number(key, part, declaration, whole=whole, vector=False) for part in value)
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            unit = f" of {declaration.knob.unit}" if declaration.knob.unit not in ("", "1") else ""
            what = ("one number" if "," in str(value) else "a number") + unit + " or none" * none
            example = declaration.default if type(declaration.default) in (float, int) else 1.5
            raise Refused(f"{key} must be {what}, not {value!r}; write for example {key}={example:g}") from None
    return whole_number(key, value) if whole else number(key, value)


def _is_law(value: object) -> bool:
    return hasattr(value, "master_start") or hasattr(value, "force")


def _law(key: str, value: object, default: object) -> object:
    if isinstance(value, str):
        return read_law(value, default)
    if isinstance(value, tuple) and value and all(map(_is_law, value)):
        return value  # one for each axis
    if not _is_law(value):
        raise Refused(f"{key} must be a law or the name of one, not {value!r}; write {key}=wave")
    return value


def read_law(text: str, default: object = None) -> Any:
    """The law that a text names: `wave`, `wave(b=3.0)`, `FILE.py:CLASS`, `deadband(0.1) | wave`. Raises `Refused`.

    `default`: the law that a scene has by itself. A text that names this law keeps the scene's gains, unless brackets
    say that they are written out: `wave()` has the law's own numbers everywhere.
    """
    law = _own_as_named(text, default)
    return _named_law(text, {}) if law is None else law


def law_with_its_numbers(text: str, scene: Callable[..., Any]) -> str:
    """The text that gives a law its own numbers in the scene of this function: `wave()` where `wave` has the scene's.

    Raises `Refused` for a text that names no law.
    """
    default = knobs_of(scene)["law"].default if "law" in knobs_of(scene) else None
    law = _own_as_named(text, default)
    return text if law is None or law == _named_law(text, {}) else f"{text}()"


def _own_as_named(text: str, default: Any) -> Any | None:
    """The scene's own law (of several axes a tuple) with the stages of `text` around; None if it names another law."""
    parts = law_text(text)
    laws = default if isinstance(default, tuple) else (default,)
    if parts.arguments or not all(is_dataclass(law) and not isinstance(law, type) for law in laws):
        return None
    kind = innermost(type(laws[0]))
    if _law_class(parts.law) is not kind:
        return None
    named = [kind(**{each.name: getattr(law, each.name) for each in fields(kind) if each.init}) for law in laws]
    if parts.stages:
        named = [around(" | ".join(parts.stages), law) for law in named]
        if type(named[0]) is type(laws[0]) and not any("(" in stage for stage in parts.stages):
            named = [*laws]  # the scene's own stages too
    return tuple(named) if isinstance(default, tuple) else named[0]


def _by_axis(make: Callable[[Mapping[str, object]], Any], changes: Mapping[str, object]) -> Any:
    """The law that `make` makes with these changes of its numbers; a law for each axis where one of them has several.

    Raises `Refused` where two of them have several, and not as many.
    """
    parted = {key: tuple(value.split(",")) if isinstance(value, str) and "," in value else value
              for key, value in changes.items()}
    several = {key: value for key, value in parted.items() if isinstance(value, tuple)}
    if not several:
        return make(parted)
    counts = {len(value) for value in several.values()}
    if len(counts) > 1:
        first, *_, last = [f"law.{key} has {len(value)}" for key, value in several.items()]
        raise Refused(f"numbers of a law that are given for each axis are as many as the scene has axes, and {first} "
                      f"and {last}; write one number, which means for each axis, or as many as there are axes")
    return tuple([make({key: value[i] if key in several else value for key, value in parted.items()})  # type: ignore[index]  # a tuple
                  for i in range(counts.pop())])


def _tuned_by_axis(law: Any, changes: Mapping[str, object]) -> Any:
    """A law with changes of its numbers, or of a tuple of laws that of each axis."""
    if not isinstance(law, tuple):
        return _by_axis(lambda changes_of_axis: _tuned(law, changes_of_axis), changes)
    alone = _by_axis(lambda changes_of_axis: changes_of_axis, changes)
    if isinstance(alone, tuple) and len(alone) != len(law):
        raise Refused(f"the scene has a law for each of {len(law)} axes, and law.{next(iter(changes))} has "
                      f"{number_of(len(alone), 'number')}; write one number, which means for each axis, or {len(law)}")
    changes_of_axis = alone if isinstance(alone, tuple) else (alone,) * len(law)
    return tuple([_tuned(each, numbers) for each, numbers in zip(law, changes_of_axis, strict=True)])


def _named_law(text: str, changes: Mapping[str, object]) -> Any:
    """The law that a text names, with its own numbers, then those in its brackets, then the changes."""
    parts = law_text(text)
    kind, in_brackets = _arguments(parts)
    if not parts.stages:
        return _made_law(kind, _numbers_of_law(kind, {**in_brackets, **changes}))
    names = {field.name for field in fields(kind)} if is_dataclass(kind) else set()
    inner = {key: value for key, value in changes.items() if key in names}
    law = around(" | ".join(parts.stages), _made_law(kind, _numbers_of_law(kind, {**in_brackets, **inner})))
    return _tuned(law, changes) if len(inner) < len(changes) else law


def _arguments(parts: LawText) -> tuple[Any, dict[str, object]]:
    """The class of a law that a text names, and the numbers in the brackets behind it."""
    kind = _law_class(parts.law)
    return kind, arguments_of_law(parts.law, kind, parts.arguments) if parts.arguments else {}


def _made_law(kind: Any, values: dict[str, object]) -> Any:
    try:
        return kind(**values)
    except WrongNumber as wrong:
        raise _of_the_law(wrong, values, kind) from None
    except Refused:
        raise
    except Exception as error:
        known = fields(kind) if is_dataclass(kind) else ()
        needs = [f.name for f in known if f.init and f.default is f.default_factory is MISSING and f.name not in values]
        if needs:
            raise Refused(f"law {name_of_law(kind)} needs {enumerated(needs)}: add --set law.{needs[0]}=VALUE, or "
                          "write a default into its file") from None
        raise Refused(f"law {name_of_law(kind)} cannot be made ({error}); write it as a dataclass of numbers, "
                      "@dataclass(frozen=True, kw_only=True)") from error


def _law_class(text: str) -> Any:
    if file_named(text):
        return file_law(text)
    try:
        return find_law(text)
    except Refused as refused:
        raise Refused(f"{refused} (a law in a file of your own is FILE.py or FILE.py:CLASS)") from None


def _tuned(law: Any, changes: Mapping[str, object]) -> Any:
    values = _numbers_of_law(type(law), changes)
    try:
        return replace(law, **values)
    except WrongNumber as wrong:
        raise _of_the_law(wrong, values, type(law)) from None


def _of_the_law(wrong: WrongNumber, values: Mapping[str, object], kind: Any) -> WrongNumber:
    """The refusal by the name that was typed, with the knob's meaning and the file whose head names its source."""
    if wrong.name not in values:
        return wrong
    knob = knobs_of_fields(kind).get(wrong.name) if is_dataclass(kind) else None
    renamed = wrong.with_name(f"law.{wrong.name}")
    if knob is None or not knob.knob.meaning:
        return renamed
    known = f"{kind.__module__}:{kind.__name__}" in BUILT_IN.values()
    source = f"; source: the head of {kind.__module__.replace('.', '/')}.py" * known
    return renamed.with_note(knob.knob.meaning + source)


def _numbers_of_law(kind: Any, changes: Mapping[str, object]) -> dict[str, object]:
    names = [f.name for f in fields(kind)] if is_dataclass(kind) else []
    for key in changes:
        if key not in names:
            whose = [name for name in BUILT_IN if key in [f.name for f in fields(find_law(name))]]  # type: ignore[arg-type]  # laws are dataclasses
            also = f" ({', '.join(whose)} {'has' if len(whose) == 1 else 'have'} one)" if whose else ""
            raise Refused(f"law {name_of_law(kind)} has no knob {key!r}{also}; {nearest(key, names)}")
    known = knobs_of_fields(kind) if changes else {}
    return {key: _number(f"law.{key}", value, known.get(key, _PLAIN), whole=False, vector=False)
            for key, value in changes.items()}

