"""UDP as the live loops use it: addresses as people type them, and a socket that never blocks and never raises."""

from __future__ import annotations

import errno
import select
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
    """Resolve `HOST:PORT` (or `:PORT`, meaning loopback) to an IPv4 address and a port. Raises `Refused`."""
    host, colon, port = text.rpartition(":")
    if not colon or not port.isdecimal() or int(port) > 65535:
        raise Refused(f"{option} takes HOST:PORT, not {text!r}; write for example {option} 127.0.0.1:9001")
    try:
        known = socket.getaddrinfo(host or "127.0.0.1", int(port), socket.AF_INET, socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:  # a name that cannot even be asked for is no OSError
        why = getattr(error, "strerror", None) or "it is no host's name"
        raise Refused(f"{option} names the host {host!r}, which is not known here ({why}); try its number") from error
    return str(known[0][4][0]), int(known[0][4][1])


def peer_address(text: str) -> Address:
    """Resolve the address of --peer, to which it must be possible to send. Raises `Refused`."""
    peer = address(text, "--peer")
    if peer[1] == 0:
        raise Refused("--peer needs the port that the other side listens on, not 0; for example --peer 127.0.0.1:9001")
    return peer


def bind_udp(at: Address, option: str) -> socket.socket:
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


def bind_towards(peer: Address) -> socket.socket:
    """A UDP socket, on any free port, from which this peer can be reached."""
    return bind_udp(("127.0.0.1" if peer[0].startswith("127.") else "0.0.0.0", 0), "--peer")


def host_port(at: tuple[str, int]) -> str:
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
MTU_DISCOVER, NEVER_PROBE = 10, 0  # IP_MTU_DISCOVER and IP_PMTUDISC_DONT of Linux: routers may cut what is too long
# What a connected socket says whose own address is not this machine's any more, or whose network is down.
NO_ROUTE = frozenset((errno.EINVAL, errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN, errno.EADDRNOTAVAIL))
CLOSED = frozenset((errno.EBADF, errno.ENOTSOCK))  # by others: nothing will ever come on it again
_TIMESPEC, _SOCKET = Struct("@ll"), int(socket.SOL_SOCKET)


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
    """A non-blocking UDP socket with one peer. Nothing raises into the loop but that others have closed it.

    With a `secure_link` every datagram sent is sealed, and only those that its peer has sealed come out.
    """

    def __init__(self, sock: socket.socket, peer: Address | None, secure_link: SecureLink | None = None) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, ROOM)
        with suppress(OSError):  # elsewhere than on Linux a datagram comes when it is read
            sock.setsockopt(socket.SOL_SOCKET, STAMP, 1)
            sock.setsockopt(socket.IPPROTO_IP, MTU_DISCOVER, NEVER_PROBE)
        self.sock, self.peer, self.secure_link = sock, peer, secure_link
        calls = secure_link is not None and peer is not None
        self._cookie = RelayCookie() if calls else None  # of a relay on the way, if any
        self._local: Address | None = None  # its own address and port before it was connected to the peer
        self.connected = False  # the system drops the datagrams of all but the peer
        self._filtered = False
        self._no_route = False  # it was connected to the peer, and is not while the system has no route there
        self.unsent = 0  # datagrams that the system did not take
        self._emptied_ns = time.monotonic_ns()  # when there was nothing to receive
        self._took = False  # a datagram, at the last look
        self._poll = select.poll()
        self._poll.register(sock, select.POLLIN)

    def keep_to_peer(self, shapes: tuple[Shape, ...] = ()) -> None:
        """Have the system drop datagrams from elsewhere, and those that have none of these shapes.

        So a flood costs no tick. The socket is connected, which for UDP means no more than that; and it has a filter.
        """
        if self.peer is not None:
            if shapes:
                self._filtered = attach(self.sock, program(*shapes))
            with suppress(OSError):
                if not self.connected:
                    self._local = self.sock.getsockname()
                self.sock.connect(self.peer)
                self.connected, self._no_route = True, False

    def listen_to_all(self) -> None:
        """Accept datagrams from anywhere again, for a peer that may come back from another port."""
        if self._filtered:
            self._filtered = not detach(self.sock)
        self._no_route = False
        self._disconnect()

    def _disconnect(self) -> None:
        """Disconnect the socket from its peer, and from the address that it took to reach it; the filter stays."""
        if self.connected:
            import ctypes

            # Python has no call for it: connecting to an address of no family disconnects a socket.
            ctypes.CDLL(None).connect(self.sock.fileno(), bytes(16), 16)
            self.connected = False
            with suppress(OSError):  # and a port that the system chose is given back with it
                if self._local is not None and self.sock.getsockname() != self._local:
                    self.sock.bind(self._local)

    def wait(self, seconds: float) -> None:
        """Wait until a datagram is there, for so long at most."""
        if any(not event & select.POLLIN for _, event in self._poll.poll(seconds * 1e3)):
            time.sleep(seconds)  # it has an error, which is no reason to ask again at once

    def send(self, data: bytes) -> None:
        """Send to the peer, if there is one yet. A datagram that the system refuses now is lost, as on any network."""
        if self.secure_link is not None:
            sealed, self.peer = self.secure_link.send(data), self.secure_link.address
            if sealed is None:
                return  # there is no association yet: whatever matters is said again
            data = sealed
        if self.peer is None:
            return
        try:
            if self.connected:
                self.sock.send(data)
            else:
                self.sock.sendto(data, self.peer)
                if self._no_route:
                    self.keep_to_peer()
        except OSError as error:
            self.unsent += 1
            if self.connected and error.errno in NO_ROUTE:  # as when this machine's own address has changed
                self._disconnect()
                self._no_route = True

    def answer(self, data: bytes, address: Address) -> None:
        """Send to the sender of a datagram: the peer, or a host that may become it; sealed, to the peer alone."""
        if self.secure_link is not None or address == self.peer:
            self.send(data)
            return
        try:
            self.sock.sendto(data, address)
        except OSError:
            self.unsent += 1

    @property
    def dropped(self) -> int | None:
        """Number of datagrams that the system dropped: foreign ones, or without room; None if it does not tell."""
        try:
            counters = self.sock.getsockopt(socket.SOL_SOCKET, MEMINFO, 4 * (DROPS + 1))
        except OSError:
            return None
        return int.from_bytes(counters[4 * DROPS :], sys.byteorder) if len(counters) == 4 * (DROPS + 1) else None

    def due(self, now: int) -> None:
        """Send the datagrams that the secure link has due: handshakes, and those without an answer again."""
        if self.secure_link is not None:
            self._send_each(self.secure_link.due(now))

    def end(self) -> None:
        """Send the alert that ends the association, if there is one."""
        if self.secure_link is not None:
            self._send_each(self.secure_link.close())

    def go_with(self, peer: Address | None) -> None:
        """Send to `peer` from now on; sealed, to where the peer's newest authenticated packet came from."""
        if self.secure_link is None:
            self.peer = peer
        elif self.secure_link.address is not None and self.peer != self.secure_link.address:
            self.peer = self.secure_link.address
            if self.connected:
                self.keep_to_peer()  # the filter stays

    def _send_each(self, out: list[Out]) -> None:
        for data, address in out:
            with suppress(OSError):
                self.sock.sendto(data if self._cookie is None else self._cookie.stamp(data), address)

    def receive(self) -> tuple[bytes | None, Address, int] | None:
        """Read a datagram: bytes, sender and time of arrival (monotonic clock, ns); None if there is none now.

        The bytes are None for a datagram of the secure link itself, or one that fails its authentication. Reading late
        does not make it late: the time is the kernel's, where it tells.
        """
        if self._took and not self._poll.poll(0):  # nothing more, at a sixth of what the exception costs
            self._took = False
            self._emptied_ns = time.monotonic_ns()
            return None
        while True:
            try:
                data, notes, _, address = self.sock.recvmsg(LONGEST, 64)
                break
            except BlockingIOError:  # nothing there
                self._took = False
                self._emptied_ns = time.monotonic_ns()
                return None
            except ConnectionRefusedError:  # the peer's port is not open; said once for what was sent there
                continue
            except OSError as error:
                if error.errno in CLOSED:
                    raise
                return None
        self._took = True
        now, wall = clocks()
        for level, kind, note in notes:
            if kind == STAMP and level == _SOCKET and len(note) == _TIMESPEC.size:
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
        self._send_each(out)
        return plain[0] if plain else None, at, now
