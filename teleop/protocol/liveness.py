"""The life of a session, judged by the peer's messages and by their echoes of ours. Times are ns.

A session is over if nothing came for `renew_ns`, or if this end's own packets did not arrive at the other end for as
long. Before the first message a link may just be long: the master waits `first_ns` for it, doubled from one session to
the next, and a slave waits on.
"""

from __future__ import annotations

from teleop.protocol.estimates import MOST_RTT_NS
from teleop.protocol.packet import Echo

RENEW_NS = 1_000_000_000  # of silence, and a session is over
FIRST_NS = 2_000_000_000  # the same before its first message: doubled whenever none came, for a link may be that long


class Liveness:
    """What one end knows of its session's life. The methods give the reason why the session is over, None if it is not.

    `begun_ns`: when the session began; before that nothing can have come. `renew_ns` is longer for an end that takes
    longer to let go of its device. `sound_ns`: until then there is nothing to judge, if nothing else ends the session.
    """

    def __init__(self, *, master: bool) -> None:
        self.renew_ns = RENEW_NS
        self.begun_ns = 0
        self._master = master
        self._first_ns = FIRST_NS
        self._heard_ns: int | None = None  # when the newest message came
        self._answered = False  # did a message come that shows that the peer hears this end
        self.sound_ns = 0

    def begin(self, begun_ns: int) -> None:
        """A session begins at `begun_ns`."""
        self._heard_ns = None
        self._answered = False
        self.sound_ns = 0
        self.begun_ns = begun_ns

    def wait_longer(self) -> None:
        """The next session waits twice as long for its first message, if this one had no answer."""
        self._first_ns = FIRST_NS if self._answered else min(2 * self._first_ns, MOST_RTT_NS)

    def silent(self, now: int) -> bool:
        """True if nothing has come for so long that the session is no longer kept."""
        if self._heard_ns is not None:
            return now - self._heard_ns > self.renew_ns
        return now - self.begun_ns > (self._first_timeout_ns if self._master else self.renew_ns)

    def judge(self, now: int) -> str | None:
        """Judge at every tick."""
        if now <= self.sound_ns:
            return None
        if self.silent(now):
            if self._master or self._heard_ns is not None:  # before its first message a link may just be long
                return f"nothing came for {self.renew_ns / 1e9:g} s"
        elif self._master and not self._answered and now - self.begun_ns > 2 * self._first_timeout_ns:
            return "nothing of this end arrives at the other"  # there and back it takes twice as long
        return None

    def message(self, now: int, sent_ns: int | None) -> str | None:
        """Take note of a new message of the peer, sent at `sent_ns` by this end's clock."""
        first = self._heard_ns is None
        self._heard_ns = now
        self.sound_ns = now + self.renew_ns if self._answered or not self._master else 0
        if first and sent_ns is not None and sent_ns - self.begun_ns > self.renew_ns:
            return f"its first {self.renew_ns / 1e9:g} s did not arrive"
        return None

    def echo(self, echo: Echo) -> str | None:
        """Take note of what the peer's newest message says of ours: which one came last, and how long before."""
        first = not self._answered
        self._answered = True
        if first and echo.sent_ns - self.begun_ns > self.renew_ns:
            return f"nothing of its first {self.renew_ns / 1e9:g} s arrived at the other end"
        if echo.held_ns > self.renew_ns:
            return f"nothing of this end arrived at the other for {self.renew_ns / 1e9:g} s"
        return None

    @property
    def _first_timeout_ns(self) -> int:
        """Time (ns) that a master waits for the first message."""
        return max(self._first_ns, self.renew_ns)
