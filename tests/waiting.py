"""Waits for conditions instead of times, so that a busy machine may take as long as it needs; and a free port."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from teleop import DeviceError

PATIENCE = 150.0  # s after which a process or a condition that is waited for counts as missing


def until(true: Callable[[], Any], missing: str = "it never came") -> None:
    """Return as soon as `true()` is. Fails with the sentence `missing` after `PATIENCE`."""
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end, missing
        time.sleep(0.02)


def answered(make: Callable[[], Any], attempts: int = 10) -> Any:
    """Return what `make` opens, whose stand-in may be late with its first answers on a busy machine."""
    for _ in range(attempts - 1):
        with suppress(DeviceError):
            return make()
        time.sleep(0.1)
    return make()


def free_port() -> int:
    """Return a UDP port of this machine that nothing is bound to."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])
