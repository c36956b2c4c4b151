"""Memory that the tick reads by number: rings of messages on their way, paths and schedules drawn up front.

In plain Python each stands as its one line where it is called; a compiled engine has instructions of these names
(`teleop.sweeps.kernels.c_kernel`).
"""

from __future__ import annotations

from typing import Any

LEFT_OUT = -2  # in place of a message's number: the tick is skipped


def ring(message: Any, size: int) -> Any:
    """Make room for `size` messages such as this one."""
    return [message] * size


def put(rows: Any, k: Any, size: int, message: Any) -> None:
    """Keep a message under the number k."""
    rows[k % size] = message


def get(rows: Any, k: Any, size: int) -> Any:
    """The message of number k."""
    return rows[k % size]


def at(numbers: Any, k: int) -> Any:
    """The k-th number of a path or of a schedule."""
    return numbers[k]
