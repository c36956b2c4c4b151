"""Names for the command line: scenes, laws, effects, velocity estimators and devices, with the knobs of each.

The devices that there are stand in `teleop.naming`, so that a live end finds one without this file.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import Refused, closest, nearest
from teleop.knob import Declared, knobs_of_fields
from teleop.law import BUILT_IN, find_law, known_laws
from teleop.laws.around.names import EXAMPLES, STAGES
from teleop.naming import DEVICE_KINDS, known_places
from teleop.scene import library
from teleop.scene.knobs import COMMON, knobs_of, read_law
from teleop.stages.velocity import ESTIMATORS


class Named(NamedTuple):
    """A scene, a law, an effect or a velocity estimator: what it is, its knobs, and how they are set."""

    kind: str
    name: str
    meaning: str
    knobs: Mapping[str, Declared]
    how: str
    made: Any = None  # the class of a law


def names() -> dict[str, dict[str, str]]:
    """Names by their kind, each with its meaning; no scene or law of a plug-in is imported."""
    laws = known_laws()
    return {
        "scenes": {name: _scene_line(name) for name in library.known_scenes()},
        "laws": {name: _law_line(name, laws[name]) for name in sorted(laws)},
        "around": {name: _line(_load(where)) for name, where in sorted(STAGES.items())},
        "effects": {name: _line(_load(where)) for name, where in sorted(_effects().items())},
        "estimators": {name: _line(_load(where)) for name, where in _estimators().items()},
    }


class UnknownName(Refused):
    """A name that no scene, law, effect or estimator has; `subject`: the refusal without the names that there are."""

    def __init__(self, name: str, known: Collection[str]) -> None:
        self.subject = f"there is no scene, law, effect or estimator {name!r}"
        self.is_close = bool(closest(name, known))
        super().__init__(f"{self.subject}; {nearest(name, known)}")


def find(name: str) -> list[Named]:
    """The scene, law, effect or estimator `name`, each of them if several have that name; of a file what is in it.

    Raises `Refused` for an unknown name.
    """
    if "|" in name or name.endswith(")"):
        return [_law(name, type(read_law(name)))]
    if library.file_named(name):
        return _in_file(name)
    entries = []
    if name in library.known_scenes():
        entries.append(_scene(name))
    if name in (laws := known_laws()):
        entries.append(_law(name, _load(laws[name])))
    if name in STAGES:
        stage = _load(STAGES[name])
        knobs = {f"{name}_{knob}": one for knob, one in knobs_of_fields(stage).items()}
        entries.append(Named("stage around a law", name, _line(stage), knobs,
                           f"--set law='{EXAMPLES[name]} | wave' --set law.NAME=VALUE"))
    if name in (effects := _effects()):
        effect = _load(effects[name])
        entries.append(Named("effect", name, _line(effect), knobs_of_fields(effect), f"--link '{name}(NAME=VALUE)'"))
    if name in (estimators := _estimators()):
        estimator = _load(estimators[name])
        entries.append(Named("velocity estimator", name, _line(estimator), knobs_of_fields(estimator),
                           f"--set 'velocity={name}(NAME=VALUE)' of a scene that has this knob"))
    if not entries:
        raise UnknownName(name, {*library.known_scenes(), *laws, *STAGES, *effects, *estimators})
    return entries


def units_of(name: str, knobs: Sequence[str], law: type[Any] | None = None) -> dict[str, str]:
    """Units that the knobs of a scene declare, by knob; those of its law too if `knobs` names one of them.

    `law`: its class; left out, the units are those of the built-in laws.
    """
    try:
        knobs_by_name = dict(knobs_of(library.scene_function(name)))
    except Refused:  # the scene's file is gone, or is no scene any more
        return {}
    if any(knob.startswith("law.") for knob in knobs):
        laws: list[Any] = [find_law(each) for each in BUILT_IN] if law is None else [law] * is_dataclass(law)
        knobs_by_name |= {f"law.{key}": each for one in laws for key, each in knobs_of_fields(one).items()}
    return {key: each.knob.unit for key, each in {**COMMON, **knobs_by_name}.items() if each.knob.unit}


def _in_file(text: str) -> list[Named]:
    """The scene and the laws of a file of the user's own, or the law of `FILE.py:CLASS`."""
    if not text.endswith(".py"):
        return [_law(text, library.file_law(text))]
    module = library.own_module(Path(text), "a scene or a law", "give the path of a .py file with a scene or a law")
    laws = library.laws_in(text)
    knobs = [_law(text if len(laws) == 1 else f"{text}:{name}", law) for name, law in laws.items()]
    if callable(getattr(module, "scene", None)) or not knobs:
        knobs.insert(0, _scene(text))
    return knobs


def _scene(name: str) -> Named:
    function = library.scene_function(name)
    return Named("scene", name, _line(function), knobs_of(function), "--set NAME=VALUE")


def _law(name: str, law: Any) -> Named:
    return Named("law", name, _line(law), knobs_of_fields(law), f"--set law={name} --set law.NAME=VALUE", law)


def _effects() -> Mapping[str, str]:
    entries: Mapping[str, str] = library.import_bundled("channel.link").known_effects()
    return entries


def _estimators() -> dict[str, str]:
    return dict(sorted(known_places(ESTIMATORS.group, ESTIMATORS.places).items()))


def _line(thing: Any) -> str:
    """The first sentence of a docstring; empty without one, or with that which a dataclass writes for itself."""
    if (thing.__doc__ or "").startswith(f"{thing.__name__}("):
        return ""
    paragraph = " ".join((thing.__doc__ or "").strip().partition("\n\n")[0].split())
    return re.split(r"(?<=\.) (?=[A-Z])", paragraph)[0]


def _law_line(name: str, where: str) -> str:
    return _line(_load(where)) if name in BUILT_IN else f"from a plug-in, {where}"


def _scene_line(name: str) -> str:
    """The first line of a scene's docstring, read from its file without importing it."""
    if name not in library.built_in_scenes():
        return "from a plug-in"
    tree = ast.parse((library.ROOT / "scenarios" / f"{name}.py").read_text(encoding="utf-8"))
    made = (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "scene")
    return next(((ast.get_docstring(node) or "").partition("\n")[0] for node in made), "")


def _load(where: str) -> Any:
    module, _, attribute = where.partition(":")
    load = library.import_bundled if module.startswith("channel.") else import_module
    return getattr(load(module), attribute)


def device_line(e: str, name: str, place: str) -> str:
    """The first line of the docstring of a built-in maker, read from its file without importing it."""
    if DEVICE_KINDS[e].built_in.get(name) != place:
        return f"from a plug-in, {place}"
    module, _, maker = place.partition(":")
    file = library.ROOT.joinpath(*module.split(".")).with_suffix(".py")
    if not file.is_file():
        return ""
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == maker:
            return (ast.get_docstring(node) or "").partition("\n")[0]
    return ""

