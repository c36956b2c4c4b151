"""Authentication of the two ends: the settings of OpenSSL, and the proof beside a hello.

OpenSSL is asked for one version, one suite and the peer's one certificate. DTLS 1.2 alone, because `association`
resends its handshake; ECDHE with ECDSA on AES-128-GCM alone, because without a choice nothing can be talked down. No
compression, no tickets, no resumption (each association has keys of its own), no renegotiation (a new handshake is a
new association).

Randomness is OpenSSL's own here, and `os.urandom`'s: keys drawn from a seed would be no keys. It is the one exception
to the rule that dice are arguments, and why runs that have to be repeated bit by bit go without encryption.

The proof shows that the sender of a hello holds the pinned key. The hello of DTLS says nothing of its sender, and a
handshake costs the end that listens a millisecond and a place in its memory. So the end that calls adds a record to the
hello that brings the cookie back: its certificate, and a signature by that certificate's key. The end that listens
begins nothing, and shows OpenSSL nothing, before the signature is good.

    signed: 64 spaces | "bilateral-teleop hello" | 0 | the hello

The hello has the cookie in it, which is good for one address, one process and a minute; so is the proof. The spaces
and the text keep the signature apart from those that the same key makes in a handshake (as in RFC 8446, 4.4.3). The
certificate is compared by its digest before anything in it is read.
"""

from __future__ import annotations

from os import urandom
from struct import Struct
from typing import Any

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ec import ECDSA, EllipticCurvePublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509 import load_der_x509_certificate
from OpenSSL import SSL
from OpenSSL.crypto import X509

from teleop.protocol.secure.dtls_record import DTLS_1_2, HANDSHAKE, HEAD, MTU, PROOF, DtlsRecord
from teleop.protocol.secure.keys import Key, fingerprint, parse_fingerprint

SUITE = b"ECDHE-ECDSA-AES128-GCM-SHA256"
_LABEL = b"EXPERIMENTAL-bilateral-teleop-data"  # RFC 5705, 4: a label that is not registered begins like that


class Notes:
    """Notes of OpenSSL's callbacks on one association."""

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
    ours, peer = made.get_certificate(), made.get_peer_certificate()
    assert ours is not None
    assert peer is not None
    ends = [_fingerprint(certificate) for certificate in ((peer, ours) if server else (ours, peer))]
    return made.export_keying_material(_LABEL, size, "|".join(ends).encode())


def _fingerprint(certificate: X509) -> str:
    # By OpenSSL's own digest: nothing more is read of a certificate, which may be anything.
    return parse_fingerprint(certificate.digest("sha256").decode())


def _notes(made: SSL.Connection) -> Notes:
    notes: Any = made.get_app_data()
    assert isinstance(notes, Notes)
    return notes


_BEFORE = b" " * 64 + b"bilateral-teleop hello\0"
_INSIDE = Struct("!BH")  # the type of the message, bytes of the certificate; the signature is the rest
_CURVE = ECDSA(SHA256())


def proof(key: Key, hello: DtlsRecord) -> DtlsRecord:
    """The record that goes with `hello`."""
    certificate = key.certificate.public_bytes(Encoding.DER)
    signature = key.private.sign(_signed(hello), _CURVE)
    body = _INSIDE.pack(PROOF, len(certificate)) + certificate + signature
    return DtlsRecord(HANDSHAKE, 0, 0, HEAD.pack(HANDSHAKE, DTLS_1_2, 0, 0, 0, len(body)) + body)


class Verifier:
    """Looks at proofs of the end whose certificate has the fingerprint `peer`."""

    def __init__(self, peer: str) -> None:
        self._peer = peer
        self._public: EllipticCurvePublicKey | None = None  # the peer's, once its certificate has come

    def fingerprint_in(self, record: DtlsRecord) -> str | None:
        """The fingerprint of the certificate in a proof, which any host can show; None if there is none."""
        certificate, _ = _parts(record)
        if not certificate:
            return None
        seen = fingerprint(certificate)
        if seen == self._peer and self._public is None:
            public = load_der_x509_certificate(certificate).public_key()  # the pinned one, to the last bit
            self._public = public if isinstance(public, EllipticCurvePublicKey) else None
        return seen

    def is_good(self, record: DtlsRecord, hello: DtlsRecord) -> bool:
        """True if the peer has signed this hello. The check takes 0.1 ms."""
        if self._public is None:
            return False
        try:
            self._public.verify(_parts(record)[1], _signed(hello), _CURVE)
        except InvalidSignature:
            return False
        return True


def _signed(hello: DtlsRecord) -> bytes:
    return _BEFORE + hello.data[HEAD.size :]


def _parts(record: DtlsRecord) -> tuple[bytes, bytes]:
    """Certificate and signature; empty where there are none."""
    body = record.data[HEAD.size :]
    if len(body) < _INSIDE.size:
        return b"", b""
    _, length = _INSIDE.unpack_from(body)
    end = _INSIDE.size + length
    return body[_INSIDE.size : end], body[end:]
