"""Jitter with a normal distribution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from channel.effect import Effect, seconds
from channel.rng import Ints, Rng
from channel.schedule import later
from teleop.knob import Knob


@dataclass(frozen=True, slots=True)
class NormalJitter(Effect):
    """Every packet leaves after a delay of its own, max(0, N(mean, sigma^2)), s: a rectified normal.

    No delay is negative, so the part of the normal below zero becomes zero, with probability
    Phi(-mean/sigma) (2.3 % at mean = 2 sigma, 3e-7 at 5 sigma); above zero the distribution is the normal's
    own. The delay's mean is mean*Phi(mean/sigma) + sigma*phi(mean/sigma), Phi and phi the standard normal's
    distribution and density. Independent from packet to packet, so packets overtake each other: add
    `| InOrder()` where they must not.
    """

    mean: Annotated[float, Knob("s", "mean delay", low=0.0)]
    sigma: Annotated[float, Knob("s", "standard deviation of the delay", low=0.0)]

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", seconds("mean", self.mean))
        object.__setattr__(self, "sigma", seconds("sigma", self.sigma))

    def carry(self, state: Rng, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, Rng]:
        """Delay each packet by its own draw."""
        delay = np.maximum(0.0, self.mean + self.sigma * state.normal(packet))
        return *later(packet, time_ns, delay), state
