"""The kinds of a law's message fields, declared in their annotations.

    class Forth(NamedTuple):
        u: kind.Wave
        x: kind.Sample
        E: kind.Total

A *wave* has energy: half its square is the power that it carries, W, so its unit is sqrt(W). It enters the ledger of
the link, and the playouts that fill gaps within the energy that was sent (`teleop.scene.playout`) fill it.

A *total* is summed from the beginning and never set back, such as the energy that an end has put in so far: so a packet
that is lost loses nothing and a copy adds nothing. The newest stands, also between ends of different rates.

A *sample* is a value at a tick: the newest stands, and of several that a slower end plays together their mean. A field
that declares nothing, `x: float`, is a sample.

A *position* is a place on the axis, m or rad, that a law compares with that of its own end; but for that it is a
sample. On the axes of a rotation it stands for an orientation: what is sent is a rotation vector, and what a law is
told is its own place and how far the other lies from it (`teleop.stages.orientation`), so that x - rx.x is the
logarithm of the relative rotation. A field of a law's state that is a place, such as a commanded point, is declared
likewise.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import lru_cache
from inspect import get_annotations
from types import SimpleNamespace
from typing import Annotated, Any, ForwardRef, get_args, get_type_hints

_KINDS = ("wave", "total", "sample", "position")
Wave = Annotated[float, "wave"]
Total = Annotated[float, "total"]
Sample = Annotated[float, "sample"]
Position = Annotated[float, "position"]


def kinds(message: type[Any]) -> dict[str, str]:
    """The kind of each field of a message or state, "wave", "total", "sample" or "position", in their order."""
    cached: Callable[[Any], dict[str, str]] = _kinds
    return cached(message)


def waves(message: type[Any]) -> tuple[str, ...]:
    """The names of the fields of a message type that are waves, in their order."""
    return tuple([name for name, kind in kinds(message).items() if kind == "wave"])


def totals(message: type[Any]) -> tuple[str, ...]:
    """The names of the fields of a message type that are totals, in their order."""
    return tuple([name for name, kind in kinds(message).items() if kind == "total"])


def positions(message: type[Any]) -> tuple[str, ...]:
    """The names of the fields of a message or a state that are positions, in their order."""
    return tuple([name for name, kind in kinds(message).items() if kind == "position"])


@lru_cache(maxsize=256)
def _kinds(message: Any) -> dict[str, str]:
    return {name: _kind(message, name) for name in message._fields}


def _kind(message: type[Any], field: str) -> str:
    for base in message.__mro__:
        if field in (hints := get_annotations(base)):
            alone = SimpleNamespace(__annotations__={field: hints[field]})  # others may be of what is not to be found
            words = vars(sys.modules[base.__module__]) if base.__module__ in sys.modules else {}
            try:
                hint = get_type_hints(alone, words, include_extras=True)[field]
            except Exception:  # its names are those of the function that the class is made in
                hint = hints[field]
                text = hint.__forward_arg__ if isinstance(hint, ForwardRef) else str(hint)
                return _or_sample(text.strip("'\"").rpartition(".")[2].lower())
            return next((_or_sample(each) for each in get_args(hint)[1:] if each in _KINDS), "sample")
    return "sample"


def _or_sample(word: str) -> str:
    return word if word in _KINDS else "sample"


def wave(message: type[Any]) -> str | None:
    """The name of the field that is a wave; None where there is none. A law has one at most in each direction."""
    return next(iter(waves(message)), None)
