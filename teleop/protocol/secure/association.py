"""Association of two ends: datagrams and `now` go in, packets and datagrams to send come out. Sans-IO.

    association = Association.towards(key, peer, now)  # the end that begins; the other's comes out of a `Gate`
    datagrams = association.begin(now)
    plain, back = association.receive(datagram, now)
    datagram = association.send(plain)  # None before it is ready
    datagrams = association.due(now)         # unanswered records again; called every few ms until it is ready

No datagram raises, of the peer or of an unknown sender. A record that is not taken is counted in `dropped` by its
cause; an association that ends has a sentence in `failure`, and another one has to be begun.

OpenSSL times the resending of its handshake by a clock of its own that begins at one second. Here it is done by `now`,
from 50 ms on: the last flight is sent again, its records in the clear under new numbers. Only the end that began
resends until both are authenticated. Until then the other answers what comes, and never with more bytes than came
in: it is no amplifier, not even for an address that has shown itself. OpenSSL's own timer may still add a copy, which
does no harm.

`DataRecords` seals the packets under keys of their own, which the handshake has made. DTLS 1.2 authenticates the two
ends and agrees on a secret. From it each direction gets a key here (RFC 5705, as DTLS-SRTP does in RFC 5764), because
the replay window of OpenSSL has 64 places: at 1 kHz whatever 64 ms overtake would be lost. On the wire the records have
the form of DTLS 1.2, type 23 and epoch 1, without the explicit nonce.

    nonce (12 bytes) = salt of the direction (4) | epoch 1 (2) | number of the record (6)
    additional data  = the record's head (13): type, version, epoch, number, length
    plaintext        = the packet, and one byte behind it that says what it is

No nonce is ever used twice under one key. The two directions have keys of their own. An end seals under the next
number each time, from 1 on, and stops at `LAST`. Each association has its own secret, to which both ends have given 28
random bytes and a key exchange, and which no other association takes up again, because there is no resumption and no
renegotiation. OpenSSL itself never seals data, and its alerts and its Finished are under DTLS's own keys.

The derivation names both certificates (the context of RFC 5705), so that the keys are of these two ends even where a
handshake had no extended master secret (RFC 7627); OpenSSL has it in all handshakes since release 1.1.0.
"""

from __future__ import annotations

from collections import Counter

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from OpenSSL import SSL

from teleop.protocol.secure.context import connection, context, exported, peer_of, proof, seen_by
from teleop.protocol.secure.dtls_record import (
    ALERT,
    CHANGE,
    DATA,
    DTLS_1_2,
    HANDSHAKE,
    HEAD,
    OVERHEAD,
    WINDOW,
    Dropped,
    DtlsRecord,
    packed,
    records,
)
from teleop.protocol.secure.keys import Key

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
        """Open the record of this number: its content and the byte of its kind, or the reason for dropping it.

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


MOST = 8192  # bytes that one record carries here
AGAIN_NS, SLOWEST_NS = 50_000_000, 250_000_000  # between two sendings of a flight: first, and after doubling
LIMIT_NS = 5_000_000_000  # a handshake that takes longer is given up
_ENOUGH = 65_536  # bytes: more than OpenSSL ever has to say at once
_UNTRUSTED = (42, 43, 44, 45, 46, 48)  # alerts about a certificate


class Association:
    """Association by DTLS, from its first hello to its end.

    `ready`: both ends are authenticated. `confirmed`: and the other end knows, for it has sent data. `failure`: why
    it is over. `hint`: what the other end seems to say is wrong; nothing proves that it is from there.
    """

    def __init__(self, tls: SSL.Connection, peer: str, now: int, *, key: Key | None = None) -> None:
        self.ready = self.confirmed = False
        self.failure: str | None = None
        self.hint: str | None = None
        self.data: DataRecords | None = None  # when it is ready
        self.words: list[bytes] = []  # what came that is no packet, each with the byte that says what it is
        self.dropped: Counter[str] = Counter()
        self._peer, self._key, self._tls = peer, key, tls
        self._server = key is None  # who calls proves with its key that it may
        self._write, self._read = self._tls.bio_write, self._tls.recv
        self._sealed = self._tls.bio_read
        self._began = now
        self._again: int | None = None  # when the flight is to be sent again
        self._wait = AGAIN_NS
        self._flight: list[DtlsRecord] = []
        self._number = 0  # of the next record in the clear
        self._credit = 0  # bytes that came in less those that went out, before the peer is known

    @classmethod
    def towards(cls, key: Key, peer: str, now: int) -> Association:
        """Make the association of the end that begins, with the end whose certificate has the fingerprint `peer`."""
        tls = connection(context(key, peer))
        tls.set_connect_state()
        return cls(tls, peer, now, key=key)

    def begin(self, now: int, *, first: int = 0, credit: int = 0) -> list[bytes]:
        """The first flight. For an answer: `first`, a number no record here had; `credit`, the bytes of the hello."""
        self._number, self._credit = first, credit
        return self._step(now)

    def receive(self, datagram: bytes, now: int) -> tuple[list[bytes], list[bytes]]:
        """Open a datagram: its packets, and the datagrams to send back. Never raises, whatever the bytes."""
        # Nearly always it is one sealed record.
        if self.ready and self.failure is None and OVERHEAD < len(datagram) <= OVERHEAD + MOST:
            kind, version, epoch, upper, lower, length = HEAD.unpack_from(datagram)
            if kind == DATA and epoch == 1 and version == DTLS_1_2 and HEAD.size + length == len(datagram):
                plain = self._open(upper << 32 | lower, datagram)
                return ([] if plain is None else [plain]), []
        return self._take(datagram, now)

    def send(self, plain: bytes, what: bytes = PACKET) -> bytes | None:
        """`plain` sealed, one datagram of `OVERHEAD` more bytes; None if it cannot be sent: see `ready`, `failure`."""
        if self.data is None or self.failure is not None or not 0 < len(plain) <= MOST:
            return None
        sealed = self.data.seal(plain, what)
        if sealed is None:
            self.failure = "the association has used all its numbers; another one begins"
        return sealed

    def is_genuine(self, datagram: bytes) -> bool:
        """True if this is one record of data that the other end has sealed, new or a copy."""
        return self.data is not None and len(datagram) > OVERHEAD and self.data.is_genuine(datagram)

    def due(self, now: int) -> list[bytes]:
        """Datagrams to send again, not answered by `now`."""
        if self.failure is not None or self.confirmed or (self.ready and not self._server):
            return []
        if now - self._began > LIMIT_NS:
            if self.ready:
                self._again = None
            else:
                heard = f"; {self.hint}" if self.hint else ""
                self.failure = f"no association came about in {LIMIT_NS / 1e9:g} s{heard}"
        if self._again is None or now < self._again or self.failure is not None:
            return []
        self._wait = min(2 * self._wait, SLOWEST_NS)
        self._again = now + self._wait
        return self._flown()

    def close(self) -> list[bytes]:
        """End the association; the datagrams that tell the other end."""
        if self.failure is not None:
            return []
        ready, self.failure = self.ready, "this end has ended the association"
        if not ready:
            return []
        try:
            self._tls.shutdown()
        except SSL.Error:
            return []
        return [self._taken_out()]

    def _take(self, datagram: bytes, now: int) -> tuple[list[bytes], list[bytes]]:
        """The same as `receive` for every datagram, record by record."""
        parts = records(datagram)
        if self.failure is not None or parts is None:
            self.dropped[Dropped.NO_RECORD if parts is None else Dropped.OVER] += 1
            return [], []
        if self._server and not self.ready:
            self._credit += len(datagram)
        plain: list[bytes] = []
        back: list[bytes] = []
        for record in parts:
            if self.failure is not None:
                self.dropped[Dropped.OVER] += 1
            elif record.is_proof:
                pass  # the `Gate` has looked at it already
            elif record.epoch > 1 or (self.ready and (record.epoch == 0 or record.type in (HANDSHAKE, CHANGE))):
                self.dropped[Dropped.EPOCH] += 1  # a copy of the handshake, or a wish for a new one
            elif self.ready and record.type == DATA:
                got = self._open(record.number, record.data)
                plain += [] if got is None else [got]
            elif self.ready:
                self._hear_sealed(record)
            elif record.epoch == 0 and record.type == ALERT:
                self._hear(record)
            elif record.type == DATA:
                self.dropped[Dropped.EARLY] += 1
            else:
                self._write(record.data)
                back += self._step(now)
        if self._server and not self.ready and not back and self.failure is None and parts[0].is_hello:
            back = self._flown()  # the hello again: our answer to it was lost
        return plain, back

    def _open(self, number: int, record: bytes) -> bytes | None:
        """The packet in one record of data, if it is from the other end and new."""
        assert self.data is not None
        opened = self.data.open(number, record)
        if isinstance(opened, Dropped):
            self.dropped[opened] += 1
            return None
        self.confirmed = True
        if opened[-1:] != PACKET:
            self.words.append(opened)
            return None
        return opened[:-1]

    def _hear_sealed(self, alert: DtlsRecord) -> None:
        """An alert under the keys of DTLS: a farewell, unless it does not open."""
        try:
            self._write(alert.data)
            self._read(1)
        except SSL.WantReadError:
            self.dropped[Dropped.FORGED] += 1
        except SSL.ZeroReturnError:
            self.failure = "the other end has ended the association"
        except Exception as error:
            if self._is_alive():
                self.dropped[Dropped.FORGED] += 1
            else:
                self._fail(error)

    def _is_alive(self) -> bool:
        """True if OpenSSL waits for more. An error that another association left in its queue is none of ours."""
        try:
            self._read(1)
        except SSL.WantReadError:
            return True
        except Exception:
            return False
        return False

    def _step(self, now: int) -> list[bytes]:
        """Let OpenSSL go on with the handshake, and send what it has to say."""
        try:
            self._tls.do_handshake()
        except SSL.WantReadError:
            pass
        except Exception as error:  # bytes of an unknown sender: whatever they raise ends the association
            self._fail(error)
        else:
            self.ready = peer_of(self._tls) == self._peer
            if self.ready:
                self.data = DataRecords(exported(self._tls, MATERIAL, server=self._server), server=self._server)
            else:
                self.failure = "the other end has shown no certificate that could be checked"
        flight = records(self._taken_out())
        if flight is None:
            return []
        if self._key is not None and flight[0].is_hello and flight[0].cookie:
            flight.append(proof(self._key, flight[0]))
        self._flight, self._wait = flight, AGAIN_NS
        self._again = now + AGAIN_NS if not self._server or self.ready else None
        return self._flown()

    def _flown(self) -> list[bytes]:
        """The last flight as datagrams, once more."""
        hello = bool(self._flight) and self._flight[0].is_hello
        datagrams, after = packed(self._flight, self._number, padded=hello)
        if self._server and not self.ready:
            cost = sum(map(len, datagrams))
            if cost > self._credit:
                return []
            self._credit -= cost
        self._number = after
        return datagrams

    def _taken_out(self) -> bytes:
        try:
            return self._sealed(_ENOUGH)
        except SSL.Error:  # there is nothing
            return b""

    def _hear(self, alert: DtlsRecord) -> None:
        """An alert in the clear ends nothing, since anybody can send one; it may help to find what is wrong."""
        what = alert.data[-1]
        why = "does not take this end's certificate: check its --peer-fingerprint" if what in _UNTRUSTED else \
            f"gave up the handshake (alert {what})"
        self.hint = f"the other end, it seems, {why}"

    def _fail(self, error: Exception) -> None:
        shown = seen_by(self._tls)
        if shown is not None:
            self.failure = another_certificate(shown, self._peer)
            return
        # OpenSSL's reasons are a list of (library, function, reason); they are fixed texts, which quote no bytes.
        entries = error.args[0] if isinstance(error, SSL.Error) and error.args else None
        reasons = ", ".join(str(entry[-1]) for entry in entries if entry) if isinstance(entries, list) else ""
        self.failure = f"the association broke: {reasons or type(error).__name__}"


def another_certificate(shown: str, pinned: str) -> str:
    """Sentence on a peer whose certificate is not the pinned one."""
    return (f"the other end shows the certificate {shown}, and {pinned} was asked for: compare both with what `teleop "
            "keygen` printed there, and give --peer-fingerprint the right one")
