"""What a peer's waves have come to, message by message: does it add up? Sans-IO.

A sender's T, U and E (`teleop.stages.wave_integral`) grow from nothing with the number of the message, which is the
tick of the grid that it was sent at. So of any two messages of a session, g > 0 ticks of the grid apart, by whatever
wave and over whatever ticks were left out,

    dt' <= T - T' <= g dt        E >= E'        (U - U')^2 <= 2 (E - E') (T - T')

dt' being the sender's tick; less than g dt where it had no reading. What is played stays within the energy that a
message tells of, also of one that lies. But T is a clock: after one that is far ahead no honest message would be played
any more. What does not add up with the newest message that was taken is not taken; if nothing else comes that is
silence, with which a session ends, and the next one begins at nothing.
"""

from __future__ import annotations

from math import inf

from teleop.stages.wave_integral import Integrals

Waves = tuple[Integrals, ...]  # per axis

CLOCK = 1e-6  # of a time: T is a sum of as many as 1e8 ticks, each rounded
SUM = 1e-15  # of a sum, a tick of the grid: what rounding makes of it
EVEN = 1.0 + 1e-9  # a steady wave fulfils the inequality with equality


class Sums:
    """Compares the messages of a session with the newest that was taken. `dt`: the tick of the grid, s."""

    __slots__ = ("_at", "_dt", "_then")

    def __init__(self, dt: float, axes: int) -> None:
        self._dt = dt
        self._at: int | None = None
        self._then: Waves = (Integrals(0.0, 0.0, 0.0),) * axes

    def add_up(self, seq: int, waves: Waves, every: int) -> bool:
        """True if message `seq` of a peer adds up, which ticks at every `every`-th tick of the grid."""
        ticks = seq - (self._at if self._at is not None else -every)
        newer, older = (waves, self._then) if ticks > 0 else (self._then, waves)
        apart = ticks if ticks > 0 else -ticks
        T = newer[0].T - older[0].T
        if not ((every if every < apart else apart) * (1.0 - CLOCK) <= T / self._dt <= apart * (1.0 + CLOCK)):
            return False
        slack = SUM * apart
        for new, old in zip(newer, older, strict=True):
            U = abs(new.U - old.U) - slack * (abs(new.U) + abs(old.U))
            E = new.E - old.E + slack * (new.E + old.E)
            if E < 0.0 or (U > 0.0 and not U * U <= 2.0 * EVEN * T * E < inf):
                return False
        if ticks > 0:
            self._at, self._then = seq, waves
        return True
