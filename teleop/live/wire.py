"""A UDP socket as the live loops use it: it never blocks and never raises into them."""

from __future__ import annotations

import socket

from teleop.live.address import Address

DRAIN = 16  # datagrams taken at one tick or wake-up: more would let a flood starve the tick
ROOM = 1 << 20  # bytes of receive buffer to ask for; the usual default holds 256 packets


class Wire:
    """A non-blocking UDP socket with one peer. Nothing that happens on it raises into the loop."""

    def __init__(self, sock: socket.socket, peer: Address | None) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, ROOM)
        self.sock, self.peer = sock, peer
        self.unsent = 0  # datagrams that the system did not take

    def send(self, data: bytes) -> None:
        """To the peer, if there is one yet. What the system does not take now is lost, as on any network."""
        if self.peer is None:
            return
        try:
            self.sock.sendto(data, self.peer)
        except OSError:
            self.unsent += 1

    def receive(self) -> tuple[bytes, Address] | None:
        """A datagram and where it came from, or None if there is none now."""
        try:
            data, address = self.sock.recvfrom(65536)
        except OSError:  # nothing there, or the peer's port is not open (yet)
            return None
        return data, address[:2]
