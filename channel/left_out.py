"""Ticks that an end of a run in virtual time leaves out, as a machine under load does.

Such a tick is left out whole: nothing is read, no law is asked, no message is sent and the force is held, as at a live
end that woke up too late. Messages that come in the meantime wait for the next tick that runs. What is given to a scene
as `left_out_m` (of the master) or `left_out_s` (of the slave) has a method `left_out(end, count, seed)`.

Tick 0 begins the run, so a draw never leaves it out. What is drawn depends on seed, end and tick alone, by the dice of
the effects of a link (`channel.rng`), and on none of these.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from channel.rng import Bools, Floats, Rng
from teleop.errors import Refused, number, whole_number

PLACE = 1 << 32  # of their dice: behind every effect of a chain
LONGEST = 1e6  # ticks in a row on average


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A share of the ticks at random: each by itself, or in stretches.

    `share`: the expected share, 0 to 1. `stretch`: how many are left out in a row on average, each stretch as long as
    a geometric draw says, at least share/(1 - share); None: each tick is drawn by itself, so 1/(1 - share).
    """

    share: float
    stretch: float | None = None

    def __post_init__(self) -> None:
        share = number("share", self.share, low=0.0, high=1.0, example="share=0.1")
        object.__setattr__(self, "share", share)
        if self.stretch is None:
            return
        stretch = number("stretch", self.stretch, low=1.0, high=LONGEST)
        object.__setattr__(self, "stretch", stretch)
        if share > stretch * (1.0 - share):
            raise Refused(f"a share of {share:g} in stretches of {stretch:g} ticks asks for gaps of less than a tick "
                          f"between them; write stretch={share / (1.0 - share):g} or more, or a smaller share"
                          if share < 1.0 else "a share of 1 leaves all ticks out; write a smaller share")

    def left_out(self, end: int, count: int, seed: int) -> Bools:
        """For each of the ticks 0 .. count-1, is it left out, of end 0 (the master) or 1 (the slave). (count,)"""
        drawn = Rng(seed, end, PLACE).uniform(np.arange(count, dtype=np.int64))
        out = drawn < self.share if self.stretch is None else _stretches(drawn, self.share, self.stretch)
        out[:1] = False
        return out


def _stretches(drawn: Floats, share: float, stretch: float) -> Bools:
    """A chain of two states, of which the second is left with 1/stretch and has `share` of the time."""
    out = np.zeros(len(drawn), dtype=bool)
    inward, stays, is_out = share / ((1.0 - share) * stretch), 1.0 - 1.0 / stretch, False
    for k, one in enumerate(drawn.tolist()):
        is_out = one < (stays if is_out else inward)
        out[k] = is_out
    return out


@dataclass(frozen=True, slots=True)
class LeftOutTicks:
    """Given ticks, the same whatever the seed, such as those that an end of a live run left out.

    `ticks`: their numbers, from 0 on, growing; those beyond the run are of no account. An end that begins late leaves
    out tick 0: it holds nothing until its first tick.
    """

    ticks: tuple[int, ...]

    def __post_init__(self) -> None:
        ticks = tuple([whole_number("ticks", each, low=0) for each in self.ticks])
        if any(a >= b for a, b in pairwise(ticks)):
            raise Refused("ticks are the numbers of the ticks that are left out, each once and in their order; write "
                          "for example LeftOutTicks((3, 4, 10))")
        object.__setattr__(self, "ticks", ticks)

    def left_out(self, end: int, count: int, seed: int) -> Bools:
        """For each of the ticks 0 .. count-1, is it left out. (count,)"""
        out = np.zeros(count, dtype=bool)
        ticks = np.array(self.ticks, dtype=np.int64)
        out[ticks[ticks < count]] = True
        return out
