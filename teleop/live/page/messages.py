"""What a page may say, and what it is told in words."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from teleop.errors import number_of
from teleop.scene.axes import MOST_AXES
from teleop.storage.strict_json import Check, Misshapen, each, optional, parse, real, record, text, truth

LONGEST = 4096  # bytes of a message
REACH = 10.0  # m from 0, in each axis: `master.steered` goes no further
SLIDERS = ("delay", "jitter", "loss", "k_e")

_SHAPES: dict[str, dict[str, Check]] = {
    "hand": {"to": optional(each(real, most=MOST_AXES))},
    "turn": {"law": text, **dict.fromkeys(SLIDERS, real)},
    "clutch": {"open": truth},
    "again": {},
}
_NEEDED = {"hand": ("to",), "turn": (), "clutch": ("open",), "again": ()}


class Garbage(Misshapen):
    """No message of a page. `kind`: what is wrong with it, in a word, so that each is told of once."""

    def __init__(self, kind: str, sentence: str) -> None:
        super().__init__(sentence)
        self.kind = kind


def read(data: str | bytes) -> dict[str, Any]:
    """The message in `data`. Raises `Garbage`."""
    if isinstance(data, bytes):
        raise Garbage("binary", "a message is a text in JSON, not bytes")
    try:
        got = parse(data)
    except Misshapen as error:
        raise Garbage("json", f"a message is an object in JSON: {error}") from None
    kind = got.get("type") if isinstance(got, dict) else None
    if not isinstance(kind, str) or kind not in _SHAPES:
        raise Garbage("type", f"a message has a type, one of {', '.join(_SHAPES)}")
    shape = _SHAPES[kind]
    other = next((key for key in got if key != "type" and key not in shape), None)
    if other is not None:
        raise Garbage(kind, f"a message {kind!r} has no {other[:40]!r}; it may have: {', '.join(shape) or 'nothing'}")
    try:
        record({key: shape[key] for key in _NEEDED[kind]}, shape)(got, "the message")
    except Misshapen as error:
        raise Garbage(kind, str(error)) from None
    return got  # type: ignore[no-any-return]  # an object, as its shape says


def place(to: Sequence[float], axes: int) -> tuple[float, ...]:
    """A place (m, per axis) that the hand may go to. Raises `Garbage`."""
    if len(to) != axes or not all(abs(x) <= REACH for x in to):
        raise Garbage("place", f"the hand goes to {number_of(axes, 'number')} in m, each at most {REACH:g} from 0")
    return tuple(map(float, to))


def said(level: str, sentence: str) -> str:
    """A sentence for people; `level`: info, warn or error."""
    return json.dumps({"type": "said", "level": level, "text": sentence})
