"""First exchanges in the open: which master asked for which session, so that the slave's answers find it.

Nothing proves who sends a HELLO without keys. So what is kept of one is its session's number (64 random bits) and its
sender, for the last `MOST_ASKED`; and HELLOs are passed on at a bounded rate, so that a flood of them is none at the
slave, which has to answer each.
"""

from __future__ import annotations

from teleop.live.net.wire import Address
from teleop.protocol.liveness import RENEW_NS

MOST_ASKED = 4096  # sessions
EACH_NS, EACH_MOST = 10_000_000, 16  # between two datagrams of one sender on the average, for all but so many
ALL_NS, ALL_MOST = 1_000_000, 100  # the same of all senders; each that is passed on costs a slave 0.1 ms
MOST_SENDERS = 1024


class Introductions:
    """The sessions that were asked for. Times are in ns, of any clock that does not go back."""

    def __init__(self) -> None:
        self._asked: dict[int, tuple[Address, int]] = {}  # by session: who, and when last; oldest first
        self._slaves: dict[int, Address] = {}  # of those among them that were answered from elsewhere than was said
        self._each: dict[Address, int] = {}  # when what was passed on of a sender is made up for; the latest last
        self._all = 0  # the same of all

    def may_pass(self, sender: Address, now: int) -> bool:
        """Spend the slave's time for one datagram of this sender; False if none is left."""
        each, every = max(now, self._each.get(sender, 0)), max(now, self._all)
        if each - now >= EACH_MOST * EACH_NS or every - now >= ALL_MOST * ALL_NS:
            return False
        self._all = every + ALL_NS
        self._each.pop(sender, None)
        self._each[sender] = each + EACH_NS
        if len(self._each) > MOST_SENDERS:
            del self._each[next(iter(self._each))]
        return True

    def ask(self, session: int, sender: Address, now: int) -> bool:
        """A HELLO from `sender`. False: another sender asks for this very session, and has not fallen silent."""
        master, last = self._asked.get(session, (sender, now))
        if master != sender and now - last < RENEW_NS:
            return False
        self._asked.pop(session, None)
        self._asked[session] = sender, now
        if len(self._asked) > MOST_ASKED:
            oldest = next(iter(self._asked))
            del self._asked[oldest]
            self._slaves.pop(oldest, None)
        return True

    def master_of(self, session: int | None) -> Address | None:
        """The address from which the HELLO of this session came, None if there was none."""
        return None if session is None else self._asked.get(session, (None, 0))[0]

    def forget(self, session: int) -> None:
        """The slave has taken it up: what still comes of it, when it is over, begins nothing."""
        self._asked.pop(session, None)
        self._slaves.pop(session, None)

    def welcome(self, session: int, slave: Address, home: Address) -> None:
        """A WELCOME came from `slave`; one from `home`, where the slave was said to be, counts for more than others."""
        if slave == home:
            self._slaves.pop(session, None)
        else:
            self._slaves.setdefault(session, slave)

    def slave_of(self, session: int, home: Address) -> Address:
        """The address from which the slave answers in this session."""
        return self._slaves.get(session, home)
