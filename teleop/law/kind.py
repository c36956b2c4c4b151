"""The kinds of a law's message fields, declared in their annotations.

    class Forth(NamedTuple):
        u: kind.Wave

A field that is a wave has energy: half its square is the power that it carries, W, so its unit is sqrt(W). It enters
the ledger of the link, and the playouts that fill gaps within the energy that was sent (`teleop.scene.playout`) fill
it. Every other field is a sample, of which the newest stands.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Annotated, Any, get_args, get_type_hints

_WAVE = "wave"
Wave = Annotated[float, _WAVE]


def waves(message: type[Any]) -> tuple[str, ...]:
    """The names of the fields of a message type that are waves, in their order."""
    found: Callable[[Any], tuple[str, ...]] = _waves
    return found(message)


@lru_cache(maxsize=256)
def _waves(message: Any) -> tuple[str, ...]:
    if "Wave" not in str(getattr(message, "__annotations__", {})):
        return ()  # nothing to look up, which a class within a function could not be
    hints = get_type_hints(message, localns={"Wave": Wave}, include_extras=True)
    return tuple([name for name in message._fields if _WAVE in get_args(hints.get(name))[1:]])


def wave(message: type[Any]) -> str | None:
    """The name of the field that is a wave; None where there is none. A law has one at most in each direction."""
    return next(iter(waves(message)), None)
