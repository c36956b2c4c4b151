"""Names for the command line: scenes, laws, effects and velocity estimators, with the knobs of each."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from teleop.errors import Refused, nearest
from teleop.knob import Declared, Knob, knobs_of_fields
from teleop.law import BUILT_IN, find_law, known_laws
from teleop.naming import known
from teleop.scene.knobs import knobs_of
from teleop.scene.library import ROOT, built_in_scenes, import_bundled, known_scenes, scene_function
from teleop.stages.velocity.named import ESTIMATORS

MEANINGS = {  # of knobs that declare nothing, by their type
    "Law": "control law: direct, pfra, wave, one of a plug-in, or FILE.py:CLASS",
    "OnePortLaw": "law that renders by itself: virtual_coupling, virtual_wall, one of a plug-in, or FILE.py:CLASS",
    "Zero | Hold | Fixed": "zero, hold, or fixed:SECONDS from sending to playing",
    "VelocityEstimator": "backward_difference(), low_pass(cutoff=30), end_fit(noise=6e-5), levant(L=1) and others",
}


def overview() -> str:
    """List scenes, laws, effects and velocity estimators with a line each; no scene or law of a plug-in is imported."""
    effects = import_bundled("channel.link").known_effects()
    laws = known_laws()
    parts = {
        "scenes": [(name, _scene_line(name)) for name in known_scenes()],
        "laws": [(name, _law_line(name, laws[name])) for name in sorted(laws)],
        "effects": [(name, _line(_load(effects[name]))) for name in sorted(effects)],
        "velocity estimators": [(name, _line(_load(place))) for name, place in _estimators().items()],
    }
    blocks = [f"{heading}\n{_columns(lines)}" for heading, lines in parts.items()]
    return "\n\n".join([*blocks, "`teleop list NAME` shows the knobs of one of them."])


def details(name: str) -> str:
    """List the knobs of the scene, law, effect or estimator `name`, each of them if several have that name.

    Raises `Refused` for an unknown name.
    """
    effects: Mapping[str, str] = import_bundled("channel.link").known_effects()
    laws, scenes = known_laws(), known_scenes()
    parts = []
    if name in scenes or name.endswith(".py"):
        function = scene_function(name)
        parts.append(_part(f"scene {name}", function, knobs_of(function), "--set NAME=VALUE"))
    if name in laws:
        law = _load(laws[name])
        parts.append(_part(f"law {name}", law, knobs_of_fields(law), f"--set law={name} --set law.NAME=VALUE"))
    if name in effects:
        effect = _load(effects[name])
        parts.append(_part(f"effect {name}", effect, knobs_of_fields(effect), f"--link '{name}(NAME=VALUE)'"))
    if name in (estimators := _estimators()):
        estimator = _load(estimators[name])
        how = f"--set 'velocity={name}(NAME=VALUE)' of a scene that has this knob"
        parts.append(_part(f"velocity estimator {name}", estimator, knobs_of_fields(estimator), how))
    if not parts:
        known = {*scenes, *laws, *effects, *estimators}
        raise Refused(f"there is no scene, law, effect or estimator {name!r}; {nearest(name, known)}")
    return "\n\n".join(parts)


def units_of(name: str, knobs: Sequence[str]) -> dict[str, str]:
    """Units that the knobs of a scene declare, by knob; those of the built-in laws too if `knobs` names a law's."""
    try:
        found = dict(knobs_of(scene_function(name)))
    except Refused:  # the scene's file is gone, or is no scene any more
        return {}
    if any(knob.startswith("law.") for knob in knobs):
        found |= {f"law.{key}": each for law in BUILT_IN for key, each in knobs_of_fields(find_law(law)).items()}
    return {"x_limit": "m"} | {key: each.knob.unit for key, each in found.items() if each.knob.unit}


def _estimators() -> dict[str, str]:
    return dict(sorted(known(ESTIMATORS.group, ESTIMATORS.places).items()))


def _part(heading: str, thing: Any, knobs: Mapping[str, Declared], how: str) -> str:
    lines = [f"{heading}: {_line(thing)}"]
    if knobs:
        rows = [(name, _kind(found.kind), _shown(found.default), _remark(found)) for name, found in knobs.items()]
        lines += [_columns([("knob", "type", "default", ""), *rows]), f"  set with: {how}"]
    return "\n".join(lines)


def _columns(rows: list[Any]) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(f"  {line}".rstrip() for line in lines)


def _kind(hint: Any) -> str:
    text = hint if isinstance(hint, str) else getattr(hint, "__name__", None) or str(hint)
    return re.sub(r"[\w.]+\.(\w+)", r"\1", text)


def _shown(default: Any) -> str:
    if default is ...:
        return "(must be given)"
    if isinstance(default, Path) and default.is_relative_to(ROOT):
        return str(default.relative_to(ROOT))
    return "none" if default is None else str(default)


def _remark(found: Declared) -> str:
    """Unit, meaning and bounds of a knob."""
    knob = found.knob
    meaning = knob.meaning or MEANINGS.get(_kind(found.kind), "")
    return ", ".join(part for part in (knob.unit, meaning, *_bounds(knob)) if part)


def _bounds(knob: Knob) -> list[str]:
    ends = ((">", knob.above), (">=", knob.low), ("<=", knob.high))
    one_of = [f"one of {', '.join(knob.choices)}"] if knob.choices else []
    return [f"{sign} {end:g}" for sign, end in ends if end is not None] + one_of


def _line(thing: Any) -> str:
    """The first sentence of a docstring."""
    paragraph = " ".join((thing.__doc__ or "").strip().partition("\n\n")[0].split())
    return re.split(r"(?<=\.) (?=[A-Z])", paragraph)[0]


def _law_line(name: str, where: str) -> str:
    return _line(_load(where)) if name in BUILT_IN else f"from a plug-in, {where}"


def _scene_line(name: str) -> str:
    """The first line of a scene's docstring, read from its file without importing it."""
    if name not in built_in_scenes():
        return "from a plug-in"
    tree = ast.parse((ROOT / "scenarios" / f"{name}.py").read_text(encoding="utf-8"))
    made = (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "scene")
    return next(((ast.get_docstring(node) or "").partition("\n")[0] for node in made), "")


def _load(where: str) -> Any:
    module, _, attribute = where.partition(":")
    return getattr(import_bundled(module) if module.startswith("channel.") else import_module(module), attribute)
