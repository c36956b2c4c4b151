"""DTLS records in datagrams (RFC 6347, 4.1), told apart without a key; and a relay's cookie among them.

    type 1 | version 2 | epoch 2 | number 6 | length 2 | length bytes

Epoch 0 is the handshake, in the clear and without any proof of who said it; from epoch 1 on everything is sealed.
The number of a record in the clear belongs to no proof either, so that it may be written anew when the record is sent
again: otherwise a copy of one that came too early, and was passed over, would pass for a replay for ever.

A relay has a master show its address before it keeps anything of it, beside the handshake that it cannot read. It
answers a hello with a record of its own that bears a cookie. The master's wire puts that cookie behind each of its
hellos (`RelayCookie`), and the relay takes it off again. OpenSSL and the slave see nothing of it. (A second
HelloVerifyRequest would not do: a client takes one in a handshake, and it is the slave's.)

    record: type 22, epoch 0, the number of the hello | its kind 1 | cookie
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from enum import StrEnum
from struct import Struct
from typing import NamedTuple

MTU = 1200  # bytes of a datagram of the handshake: below that of every network in use
OVERHEAD = 30  # bytes that a record of data is longer than what it carries: head 13, tag 16 (AES-GCM), what it is 1
CHANGE, ALERT, HANDSHAKE, DATA = 20, 21, 22, 23  # types
CLIENT_HELLO, VERIFY_REQUEST = 1, 3  # first bytes of handshake messages
PROOF = 0xF0  # the same of the record that goes with a hello; no message of DTLS has it: see `proof`
DTLS_1_0, DTLS_1_2 = 0xFEFF, 0xFEFD  # versions; the first hello says 1.0 for the sake of old middle boxes
HEAD = Struct("!BHHHIH")  # type, version, epoch, number (its upper 16 bits, its lower 32), length
WINDOW = 2048  # records of data: one that so many newer ones overtook is not taken; two seconds at 1 kHz
_NUMBER = slice(5, 11)
_RANDOM = slice(HEAD.size + 14, HEAD.size + 46)  # of a hello
_LEAST_DATA = OVERHEAD - HEAD.size + 1  # bytes of a record of data behind its head
_LEAST_SEALED = 8 + 16 + 1  # the same of one that OpenSSL has sealed: nonce, tag and a byte


class Dropped(StrEnum):
    """Why a record, or what should have been one, was passed over."""

    NO_RECORD = "no record"  # nothing of DTLS 1.2, or cut short
    EPOCH = "epoch"  # of the handshake after it, or of an epoch that there is not
    EARLY = "early"  # data before the handshake is over
    REPLAYED = "replayed"
    LATE = "late"  # overtaken by `WINDOW` and more: too old to say whether it is a replay
    FORGED = "forged"  # does not open: changed, of another association, or sealed without its keys
    UNPROVED = "unproved"  # a hello with a good cookie and no proof of the pinned key
    OVER = "over"  # came when the association had ended


class DtlsRecord(NamedTuple):
    """Record with its head read."""

    type: int
    epoch: int
    number: int
    data: bytes  # with the head

    @property
    def is_hello(self) -> bool:
        """True if it begins a handshake, in the clear."""
        return self.type == HANDSHAKE and self.epoch == 0 and self.data[HEAD.size] == CLIENT_HELLO

    @property
    def is_proof(self) -> bool:
        """True if it is the proof of the hello before it."""
        return self.type == HANDSHAKE and self.epoch == 0 and self.data[HEAD.size] == PROOF

    @property
    def random(self) -> bytes:
        """The random bytes of a hello: the same 32 with and without the cookie, others in each handshake."""
        return self.data[_RANDOM]

    @property
    def cookie(self) -> bytes | None:
        """The cookie that a hello brings, behind its random and its session; None if it is no hello."""
        hello, at = self.data, _RANDOM.stop
        if len(hello) <= at:
            return None
        at += 1 + hello[at]
        if len(hello) <= at:
            return None
        return hello[at + 1 : at + 1 + hello[at]]

    @property
    def is_request(self) -> bool:
        """True if it asks for a hello with a cookie. Its number is that of the hello it answers (RFC 6347, 4.2.1)."""
        return self.type == HANDSHAKE and self.epoch == 0 and self.data[HEAD.size] == VERIFY_REQUEST


def records(datagram: bytes) -> list[DtlsRecord] | None:
    """The records of a datagram in their order; None if any of it is none. Zero bytes at its end are padding."""
    parts: list[DtlsRecord] = []
    at, size = 0, len(datagram)
    while at < size:
        if size - at <= HEAD.size:
            return parts if parts and not datagram[at:].strip(b"\0") else None
        kind, version, epoch, upper, lower, length = HEAD.unpack_from(datagram, at)
        end = at + HEAD.size + length
        # Some releases of OpenSSL (3.5.2) break an association over a sealed record that is too short to be one.
        short = length < (1 if epoch == 0 else _LEAST_DATA if kind == DATA else _LEAST_SEALED)
        if not CHANGE <= kind <= DATA or version not in (DTLS_1_0, DTLS_1_2) or short or end > size:
            return parts if parts and not datagram[at:].strip(b"\0") else None
        parts.append(DtlsRecord(kind, epoch, upper << 32 | lower, datagram[at:end]))
        at = end
    return parts or None


def packed(flight: Iterable[DtlsRecord], first: int, *, padded: bool = False) -> tuple[list[bytes], int]:
    """Datagrams of at most `MTU` bytes, records of epoch 0 numbered from `first` on; and the next number.

    `padded`: the datagrams are made `MTU` long.
    """
    datagrams: list[bytes] = []
    for record in flight:
        data = record.data
        if record.epoch == 0:
            data = data[:_NUMBER.start] + first.to_bytes(6, "big") + data[_NUMBER.stop:]
            first += 1
        if datagrams and len(datagrams[-1]) + len(data) <= MTU:
            datagrams[-1] += data
        else:
            datagrams.append(data)
    return [data.ljust(MTU, b"\0") for data in datagrams] if padded else datagrams, first


SHOW = 0xF1  # first byte of the record; no message of DTLS has it
COOKIE = 32  # bytes
EXTRA = HEAD.size + 1 + COOKIE  # bytes that a hello may be longer than others with it
_MOST = 256  # hellos whose numbers are remembered


def cookie_record(hello: DtlsRecord, cookie: bytes) -> bytes:
    """The record that bears `cookie` (32 bytes), in a relay's answer to `hello` and behind the hellos that follow."""
    head = HEAD.pack(HANDSHAKE, DTLS_1_2, 0, hello.number >> 32, hello.number & 0xFFFFFFFF, 1 + len(cookie))
    return head + bytes((SHOW,)) + cookie


def is_cookie_record(record: DtlsRecord) -> bool:
    """True if this record bears a relay's cookie."""
    return (record.type == HANDSHAKE and record.epoch == 0 and len(record.data) == EXTRA
            and record.data[HEAD.size] == SHOW)


def cookie_of(parts: list[DtlsRecord]) -> bytes:
    """The relay's cookie among the records of a hello, empty if there is none."""
    return next((one.data[-COOKIE:] for one in parts if is_cookie_record(one)), b"")


def without_cookie(parts: list[DtlsRecord], size: int) -> bytes:
    """The same hello without it, as long as it was."""
    return b"".join(one.data for one in parts if not is_cookie_record(one)).ljust(min(size, MTU), b"\0")


class RelayCookie:
    """Cookie that a relay on the way has given to the end that calls, if there is a relay."""

    def __init__(self) -> None:
        self._cookie = b""
        self._hellos: deque[tuple[int, bytes]] = deque(maxlen=_MOST)  # what was sent, by number

    def stamp(self, datagram: bytes) -> bytes:
        """The datagram as it goes out: a hello with the cookie of the relay."""
        parts = records(datagram) if datagram[:1] == bytes((HANDSHAKE,)) else None
        if not parts or not parts[0].is_hello:
            return datagram
        self._hellos.append((parts[0].number, datagram))
        if not self._cookie:
            return datagram
        return (b"".join(one.data for one in parts) + cookie_record(parts[0], self._cookie)).ljust(MTU, b"\0")

    def take(self, datagram: bytes) -> bytes | None:
        """The hello to send again if this is a relay's answer to it, empty if to none; None: it is no such answer.

        Only a host that has seen the hello knows its number.
        """
        if len(datagram) != EXTRA or datagram[0] != HANDSHAKE:
            return None
        parts = records(datagram)
        if not parts or not is_cookie_record(parts[0]):
            return None
        hello = next((sent for number, sent in self._hellos if number == parts[0].number), None)
        if hello is None or parts[0].data[-COOKIE:] == self._cookie:
            return b""
        self._cookie = parts[0].data[-COOKIE:]
        return self.stamp(hello)
