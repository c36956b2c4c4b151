"""Suspension of the machine, seen by two of Linux's clocks: one counts the time meanwhile, the other does not."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

LEAST_NS = 1_000_000  # shorter is no suspension

Clock = Callable[[], int]


def boottime() -> Clock | None:
    """A clock (ns) that counts the time in which the machine is suspended; None where the system has none."""
    which = getattr(time, "CLOCK_BOOTTIME", None)
    return None if which is None else partial(time.clock_gettime_ns, which)


class Suspension:
    """Compares `boot`, which counts suspension, with `mono`, which does not; both in ns. Without `boot` it sees none.

    `time.monotonic_ns` is such a `mono` on Linux: all that an end knows of its peer is older than it says afterwards.
    """

    def __init__(self, boot: Clock | None, mono: Clock = time.monotonic_ns) -> None:
        self._boot, self._mono = boot, mono
        before = mono()
        self._apart = 0 if boot is None else boot() - before  # if anything, too large

    def passed(self) -> int:
        """For how long the machine was suspended since this was asked last, ns; 0 if it was not."""
        # Read in this order the difference is too small, if anything, when the process is held up between the two.
        if self._boot is None:
            return 0
        apart = self._boot() - self._mono()
        slept = apart - self._apart
        if slept > 0:
            self._apart = apart
        return slept if slept > LEAST_NS else 0
