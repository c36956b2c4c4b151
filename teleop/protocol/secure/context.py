"""What OpenSSL is asked for: one version, one suite, the peer's one certificate.

DTLS 1.2 and nothing else, because the resending of `association` is of its handshake; ECDHE with ECDSA on AES-128-GCM
and nothing else, because where there is nothing to choose nothing can be talked down. No compression, no tickets, no
resumption (each association has keys of its own), no renegotiation (a new handshake is a new association).

Randomness is OpenSSL's own here, and `os.urandom`'s: keys drawn from a seed would be no keys. It is the one exception
to the rule that dice are arguments, and why runs that have to be repeated bit by bit go without encryption.
"""

from __future__ import annotations

from os import urandom
from typing import Any

from OpenSSL import SSL
from OpenSSL.crypto import X509

from teleop.protocol.secure.dtls_record import DTLS_1_2, MTU
from teleop.protocol.secure.keys import Key, parse_fingerprint

SUITE = b"ECDHE-ECDSA-AES128-GCM-SHA256"
_LABEL = b"EXPERIMENTAL-bilateral-teleop-data"  # RFC 5705, 4: a label that is not registered begins like that


class Notes:
    """What OpenSSL's callbacks are told, and tell, of one association."""

    __slots__ = ("seen",)

    def __init__(self) -> None:
        self.seen: str | None = None  # the fingerprint of a certificate that was not the pinned one


def context(key: Key, peer: str) -> SSL.Context:
    """Settings for associations of `key` with the end whose certificate has the fingerprint `peer`."""
    made = SSL.Context(SSL.DTLS_METHOD)
    made.set_min_proto_version(DTLS_1_2)
    made.set_max_proto_version(DTLS_1_2)
    made.set_cipher_list(SUITE)
    made.set_options(SSL.OP_NO_QUERY_MTU | SSL.OP_NO_TICKET | SSL.OP_NO_COMPRESSION | SSL.OP_NO_RENEGOTIATION)
    made.set_session_cache_mode(SSL.SESS_CACHE_OFF)
    made.use_certificate(key.certificate)
    made.use_privatekey(key.private)

    def is_pinned(begun: SSL.Connection, certificate: X509, _error: int, depth: int, _fine: int) -> bool:
        # OpenSSL's own verdict is left aside: no authority signed the certificate, and its dates say nothing.
        seen = _fingerprint(certificate)
        if seen == peer and depth == 0:
            return True
        _notes(begun).seen = seen
        return False

    made.set_verify(SSL.VERIFY_PEER | SSL.VERIFY_FAIL_IF_NO_PEER_CERT, is_pinned)
    made.set_cookie_verify_callback(lambda _, cookie: len(cookie) > 0)  # `Gate` has looked at it already
    return made


def connection(settings: SSL.Context) -> SSL.Connection:
    """A new association that has not begun, on memory."""
    made = SSL.Connection(settings)
    made.set_ciphertext_mtu(MTU)
    made.set_app_data(Notes())
    return made


def first_number() -> int:
    """A number for the first record of the end that calls, below 2**47 of 2**48: not guessed, and enough are left."""
    return int.from_bytes(urandom(6), "big") >> 1


def seen_by(made: SSL.Connection) -> str | None:
    """The fingerprint of the certificate that was refused, if one was."""
    return _notes(made).seen


def peer_of(made: SSL.Connection) -> str | None:
    """The fingerprint of the certificate that the other end has proved to be its own."""
    certificate = made.get_peer_certificate()
    return None if certificate is None else _fingerprint(certificate)


def exported(made: SSL.Connection, size: int, *, server: bool) -> bytes:
    """Secret bytes that only the two ends of a finished handshake can know (RFC 5705).

    They depend on both certificates, the one of the end that called first.
    """
    own, peer = made.get_certificate(), made.get_peer_certificate()
    assert own is not None
    assert peer is not None
    ends = [_fingerprint(certificate) for certificate in ((peer, own) if server else (own, peer))]
    return made.export_keying_material(_LABEL, size, "|".join(ends).encode())


def _fingerprint(certificate: X509) -> str:
    # By OpenSSL's own digest: nothing more is read of a certificate, which may be anything.
    return parse_fingerprint(certificate.digest("sha256").decode())


def _notes(made: SSL.Connection) -> Notes:
    notes: Any = made.get_app_data()
    assert isinstance(notes, Notes)
    return notes
