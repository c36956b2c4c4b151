"""Datagrams by the handful: one call into the system reads all that wait at a socket, or sends all that are due.

Python's own `recvmsg` and `sendto` cost a call, a list and a tuple for each datagram, and an exception to learn
that none is left. Linux has `recvmmsg` and `sendmmsg`; elsewhere the datagrams go through the `Wire` one by one.
"""

from __future__ import annotations

import ctypes
import errno
import socket
import time
from collections.abc import Sequence
from struct import Struct

from teleop.live.net.wire import LONGEST, STAMP, Address, Wire, arrival, clocks

MOST = 32  # datagrams in one call
_KNOWN = 64  # senders whose address is remembered as text
_NAME = Struct("=HH4s8x")  # sockaddr_in
_NOTE = Struct("@Niill")  # cmsghdr and the timespec behind it
_HEADER = Struct("@PIPNPNi4xI4x")  # mmsghdr: name, iovec, control with their sizes; flags; bytes received
_PART = Struct("@PN")  # iovec
_NAME_USED = 8  # bytes of a name that tell the sender
_WORDS, _NOTED, _TAKEN = 16, 10, 14  # 32-bit words of a header; those that tell the bytes of notes and of data

Taken = tuple[bytes, Address, int]


class _Headers:
    """Room for `MOST` datagrams, with the headers that point into it."""

    def __init__(self, each: int) -> None:
        self.each = each
        self.data = bytearray(MOST * each)
        self.names = bytearray(MOST * _NAME.size)
        self.notes = bytearray(MOST * _NOTE.size)
        self.parts = bytearray(MOST * _PART.size)
        self.headers = bytearray(MOST * _HEADER.size)
        data, names, notes, parts, self.at = map(_where, (self.data, self.names, self.notes, self.parts, self.headers))
        for i in range(MOST):
            _PART.pack_into(self.parts, i * _PART.size, data + i * each, each)
            _HEADER.pack_into(self.headers, i * _HEADER.size, names + i * _NAME.size, _NAME.size,
                              parts + i * _PART.size, 1, notes + i * _NOTE.size, _NOTE.size, 0, 0)
        self.fresh = bytes(self.headers)  # the system writes into them
        self.words = memoryview(self.headers).cast("I")
        self.sizes = memoryview(self.parts).cast("L")  # size_t


def _where(room: bytearray) -> int:
    return ctypes.addressof((ctypes.c_char * len(room)).from_buffer(room))


class Bulk:
    """The socket of a `Wire` without a line, for many datagrams at a time. Nothing that happens on it raises."""

    def __init__(self, wire: Wire) -> None:
        self._wire, self._fd = wire, wire.sock.fileno()
        self._known: dict[bytes, Address] = {}
        self._peer: Address | None = None
        self._emptied_ns = time.monotonic_ns()  # when nothing was left to receive
        try:
            libc = ctypes.CDLL(None, use_errno=True)
            self._recvmmsg, self._sendmmsg = libc.recvmmsg, libc.sendmmsg
            self.available = _HEADER.size == 4 * _WORDS  # as the system lays them out where addresses have 64 bits
        except (OSError, AttributeError):
            self.available = False
        if not self.available:
            return
        self._recvmmsg.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p]
        self._sendmmsg.argtypes = self._recvmmsg.argtypes[:-1]
        self._in, self._out = _Headers(LONGEST), _Headers(LONGEST)

    def receive(self) -> list[Taken]:
        """Read up to `MOST` datagrams that wait: bytes, sender and time of arrival (monotonic clock, ns) of each."""
        if not self.available:
            return self._one_by_one()
        box = self._in
        while True:
            count = self._recvmmsg(self._fd, box.at, MOST, socket.MSG_DONTWAIT, None)
            if count >= 0 or ctypes.get_errno() != errno.ECONNREFUSED:  # said once for what was sent there
                break
        now, wall = clocks()
        if count <= 0:
            self._emptied_ns = now
            return []
        emptied = self._emptied_ns
        if count < MOST:
            self._emptied_ns = now
        out = []
        for i in range(count):
            start = i * LONGEST
            name = bytes(box.names[i * _NAME.size : i * _NAME.size + _NAME_USED])
            _, level, kind, seconds, nanoseconds = _NOTE.unpack_from(box.notes, i * _NOTE.size)
            arrived = now
            if box.words[i * _WORDS + _NOTED] == _NOTE.size and kind == STAMP and level == socket.SOL_SOCKET:
                arrived = arrival(seconds * 1_000_000_000 + nanoseconds, now, wall, emptied)
            data = bytes(box.data[start : start + box.words[i * _WORDS + _TAKEN]])
            out.append((data, self._known.get(name) or self._address_of(name), arrived))
        used = count * _HEADER.size
        box.headers[:used] = box.fresh[:used]
        return out

    def send(self, datagrams: Sequence[bytes]) -> None:
        """Send them to the wire's peer, in this order, if there is one yet."""
        wire = self._wire
        if not self.available or wire.peer is None or len(datagrams) == 1:
            for data in datagrams:
                wire.send(data)
            return
        for start in range(0, len(datagrams), MOST):
            self._send_many(datagrams[start : start + MOST], wire.peer)

    def _one_by_one(self) -> list[Taken]:
        out: list[Taken] = []
        while len(out) < MOST and (got := self._wire.receive()) is not None:
            out.append((got[0] or b"", got[1], got[2]))
        return out

    def _address_of(self, name: bytes) -> Address:
        if len(self._known) >= _KNOWN:
            self._known.clear()
        _, port, host = _NAME.unpack(name.ljust(_NAME.size, b"\0"))
        address = self._known[name] = socket.inet_ntoa(host), socket.ntohs(port)
        return address

    def _send_many(self, datagrams: Sequence[bytes], peer: Address) -> None:
        box = self._out
        if peer != self._peer:
            name = _NAME.pack(socket.AF_INET, socket.htons(peer[1]), socket.inet_aton(peer[0]))
            box.names[:] = name * MOST
            for i in range(MOST):  # nothing but data goes out
                _HEADER.pack_into(box.headers, i * _HEADER.size, *_HEADER.unpack_from(box.fresh, i * _HEADER.size)[:4],
                                  0, 0, 0, 0)
            self._peer = peer
        for i, data in enumerate(datagrams):
            start, size = i * LONGEST, len(data)
            box.data[start : start + size] = data
            box.sizes[2 * i + 1] = size
        done, count = 0, len(datagrams)
        while done < count:
            got = self._sendmmsg(self._fd, box.at + done * _HEADER.size, count - done, 0)
            if got <= 0:
                self._wire.unsent += 1
                got = 1
            done += got
