"""Playout: the choice of the packet that a tick plays among those that have arrived, and of the message in gaps.

A packet sent at tick k arrives at tick `max(k+1, ceil(time/dt))`. With playout zero or hold the newest wins: a tick
plays the greatest number that has come, if it is greater than every one played before. With a fixed playout delay,
packet k is played at exactly tick k + D if it has come by then, and never otherwise. Either way a packet is played at
most once and the numbers played only grow.
"""

from __future__ import annotations

from dataclasses import dataclass

from teleop.errors import Refused, number


@dataclass(frozen=True, kw_only=True, slots=True)
class Zero:
    """Playout of the newest packet; a tick without one tells the law so; a wave law plays zero, which is passive."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Hold:
    """Playout of the newest packet; a tick without one plays the last message again, which is active."""


@dataclass(frozen=True, slots=True)
class Fixed:
    """Playout of every packet `delay` s after it was sent, of late ones never; gaps are filled as `gaps` has it."""

    delay: float
    gaps: Zero | Hold = Zero()

    def __post_init__(self) -> None:
        number("playout delay", self.delay, above=0.0, high=3600.0)
        if not isinstance(self.gaps, (Zero, Hold)):
            raise Refused(f"gaps are Zero() or Hold(), not {self.gaps!r}; write gaps=Zero()")

    def ticks(self, dt_ns: int) -> int:
        """The delay in ticks: rounded up, at least 1."""
        # By way of whole nanoseconds: 0.1 + 0.2 s are 300 ticks of 1 ms, not 301.
        return max(1, -(-round(self.delay * 1e9) // dt_ns))


Playout = Zero | Hold | Fixed


def repeats(playout: Playout) -> bool:
    """True if the last message is played again in the gaps."""
    return isinstance(playout.gaps if isinstance(playout, Fixed) else playout, Hold)


def as_typed(playout: Playout) -> str:
    """A playout as it is typed: zero, hold, fixed:0.1, or fixed:0.1:hold where the last message fills its gaps."""
    if isinstance(playout, Fixed):
        return f"fixed:{playout.delay:g}" + ":hold" * repeats(playout)
    return "hold" if repeats(playout) else "zero"
