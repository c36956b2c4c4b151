"""Sealed link of an end to its peer, over as many associations (DTLS 1.2, RFC 6347) as it takes. Sans-IO.

    link = SecureLink.calling(key, peer, address)   # the end that begins
    link = SecureLink.listening(key, peer, secret)  # the end that waits
    plain, back = link.receive(datagram, address, now)
    datagram = link.send(plain)                     # to link.address; None: not now
    back = link.due(now)                            # every few ms; `back`: (datagram, address) to send

Three associations at most: the one in use, the one that is coming, and the one before, which still opens what was
under way when the keys changed. The one in use goes on until the coming one is authenticated, so that no sender without
the pinned certificate can end it; a peer that was killed and restarted, at either end, is met again by itself.

The end that calls hears a handshake from the address that it called. Hosts with several addresses answer from any of
them, so where the one that was called does not answer for `ELSEWHERE_NS` longer than another, that one is heard. An
answer bears the number of the hello, which is drawn at random for that: who does not see what this end sends has 2**47
to guess from, and who does see it comes into a handshake from the called address alone, or where that is silent. The
certificate decides who it is.

`ELSEWHERE_NS` has to be above the round trip to the peer: an observer that answers a hello from near by would be heard
before the peer, and a handshake that begins with it is only given up after `STUCK_NS`. A satellite takes 0.6 s there
and back. A host that answers from another address than the called one is met as much later, once.

Where the peer is, the handshake says first: the end that calls sends to where its flights were answered from, the one
that listens to the address that its cookie was for. Another address is validated before it takes that one's place, by
`PathValidation`. A genuine record may still come from anywhere: an observer can send a copy of one from an address of
its own, and be first. So an address proves that the peer is there before anything is sent to it (as in RFC 9000, 8.2
and 9.3): it gets a sealed challenge, which only the peer can open and answer. A challenge and its answer are as long as
the last packet, so that they cannot be told from packets. While genuine records, new ones or copies, come from another
address than the one in use, both are challenged, and the one in use stays as long as

- its challenge is answered, from wherever the answer comes: what is sent there reaches the peer; and
- genuine records, new ones or copies, come from it: it is the peer's own, as it shows itself here.

Where one of these is not so for two round trips of the other address and `PATIENCE_NS`, an address that has answered
takes its place. So a peer that moves is followed within half a second and three round trips. An observer that copies
draws nothing to itself. One that passes on challenges and answers is a relay: it comes into use only where the old
address has fallen silent or the handshake went through it, and while it is in use it can delay and drop like any on
the path, though not read or change. As soon as it passes on no more, the old address takes over again.
"""

from __future__ import annotations

from collections import Counter
from os import urandom

from teleop.protocol.secure.association import ANSWER, CHALLENGE, LIMIT_NS, Association
from teleop.protocol.secure.context import first_number
from teleop.protocol.secure.dtls_record import Dropped, records
from teleop.protocol.secure.gate import Gate, Where, is_for_gate
from teleop.protocol.secure.keys import Key

PATIENCE_NS = 200_000_000  # beyond two round trips, for answers that are lost
CHALLENGED_NS = 50_000_000  # between two challenges of an address
REST_NS = 250_000_000  # after an address has been confirmed, before another one is looked at
LAPSE_NS = 1_000_000_000  # nothing has come from elsewhere for so long: there is no question any more
MOST_AT_ONCE = 4  # other addresses that are challenged in `CHALLENGED_NS`
MOST_ASKED = 64  # challenges that can still be answered
TOKEN = 8  # bytes of a challenge, drawn at random

Challenge = tuple[bytes, Where]  # the token, and where it goes


class PathValidation:
    """The address in use, and what is asked of others. `address`: None before an end that listens has met its peer."""

    def __init__(self, address: Where | None) -> None:
        self.address = address
        self._since: int | None = None  # since when another address is in question; None: none is
        self._speaks = self._reached = False  # the address in use, since then
        self._next = 0  # when challenges may go out again
        self._elsewhere = 0  # when something genuine last came from another address
        self._at_once: list[Where] = []  # the others that were challenged since `_next` was set
        self._tokens: dict[bytes, tuple[Where, int]] = {}  # tokens under way: where they went, and when

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

    def receive(self, address: Where, now: int) -> list[Challenge]:
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

    def take_answer(self, token: bytes, now: int) -> None:
        """The peer has sent this token back, from wherever."""
        address, sent = self._tokens.pop(token, (None, 0))
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
        self._next = now + CHALLENGED_NS
        self._at_once.clear()
        return [self._challenge(self.address, now)]

    def _confirm(self, now: int) -> None:
        if self._speaks and self._reached and self._since is not None:
            self._since, self._next = None, now + REST_NS

    def _challenge(self, address: Where, now: int) -> Challenge:
        token = urandom(TOKEN)
        while len(self._tokens) >= MOST_ASKED:
            del self._tokens[next(iter(self._tokens))]
        self._tokens[token] = address, now
        return token, address


SILENT_NS = 500_000_000  # nothing was opened for so long: the end that calls begins anew, beside what there is
ELSEWHERE_NS = 750_000_000  # an answer from elsewhere than from the called address waits so long for one from there
STUCK_NS = 2_000_000_000  # a handshake without an answer for so long is with a peer that is no more
APART_NS = 1_000_000_000  # between two that it begins
_MOST_HELLOS = 256  # more than are sent in one handshake
_MOST_FROM = 16  # addresses from which a handshake is heard
_ANY, _OWN = "0.0.0.0", "127.0.0.1"  # who calls any address of this machine is answered from its first
Out = tuple[bytes, Where]


class SecureLink:
    """Link to the end whose certificate is pinned. Nothing that comes in raises.

    `trouble`: what went wrong last, a sentence. `associations`: how many there were, all authenticated.
    `fingerprint`: this end's own.
    """

    def __init__(self, key: Key, peer: str, address: Where | None, gate: Gate | None) -> None:
        self.associations, self.fingerprint = 0, key.fingerprint
        self.trouble: str | None = None
        self._key, self._peer, self._gate = key, peer, gate
        self._use: Association | None = None
        self._coming: Association | None = None
        self._path = PathValidation(address)
        self._called = address  # by the end that calls
        self._coming_at: Where | None = address  # where its flights go
        self._coming_from: list[Where] = []  # and from where else it is answered
        self._elsewhere: int | None = None  # when it first was
        self._direct = False  # is it answered from where its flights go
        self._tries = 0  # handshakes begun since the last one that was finished
        self._size = TOKEN  # bytes of the last packet
        self._first = 0  # the number of its first hello
        self._old: Association | None = None
        self._retired: Counter[str] = Counter()  # what was dropped by those that are gone
        self._changed = 0  # when the one in use came into use
        self._heard = 0  # when something was last opened
        self._began: int | None = None  # when this end last began one
        self._answered = 0  # when the one that is coming was last answered

    @classmethod
    def calling(cls, key: Key, peer: str, address: Where) -> SecureLink:
        """The end that begins; the first `due` does."""
        host, port = address
        return cls(key, peer, (_OWN if host == _ANY else host, port), None)

    @classmethod
    def listening(cls, key: Key, peer: str, secret: bytes) -> SecureLink:
        """The end that waits. `secret`: 32 random bytes of this process."""
        return cls(key, peer, None, Gate(key, peer, secret))

    @property
    def address(self) -> Where | None:
        """Address of the peer, None before an end that listens has met it."""
        return self._path.address

    @property
    def settled(self) -> bool:
        """True if it is certain, for the time being, that the peer is at `address` and nowhere else."""
        return self._path.settled

    @property
    def ready(self) -> bool:
        """True if an association is in use."""
        return self._use is not None and self._use.failure is None

    @property
    def dropped(self) -> Counter[str]:
        """Counts of dropped records, by cause."""
        gate = Counter() if self._gate is None else self._gate.dropped
        known = [association.dropped for association in (self._use, self._coming, self._old) if association is not None]
        return sum([gate, *known], self._retired)

    def send(self, plain: bytes) -> bytes | None:
        """`plain` sealed, to go to `address`."""
        self._size = len(plain)
        return None if self._use is None else self._use.send(plain)

    def receive(self, datagram: bytes, address: Where, now: int) -> tuple[list[bytes], list[Out]]:
        """Open a datagram: its packets, and the datagrams to send at once."""
        if is_for_gate(datagram):
            return [], self._meet(datagram, address, now)
        # A handshake record may lie behind another: one that is not over hears only the addresses it goes to.
        candidates = [one for one in (self._use, self._coming, self._old) if one is not None and one.failure is None
                 and (one.ready or self._hears(address, now))]
        if not candidates:
            self._retired[Dropped.EARLY] += 1
        before = [Counter(one.dropped) for one in candidates] if len(candidates) > 1 else []
        for i, association in enumerate(candidates):
            plain = association.receive(datagram, now)[0]
            if plain or association.words:
                for missed, dropped in zip(candidates[:i], before, strict=False) if i else ():
                    missed.dropped = dropped  # it was only meant for another one
                if association is self._coming:
                    self._change(now)
                self._heard = now
                known = not association.words and not self._path.matters(address, now)
                return plain, [] if known else self._genuine(association, address, now)
            if association.failure is not None:
                self._retire(association)
        for association, dropped in zip(candidates[1:], before[1:], strict=False):
            association.dropped = dropped  # one datagram counts once
        if self._use is not None and self._path.matters(address, now) and self._use.is_genuine(datagram):
            return [], self._sealed(self._path.receive(address, now))  # a copy
        return [], []

    def due(self, now: int) -> list[Out]:
        """Datagrams to send by now: handshakes, and their unanswered flights again."""
        out: list[Out] = []
        if self._old is not None and now - self._changed > LIMIT_NS:
            self._retired += self._old.dropped
            self._old = None
        for association, at in ((self._use, self.address), (self._coming, self._coming_at)):
            if association is not None and at is not None:
                out += [(data, at) for data in association.due(now)]
        out += self._sealed(self._path.due(now))
        if self._coming is not None and self._coming.failure is not None:
            self._retire(self._coming)
        if self._coming is not None and self._gate is None and now - self._answered > STUCK_NS:
            self._retired += self._coming.dropped
            self._coming = None
            self.trouble = ("nothing answers; start the other end first, and if it runs, check the address, and that "
                            f"its --peer-fingerprint is that of this key: {self.fingerprint}")
        quiet = not self.ready or now - max(self._heard, self._changed) > SILENT_NS
        rested = self._began is None or now - self._began > APART_NS
        return out + self.renew(now) if quiet and rested else out

    def renew(self, now: int) -> list[Out]:
        """Begin another association beside the one in use, for new keys; only the end that calls can."""
        at = self.address if self._tries % 2 else self._called  # by turns: it may be back, or have moved
        if self._gate is not None or self._coming is not None or at is None:
            return []
        self._began = self._answered = now
        self._tries += 1
        self._coming_at, self._coming_from, self._elsewhere, self._direct = at, [], None, False
        self._coming, self._first = Association.towards(self._key, self._peer, now), first_number()
        return [(data, at) for data in self._coming.begin(now, first=self._first)]

    def close(self) -> list[Out]:
        """End all there is; what tells the peer."""
        at = self.address
        return [(data, at) for one in (self._use, self._coming) if one is not None and at for data in one.close()]

    def _meet(self, datagram: bytes, address: Where, now: int) -> list[Out]:
        if self._gate is not None:
            let_in, back = self._gate.receive(datagram, address, now)
            self.trouble = self._gate.refused or self.trouble
            if let_in is not None:
                self._coming, self._coming_at = let_in, address
                if not self.ready:
                    self._change(now)
            return [(data, address) for data in back]
        coming, at = self._coming, self._coming_at
        requests = [one.number - self._first for one in records(datagram) or [] if one.is_request]
        answers = all(0 <= number < _MOST_HELLOS for number in requests)  # or it is of another handshake
        if requests and answers and address == at:
            self._direct = True
        elif requests and answers and address not in self._coming_from and len(self._coming_from) < _MOST_FROM:
            self._coming_from.append(address)
            self._elsewhere = now if self._elsewhere is None else self._elsewhere
        if coming is None or at is None or not answers or not self._hears(address, now):
            self._retired[Dropped.EPOCH] += 1
            return []
        back = coming.receive(datagram, now)[1]
        self._answered = now
        if coming.failure is not None:
            self._retire(coming)
        elif coming.ready:
            self._change(now)
        return [(data, at) for data in back]  # to where the hello came to its end: a cookie is for the way that it took

    def _hears(self, address: Where, now: int) -> bool:
        """True if the handshake under way is heard from there."""
        if address == self._coming_at or self._elsewhere is None or self._direct:
            return address == self._coming_at
        return address in self._coming_from and now - self._elsewhere > ELSEWHERE_NS

    def _change(self, now: int) -> None:
        """The coming association is the one in use from now on."""
        if self._old is not None:
            self._retired += self._old.dropped
        self._old, self._use, self._coming = self._use, self._coming, None
        self._changed = self._heard = now
        self.associations += 1
        self._tries = 0
        if self._coming_at is not None:
            self._path.settle(self._coming_at)

    def _genuine(self, association: Association, address: Where, now: int) -> list[Out]:
        """Datagrams to send after something genuine and new has come from this address."""
        words, association.words = association.words, []
        if association is not self._use:
            return []
        out: list[Out] = []
        for word in words:
            token, what = word[:TOKEN], word[-1:]
            if what == ANSWER:
                self._path.take_answer(token, now)
            elif what == CHALLENGE and self.address is not None:
                # Also to where the peer is known to be: a challenge that was copied may have come from anywhere.
                answer = association.send(word[:-1], ANSWER)
                out += [(answer, at) for at in {address, self.address} if answer is not None]
        if self._path.matters(address, now):
            out += self._sealed(self._path.receive(address, now))
        return out

    def _sealed(self, challenges: list[Challenge]) -> list[Out]:
        out: list[Out] = []
        for token, at in challenges:
            data = None if self._use is None else self._use.send(token.ljust(self._size, b"\0"), CHALLENGE)
            out += [] if data is None else [(data, at)]
        return out

    def _retire(self, association: Association) -> None:
        self.trouble = association.failure
        if association is self._coming:
            self._retired += association.dropped
            self._coming = None
