"""Presence of the other end: does it still hear this one, and do the two count the same ticks? Sans-IO; times are ns.

Both are told by the messages that come, whatever is in them of the law. Each says when the newest of ours came that its
sender has, and how long ago: if that is long, ours are lost on their way, and nothing answers the force that we hold.
And it bears the tick at which it was sent. No message comes before it was sent, so one that is ahead of our grid by
more than the two clocks can be apart says that our own clock stood still, as a suspended machine's does: what we took
for the newest is as old as the other end's messages are ahead.
"""

from __future__ import annotations

from teleop.protocol.estimates import MOST_RTT_NS, LinkEstimates
from teleop.protocol.packet import Echo
from teleop.protocol.session import Session

EARLY_NS = 1_000_000_000  # a message from further ahead than this is never believed: the two share one grid
STILL_NS = 50_000_000  # nor is one that is ahead by more than this, or the watchdog's timeout, and what is uncertain
STILL = 3  # ticks, of the slower end: if for so long nothing but such messages came, it is this end that stood still


class Presence:
    """What the messages of one session tell of that. `every`: this end ticks at every so many ticks of `dt_ns`.

    `answered`: has one come that shows that the peer hears this end. `unheard_ns`: how long the peer had heard nothing
    of this end when it sent its newest message; before the first answer, since the session began.
    """

    def __init__(self, session: Session, link: LinkEstimates, dt_ns: int, every: int, timeout_ns: int) -> None:
        self.session, self.link = session, link
        self._liveness = session.liveness
        self._dt_ns, self._every = dt_ns, every
        self._margin_ns = max(STILL_NS, timeout_ns)  # a stall of its own that is shorter is none either
        self.begin()

    def begin(self) -> None:
        """A new session."""
        self.answered, self.unheard_ns = False, 0
        self._ahead: tuple[int, int] | None = None  # since which tick messages are ahead of the grid, and by how many

    def newest(self, echo: Echo | None, sent_ns: int, now: int) -> None:
        """The newest message came at `now`, sent at `sent_ns` by our clock, with this echo."""
        if echo is None:
            self.unheard_ns = max(0, sent_ns - self.session.liveness.begun_ns)
        elif 0 <= now - echo[0] - (held_ns := echo[1]) <= MOST_RTT_NS:  # otherwise it is of one that was never sent
            self.answered, self.unheard_ns = True, held_ns
            self.session.answer_came(echo)

    def most_ahead(self) -> int:
        """Greatest number of ticks that a message can be ahead of the grid by the uncertainty of the clocks alone."""
        session = self.session
        uncertain = max(session.rtt_ns or 0, session.start_rtt_ns) // 2 + self.link.clock.sure_ns
        return min(EARLY_NS, uncertain + self._margin_ns) // self._dt_ns + 1

    def ahead(self, tick: int, ticks: int, sent_ns: int, now: int) -> None:
        """Take note that after tick `tick` a message came `ticks` ahead of the grid, which is more than `most_ahead`.

        Its send time (by the peer's clock) has to say as much: a number alone is easily forged.
        """
        before = self.link.transit_ns
        if before is not None and 2 * (before - (now - sent_ns)) > ticks * self._dt_ns:
            self._ahead = (tick if self._ahead is None else self._ahead[0], ticks)

    def in_time(self) -> None:
        """Take note that a new message came that is not ahead."""
        self._ahead = None

    def judge(self, k: int, now: int) -> None:
        """End the session if it is over for this end at tick k."""
        if self._ahead is not None and k - self._ahead[0] > STILL * max(self._every, self.session.peer_every):
            ahead = self._ahead[1] * self._dt_ns / 1e9
            self.session.end(f"stood still: the other end's messages are {ahead:.3f} s ahead of this end's clock")
        if now > self._liveness.sound_ns:
            self.session.judge(now)
