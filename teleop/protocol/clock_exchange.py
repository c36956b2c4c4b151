"""The peer's clock, measured by the round trips of HELLO and WELCOME, and the grid of ticks that follows. Times are ns.

Each WELCOME echoes its HELLO, which bounds the slave's clock against the master's: the offset is taken from the fastest
round trip and is uncertain by half of that (NTP, RFC 5905, 8).
"""

from __future__ import annotations

from teleop.protocol.estimates import MOST_RTT_NS
from teleop.protocol.manifest import MOST_CLOCK_NS
from teleop.protocol.packet import Packet

ROUNDS = 5  # HELLO/WELCOME round trips before the clock offset is taken: one, and four after it that are no faster
FASTER_NS = 1_000_000  # by so much: what waited at a process that stood still is answered faster from one to the next
LEAD_NS = 150_000_000  # tick 0 is this far ahead when START is first sent
AHEAD_NS = LEAD_NS + 3 * MOST_RTT_NS  # the furthest that tick 0 can be ahead


class ClockExchange:
    """The master's measurement. `offset_ns`: the slave's clock less the master's; `rtt_ns`: the fastest round trip.

    `rounds` counts the round trips that bear that one out.
    """

    def __init__(self) -> None:
        self.offset_ns = 0
        self.rtt_ns: int | None = None
        self.rounds = 0
        self._since_ns = 0  # when the first of these rounds was over
        self._grid_rtt_ns: int | None = None  # the round trip by which the grids of the two ends were set to be one

    def restart(self) -> None:
        """Measure anew, for another session; the offset stays until then."""
        self.rtt_ns = None
        self.rounds = 0

    @property
    def enough(self) -> bool:
        """True if the fastest round trip has been borne out by enough others."""
        return self.rounds >= ROUNDS

    def take(self, welcome: Packet, now: int) -> bool:
        """Take the round trip of a WELCOME that came at `now`; False if it is implausible, and so ignored."""
        if welcome.echo is None:
            return False
        rtt = now - welcome.echo.sent_ns - welcome.echo.held_ns
        if not 0 <= rtt <= MOST_RTT_NS or abs(welcome.sent_ns) > MOST_CLOCK_NS:
            return False
        if self.rtt_ns is None or rtt < self.rtt_ns - FASTER_NS:
            self.rounds = 1  # what was asked before may have waited just as long
            self._since_ns = now
        elif welcome.echo.sent_ns >= self._since_ns:
            self.rounds += 1
        if self.rtt_ns is None or rtt < self.rtt_ns:
            self.rtt_ns = rtt
            self.offset_ns = welcome.sent_ns - (now - rtt // 2)
        return True

    def tick_0(self, own: int | None, theirs: int | None, now: int) -> int:
        """The time of tick 0 on the master's clock. `own`: that of its grid; `theirs`: of the slave's, on its clock.

        Of two grids that came apart the one that is further on: ticks cannot be taken back, only left out.
        """
        assert self.rtt_ns is not None
        if own is not None and theirs is not None and self._knows_better(theirs - own):
            self.offset_ns = theirs - own  # the two ends have one grid still
        else:
            self._grid_rtt_ns = self.rtt_ns
        grids = [] if own is None else [own]
        if theirs is not None:
            grids.append(theirs - self.offset_ns)
        return min(grids) if grids else now + LEAD_NS + 2 * self.rtt_ns

    def _knows_better(self, offset_ns: int) -> bool:
        """True if `offset_ns`, by which the grids of the two ends are one, says more of the clocks than this exchange.

        It does if it was measured by a round trip less than half as long, and this one does not contradict it: one way
        may be slow at the moment, and the grids would be set apart by half of that for good.
        """
        assert self.rtt_ns is not None
        rtt, before = self.rtt_ns, self._grid_rtt_ns
        return before is not None and rtt > 2 * before and abs(offset_ns - self.offset_ns) <= (rtt + before) // 2
