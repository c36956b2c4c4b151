"""Stages around a law by name, and the texts that name them: `deadband(0.1) | guard() | pfra(alpha=0.2)`.

The last part is the law, what stands before it are stages, the outermost first. A part without numbers needs no
brackets: `deadband | wave`.
"""

from __future__ import annotations

import ast
import re
from functools import reduce
from typing import Any, NamedTuple

from teleop.errors import Refused, WrongNumber, nearest
from teleop.law import BUILT_IN
from teleop.laws.around.compose import compose
from teleop.naming import PartKind, unreadable

STAGES = {
    "deadband": "teleop.laws.around.deadband:DeadbandWrapper",
    "guard": "teleop.laws.around.guard:GuardWrapper",
    "virtual_coupling": "teleop.laws.around.virtual_coupling:VirtualCouplingWrapper",
}
EXAMPLES = {"deadband": "deadband(0.1, floor=1e-3)", "guard": "guard(E0=0.05)",
            "virtual_coupling": "virtual_coupling(K=400, B=0.2)"}
KIND = PartKind(word="stage", group="teleop.stages_around", places=STAGES, examples=EXAMPLES)
_FORM = "write for example law='deadband(0.1) | wave'"
_CALL = re.compile(r"(?P<name>.*\.py(?::\w+)?|[^(]*?)\s*(?P<arguments>\(.*\))?", re.DOTALL)
_LONGEST = 1000  # characters of a text


class LawText(NamedTuple):
    """A text that names a law, in its parts."""

    stages: tuple[str, ...]  # the outermost first, each as `deadband(0.1)`
    law: str  # the name of the law, or FILE.py:CLASS
    arguments: str  # of the law, with their brackets; empty if there are none


def law_text(text: str) -> LawText:
    """The parts of a text that names a law. Raises `Refused` for brackets that are not closed and for empty parts.

    >>> law_text("deadband(0.1) | wave(b=3.0)")
    LawText(stages=('deadband(0.1)',), law='wave', arguments='(b=3.0)')
    """
    if len(text) > _LONGEST:
        raise Refused(f"a law is a text of at most {_LONGEST} characters; {_FORM}")
    *stages, law = [part.strip() for part in _parted(text)]
    call = _CALL.fullmatch(law)
    if not law or not all(stages) or call is None:
        raise Refused(f"the law {text[:80]!r} cannot be read: {unreadable(text, SyntaxError())}; {_FORM}")
    if call["name"] in STAGES and call["name"] not in BUILT_IN:
        raise Refused(f"the stage {call['name']} stands before a law, and {text[:80]!r} ends with it; {_FORM}")
    return LawText(tuple(stages), call["name"], call["arguments"] or "")


def around(stages: str, law: Any) -> Any:
    """The law with stages around it: `around("deadband(0.1) | guard()", Wave(b=3.0))`, the outermost first.

    It runs in every engine to the same bits, and its class is the same for the same names, whatever their numbers.
    Raises `Refused` for a text that names no stages, and for a law that has not two ends.

    >>> from teleop.laws.wave import Wave
    >>> around("deadband(0.1)", Wave(b=3.0))
    DeadbandWave(b=3.0, K=500.0, B=20.0, deadband_k=0.1, deadband_floor=0.001)
    """
    if not isinstance(stages, str) or not stages.strip():
        raise Refused(f"around takes the stages as a text, not {stages!r}; write for example around('deadband(0.1)', "
                      "Wave())")
    made = [read_stage(part.strip()) for part in _parted(stages)]
    return reduce(lambda inner, stage: compose(stage, inner), reversed(made), law)


def read_stage(text: str) -> Any:
    """The stage that a text names. Raises `Refused`."""
    if not text:
        raise Refused(f"nothing stands on one side of a |; {_FORM}")
    name = text.partition("(")[0].strip()
    if name.isidentifier() and name not in STAGES:
        raise Refused(f"there is no stage {name!r} to stand around a law; {nearest(name, STAGES)} ({_FORM})")
    try:
        return KIND.read(f"{text}()" if text.isidentifier() else text)
    except WrongNumber as wrong:  # by the name that it has beside the knobs of the law
        raise wrong.with_name(f"law.{name}_{wrong.name}") from None


def arguments_of_law(name: str, kind: type[Any], arguments: str) -> dict[str, Any]:
    """The numbers in the brackets behind a law's name, by knob. Raises `Refused` for what is no knob of the law.

    >>> from teleop.laws.wave import Wave
    >>> arguments_of_law("wave", Wave, "(b=3.0)")
    {'b': 3.0}
    """
    laws = PartKind(word="law", group="", places={}, examples={})
    try:
        node = ast.parse(f"law{arguments}", mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise Refused(f"the numbers of law {name}, {arguments[:80]}, cannot be read: {unreadable(arguments, error)}; "
                      "write for example wave(b=3.0)") from None
    if not isinstance(node, ast.Call):
        raise Refused(f"the law {(name + arguments)[:80]!r} cannot be read; write for example wave(b=3.0)")
    return laws.arguments(name, kind, node)


def _parted(text: str) -> list[str]:
    """`text` parted at each | that is in no brackets and no quotes."""
    parts, depth, quote = [""], 0, ""
    for sign in text:
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"":
            quote = sign
        elif sign in "([{)]}":
            depth += 1 if sign in "([{" else -1
        elif sign == "|" and not depth:
            parts.append("")
            continue
        parts[-1] += sign
    if quote or depth:
        raise Refused(f"the law {text[:80]!r} cannot be read: {unreadable(text, SyntaxError())}; {_FORM}")
    return parts
