"""How a relay has a master show its address before it keeps anything of it, beside the handshake that it cannot read.

A relay answers a hello with a record of its own that bears a cookie; the master's wire puts that cookie behind each of
its hellos, and the relay takes it off again. OpenSSL and the slave see nothing of it. (A second HelloVerifyRequest
would not do: a client takes one in a handshake, and that is the slave's.)

    record: type 22, epoch 0, the number of the hello | what it is 1 | cookie
"""

from __future__ import annotations

from collections import deque

from teleop.protocol.secure.dtls_record import DTLS_1_2, HANDSHAKE, HEAD, MTU, DtlsRecord, records

SHOW = 0xF1  # first byte of the record; no message of DTLS has it
COOKIE = 32  # bytes
EXTRA = HEAD.size + 1 + COOKIE  # bytes that a hello may be longer than others with it
_MOST = 256  # hellos whose numbers are remembered


def shown(hello: DtlsRecord, cookie: bytes) -> bytes:
    """The record that bears `cookie` (32 bytes), in a relay's answer to `hello` and behind the hellos that follow."""
    head = HEAD.pack(HANDSHAKE, DTLS_1_2, 0, hello.number >> 32, hello.number & 0xFFFFFFFF, 1 + len(cookie))
    return head + bytes((SHOW,)) + cookie


def is_shown(record: DtlsRecord) -> bool:
    """True if this record bears a relay's cookie."""
    return (record.type == HANDSHAKE and record.epoch == 0 and len(record.data) == EXTRA
            and record.data[HEAD.size] == SHOW)


def cookie_of(found: list[DtlsRecord]) -> bytes:
    """The relay's cookie among the records of a hello, empty if there is none."""
    return next((one.data[-COOKIE:] for one in found if is_shown(one)), b"")


def without(found: list[DtlsRecord], size: int) -> bytes:
    """The same hello without it, as long as it was."""
    return b"".join(one.data for one in found if not is_shown(one)).ljust(min(size, MTU), b"\0")


class Caller:
    """What the end that calls has been given by a relay on the way, if there is one."""

    def __init__(self) -> None:
        self._cookie = b""
        self._hellos: deque[tuple[int, bytes]] = deque(maxlen=_MOST)  # what was sent, by number

    def sends(self, datagram: bytes) -> bytes:
        """The datagram as it goes out: a hello with the cookie of the relay."""
        found = records(datagram) if datagram[:1] == bytes((HANDSHAKE,)) else None
        if not found or not found[0].is_hello:
            return datagram
        self._hellos.append((found[0].number, datagram))
        if not self._cookie:
            return datagram
        return (b"".join(one.data for one in found) + shown(found[0], self._cookie)).ljust(MTU, b"\0")

    def hears(self, datagram: bytes) -> bytes | None:
        """The hello to send again if this is a relay's answer to it, empty if to none; None: it is no such answer.

        Only a host that has seen the hello knows its number.
        """
        if len(datagram) != EXTRA or datagram[0] != HANDSHAKE:
            return None
        found = records(datagram)
        if not found or not is_shown(found[0]):
            return None
        asked = next((sent for number, sent in self._hellos if number == found[0].number), None)
        if asked is None or found[0].data[-COOKIE:] == self._cookie:
            return b""
        self._cookie = found[0].data[-COOKIE:]
        return self.sends(asked)
