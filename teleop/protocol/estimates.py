"""Estimates of the link and of the peer's clock, from the packets alone. Sans-IO; times are ns.

One packet tells four instants: `t1`, when the packet that it echoes left here; `t2`, when that came there; `t3`, when
this one left there; `t4`, when it came here; t1 and t4 by our clock, the others by the peer's. Then

    rtt = (t4 - t1) - (t3 - t2)              theta = ((t2 - t1) + (t3 - t4)) / 2

and theta is the peer's clock less ours, wrong by half the difference of the two ways at most (NTP, RFC 5905, 8). That
error stays the same as long as the ways do: how the offset *changes* is known much better than the offset.

`ClockExchange` measures before the first message, by the round trips of HELLO and WELCOME, and sets the grid of ticks.
Each WELCOME echoes its HELLO, which bounds the slave's clock against the master's: the offset is taken from the fastest
round trip and is uncertain by half of that.
"""

from __future__ import annotations

from collections import deque

from teleop.protocol.manifest import MOST_CLOCK_NS
from teleop.protocol.packet import Packet

MOST_RTT_NS = 60_000_000_000  # of a round trip that is believed
WINDOW_NS = 1_000_000_000  # of each, the fastest round trip counts
WINDOWS = 64  # remembered; the drift is the slope over them
FEWEST = 10  # for a slope
MOVED = 10  # windows in a row with another round trip, and the way is taken to be another one


class Times:
    """Mean, least and most of times in ns, taken one by one."""

    def __init__(self) -> None:
        self.count, self.total, self.least, self.most = 0, 0, 0, 0
        self.recent = 0.0  # mean over about the last 200

    def add(self, ns: int) -> None:
        """Count one more time (ns)."""
        count = self.count
        if ns < self.least or not count:
            self.least = ns
        if ns > self.most or not count:
            self.most = ns
        self.count = count = count + 1
        self.total += ns
        self.recent += (ns - self.recent) / (count if count < 200 else 200)


class PeerClock:
    """Clock of the peer beside ours: `offset_ns` (peer's less ours), `drift` (of its rate, 1e-6 is 1 ppm).

    `shift_ns` is how far the offset has moved since the first window. A window moves it only by what the ways cannot
    explain: if a round trip differs by d from the first one's, the ways can have moved theta by d/2 and no more.
    `band_ns` is what is left alone beyond that. Where the round trips stay different, the ways are taken to be others
    from then on, and what the clocks moved by in the meantime goes by as theirs; in all never more than a round trip.
    """

    def __init__(self, band_ns: int) -> None:
        self.offset_ns: int | None = None
        self.shift_ns = 0
        self.sure_ns = 0  # so much, at most, is `shift_ns` from what the clocks moved by
        self.band_ns = band_ns
        self._best: tuple[int, int, int] | None = None  # of this window: round trip, theta, when
        self._fastest = MOST_RTT_NS + 1  # round trip in this window
        self._until = 0  # when it is over, our clock
        self.since_ns = self.seen_ns = 0  # when the best of the first window came, and of the newest
        self._first = (0, 0)  # the round trip and theta of the first window
        self._base = (0, 0)  # those that the shift counts from
        self._moved = 0
        self._windows: deque[tuple[int, int, int]] = deque(maxlen=WINDOWS)  # the same of each

    def add(self, t1: int, held: int, t3: int, t4: int) -> int | None:
        """Take in one echo, `held` = t3 - t2; returns its round trip, or None if that is impossible."""
        rtt = t4 - t1 - held
        if self._fastest <= rtt <= MOST_RTT_NS and t4 < self._until:
            return rtt  # nearly always
        if not 0 <= rtt <= MOST_RTT_NS:
            return None
        if self._best is None:
            self._until = t4 + WINDOW_NS
        elif t4 >= self._until:
            self._close(*self._best)
            self._best, self._until = None, t4 + WINDOW_NS
        if self._best is None or rtt < self._best[0]:
            self._best = (rtt, (2 * t3 - held - t1 - t4) // 2, t4)
            self._fastest = rtt
        return rtt

    @property
    def drift(self) -> float | None:
        """Rate of the peer's clock above ours, as a fraction; None before there is enough to tell.

        The slope of theta by least squares. A window weighs the less the slower its round trip was than the fastest:
        by half of that it can be wrong.
        """
        if len(self._windows) < FEWEST:
            return None
        fastest, y0, t0 = min(self._windows)
        exact = max(1.0, self.band_ns / 10)
        rows = [(1.0 / (((rtt - fastest) / 2) ** 2 + exact**2), t - t0, y - y0) for rtt, y, t in self._windows]
        total = sum(w for w, _, _ in rows)
        mean_t, mean_y = sum(w * t for w, t, _ in rows) / total, sum(w * y for w, _, y in rows) / total
        spread = sum(w * (t - mean_t) ** 2 for w, t, _ in rows)
        return sum(w * (t - mean_t) * (y - mean_y) for w, t, y in rows) / spread

    def _close(self, rtt: int, theta: int, when: int) -> None:
        if self.offset_ns is None:
            self._base = self._first = (rtt, theta)
            self.since_ns = when
        self.offset_ns, self.seen_ns = theta, when
        self._windows.append((rtt, theta, when))
        base_rtt, base = self._base
        ways = abs(rtt - base_rtt) // 2
        moved = theta - base - self.shift_ns
        if abs(moved) > ways + self.band_ns:
            self.shift_ns += moved - ways if moved > 0 else moved + ways
        # Whatever the ways do, the offset is within half a round trip of theta, now as then.
        self.sure_ns, change = (rtt + self._first[0]) // 2, theta - self._first[1]
        self.shift_ns = max(change - self.sure_ns, min(change + self.sure_ns, self.shift_ns))
        self._moved = self._moved + 1 if ways > self.band_ns else 0
        if self._moved >= MOVED:  # from here on the ways are these
            self._base, self._moved = (rtt, theta - self.shift_ns), 0
            while len(self._windows) > MOVED:
                self._windows.popleft()


TOGETHER = 16  # messages whose figures are worked out together: with cold caches each would cost several times as much


class LinkEstimates:
    """Estimates of the link from the packets of one session: delays, jitter, loss, order.

    `way`: one-way delay as it is seen over the common grid of ticks. `rtt`: round trips, which need no common clock.
    `jitter_ns`: interarrival jitter (RFC 3550, 6.4.1). `lost` and `reordered`: of the numbers up to the newest one that
    came (RFC 3550, A.3), copies left out; what the peer never sent, for it left that tick out, is among the lost.
    `every`: the peer's packets are so many numbers apart. All but the clock waits until it is asked for.
    """

    def __init__(self, band_ns: int) -> None:
        self.clock = self._parted = PeerClock(band_ns)
        self._waiting: list[tuple[int, int, int, int | None]] = []  # number, delay, transit, round trip
        self._way, self._rtt = Times(), Times()
        self._jitter_ns = 0.0
        self._reordered = 0
        self._transit_ns: int | None = None
        self._first, self._newest = 0, -1
        self._count = 0
        self._lost = 0  # in sessions before this one

    def add(self, seq: int, sent_ns: int, echo: tuple[int, int] | None, way_ns: int, now: int) -> None:
        """A message that has not come before: its number, send time (peer's clock), echo, and delay over the grid."""
        rtt = None if echo is None else self.clock.add(echo[0], echo[1], sent_ns, now)
        self._waiting.append((seq, way_ns, now - sent_ns, rtt))
        if len(self._waiting) >= TOGETHER:
            self._work_out()

    @property
    def way(self) -> Times:
        """Delays of one way."""
        self._work_out()
        return self._way

    @property
    def rtt(self) -> Times:
        """Round trips."""
        self._work_out()
        return self._rtt

    @property
    def jitter_ns(self) -> float:
        """Interarrival jitter."""
        self._work_out()
        return self._jitter_ns

    @property
    def reordered(self) -> int:
        """Number of packets that came behind one with a greater number."""
        self._work_out()
        return self._reordered

    @property
    def transit_ns(self) -> int | None:
        """Time of the last message on its way, by the two ends' own clocks; None before there is one."""
        self._work_out()
        return self._transit_ns

    def lost(self, every: int = 1) -> int:
        """Number of packets that did not come, of those up to the newest that came."""
        return self._lost + self._missing(every)

    def loss(self, every: int = 1) -> float:
        """The same as a fraction."""
        lost = self.lost(every)
        return lost / (lost + self.way.count) if lost else 0.0

    @property
    def parted(self) -> PeerClock:
        """The peer's clock in the session in which it moved most beside ours."""
        return max(self._parted, self.clock, key=lambda clock: abs(clock.shift_ns))

    def begin(self, every: int = 1) -> None:
        """A new session: its numbers, its clock; the figures go on."""
        self._lost += self._missing(every)
        self._count, self._newest, self._transit_ns = 0, -1, None
        self._parted, self.clock = self.parted, PeerClock(self.clock.band_ns)

    def _missing(self, every: int) -> int:
        self._work_out()
        return max(0, (self._newest - self._first) // every + 1 - self._count) if self._count else 0

    def _work_out(self) -> None:
        for seq, way_ns, transit, rtt in self._waiting:
            self._way.add(way_ns)
            if rtt is not None:
                self._rtt.add(rtt)
            if self._transit_ns is not None:
                self._jitter_ns += (abs(transit - self._transit_ns) - self._jitter_ns) / 16.0
            self._transit_ns = transit
            if not self._count:
                self._first = seq
            self._count += 1
            if seq > self._newest:
                self._newest = seq
            else:
                self._reordered += 1
                self._first = min(self._first, seq)
        self._waiting.clear()


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

    def tick_0(self, ours: int | None, theirs: int | None, now: int) -> int:
        """The time of tick 0 on the master's clock. `ours`: that of its grid; `theirs`: of the slave's, on its clock.

        Of two grids that came apart the one that is further on: ticks cannot be taken back, only left out.
        """
        assert self.rtt_ns is not None
        if ours is not None and theirs is not None and self._knows_better(theirs - ours):
            self.offset_ns = theirs - ours  # the two ends have one grid still
        else:
            self._grid_rtt_ns = self.rtt_ns
        grids = [] if ours is None else [ours]
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
