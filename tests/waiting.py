"""Waits for conditions instead of times, so that a busy machine may take as long as it needs."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

PATIENCE = 150.0  # s after which a process or a condition that is waited for counts as missing


def until(true: Callable[[], Any], missing: str = "it never came") -> None:
    """Return as soon as `true()` is. Fails with the sentence `missing` after `PATIENCE`."""
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end, missing
        time.sleep(0.02)
