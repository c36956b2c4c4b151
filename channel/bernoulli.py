"""Independent loss."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from channel.effect import Effect, probability
from channel.rng import Ints, Rng
from teleop.knob import Knob


@dataclass(frozen=True, slots=True)
class Bernoulli(Effect):
    """Every packet is lost with probability `p`, whatever happens to the others.

    Losses in a row are then geometric: bursts have a mean length of 1/(1 - p).
    """

    reorders: ClassVar[bool] = False
    p: Annotated[float, Knob("", "probability that a packet is lost", low=0.0, high=1.0)]

    def __post_init__(self) -> None:
        object.__setattr__(self, "p", probability("p", self.p))

    def carry(self, state: Rng, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, Rng]:
        """The packets that are spared, at once."""
        spared = state.uniform(packet) >= self.p
        return packet[spared], time_ns[spared], state
