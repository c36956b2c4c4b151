"""The door of the end that listens: only the end with the pinned key begins anything here.

A hello is answered with a cookie (RFC 6347, 4.2.1), a digest under a secret of the address and of the hello itself,
and forgotten. The hello that comes back with its cookie has a proof beside it, a signature by the pinned key
(`teleop.protocol.secure.context`), and begins an association. Only one with the pinned certificate comes out:

    association, back = gate.receive(datagram, address, now)

What senders without that key can use up is processor time. A cookie costs 10 us. A signature costs 0.1 ms to look at,
so only one in `CHECKED_NS` is looked at of each address, and 1,000 a second of all together. Senders from fewer than a
hundred addresses cannot use that up; where more do, who all have to show cookies that are good at their addresses and
the pinned certificate, the peer gets its share of it each time that it asks again.

A hello begins one association, so a copy of the peer's own costs nothing. What it began is given up for another that
the peer itself begins and for nothing else, or after `LIMIT_NS`. Not kept off is an observer who sends from the peer's
own address: it can break a handshake, as in all of DTLS, by records in the clear.

An end that listens holds the association in use beside the gate, and hands each datagram to one of them by what
`is_for_gate` says: so a peer that was restarted, or that wants new keys, begins anew while the old association goes
on, and replaces it when, and only if, it is authenticated.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from hashlib import sha256
from hmac import compare_digest
from hmac import digest as hmac_digest
from typing import Any, NamedTuple

from OpenSSL import SSL

from teleop.protocol.secure.association import LIMIT_NS, Association, another_certificate
from teleop.protocol.secure.context import Verifier, connection, context
from teleop.protocol.secure.dtls_record import (
    ALERT,
    CHANGE,
    DTLS_1_0,
    DTLS_1_2,
    HANDSHAKE,
    HEAD,
    VERIFY_REQUEST,
    Dropped,
    DtlsRecord,
    records,
)
from teleop.protocol.secure.keys import Key

Where = tuple[str, int]

MOST_BEGUN = 4  # associations that have begun and are not authenticated yet, all by the holder of the pinned key
CHECKED_NS = 100_000_000  # between two signatures of one address that are looked at
CHECK_NS, BURST = 1_000_000, 100  # between two of any addresses, on the average and for all but so many
_SLOT_NS = 30_000_000_000  # a cookie is good for one to two of these
_BAD_CERTIFICATE = 42


def is_for_gate(datagram: bytes) -> bool:
    """True if its first byte is of a handshake. Data and alerts are for an association that is there."""
    return bool(datagram) and datagram[0] in (HANDSHAKE, CHANGE)


class _Begun(NamedTuple):
    association: Association
    random: bytes  # of the hello it answers
    at_ns: int


class Gate:
    """Lets in the end whose certificate has the fingerprint `peer`. `secret`: 32 random bytes of this process.

    `refused`: why the last that was not let in was not, as a sentence; nothing proves that it was the peer.
    """

    def __init__(self, key: Key, peer: str, secret: bytes) -> None:
        self.refused: str | None = None
        self.dropped: Counter[str] = Counter()
        self._peer, self._secret = peer, secret
        self._settings = context(key, peer)
        self._begun: dict[Where, _Begun] = {}  # oldest first
        self._used: dict[bytes, int] = {}  # the randoms of hellos that have begun one, and when; oldest first
        self._checked: dict[Where, int] = {}  # whose signatures were looked at, and when; oldest first
        self._free_ns: int | None = None  # when the time of all that were looked at is made up for
        self._verifier = Verifier(peer)

    def receive(self, datagram: bytes, address: Where, now: int) -> tuple[Association | None, list[bytes]]:
        """Take a datagram of a handshake; the association that it completes, and what to send back to `address`."""
        parts = records(datagram)
        if parts is None:
            self.dropped[Dropped.NO_RECORD] += 1
            return None, []
        hello = parts[0] if parts[0].is_hello else None
        begun = self._begun.get(address)
        if begun is not None and (hello is None or hello.random == begun.random):
            return self._go_on(begun, datagram, address, now)
        if hello is None or hello.random in self._used:
            self.dropped[Dropped.EPOCH] += 1
            return None, []
        return None, self._greet(hello, parts[1:], len(datagram), address, now)

    def _go_on(
        self, begun: _Begun, datagram: bytes, address: Where, now: int
    ) -> tuple[Association | None, list[bytes]]:
        association = begun.association
        _, back = association.receive(datagram, now)
        if association.ready or association.failure is not None:
            del self._begun[address]
            self.dropped += association.dropped
        if association.failure is not None:
            self.refused = association.failure
            return None, back
        return association if association.ready else None, back

    def _greet(self, hello: DtlsRecord, behind: list[DtlsRecord], size: int, address: Where, now: int) -> list[bytes]:
        """Answer a hello: with a cookie, or if it has brought a good one and its proof with an association."""
        brought = hello.cookie
        if brought is None:
            self.dropped[Dropped.NO_RECORD] += 1
            return []
        asks = f"{address[0]}|{address[1]}|".encode() + hello.random
        slot = now // _SLOT_NS
        due, before = (hmac_digest(self._secret, asks + b"%d" % when, sha256) for when in (slot, slot - 1))
        if not compare_digest(brought, due) and not compare_digest(brought, before):
            reply = _verify_request(hello.number, due)
            return [reply] if len(reply) <= size else []
        shown = self._verifier.fingerprint_in(behind[0]) if behind and behind[0].is_proof else None
        if shown is None:
            self.dropped[Dropped.UNPROVED] += 1
            return []
        if shown != self._peer:
            self.refused = another_certificate(shown, self._peer)
            return [_alert(hello.number, _BAD_CERTIFICATE)]
        if not self._may_check(address, now):
            return []  # it will ask again
        if not self._verifier.is_good(behind[0], hello):
            self.dropped[Dropped.FORGED] += 1
            return []
        return self._begin(hello, size, address, now)

    def _may_check(self, address: Where, now: int) -> bool:
        """True if there is time to check a signature from this address."""
        _forget(self._checked, now - CHECKED_NS)
        free = now if self._free_ns is None else max(now, self._free_ns)
        if address in self._checked or free - now >= BURST * CHECK_NS:
            return False
        self._checked[address], self._free_ns = now, free + CHECK_NS
        return True

    def _begin(self, hello: DtlsRecord, size: int, address: Where, now: int) -> list[bytes]:
        """An association with the holder of the pinned key, in place of what it began from there before."""
        _forget(self._used, now - 2 * _SLOT_NS)
        self._used[hello.random] = now
        accepted = connection(self._settings)
        accepted.set_accept_state()
        try:
            accepted.bio_write(hello.data)
            accepted.DTLSv1_listen()
        except SSL.Error:
            self.dropped[Dropped.NO_RECORD] += 1
            with suppress(SSL.Error):
                accepted.do_handshake()  # clears OpenSSL's queue of errors, where listening leaves its own for others
            return []
        for where, begun in list(self._begun.items()):
            if now - begun.at_ns > LIMIT_NS or where == address:
                del self._begun[where]
        while len(self._begun) >= MOST_BEGUN:
            del self._begun[next(iter(self._begun))]
        association = Association(accepted, self._peer, now)
        self._begun[address] = _Begun(association, hello.random, now)
        # The client has seen numbers up to its own: a cookie goes out under the number of its hello.
        return association.begin(now, first=hello.number + 1, credit=size)


def _forget(times: dict[Any, int], before: int) -> None:
    """Leave out what is older than `before`; `times` is in the order of time."""
    while times and next(iter(times.values())) <= before:
        del times[next(iter(times))]


def _alert(number: int, what: int) -> bytes:
    return HEAD.pack(ALERT, DTLS_1_2, 0, number >> 32, number & 0xFFFFFFFF, 2) + bytes((2, what))


def _verify_request(number: int, cookie: bytes) -> bytes:
    """A HelloVerifyRequest under the number of its hello (RFC 6347, 4.2.1)."""
    body = DTLS_1_0.to_bytes(2, "big") + bytes((len(cookie),)) + cookie
    length = len(body).to_bytes(3, "big")
    message = bytes((VERIFY_REQUEST,)) + length + bytes(2 + 3) + length + body
    return HEAD.pack(HANDSHAKE, DTLS_1_0, 0, number >> 32, number & 0xFFFFFFFF, len(message)) + message
