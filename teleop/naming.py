"""Parts found by name: those built in, and those that installed packages offer as entry points.

A package of yours offers a law by `[project.entry-points."teleop.laws"]`, `mine = "my_package:MyLaw"`; an
effect by the group `teleop.effects`, a scene (its module) by `teleop.scenes`, a master's device by `teleop.devices`, a
slave's robot by `teleop.robots`. They are listed without being imported. `teleop.live.devices.opening` opens one by
its name. A `PartKind` reads parts from texts, written as in Python: `low_pass(cutoff=30.0)`, `bernoulli(0.02)`.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import lru_cache
from importlib import import_module
from typing import Any, NamedTuple

from teleop.errors import Refused, enumerated, nearest, number_of


def known_places(group: str, built_in: Mapping[str, str]) -> dict[str, str]:
    """Places of all parts of a group by name, as `"module:attribute"`; none is imported."""
    from importlib.metadata import entry_points

    return {**_offered(entry_points, group, tuple(sys.path)), **built_in}


@lru_cache(maxsize=16)  # reading the metadata of all packages takes tens of milliseconds, and a sweep asks for each row
def _offered(entry_points: Any, group: str, path: tuple[str, ...]) -> dict[str, str]:  # noqa: ARG001 - a key alone
    """The parts of a group that the packages on `path` offer: `name -> "module:attribute"`."""
    return {entry.name: entry.value for entry in entry_points(group=group)}


def find(kind: str, group: str, built_in: Mapping[str, str], name: str) -> Any:
    """Load the part of this name. Raises `Refused` with the nearest names if there is none.

    >>> find("law", "teleop.laws", {"wave": "teleop.laws.wave:Wave"}, "wave").__name__
    'Wave'
    """
    # The installed packages are looked through only for what is not built in: it costs tens of milliseconds.
    place = built_in.get(name)
    if place is None:
        places = known_places(group, built_in)
        if name not in places:
            _offered.cache_clear()  # a package may have been installed since
            places = known_places(group, built_in)
        if name not in places:
            raise Refused(f"there is no {kind} {name!r}; {nearest(name, places)}")
        place = places[name]
    module, _, attribute = place.partition(":")
    loaded = import_module(module)
    return getattr(loaded, attribute) if attribute else loaded


def public_name(package: str, homes: Mapping[str, Sequence[str]], name: str) -> Any:
    """Load a public name of a package; `homes` lists the names of each module of the package.

    Raises `AttributeError`, as a module does, if no module of `homes` has the name.
    """
    for module, names in homes.items():
        if name in names:
            return getattr(import_module(f"{package}.{module}"), name)
    raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name, obj=import_module(package))


@dataclass(frozen=True, kw_only=True, slots=True)
class PartKind:
    """A kind of part that texts may name: dataclasses, built in at `places` or offered as entry points of `group`."""

    word: str  # for a part of this kind
    group: str
    places: Mapping[str, str]  # "module:class" by name
    examples: Mapping[str, str]
    synonyms: Mapping[str, str] = field(default_factory=dict)  # names by which people look for a part, to its name

    def make(self, node: ast.AST, text: str, form: str) -> Any:
        """Make the part of a call in `text`; `form` is an example of one. Raises `Refused`."""
        if isinstance(node, ast.Name):
            made = self.find(node.id)
            raise Refused(f"the {self.word} {node.id} needs brackets: {self._usage(node.id, made)}")
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
            part = ast.unparse(node)[:40]
            raise Refused(f"{text[:80]!r} has a part that is no {self.word}, {part!r}; {form}")
        name = node.func.id
        made = self.find(name)
        return made(**self.arguments(name, made, node))

    def find(self, name: str) -> Any:
        """Load the part of this name. Raises `Refused` with what a synonym stands for, or the nearest names."""
        if name in self.synonyms and name not in known_places(self.group, self.places):
            raise Refused(f"there is no {self.word} {name!r}; write for example {self.examples[self.synonyms[name]]}")
        return find(self.word, self.group, self.places, name)

    def read(self, text: str) -> Any:
        """Make the one part that `text` describes. Raises `Refused`.

        >>> laws = PartKind(word="law", group="teleop.laws", places={"wave": "teleop.laws.wave:Wave"}, examples={})
        >>> laws.read("wave(b=3.0)").b
        3.0
        """
        form = f"write for example {next(iter(self.examples.values()), 'name(argument=1.0)')}"
        try:
            node = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise Refused(f"the {self.word} {text[:80]!r} cannot be read: {unreadable(text, error)}; {form}") from None
        return self.make(node, text, form)

    def arguments(self, name: str, made: type[Any], node: ast.Call) -> dict[str, Any]:
        """Arguments of a call by name, of the class `made`; the part itself checks their values. Raises `Refused`."""
        knobs = _arguments_of(made)
        usage = self._usage(name, made)
        in_place = [knob for knob, (_, by_name) in knobs.items() if not by_name]
        if len(node.args) > len(in_place) or any(isinstance(arg, ast.Starred) for arg in node.args):
            raise Refused(f"{name} takes at most {number_of(len(in_place), 'argument')} without their names: {usage}")
        nodes = dict(zip(in_place, node.args, strict=False))
        for keyword in node.keywords:
            if keyword.arg is None or keyword.arg in nodes or keyword.arg not in knobs:
                twice = "twice " if keyword.arg in nodes else ""
                raise Refused(f"{name} does not take {keyword.arg or '**'} {twice}as an argument: {usage}")
            nodes[keyword.arg] = keyword.value
        missing = [knob for knob, (needed, _) in knobs.items() if needed and knob not in nodes]
        if missing:
            raise Refused(f"{name} needs {enumerated(missing)}: {usage}")
        try:
            return {knob: ast.literal_eval(value) for knob, value in nodes.items()}
        except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError):
            raise Refused(f"the arguments of {name} must be numbers or texts in quotes: {usage}") from None

    def _usage(self, name: str, made: type[Any]) -> str:
        """Example of how to write a part: its own, or its arguments with their defaults."""
        named = ", ".join(knob.name if knob.default is MISSING else f"{knob.name}={knob.default!r}"
                          for knob in fields(made) if knob.init)
        return f"write for example {self.examples.get(name, f'{name}({named})')}"


def unreadable(text: str, error: Exception) -> str:
    """The reason why a text of parts cannot be read, as the parser's `error` found it.

    >>> unreadable("delay(0.04", SyntaxError()), unreadable("delay(0.04) |", SyntaxError())
    ('its ( is never closed', 'nothing stands behind its last |')
    """
    open_brackets, quote = "", ""
    for sign in text:
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"":
            quote = sign
        elif sign in "([{":
            open_brackets += sign
        elif sign in ")]}":
            if not open_brackets or f"{open_brackets[-1]}{sign}" not in ("()", "[]", "{}"):
                return f"a {sign} closes no bracket"
            open_brackets = open_brackets[:-1]
    if quote or open_brackets:
        return f"its {quote or open_brackets[-1]} is never closed"
    if text.rstrip().endswith("|"):
        return "nothing stands behind its last |"
    if text.lstrip().startswith("|") or "||" in text.replace(" ", ""):
        return "nothing stands in front of a |"
    at = getattr(error, "offset", None) or 0
    rest = text.strip()[max(at - 1, 0):][:40]
    return f"it is not understood from {rest!r} on" if at and rest else "it is no name with arguments in brackets"


def _arguments_of(made: type[Any]) -> dict[str, tuple[bool, bool]]:
    """Arguments of a part by name: True if it must be given, True if it must be given by name."""
    return {knob.name: (knob.default is MISSING, bool(knob.kw_only)) for knob in fields(made) if knob.init}


DEVICES = {  # of the master's end
    "compensated": "teleop.live.devices.compensated:compensated_device",
    "csv": "teleop.live.devices.csv_replay:replayed_device",
    "dynamixel": "teleop.live.devices.arms.dynamixel:dynamixel_device",
    "feetech": "teleop.live.devices.arms.feetech:feetech_device",
    "franka": "teleop.live.devices.arms.franka:franka_device",
    "gamepad": "teleop.live.devices.opening:gamepad",
    "haply": "master.haply:Inverse3",
    "openarm": "teleop.live.devices.arms.openarm:openarm_device",
    "pointer": "teleop.live.devices.opening:pointer",
    "simulated": "master.device:SimulatedMaster",
}
ROBOTS = {  # of the slave's end
    "compensated": "teleop.live.devices.compensated:compensated_robot",
    "csv": "teleop.live.devices.csv_replay:replayed_robot",
    "dynamixel": "teleop.live.devices.arms.dynamixel:dynamixel_robot",
    "feetech": "teleop.live.devices.arms.feetech:feetech_robot",
    "franka": "teleop.live.devices.arms.franka:franka_robot",
    "mujoco": "slave.mujoco_robot:MuJoCoRobot",
    "openarm": "teleop.live.devices.arms.openarm:openarm_robot",
    "simulated": "slave.robot:SimulatedSlave",
}


class DeviceKind(NamedTuple):
    """Kind of device at one end: its word, the option that names it, the group of entry points, the built-in ones."""

    word: str
    option: str
    group: str
    built_in: Mapping[str, str]  # "module:maker" by name


DEVICE_KINDS = {
    "m": DeviceKind("device", "--device", "teleop.devices", DEVICES),
    "s": DeviceKind("robot", "--robot", "teleop.robots", ROBOTS),
}


def known_devices(e: str) -> dict[str, str]:
    """Places of all that may stand at the end `e`, "m" or "s": `name -> "module:maker"`. None is imported."""
    return dict(sorted(known_places(DEVICE_KINDS[e].group, DEVICE_KINDS[e].built_in).items()))
