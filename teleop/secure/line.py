"""One end's line to its peer, over as many associations as it takes. Sans-IO.

    line = Line.calling(key, peer, address)     # the end that begins
    line = Line.listening(key, peer, secret)    # the end that waits
    plain, back = line.receive(datagram, address, now)
    datagram = line.send(plain)                 # to line.address; None: not now
    back = line.due(now)                        # every few ms; `back`: (datagram, address) to send

Three associations at most: the one in use, the one that is coming, and the one before, which still opens what was
under way when the keys changed. The one in use goes on until the coming one is authenticated, so that nobody without
the pinned certificate can end it; a peer that was killed and restarted, at either end, is met again by itself.

The end that calls hears a handshake from one address alone, so that no stranger's word comes into it: the address that
it called, or the one from which a hello of its own is first answered, for hosts with several addresses do so from any.
The answer bears the number of the hello, which is drawn at random for that: who does not see what this end sends has
2**47 to guess from. Who does see it can break a handshake from any address. The certificate decides who it is.

The peer's address is where its newest authenticated packet came from: who moves to another network is followed, a
copy of a packet sent on from elsewhere draws nothing to itself.
"""

from __future__ import annotations

from collections import Counter

from teleop.secure.context import first_number
from teleop.secure.gate import Gate, Where, is_for_gate
from teleop.secure.keys import Key
from teleop.secure.record import Dropped, records
from teleop.secure.tunnel import LIMIT_NS, Tunnel

SILENT_NS = 500_000_000  # nothing was opened for so long: the end that calls begins anew, beside what there is
STUCK_NS = 2_000_000_000  # a handshake that nobody answers for so long is with a peer that is no more
APART_NS = 1_000_000_000  # between two that it begins
_MOST_HELLOS = 256  # more than are sent in one handshake
_ANY, _OWN = "0.0.0.0", "127.0.0.1"  # who calls any address of this machine is answered from its first
Out = tuple[bytes, Where]


class Line:
    """One end's line to the end whose certificate is pinned. Nothing that comes in raises.

    `address`: where the peer is, None before a listening end knows. `trouble`: what went wrong last, a sentence.
    `associations`: how many there were, all authenticated. `fingerprint`: this end's own.
    """

    def __init__(self, key: Key, peer: str, address: Where | None, gate: Gate | None) -> None:
        self.address, self.associations, self.fingerprint = address, 0, key.fingerprint
        self.trouble: str | None = None
        self._key, self._peer, self._gate = key, peer, gate
        self._use: Tunnel | None = None
        self._coming: Tunnel | None = None
        self._coming_at: Where | None = address  # where its flights go
        self._coming_from: Where | None = address  # and from where it is answered
        self._first = 0  # the number of its first hello
        self._old: Tunnel | None = None
        self._retired: Counter[str] = Counter()  # what was dropped by those that are gone
        self._changed = 0  # when the one in use came into use
        self._heard = 0  # when something was last opened
        self._began: int | None = None  # when this end last began one
        self._answered = 0  # when the one that is coming was last answered

    @classmethod
    def calling(cls, key: Key, peer: str, address: Where) -> Line:
        """The end that begins; the first `due` does."""
        host, port = address
        return cls(key, peer, (_OWN if host == _ANY else host, port), None)

    @classmethod
    def listening(cls, key: Key, peer: str, secret: bytes) -> Line:
        """The end that waits. `secret`: 32 random bytes of this process."""
        return cls(key, peer, None, Gate(key, peer, secret))

    @property
    def ready(self) -> bool:
        """Is there an association in use?"""
        return self._use is not None and self._use.failure is None

    @property
    def dropped(self) -> Counter[str]:
        """What was not taken, by cause."""
        gate = Counter() if self._gate is None else self._gate.dropped
        there = [tunnel.dropped for tunnel in (self._use, self._coming, self._old) if tunnel is not None]
        return sum([gate, *there], self._retired)

    def send(self, plain: bytes) -> bytes | None:
        """`plain` sealed, to go to `address`."""
        return None if self._use is None else self._use.send(plain)

    def receive(self, datagram: bytes, address: Where, now: int) -> tuple[list[bytes], list[Out]]:
        """What a datagram carries, and what to send at once."""
        if is_for_gate(datagram):
            return [], self._meet(datagram, address, now)
        # A handshake record may lie behind another: one that is not over hears only the address it goes to.
        there = [one for one in (self._use, self._coming, self._old) if one is not None and one.failure is None
                 and (one.ready or address == self._coming_from)]
        if not there:
            self._retired[Dropped.EARLY] += 1
        before = [Counter(one.dropped) for one in there] if len(there) > 1 else []
        for i, tunnel in enumerate(there):
            newest = tunnel.data.newest if tunnel.data is not None else 0
            plain = tunnel.receive(datagram, now)[0]
            if plain:
                for missed, dropped in zip(there[:i], before, strict=False):
                    missed.dropped = dropped  # it was only meant for another one
                if tunnel is self._coming:
                    self._change(now)
                if tunnel is self._use and tunnel.data is not None and tunnel.data.newest > newest:
                    self.address = address
                self._heard = now
                return plain, []
            if tunnel.failure is not None:
                self._ended(tunnel)
        for tunnel, dropped in zip(there[1:], before[1:], strict=False):
            tunnel.dropped = dropped  # one datagram counts once
        return [], []

    def due(self, now: int) -> list[Out]:
        """What is to be sent by now: handshakes, and what was not answered of them."""
        out: list[Out] = []
        if self._old is not None and now - self._changed > LIMIT_NS:
            self._retired += self._old.dropped
            self._old = None
        for tunnel, at in ((self._use, self.address), (self._coming, self._coming_at)):
            if tunnel is not None and at is not None:
                out += [(data, at) for data in tunnel.due(now)]
        if self._coming is not None and self._coming.failure is not None:
            self._ended(self._coming)
        if self._coming is not None and self._gate is None and now - self._answered > STUCK_NS:
            self._retired += self._coming.dropped
            self._coming, self.trouble = None, "nobody answers"
        quiet = not self.ready or now - max(self._heard, self._changed) > SILENT_NS
        rested = self._began is None or now - self._began > APART_NS
        return out + self.renew(now) if quiet and rested else out

    def renew(self, now: int) -> list[Out]:
        """Begin another association beside the one in use, for new keys; only the end that calls can."""
        if self._gate is not None or self._coming is not None or self.address is None:
            return []
        self._began = self._answered = now
        self._coming_at = self._coming_from = self.address
        self._coming, self._first = Tunnel.towards(self._key, self._peer, now), first_number()
        return [(data, self.address) for data in self._coming.begin(now, first=self._first)]

    def close(self) -> list[Out]:
        """End all there is; what tells the peer."""
        at = self.address
        return [(data, at) for one in (self._use, self._coming) if one is not None and at for data in one.close()]

    def _meet(self, datagram: bytes, address: Where, now: int) -> list[Out]:
        if self._gate is not None:
            let_in, back = self._gate.receive(datagram, address, now)
            self.trouble = self._gate.refused or self.trouble
            if let_in is not None:
                self._coming, self._coming_at, self._coming_from = let_in, address, address
                if not self.ready:
                    self._change(now)
            return [(data, address) for data in back]
        coming, at = self._coming, self._coming_at
        asked = [one.number - self._first for one in records(datagram) or [] if one.is_request]
        answers = all(0 <= number < _MOST_HELLOS for number in asked)  # or it is of another handshake
        if asked and answers and self._answered == self._began:
            self._coming_from = address
        if coming is None or at is None or address != self._coming_from or not answers:
            self._retired[Dropped.EPOCH] += 1
            return []
        back = coming.receive(datagram, now)[1]
        self._answered = now
        if coming.failure is not None:
            self._ended(coming)
        elif coming.ready:
            self._change(now)
        return [(data, at) for data in back]  # to where the hello came to its end: a cookie is for the way that it took

    def _change(self, now: int) -> None:
        """The coming association is the one in use from now on."""
        if self._old is not None:
            self._retired += self._old.dropped
        self._old, self._use, self._coming = self._use, self._coming, None
        self._changed = self._heard = now
        self.address = self._coming_from
        self.associations += 1

    def _ended(self, tunnel: Tunnel) -> None:
        self.trouble = tunnel.failure
        if tunnel is self._coming:
            self._retired += tunnel.dropped
            self._coming = None
