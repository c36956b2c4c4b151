"""Packets that arrive twice."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Annotated

import numpy as np

from channel.effect import Effect, probability, seconds
from channel.rng import Ints, Rng
from channel.schedule import by_time, nanoseconds
from teleop.knob import Knob


@dataclass(frozen=True, slots=True)
class Duplicate(Effect):
    """With probability `p` a packet leaves twice: at once, and `after` s later. None is lost or late.

    Effects behind it meet both copies with the same random numbers: both are lost, or late by the same time.
    """

    p: Annotated[float, Knob("", "probability that a packet is copied", low=0.0, high=1.0)]
    _: KW_ONLY
    after: Annotated[float, Knob("s", "time by which the copy is later", low=0.0)] = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "p", probability("p", self.p))
        object.__setattr__(self, "after", seconds("after", self.after))

    def carry(self, state: Rng, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, Rng]:
        """Repeat some of the packets."""
        twice = state.uniform(packet) < self.p
        copies = np.concatenate((packet, packet[twice]))
        times = np.concatenate((time_ns, time_ns[twice] + nanoseconds(self.after)))
        return *by_time(copies, times), state
