"""A link that is gone for a while."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Annotated, ClassVar

from channel.effect import Effect
from channel.rng import Ints, Rng
from channel.schedule import nanoseconds
from teleop.errors import Refused, number
from teleop.knob import Knob


@dataclass(frozen=True, slots=True)
class Blackout(Effect):
    """Packets that get here from `start` s on, for `duration` s, are lost; again every `every` s if given.

    Times count from the start of the session. The first instant is inside, the last is not.
    """

    reorders: ClassVar[bool] = False
    start: Annotated[float, Knob("s", "time at which the link goes", low=0.0, high=1e6)]
    duration: Annotated[float, Knob("s", "time for which it is gone", low=0.0, high=1e6)]
    _: KW_ONLY
    every: Annotated[float | None, Knob(
        "s", "time from one start to the next; none: it goes once", above=0.0, high=1e6)] = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", number("start", self.start, low=0.0, high=1e6))
        object.__setattr__(self, "duration", number("duration", self.duration, low=0.0, high=1e6))
        if self.every is not None:
            object.__setattr__(self, "every", number("every", self.every, above=0.0, high=1e6))
            if nanoseconds(self.every) <= nanoseconds(self.duration):
                raise Refused(f"every must be longer than duration ({self.duration:g} s), not {self.every:g},"
                              " or the link never comes back; "
                              f"write for example every={2 * self.duration + 1:g}")

    def carry(self, state: Rng, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, Rng]:
        """The packets outside, at once."""
        since = time_ns - nanoseconds(self.start)
        gone = since >= 0
        if self.every is not None:
            since = since % nanoseconds(self.every)
        gone &= since < nanoseconds(self.duration)
        return packet[~gone], time_ns[~gone], state
