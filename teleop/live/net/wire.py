"""UDP as the live loops use it: addresses as people type them, and a socket that never blocks and never raises."""

from __future__ import annotations

import errno
import socket
import sys
import time
from contextlib import suppress
from struct import Struct
from typing import TYPE_CHECKING

from teleop.errors import Refused
from teleop.live.net.filter import Shape, attach, detach, program
from teleop.protocol.secure.dtls_record import RelayCookie

if TYPE_CHECKING:
    from teleop.protocol.secure.secure_link import Out, SecureLink

Address = tuple[str, int]


def address(text: str, option: str) -> Address:
    """`HOST:PORT` (or `:PORT`, meaning loopback) resolved to an IPv4 address and a port. Raises `Refused`."""
    host, colon, port = text.rpartition(":")
    if not colon or not port.isdecimal() or int(port) > 65535:
        raise Refused(f"{option} takes HOST:PORT, not {text!r}; write for example {option} 127.0.0.1:9001")
    try:
        found = socket.getaddrinfo(host or "127.0.0.1", int(port), socket.AF_INET, socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:  # a name that cannot even be asked for is no OSError
        why = getattr(error, "strerror", None) or "it is no host's name"
        raise Refused(f"{option} names the host {host!r}, which is not known here ({why}); try its number") from error
    return str(found[0][4][0]), int(found[0][4][1])


def peer_address(text: str) -> Address:
    """The address of --peer, which has to be one that can be sent to. Raises `Refused`."""
    found = address(text, "--peer")
    if found[1] == 0:
        raise Refused("--peer needs the port that the other side listens on, not 0; for example --peer 127.0.0.1:9001")
    return found


def bound(at: Address, option: str) -> socket.socket:
    """A UDP socket bound to an address; port 0 takes any free one. Raises `Refused`."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind(at)
    except OSError as error:
        sock.close()
        raise Refused(
            f"cannot listen on {at[0]}:{at[1]} ({error.strerror}); another program has that port, or the address is "
            f"not this machine's: give another with {option}, for example {option} {at[0]}:0 for any free one"
        ) from error
    return sock


def towards(peer: Address) -> socket.socket:
    """A UDP socket, on any free port, from which this peer can be reached."""
    return bound(("127.0.0.1" if peer[0].startswith("127.") else "0.0.0.0", 0), "--peer")


def shown(at: tuple[str, int]) -> str:
    """An address as it is typed."""
    return f"{at[0]}:{at[1]}"


# Read at ticks alone, a socket wakes no process in between, which saves a third of the processor time.
DRAIN = 16  # datagrams taken at one tick or wake-up whatever they cost
LONGEST = 8240  # bytes: more than any packet has, sealed or not, so that a longer datagram shows as such
STAMP = 35  # SO_TIMESTAMPNS of Linux, which Python does not name: the kernel says when a datagram came
MEMINFO, DROPS = 55, 8  # SO_MEMINFO of Linux, and the place of the count of datagrams dropped in it
OLDEST_NS = 10_000_000_000  # a stamp that is older, or from the future, tells of a wall clock that was set
APART_NS = 200_000  # between two readings of clocks: the process did not run meanwhile
SKEW_NS = 5_000_000  # between what two clocks say, and for what comes while it is looked
ROOM = 1 << 20  # bytes of receive buffer to ask for; the usual default holds 256 packets
MTU_DISCOVER, WHEREVER = 10, 0  # IP_MTU_DISCOVER and IP_PMTUDISC_DONT of Linux: routers may cut what is too long
# What a connected socket says whose own address is not this machine's any more, or whose network is down.
NO_WAY = frozenset((errno.EINVAL, errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN, errno.EADDRNOTAVAIL))
_TIMESPEC = Struct("@ll")


def arrival(stamp: int, now: int, wall: int, emptied_ns: int) -> int:
    """When a datagram came (monotonic clock, ns) that the kernel stamped at `stamp`; `now` if that cannot be.

    `now` and `wall` are the monotonic and the wall clock as it was read; at `emptied_ns` there was nothing to read.
    """
    age = wall - stamp
    # What was not there when it was empty cannot have come before: the wall clock was set in between.
    believed = 0 <= age < OLDEST_NS and age < now - emptied_ns + SKEW_NS
    return now - age if believed else now


def clocks() -> tuple[int, int]:
    """The monotonic and the wall clock at one moment, ns; read anew where the process stood still between the two."""
    for _ in range(3):
        now, wall = time.monotonic_ns(), time.time_ns()
        if time.monotonic_ns() - now < APART_NS:
            break
    return now, wall


class Wire:
    """A non-blocking UDP socket with one peer. Nothing that happens on it raises into the loop.

    With a `secure_link` all that is sent is sealed, and only what its peer has sealed comes out.
    """

    def __init__(self, sock: socket.socket, peer: Address | None, secure_link: SecureLink | None = None) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, ROOM)
        with suppress(OSError):  # elsewhere than on Linux a datagram comes when it is read
            sock.setsockopt(socket.SOL_SOCKET, STAMP, 1)
            sock.setsockopt(socket.IPPROTO_IP, MTU_DISCOVER, WHEREVER)
        self.sock, self.peer, self.secure_link = sock, peer, secure_link
        calls = secure_link is not None and peer is not None
        self._cookie = RelayCookie() if calls else None  # of a relay on the way, if any
        self._bound: Address | None = None  # its own address and port before it was kept to the peer
        self.kept = False  # is it deaf to everybody but the peer
        self._filtered = False
        self._lost_way = False  # it was kept to the peer, and is not while the system has no way there
        self.unsent = 0  # datagrams that the system did not take
        self._emptied_ns = time.monotonic_ns()  # when there was nothing to receive

    def keep_to_peer(self, shapes: tuple[Shape, ...] = ()) -> None:
        """Take in nothing from elsewhere, nor what has none of these shapes: the system itself drops it.

        So a flood costs no tick. The socket is connected, which for UDP says no more than that; and it has a filter.
        """
        if self.peer is not None:
            if shapes:
                self._filtered = attach(self.sock, program(*shapes))
            with suppress(OSError):
                if not self.kept:
                    self._bound = self.sock.getsockname()
                self.sock.connect(self.peer)
                self.kept, self._lost_way = True, False

    def listen_to_all(self) -> None:
        """Take in what comes from anywhere again, for a peer that may come back from another port."""
        if self._filtered:
            self._filtered = not detach(self.sock)
        self._lost_way = False
        self._let_loose()

    def _let_loose(self) -> None:
        """The socket has no peer of its own any more, nor an address that it took to reach it; the filter stays."""
        if self.kept:
            import ctypes

            # Python has no word for it: connected to an address of no family, a socket is connected no more.
            ctypes.CDLL(None).connect(self.sock.fileno(), bytes(16), 16)
            self.kept = False
            with suppress(OSError):  # and a port that the system chose is given back with it
                if self._bound is not None and self.sock.getsockname() != self._bound:
                    self.sock.bind(self._bound)

    def send(self, data: bytes) -> None:
        """To the peer, if there is one yet. What the system does not take now is lost, as on any network."""
        if self.secure_link is not None:
            sealed, self.peer = self.secure_link.send(data), self.secure_link.address
            if sealed is None:
                return  # there is no association yet: whatever matters is said again
            data = sealed
        if self.peer is None:
            return
        try:
            if self.kept:
                self.sock.send(data)
            else:
                self.sock.sendto(data, self.peer)
                if self._lost_way:
                    self.keep_to_peer()
        except OSError as error:
            self.unsent += 1
            if self.kept and error.errno in NO_WAY:  # as when this machine's own address has changed
                self._let_loose()
                self._lost_way = True

    def answer(self, data: bytes, address: Address) -> None:
        """Send to the sender of a datagram: the peer, or a host that may become it. Sealed, to the peer alone."""
        if self.secure_link is not None or address == self.peer:
            self.send(data)
            return
        try:
            self.sock.sendto(data, address)
        except OSError:
            self.unsent += 1

    @property
    def dropped(self) -> int | None:
        """How many datagrams the system did not hand over: not ours, or no room; None if it does not tell."""
        try:
            counters = self.sock.getsockopt(socket.SOL_SOCKET, MEMINFO, 4 * (DROPS + 1))
        except OSError:
            return None
        return int.from_bytes(counters[4 * DROPS :], sys.byteorder) if len(counters) == 4 * (DROPS + 1) else None

    def due(self, now: int) -> None:
        """Send what the secure link has due: handshakes, and what was not answered of them."""
        if self.secure_link is not None:
            self._say(self.secure_link.due(now))

    def end(self) -> None:
        """Send the alert that ends the association, if there is one."""
        if self.secure_link is not None:
            self._say(self.secure_link.close())

    def go_with(self, peer: Address | None) -> None:
        """Send to `peer` from now on; sealed, to where the peer's newest authenticated packet came from."""
        if self.secure_link is None:
            self.peer = peer
        elif self.secure_link.address is not None and self.peer != self.secure_link.address:
            self.peer = self.secure_link.address
            if self.kept:
                self.keep_to_peer()  # the filter stays

    def _say(self, out: list[Out]) -> None:
        for data, address in out:
            with suppress(OSError):
                self.sock.sendto(data if self._cookie is None else self._cookie.stamp(data), address)

    def receive(self) -> tuple[bytes | None, Address, int] | None:
        """A datagram, where it came from and when (monotonic clock, ns), or None if there is none now.

        There are no bytes of a datagram of the secure link itself, or of one that fails its authentication.

        Reading late does not make it late: the time is the kernel's, where it tells.
        """
        while True:
            try:
                data, notes, _, address = self.sock.recvmsg(LONGEST, 64)
                break
            except ConnectionRefusedError:  # the peer's port is not open; said once for what was sent there
                continue
            except OSError:  # nothing there
                self._emptied_ns = time.monotonic_ns()
                return None
        now, wall = clocks()
        for level, kind, note in notes:
            if level == socket.SOL_SOCKET and kind == STAMP and len(note) == _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack(note)
                now = arrival(seconds * 1_000_000_000 + nanoseconds, now, wall, self._emptied_ns)
        at: Address = address[:2]
        if self.secure_link is None:
            return data, at, now
        if self._cookie is not None and (again := self._cookie.take(data)) is not None:
            with suppress(OSError):
                if again:
                    self.sock.sendto(again, at)
            return None, at, now
        plain, out = self.secure_link.receive(data, at, now)
        self._say(out)
        return plain[0] if plain else None, at, now
