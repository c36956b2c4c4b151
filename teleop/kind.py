"""The kinds of a law's message fields, declared in their annotations.

    class Forth(NamedTuple):
        u: kind.Wave

A field that is a wave has energy: half its square is the power that it carries, W, so its unit is sqrt(W). It enters
the ledger of the link, and the playouts that fill gaps within the energy that was sent (`teleop.scene.playout`) fill
it. Every other field is a sample, of which the newest stands.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import lru_cache
from inspect import get_annotations
from types import SimpleNamespace
from typing import Annotated, Any, ForwardRef, get_args, get_type_hints

_WAVE = "wave"
Wave = Annotated[float, _WAVE]


def waves(message: type[Any]) -> tuple[str, ...]:
    """The names of the fields of a message type that are waves, in their order."""
    found: Callable[[Any], tuple[str, ...]] = _waves
    return found(message)


@lru_cache(maxsize=256)
def _waves(message: Any) -> tuple[str, ...]:
    return tuple([name for name in message._fields if _is_wave(message, name)])


def _is_wave(message: type[Any], field: str) -> bool:
    for base in message.__mro__:
        if field in (hints := get_annotations(base)):
            alone = SimpleNamespace(__annotations__={field: hints[field]})  # others may be of what is not to be found
            words = vars(sys.modules[base.__module__]) if base.__module__ in sys.modules else {}
            try:
                hint = get_type_hints(alone, words, include_extras=True)[field]
            except Exception:  # its names are those of the function that the class is made in
                hint = hints[field]
                text = hint.__forward_arg__ if isinstance(hint, ForwardRef) else str(hint)
                return text.strip("'\"").rpartition(".")[2] == "Wave"
            return _WAVE in get_args(hint)[1:]
    return False


def wave(message: type[Any]) -> str | None:
    """The name of the field that is a wave; None where there is none. A law has one at most in each direction."""
    return next(iter(waves(message)), None)
