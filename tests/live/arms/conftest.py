"""Arms and their stand-ins, each closed in the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest

from teleop import DeviceError


@pytest.fixture
def opened() -> Iterator[Callable[..., Any]]:
    """`opened(thing)`: it is closed in the end, whatever it raises then."""
    things: list[Any] = []

    def keep(thing: Any) -> Any:
        things.append(thing)
        return thing

    yield keep
    for each in reversed(things):
        with suppress(DeviceError, OSError):
            each.close()
