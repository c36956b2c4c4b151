"""Records of data: sealed under keys of their own, which the association's handshake has made.

DTLS 1.2 authenticates the two ends and agrees on a secret; from that secret each direction gets a key here (RFC 5705,
as DTLS-SRTP does in RFC 5764), because the replay window of OpenSSL has 64 places: at 1 kHz whatever 64 ms overtake
would be lost. On the wire the records are those of DTLS 1.2, type 23 and epoch 1, without the explicit nonce.

    nonce (12 bytes) = salt of the direction (4) | epoch 1 (2) | number of the record (6)
    additional data  = the record's head (13): type, version, epoch, number, length
    plaintext        = what the record carries, and one byte behind it that says what that is

No nonce is ever used twice under one key. The two directions have keys of their own. An end seals under the next
number each time, from 1 on, and stops at `LAST`. Each association has its own secret, to which both ends have given 28
random bytes and a key exchange, and which no other association takes up again, because there is no resumption and no
renegotiation. OpenSSL itself never seals data, and its alerts and its Finished are under DTLS's own keys.

The derivation names both certificates (the context of RFC 5705), so that the keys are of these two ends even where a
handshake had no extended master secret (RFC 7627); OpenSSL has it in all handshakes since release 1.1.0.
"""

from __future__ import annotations

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from teleop.protocol.secure.dtls_record import DATA, DTLS_1_2, HEAD, OVERHEAD, WINDOW, Dropped

KEY, SALT = 16, 4  # bytes: AES-128, as in the suite of the handshake
MATERIAL = 2 * (KEY + SALT)  # bytes for both directions
LAST = 1 << 30  # the last number: 12 days at 1 kHz, and 2^34.5 blocks (RFC 9147, 4.5.3) of packets of up to 300 bytes
PACKET, CHALLENGE, ANSWER = b"\0", b"\1", b"\2"  # what a record carries: see `Line`
_MASK = (1 << WINDOW) - 1
_BEHIND = OVERHEAD - HEAD.size  # bytes behind the head that are not the packet's own


class DataRecords:
    """Both directions of one association's data.

    `material`: `MATERIAL` secret bytes, the same at both ends. `server`: is this the end that was called?
    `newest`: the greatest number taken.
    """

    __slots__ = ("_open", "_open_salt", "_seal", "_seal_salt", "_seen", "newest", "number")

    def __init__(self, material: bytes, *, server: bool) -> None:
        keys = material[:KEY], material[KEY : 2 * KEY]
        salts = material[2 * KEY : 2 * KEY + SALT], material[2 * KEY + SALT : MATERIAL]
        self._seal, self._open = AESGCM(keys[server]), AESGCM(keys[not server])
        self._seal_salt, self._open_salt = salts[server], salts[not server]
        self.number = 0  # of the last record sealed
        self.newest = 0
        self._seen = 1  # bit i: the number newest - i is taken; 0 is none's

    def seal(self, plain: bytes, what: bytes = PACKET) -> bytes | None:
        """A record of `OVERHEAD` more bytes than `plain`; None when the numbers have run out."""
        number = self.number + 1
        if number > LAST:
            return None
        self.number = number
        head = HEAD.pack(DATA, DTLS_1_2, 1, number >> 32, number & 0xFFFFFFFF, len(plain) + _BEHIND)
        return head + self._seal.encrypt(self._seal_salt + head[3:11], plain + what, head)

    def open(self, number: int, record: bytes) -> bytes | Dropped:
        """What the record of this number carries and the byte that says what it is, or why it is not taken.

        The window is looked at before the record is opened, and moved only by one that did open.
        """
        ahead = number - self.newest
        if ahead <= 0:
            if -ahead >= WINDOW:
                return Dropped.LATE
            if self._seen >> -ahead & 1:
                return Dropped.REPLAYED
        try:
            plain = self._open.decrypt(self._open_salt + record[3:11], record[13:], record[:13])
        except InvalidTag:
            return Dropped.FORGED
        if ahead > 0:
            self._seen = (self._seen << ahead | 1) & _MASK if ahead < WINDOW else 1
            self.newest = number
        else:
            self._seen |= 1 << -ahead
        return plain

    def is_genuine(self, record: bytes) -> bool:
        """True if this is a record that the other end has sealed, be it new or a copy."""
        try:
            self._open.decrypt(self._open_salt + record[3:11], record[13:], record[:13])
        except InvalidTag:
            return False
        return True
