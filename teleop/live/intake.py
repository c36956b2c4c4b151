"""Bound on what one tick takes in from outside: so many pieces, and no longer than a share of the tick.

One rule for datagrams, for orders and for what the service of a device says. What is left over waits for the next tick:
whoever sends without pause is slowed down or loses packets, and the force is renewed all the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

SHARE = 0.3  # of a tick: beyond it a flood would starve the tick
MOST = 1024  # pieces at one tick, however cheap they are


def intake(within_ns: int, *, least: int = 1, most: int = MOST,
           clock: Callable[[], int] = time.monotonic_ns) -> Iterator[int]:
    """Count the pieces that may be taken in now: `least` whatever they cost, and up to `most` within `within_ns`.

    >>> list(intake(0, least=2)), list(intake(10**12, most=3))
    ([0, 1], [0, 1, 2])
    """
    until = clock() + within_ns
    for taken in range(most):
        if taken >= least and clock() >= until:
            return
        yield taken
