"""Jitter with a uniform distribution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from channel.effect import Effect, seconds
from channel.rng import Ints, Rng
from channel.schedule import by_time, nanoseconds
from teleop.knob import Knob


@dataclass(frozen=True, slots=True)
class UniformJitter(Effect):
    """Every packet leaves after a delay of its own, uniform in [0, width) s.

    Mean width/2, variance width^2/12. Independent from packet to packet, so packets overtake each other: add
    `| InOrder()` where they must not.
    """

    width: Annotated[float, Knob("s", "most that a packet is late", low=0.0)]

    def __post_init__(self) -> None:
        object.__setattr__(self, "width", seconds("width", self.width))

    def carry(self, state: Rng, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, Rng]:
        """Delay each packet by its own draw."""
        delay = (state.uniform(packet) * nanoseconds(self.width)).astype(np.int64)
        return *by_time(packet, time_ns + delay), state
