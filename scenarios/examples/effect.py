"""An effect of your own: a radio link that changes its base station now and then. Run it as it stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from channel import Delay, Effect, Ints, Rng, by_time, check_effect, nanoseconds, seconds
from teleop import Refused, load_scene, run


@dataclass(frozen=True, slots=True)
class RoamingGap(Effect):
    """Every `every` s the link stands still for `gap` s; what was sent meanwhile is let go together at the end."""

    every: float  # s, from one standstill to the next
    gap: float  # s, shorter than `every`

    def __post_init__(self) -> None:
        object.__setattr__(self, "every", seconds("every", self.every, above=0.0))
        object.__setattr__(self, "gap", seconds("gap", self.gap))
        if self.gap >= self.every:
            raise Refused(f"gap must be shorter than every ({self.every:g} s), not {self.gap:g}; write gap=0.1")

    def begin(self, rng: Rng) -> None:
        """No state: whether a packet waits depends on its own time alone."""

    def carry(self, state: None, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, None]:
        """Return all packets, those of a standstill at its end. Arrays (n,) in, sorted by time, and the same out."""
        into = time_ns % nanoseconds(self.every)  # ns since the last standstill began
        gap = nanoseconds(self.gap)
        leave = np.where(into < gap, time_ns - into + gap, time_ns)
        return *by_time(packet, leave), state


if __name__ == "__main__":
    check_effect(RoamingGap(1.0, 0.1))  # raises one sentence for the first promise that is broken
    for gap in (0.0, 0.1, 0.15):
        result = run(load_scene("hard_wall", link=RoamingGap(1.0, gap) | Delay(0.03)))
        fresh = result.metrics["fresh_fwd"]
        print(f"{1e3 * gap:3g} ms a second: {result.status}, {100 * fresh:.0f} % of the slave's ticks had a message")
