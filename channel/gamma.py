"""Jitter with a gamma distribution: the long right tail of a loaded path."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from channel.effect import Effect, seconds
from channel.rng import Ints, Rng, inside, normal
from channel.schedule import later
from teleop.errors import number
from teleop.knob import Knob


@dataclass(frozen=True, slots=True)
class GammaJitter(Effect):
    """Every packet leaves after a delay of its own, gamma with `mean` s and `shape` (0.05 to 1e6).

    Variance mean^2/shape; shape 1 is exponential, a large one nearly normal. Independent from packet to
    packet, so packets overtake each other: add `| InOrder()` where they must not.
    """

    mean: Annotated[float, Knob("s", "mean delay", low=0.0)]
    shape: Annotated[float, Knob("", "shape of the distribution; 1 is exponential", low=0.05, high=1e6)]

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", seconds("mean", self.mean))
        object.__setattr__(self, "shape", number("shape", self.shape, low=0.05, high=1e6))

    def carry(self, state: Rng, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, Rng]:
        """Delay each packet by its own draw."""
        delay = standard_gamma(state, packet, self.shape) * (self.mean / self.shape)
        return *later(packet, time_ns, delay), state


def standard_gamma(rng: Rng, packet: Ints, shape: float) -> NDArray[np.float64]:
    """Gamma of this shape and scale 1 for each packet, (n,).

    Marsaglia & Tsang, "A simple method for generating gamma variables", ACM TOMS 26 (2000), without the
    squeeze: attempt j of a packet takes its draw j (normal from words 0 and 1, uniform from word 2), so that
    no packet's draws shift another's. At least 95 % are accepted at once. For shape < 1 their boost: the
    gamma of shape + 1 times U^(1/shape), U from word 3 of draw 0.
    """
    d = (shape + 1.0 if shape < 1.0 else shape) - 1.0 / 3.0
    c = 1.0 / sqrt(9.0 * d)
    gamma = np.empty(len(packet))
    waiting = np.arange(len(packet))
    words = first = rng.words(packet)
    attempt = 0
    while len(waiting):
        x = normal(words)
        v = np.maximum(1.0 + c * x, 0.0) ** 3
        log_v = np.log(np.maximum(v, 1e-300))  # v = 0 is rejected: its log must only be very low
        accepted = np.log(inside(words[:, 2])) < 0.5 * x * x + d - d * v + d * log_v
        gamma[waiting[accepted]] = d * v[accepted]
        waiting = waiting[~accepted]
        attempt += 1
        words = rng.words(packet[waiting], attempt)
    if shape < 1.0:
        gamma *= inside(first[:, 3]) ** (1.0 / shape)
    return gamma
