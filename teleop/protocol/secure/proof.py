"""The proof beside a hello that brings its cookie: its sender holds the pinned key.

The hello of DTLS says nothing of its sender, and to begin a handshake costs the end that listens a millisecond and a
place in its memory. So the end that calls adds a record to the hello that brings the cookie back: its certificate, and
a signature by that certificate's key. The end that listens begins nothing, and shows OpenSSL nothing, before the
signature is good.

    signed: 64 spaces | "bilateral-teleop hello" | 0 | the hello

The hello has the cookie in it, which is good for one address, one process and a minute; so is the proof. The spaces
and the text keep the signature apart from those that the same key makes in a handshake (as in RFC 8446, 4.4.3). The
certificate is compared by its digest before anything in it is read.
"""

from __future__ import annotations

from struct import Struct

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ec import ECDSA, EllipticCurvePublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509 import load_der_x509_certificate

from teleop.protocol.secure.dtls_record import DTLS_1_2, HANDSHAKE, HEAD, PROOF, DtlsRecord
from teleop.protocol.secure.keys import Key, fingerprint

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

    def shown(self, record: DtlsRecord) -> str | None:
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
