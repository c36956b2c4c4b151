"""Order kept: what a path does on which nobody overtakes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from channel.effect import Effect
from channel.rng import Ints, Rng
from channel.schedule import Order

_LONG_AGO = -(2**63)


@dataclass(frozen=True, slots=True)
class InOrder(Effect):
    """No packet leaves before one that was sent earlier: whoever is early waits for those in front.

    A packet k that gets here at t_k leaves at max(t_j, j <= k), over the packets that get here: nobody waits
    for one that was lost on the way. Behind a jitter this is a path with varying latency on which packets
    cannot overtake; the delay's distribution is then no longer that of the jitter, but longer.
    """

    order: ClassVar[Order] = "number"
    reorders: ClassVar[bool] = False

    def begin(self, rng: Rng) -> int:
        """The time at which the last packet left, ns."""
        return _LONG_AGO

    def carry(self, state: int, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, int]:
        """Sort all packets by number; none leaves before the one in front of it."""
        leaves = np.maximum(np.maximum.accumulate(time_ns), state) if len(time_ns) else time_ns
        return packet, leaves, int(leaves[-1]) if len(leaves) else state
