"""Rows of packets, (number, time): sorted, delayed, and times in whole nanoseconds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from channel.rng import Ints


def by_time(packet: Ints, time_ns: Ints) -> tuple[Ints, Ints]:
    """The rows sorted by (time, packet number); rows that already are sorted are returned as they came."""
    if len(time_ns) < 2:
        return packet, time_ns
    step = np.diff(time_ns)
    if step.min() > 0 or bool(np.all((step > 0) | ((step == 0) & (np.diff(packet) >= 0)))):
        return packet, time_ns
    rows = np.lexsort((packet, time_ns))
    return packet[rows], time_ns[rows]


def by_number(packet: Ints, time_ns: Ints) -> tuple[Ints, Ints]:
    """The rows sorted by (packet number, time)."""
    if len(packet) < 2 or bool(np.all(np.diff(packet) > 0)):
        return packet, time_ns
    rows = np.lexsort((time_ns, packet))
    return packet[rows], time_ns[rows]


def nanoseconds(time: float) -> int:
    """A time in s as a whole number of ns, to the nearest."""
    return round(time * 1e9)


def later(packet: Ints, time_ns: Ints, delay: NDArray[np.float64]) -> tuple[Ints, Ints]:
    """The rows after a delay of their own each, s (n,), to the nearest ns, sorted again."""
    return by_time(packet, time_ns + np.rint(delay * 1e9).astype(np.int64))
