"""Parts written as text, the way they are written in Python: `low_pass(cutoff=30.0)`, `bernoulli(0.02)`."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any

from teleop.errors import Refused
from teleop.naming import find


@dataclass(frozen=True, kw_only=True, slots=True)
class Kind:
    """A kind of part that texts may name: dataclasses, built in at `places` or offered as entry points of `group`."""

    word: str  # what one of it is called
    group: str
    places: Mapping[str, str]  # "module:class" by name
    examples: Mapping[str, str]

    def make(self, node: ast.AST, text: str, form: str) -> Any:
        """The part that a call in `text` makes; `form` is how to write one. Raises `Refused`."""
        if isinstance(node, ast.Name):
            made = find(self.word, self.group, self.places, node.id)
            raise Refused(f"the {self.word} {node.id} needs brackets: {self._usage(node.id, made)}")
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
            part = ast.unparse(node)[:40]
            raise Refused(f"{text[:80]!r} has a part that is no {self.word}, {part!r}; {form}")
        name = node.func.id
        made = find(self.word, self.group, self.places, name)
        return made(**self._arguments(name, made, node))

    def read(self, text: str) -> Any:
        """The one part that `text` describes. Raises `Refused`.

        >>> laws = Kind(word="law", group="teleop.laws", places={"wave": "teleop.laws.wave:Wave"}, examples={})
        >>> laws.read("wave(b=3.0)").b
        3.0
        """
        form = f"write for example {next(iter(self.examples.values()), 'name(argument=1.0)')}"
        try:
            node = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise Refused(f"the {self.word} {text[:80]!r} cannot be read; {form}") from None
        return self.make(node, text, form)

    def _arguments(self, name: str, made: type[Any], node: ast.Call) -> dict[str, Any]:
        """The call's arguments by name; whether their values are any good the part says itself."""
        knobs = _knobs(made)
        usage = self._usage(name, made)
        in_place = [knob for knob, (_, by_name) in knobs.items() if not by_name]
        if len(node.args) > len(in_place) or any(isinstance(arg, ast.Starred) for arg in node.args):
            raise Refused(f"{name} takes at most {len(in_place)} arguments without their names: {usage}")
        given = dict(zip(in_place, node.args, strict=False))
        for keyword in node.keywords:
            if keyword.arg is None or keyword.arg in given or keyword.arg not in knobs:
                twice = "twice " if keyword.arg in given else ""
                raise Refused(f"{name} does not take {keyword.arg or '**'} {twice}as an argument: {usage}")
            given[keyword.arg] = keyword.value
        missing = [knob for knob, (needed, _) in knobs.items() if needed and knob not in given]
        if missing:
            raise Refused(f"{name} needs {' and '.join(missing)}: {usage}")
        try:
            return {knob: ast.literal_eval(value) for knob, value in given.items()}
        except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError):
            raise Refused(f"the arguments of {name} must be numbers or texts in quotes: {usage}") from None

    def _usage(self, name: str, made: type[Any]) -> str:
        """What to write for a part; of a plug-in's only the names of its arguments are known."""
        named = ", ".join(knob if needed else f"{knob}=..." for knob, (needed, _) in _knobs(made).items())
        return f"write for example {self.examples.get(name, f'{name}({named})')}"


def _knobs(made: type[Any]) -> dict[str, tuple[bool, bool]]:
    """A part's arguments: whether it is needed, whether it must be named."""
    return {knob.name: (knob.default is MISSING, bool(knob.kw_only)) for knob in fields(made) if knob.init}
