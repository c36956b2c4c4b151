"""The relay's own cookies: a sender of DTLS hellos shows its address before anything is kept of it.

As RFC 6347, 4.2.1 has it for a server: a hello without a good cookie is answered with one, no longer than the hello,
and forgotten. How cookies travel is in `teleop.protocol.secure.relayed`; a slave asks for one of its own behind it.
"""

from __future__ import annotations

from hashlib import sha256
from hmac import compare_digest, digest

from teleop.live.net.wire import Address
from teleop.protocol.secure.dtls_record import DtlsRecord

SLOT_NS = 30_000_000_000  # a cookie is good for one to two of these


class Cookies:
    """Cookies under a `secret` (32 random bytes of this process), each for one address and one handshake."""

    def __init__(self, secret: bytes) -> None:
        self._secret = secret

    def of(self, hello: DtlsRecord, address: Address, now: int) -> bytes:
        """The cookie (32 bytes) for a hello from `address`; `now` in ns, of any clock that does not go back."""
        return self._of(hello, address, now // SLOT_NS)

    def is_good(self, brought: bytes, hello: DtlsRecord, address: Address, now: int) -> bool:
        """True if this is the cookie that a hello from `address` was given."""
        slot = now // SLOT_NS
        return any(compare_digest(brought, self._of(hello, address, when)) for when in (slot, slot - 1))

    def _of(self, hello: DtlsRecord, address: Address, slot: int) -> bytes:
        asked = f"{address[0]}|{address[1]}|{slot}|".encode() + hello.random
        return digest(self._secret, asked, sha256)
