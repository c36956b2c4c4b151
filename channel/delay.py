"""A constant delay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from channel.effect import Effect, seconds
from channel.rng import Ints, Rng
from channel.schedule import nanoseconds
from teleop.knob import Knob


@dataclass(frozen=True, slots=True)
class Delay(Effect):
    """Every packet leaves `delay` s after it entered (to the nearest ns; 0 to 3600 s)."""

    reorders: ClassVar[bool] = False
    delay: Annotated[float, Knob("s", "delay of every packet", low=0.0)]

    def __post_init__(self) -> None:
        object.__setattr__(self, "delay", seconds("delay", self.delay))

    @property
    def constant_ns(self) -> int:
        """The delay in ns: it is all that this effect does."""
        return nanoseconds(self.delay)

    def carry(self, state: Rng, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, Rng]:
        """Delay all packets."""
        return packet, time_ns + self.constant_ns, state
