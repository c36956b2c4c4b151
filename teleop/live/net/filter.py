"""Filter that the kernel runs on a socket's datagrams, so that a flood of foreign ones costs no tick.

    attach(sock, program(*of_session(number, size, Kind.FORTH)))    # True; False on a system without such filters
    detach(sock)

It is a classic BPF program (McCanne & Jacobson 1993): it judges a datagram as it comes, before that takes a place in
the socket's queue. Those that only look like ours pass, since no such program has a loop to compute a checksum with.
Datagrams that waited in the queue when the filter was attached stay there.
"""

from __future__ import annotations

import ctypes
import socket
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass

from msgpack import packb

from teleop.errors import Refused
from teleop.protocol.packet import DATA, MOST_CONTROL, VERSION, Kind

LONGEST = 65_507  # bytes of a UDP datagram over IPv4
_ATTACH, _DETACH = 26, 27  # SO_ATTACH_FILTER and SO_DETACH_FILTER of Linux, which Python does not name
_UDP = 8  # bytes of header before the datagram's own, in what a program on a UDP socket sees
_MOST = 4096  # instructions that the kernel takes
_FARTHEST = 255  # lines that a jump goes over
_BYTE, _HALF, _WORD, _LENGTH = 0x30, 0x28, 0x20, 0x80  # load these at a fixed place; load the datagram's length
_LESS, _TO_X = 0x14, 0x07  # subtract a constant; keep it for a comparison
_EQUAL, _ABOVE, _FROM, _EQUAL_X, _RETURN = 0x15, 0x25, 0x35, 0x1D, 0x06  # jumps if A is = k, > k, >= k, = X
_INSTRUCTION = struct.Struct("=HBBI")  # operation, lines to jump if true, if false, k
_Line = tuple[int, int, int]  # operation, k, and where it goes: _ON, _OUT, _UNLESS
_ON, _OUT, _UNLESS = 0, 1, 2  # to the next line; out unless the jump's question is true; out if it is true


@dataclass(frozen=True, kw_only=True, slots=True)
class Shape:
    """Shape of a datagram that may pass. Offsets and sizes in bytes of UDP payload.

    Raises `Refused` for a size that no datagram has.
    """

    has: tuple[tuple[int, bytes], ...] = ()  # (offset, the bytes that are there)
    least: int = 0
    most: int = LONGEST
    rest_at: int | None = None  # offset of a number of two bytes, big end first: how many bytes follow it

    def __post_init__(self) -> None:
        if any(at < 0 for at in (*(at for at, _ in self.has), self.rest_at or 0)):
            raise Refused("an offset in a shape is 0 or more; write has=((0, b'BT'),)")
        if not 0 <= self.least <= self.most <= LONGEST or self.shortest > self.most:
            raise Refused(f"a shape is of 0 to {LONGEST} bytes and has in it what it looks for, which {self.least} to "
                          f"{self.most} bytes have not; write least=0 and most=1200")

    @property
    def shortest(self) -> int:
        """Least number of bytes that can have this shape."""
        ends = [at + len(text) for at, text in self.has] + ([] if self.rest_at is None else [self.rest_at + 2])
        return max([self.least, *ends])


def program(*shapes: Shape) -> bytes:
    """Compile the program that passes a datagram of any of these shapes, for `attach`.

    >>> len(program(Shape(has=((0, b"BT"),), least=100, most=100))) // 8
    6
    """
    code = b"".join(map(_shape, shapes)) + _INSTRUCTION.pack(_RETURN, 0, 0, 0)
    if len(code) // _INSTRUCTION.size > _MOST:
        raise Refused(f"a filter has at most {_MOST} instructions; name fewer shapes")
    return code


def attach(sock: socket.socket, code: bytes) -> bool:
    """Give the socket the filter `code`, in place of one that it had; False where the system has no filters."""
    if not sys.platform.startswith("linux"):
        return False
    lines = ctypes.create_string_buffer(code, len(code))
    program = struct.pack("@HP", len(code) // _INSTRUCTION.size, ctypes.addressof(lines))
    try:
        sock.setsockopt(socket.SOL_SOCKET, _ATTACH, program)  # the kernel copies the lines
    except OSError:
        return False
    return True


def detach(sock: socket.socket) -> bool:
    """Take the socket's filter away; False if it had none."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        sock.setsockopt(socket.SOL_SOCKET, _DETACH, 0)
    except OSError:
        return False
    return True


def of_session(number: int, size: int, heard: Kind) -> tuple[Shape, ...]:
    """Shapes of the unsealed packets of one session: messages of exactly `size` bytes, and all that are no messages.

    `heard`: the kind of messages that this end hears; its own, thrown back at it, do not pass. The session's number
    stands in the body, behind the mark of an array of six.
    """
    inside = (6, b"\x96" + packb(number))
    sizes = {kind: (0, MOST_CONTROL) for kind in Kind if kind not in DATA} | {heard: (size, size)}
    return tuple(Shape(has=((0, b"BT" + bytes((VERSION, kind))), inside), least=least, most=most)
                 for kind, (least, most) in sizes.items())


def of_next(number: int) -> tuple[Shape, ...]:
    """Shape of the HELLO with which the master of this session asks for the next one."""
    inside = (6, b"\x96" + packb((number + 1) % 2**64))
    return (Shape(has=((0, b"BT" + bytes((VERSION, Kind.HELLO))), inside), most=MOST_CONTROL),)


def of_records(*, handshakes: bool = True) -> tuple[Shape, ...]:
    """Shapes of sealed datagrams (DTLS 1.2, RFC 6347): one record of data of epoch 1, of the length that it states.

    `handshakes`: also those that begin or end an association, of which a datagram may have several records.
    """
    data = Shape(has=((0, b"\x17\xfe\xfd\x00\x01"),), rest_at=11)
    return (data, *(Shape(has=((0, bytes((kind, 0xFE))),), least=13) for kind in (20, 21, 22) if handshakes))


def _shape(shape: Shape) -> bytes:
    """Compile one shape: each line goes on, or out to the line behind them."""
    lines = list(_lines(shape))
    if len(lines) > _FARTHEST:
        raise Refused("a shape's texts are too long for a jump over them; look for fewer bytes")
    code = b""
    for i, (operation, k, goes) in enumerate(lines):
        out = len(lines) - i  # over the rest and the return
        code += _INSTRUCTION.pack(operation, *((0, 0), (0, out), (out, 0))[goes], k)
    return code + _INSTRUCTION.pack(_RETURN, 0, 0, 0xFFFFFFFF)


def _lines(shape: Shape) -> Iterator[_Line]:
    # Loading from behind the end would drop the datagram at once, whatever the other shapes say.
    least = shape.shortest
    yield _LENGTH, 0, _ON
    if least == shape.most:
        yield _EQUAL, least + _UDP, _OUT
    else:
        yield _FROM, least + _UDP, _OUT
        if shape.most < LONGEST:
            yield _ABOVE, shape.most + _UDP, _UNLESS
    if shape.rest_at is not None:
        yield _LESS, shape.rest_at + 2 + _UDP, _ON
        yield _TO_X, 0, _ON
        yield _HALF, shape.rest_at + _UDP, _ON
        yield _EQUAL_X, 0, _OUT
    for at, text in shape.has:
        done = 0
        while done < len(text):
            width = 4 if len(text) - done >= 4 else 2 if len(text) - done >= 2 else 1
            yield {4: _WORD, 2: _HALF, 1: _BYTE}[width], at + done + _UDP, _ON
            yield _EQUAL, int.from_bytes(text[done : done + width], "big"), _OUT
            done += width
