"""What there is to name on the command line: scenes, laws and effects, and the knobs of each."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from importlib import import_module
from inspect import getsource
from pathlib import Path
from typing import Any

from teleop.errors import Refused, nearest
from teleop.law import BUILT_IN, find_law, known_laws
from teleop.scene.library import ROOT, built_in_scenes, house, known_scenes, scene_function

UNITS = ("N s/m", "N/m^n", "N/m", "N/s", "m/s", "s/m", "1/s", "kg", "Hz", "ticks", "m", "s", "N")
_UNIT = re.compile(rf"(?:^|, )({'|'.join(map(re.escape, UNITS))})(?=[,;]|$| of | after | from )")
Knob = tuple[str, str, str, str]  # name, type, default, remark


def overview() -> str:
    """Scenes, laws and effects with a line each; those of plug-ins are named without being imported."""
    effects = house("channel.link").known_effects()
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
    """The knobs of whatever is called `name`, scene, law or effect. Raises `Refused` if nothing is."""
    effects: Mapping[str, str] = house("channel.link").known_effects()
    laws, scenes = known_laws(), known_scenes()
    parts = []
    if name in scenes or name.endswith(".py"):
        function = scene_function(name)
        parts.append(_part(f"scene {name}", function, _scene_knobs(function), "--set NAME=VALUE"))
    if name in laws:
        law = _load(laws[name])
        parts.append(_part(f"law {name}", law, _field_knobs(law), f"--set law={name} --set law.NAME=VALUE"))
    if name in effects:
        effect = _load(effects[name])
        parts.append(_part(f"effect {name}", effect, _field_knobs(effect), f"--link '{name}(NAME=VALUE)'"))
    if name in (estimators := _estimators()):
        estimator = _load(estimators[name])
        how = f"--set 'velocity={name}(NAME=VALUE)' of a scene that has this knob"
        parts.append(_part(f"velocity estimator {name}", estimator, _field_knobs(estimator), how))
    if not parts:
        known = {*scenes, *laws, *effects, *estimators}
        raise Refused(f"there is no scene, law, effect or estimator {name!r}; {nearest(name, known)}")
    return "\n\n".join(parts)


def units_of(name: str, knobs: Sequence[str]) -> dict[str, str]:
    """The units of a scene's knobs as `details` shows them, out of the remarks beside the knobs."""
    try:
        said = {key: remark for key, *_, remark in _scene_knobs(scene_function(name))}
    except Refused:  # the scene's file is gone, or is no scene any more
        return {}
    if any(knob.startswith("law.") for knob in knobs):
        said |= {f"law.{key}": remark for law in BUILT_IN for key, *_, remark in _field_knobs(find_law(law))}
    return {"x_limit": "m"} | {key: match[1] for key, remark in said.items() if (match := _UNIT.search(remark))}


def _estimators() -> dict[str, str]:
    from teleop.naming import known
    from teleop.stages.velocity.named import ESTIMATORS

    return dict(sorted(known(ESTIMATORS.group, ESTIMATORS.places).items()))


def _part(heading: str, thing: Any, knobs: list[Knob], how: str) -> str:
    lines = [f"{heading}: {_line(thing)}"]
    if knobs:
        lines += [_columns([("knob", "type", "default", ""), *knobs]), f"  set with: {how}"]
    return "\n".join(lines)


def _columns(rows: list[Any]) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(f"  {line}".rstrip() for line in lines)


def _scene_knobs(function: Callable[..., Any]) -> list[Knob]:
    from teleop.scene.knobs import knobs_of

    said = _remarks(function)
    return [
        (name, _kind(hint), _shown(default), said.get(name, ""))
        for name, (hint, default) in knobs_of(function).items()
    ]


def _field_knobs(kind: Any) -> list[Knob]:
    said = _remarks(kind)
    return [
        (f.name, _kind(f.type), _shown(... if f.default is MISSING else f.default), said.get(f.name, ""))
        for f in fields(kind) if f.init
    ]


def _kind(hint: Any) -> str:
    text = hint if isinstance(hint, str) else getattr(hint, "__name__", None) or str(hint)
    return re.sub(r"[\w.]+\.(\w+)", r"\1", text)


def _shown(default: Any) -> str:
    if default is ...:
        return "(must be given)"
    if isinstance(default, Path) and default.is_relative_to(ROOT):
        return str(default.relative_to(ROOT))
    return "none" if default is None else str(default)


def _remarks(thing: Any) -> dict[str, str]:
    """The comments beside a function's parameters or a class's fields: there the units stand."""
    try:
        source = getsource(thing)
    except OSError:
        return {}
    return dict(re.findall(r"^ +(\w+): [^#\n]*#[: ]*(.+)$", source, flags=re.MULTILINE))


def _line(thing: Any) -> str:
    """The first sentence of a docstring."""
    paragraph = " ".join((thing.__doc__ or "").strip().partition("\n\n")[0].split())
    return re.split(r"(?<=\.) (?=[A-Z])", paragraph)[0]


def _law_line(name: str, where: str) -> str:
    return _line(_load(where)) if name in BUILT_IN else f"from a plug-in, {where}"


def _scene_line(name: str) -> str:
    """A scene's first line, read and not run."""
    if name not in built_in_scenes():
        return "from a plug-in"
    tree = ast.parse((ROOT / "scenarios" / f"{name}.py").read_text(encoding="utf-8"))
    made = (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "scene")
    return next(((ast.get_docstring(node) or "").partition("\n")[0] for node in made), "")


def _load(where: str) -> Any:
    module, _, attribute = where.partition(":")
    return getattr(house(module) if module.startswith("channel.") else import_module(module), attribute)
