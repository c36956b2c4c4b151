"""Where the peer is, and when another address takes that one's place. Sans-IO.

What is genuine may still come from anywhere: an observer can send a copy of a record from an address of its own, and
be first. So an address proves that the peer is there before anything is sent to it (as in RFC 9000, 8.2 and 9.3): it
is sent a challenge, sealed, which only the peer can open and answer. While genuine records, new ones or copies, come
from another address than the one in use, both are challenged, and the one in use stays as long as

- its challenge is answered, from wherever the answer comes: what is sent there reaches the peer; and
- genuine records, new ones or copies, come from it: it is the peer's own, as it shows itself here.

Where one of these is not so for two round trips of the other address and `PATIENCE_NS`, an address that has answered
takes its place. So a peer that moves is followed within half a second and three round trips. An observer that copies
draws nothing to itself. One that passes on challenges and answers is a relay: it comes into use only where the old
address has fallen silent or the handshake went through it, and while it is in use it can delay and drop like any on
the path, though not read or change. As soon as it passes on no more, the old address takes over again.
"""

from __future__ import annotations

from os import urandom

PATIENCE_NS = 200_000_000  # beyond two round trips, for answers that are lost
AGAIN_NS = 50_000_000  # between two challenges of an address
REST_NS = 250_000_000  # after an address has been confirmed, before another one is looked at
LAPSE_NS = 1_000_000_000  # nothing has come from elsewhere for so long: there is no question any more
MOST_AT_ONCE = 4  # other addresses that are challenged in `AGAIN_NS`
MOST_ASKED = 64  # challenges that can still be answered
TOKEN = 8  # bytes of a challenge, drawn at random
Where = tuple[str, int]
Challenge = tuple[bytes, Where]  # the token, and where it goes


class Path:
    """The address in use, and what is asked of others. `address`: None before an end that listens has met its peer."""

    def __init__(self, address: Where | None) -> None:
        self.address = address
        self._since: int | None = None  # since when another address is in question; None: none is
        self._speaks = self._reached = False  # the address in use, since then
        self._next = 0  # when challenges may go out again
        self._elsewhere = 0  # when something genuine last came from another address
        self._at_once: list[Where] = []  # the others that were challenged since `_next` was set
        self._asked: dict[bytes, tuple[Where, int]] = {}  # tokens under way: where they went, and when

    @property
    def settled(self) -> bool:
        """True if no other address is in question."""
        return self._since is None

    def settle(self, address: Where) -> None:
        """A handshake has gone through this address: it is the one in use."""
        self.address, self._since, self._next = address, None, 0

    def matters(self, address: Where, now: int) -> bool:
        """Would something genuine from this address say anything now?"""
        return self._since is not None or (address != self.address and now >= self._next)

    def heard(self, address: Where, now: int) -> list[Challenge]:
        """Something genuine has come from this address, a new record or a copy; what to ask."""
        if address == self.address:
            self._speaks = True
            self._confirm(now)
            return []
        self._elsewhere = now
        if self._since is None:
            if now < self._next:
                return []
            self._since, self._next, self._speaks, self._reached = now, now, False, False
        out = self.due(now)
        if address not in self._at_once and len(self._at_once) < MOST_AT_ONCE:
            self._at_once.append(address)
            out.append(self._challenge(address, now))
        return out

    def answered(self, token: bytes, now: int) -> None:
        """The peer has sent this token back, from wherever."""
        address, sent = self._asked.pop(token, (None, 0))
        if address is None or self._since is None:
            return
        if address == self.address:
            self._reached = True
            self._confirm(now)
        elif now - self._since >= 2 * (now - sent) + PATIENCE_NS:
            self.address, self._since, self._next = address, None, now + REST_NS

    def due(self, now: int) -> list[Challenge]:
        """The address in use, challenged again while another one is in question."""
        if self._since is None or now < self._next or self.address is None:
            return []
        if now - self._elsewhere > LAPSE_NS:
            self._since = None
            return []
        self._next = now + AGAIN_NS
        self._at_once.clear()
        return [self._challenge(self.address, now)]

    def _confirm(self, now: int) -> None:
        if self._speaks and self._reached and self._since is not None:
            self._since, self._next = None, now + REST_NS

    def _challenge(self, address: Where, now: int) -> Challenge:
        token = urandom(TOKEN)
        while len(self._asked) >= MOST_ASKED:
            del self._asked[next(iter(self._asked))]
        self._asked[token] = address, now
        return token, address
