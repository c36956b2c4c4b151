"""The door of the end that listens: a stranger is asked to show its address first, and costs nothing until then.

A hello is answered with a cookie (RFC 6347, 4.2.1), a digest under a secret of the address and of the hello itself,
and forgotten. Only the hello that comes back with its cookie begins an association, and only one with the pinned
certificate comes out of the gate:

    tunnel, back = gate.receive(datagram, address, now)

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
from typing import NamedTuple

from OpenSSL import SSL

from teleop.secure.context import connection, context
from teleop.secure.keys import Key
from teleop.secure.record import CHANGE, HANDSHAKE, HEAD, VERIFY_REQUEST, Dropped, Record, records
from teleop.secure.tunnel import LIMIT_NS, Tunnel

Where = tuple[str, int]

MOST_BEGUN = 8  # associations that have begun and are not authenticated yet; of more, the oldest gives way
APART_NS = 10_000_000  # between two that begin: each costs about 1 ms, and strangers can begin them too
_SLOT_NS = 30_000_000_000  # a cookie is good for one to two of these
_SAYS_1_0 = 0xFEFF
_RANDOM = slice(HEAD.size + 14, HEAD.size + 46)  # of a hello: the same 32 bytes with and without the cookie


def is_for_gate(datagram: bytes) -> bool:
    """Is it part of a handshake, by its first byte? Data and alerts are for an association that is there."""
    return bool(datagram) and datagram[0] in (HANDSHAKE, CHANGE)


class _Begun(NamedTuple):
    tunnel: Tunnel
    random: bytes  # of the hello it answers
    at_ns: int


class Gate:
    """Lets in the end whose certificate has the fingerprint `peer`. `secret`: 32 random bytes of this process.

    `refused`: how the last association that failed here did, as a sentence; it may have been a stranger's.
    """

    def __init__(self, key: Key, peer: str, secret: bytes) -> None:
        self.refused: str | None = None
        self.dropped: Counter[str] = Counter()
        self._peer, self._secret = peer, secret
        self._settings = context(key, peer)
        self._begun: dict[Where, _Begun] = {}  # oldest first
        self._last: int | None = None  # when one last began
        self._let_in = b""  # the random of the last that was: late copies of its hello begin nothing

    def receive(self, datagram: bytes, address: Where, now: int) -> tuple[Tunnel | None, list[bytes]]:
        """Take a datagram of a handshake; the association that it completes, and what to send back to `address`."""
        found = records(datagram)
        if found is None:
            self.dropped[Dropped.NO_RECORD] += 1
            return None, []
        hello = found[0] if found[0].is_hello else None
        begun = self._begun.get(address)
        if begun is not None and (hello is None or hello.data[_RANDOM] == begun.random):
            return self._go_on(begun, datagram, address, now)
        if hello is None or len(found) > 1 or hello.data[_RANDOM] == self._let_in:
            self.dropped[Dropped.EPOCH] += 1
            return None, []
        return None, self._greet(hello, len(datagram), address, now)

    def _go_on(
        self, begun: _Begun, datagram: bytes, address: Where, now: int
    ) -> tuple[Tunnel | None, list[bytes]]:
        tunnel = begun.tunnel
        _, back = tunnel.receive(datagram, now)
        if tunnel.ready or tunnel.failure is not None:
            del self._begun[address]
            self.dropped += tunnel.dropped
        if tunnel.failure is not None:
            self.refused = tunnel.failure
            return None, back
        if tunnel.ready:
            self._let_in = begun.random
            return tunnel, back
        return None, back

    def _greet(self, hello: Record, came: int, address: Where, now: int) -> list[bytes]:
        """Answer a hello: with a cookie, or if it has brought a good one with an association.

        OpenSSL sees nothing of it before its cookie is good.
        """
        brought = _cookie(hello.data)
        if brought is None:
            self.dropped[Dropped.NO_RECORD] += 1
            return []
        asks = f"{address[0]}|{address[1]}|".encode() + hello.data[_RANDOM]
        slot = now // _SLOT_NS
        due, before = (hmac_digest(self._secret, asks + b"%d" % when, sha256) for when in (slot, slot - 1))
        if compare_digest(brought, due) or compare_digest(brought, before):
            return self._begin(hello, came, address, now)
        reply = _verify_request(hello.number, due)
        return [reply] if len(reply) <= came else []

    def _begin(self, hello: Record, came: int, address: Where, now: int) -> list[bytes]:
        if self._last is not None and now - self._last < APART_NS:
            return []  # it will ask again
        self._last = now
        accepted = connection(self._settings)
        accepted.set_accept_state()
        try:
            accepted.bio_write(hello.data)
            accepted.DTLSv1_listen()
        except SSL.Error:  # the cookie is good and nothing else
            self.dropped[Dropped.NO_RECORD] += 1
            with suppress(SSL.Error):
                accepted.do_handshake()  # clears OpenSSL's queue of errors, where listening leaves its own for others
            return []
        for where, begun in list(self._begun.items()):
            if now - begun.at_ns > LIMIT_NS or where == address:
                del self._begun[where]
        while len(self._begun) >= MOST_BEGUN:
            del self._begun[next(iter(self._begun))]
        tunnel = Tunnel(accepted, self._peer, now, server=True)
        self._begun[address] = _Begun(tunnel, hello.data[_RANDOM], now)
        # The client has seen numbers up to its own: a cookie goes out under the number of its hello.
        return tunnel.begin(now, first=hello.number + 1, credit=came)


def _cookie(hello: bytes) -> bytes | None:
    """The cookie that a hello brings, behind its random and its session; None if it is no hello."""
    at = _RANDOM.stop
    if len(hello) <= at:
        return None
    at += 1 + hello[at]
    if len(hello) <= at:
        return None
    return hello[at + 1 : at + 1 + hello[at]]


def _verify_request(number: int, cookie: bytes) -> bytes:
    """A HelloVerifyRequest under the number of its hello (RFC 6347, 4.2.1)."""
    body = _SAYS_1_0.to_bytes(2, "big") + bytes((len(cookie),)) + cookie
    length = len(body).to_bytes(3, "big")
    message = bytes((VERIFY_REQUEST,)) + length + bytes(2 + 3) + length + body
    return HEAD.pack(HANDSHAKE, _SAYS_1_0, 0, number >> 32, number & 0xFFFFFFFF, len(message)) + message
