"""What a device may read at every tick: knobs of `tests.fakes.Body`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from teleop import Reading
from tests.fakes import Body

WELL = Reading((0.1,), (0.2,), (0.3,))
standing = partial(Body, mass=None, x=0.5, v=0.25)  # nothing moves it, whatever it says; f: what its sensor has, N


def always(found: Any) -> Callable[[int, Reading], Any]:
    """`reads` of a device that has this for its reading, or an error that it raises, or a function of the tick."""
    def reads(k: int, _reading: Reading) -> Any:
        now = found(k) if callable(found) else found
        if isinstance(now, BaseException):
            raise now.with_traceback(None)
        return now

    return reads


def reading(found: Any = WELL, **knobs: Any) -> Body:
    return Body(reads=always(found), **knobs)
