"""Whom a live end listens to: its peer alone while a session lasts, anybody after a silence."""

from __future__ import annotations

import time

from teleop.live.net.address import Address
from teleop.live.net.filter import of_next, of_records, of_session
from teleop.live.net.wire import Wire
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.liveness import RENEW_NS
from teleop.protocol.packet import Kind, peek

OPEN_NS = RENEW_NS  # of silence, after which a peer is listened for from anywhere


class Hearing:
    """What comes in over `wire` for `endpoint`, and what the system may drop of it."""

    def __init__(self, endpoint: Endpoint, wire: Wire) -> None:
        self.endpoint, self.wire = endpoint, wire
        self.open = False  # to everybody, for the peer was silent
        self._heard_ns = 0  # when the last message came

    def begin(self) -> None:
        """Two ends have met: from now on there is nobody but the peer."""
        self._keep_to_peer()
        self._heard_ns = time.monotonic_ns()

    def heard(self) -> tuple[int, int]:
        """Grows with every new message and session; a copy of an old one proves nothing."""
        return self.endpoint.way.count, self.endpoint.session.met

    def listen(self, now: int, before: tuple[int, int]) -> None:
        """After a silence listen to everybody: the peer, or the channel, may come back from another port.

        `before`: what `heard` was when the socket was last read.
        """
        heard = self.heard()
        if heard != before:
            self._heard_ns = now
            if self.open or heard[1] != before[1]:
                self._keep_to_peer()
        elif not self.open and (now - self._heard_ns > OPEN_NS or not self.endpoint.session.carries_data):
            self.open = True
            self.wire.listen_to_all()

    def is_strange(self, data: bytes, address: Address) -> bool:
        """Is this from somebody else than the peer of the session, which in the open is fixed, and of no use to it?

        From elsewhere comes only what may begin another session. If it was the peer, it notices that nothing of it
        arrives: the echoes that it gets stand still.
        """
        session = self.endpoint.session
        if address == self.wire.peer or self.wire.line is not None or not session.met or session.meeting:
            return False
        if not session.master and peek(data)[0] in (Kind.HELLO, Kind.START):
            return False
        self.endpoint.rejected["address"] += 1
        return True

    def _keep_to_peer(self) -> None:
        endpoint, number, line = self.endpoint, self.endpoint.session.number, self.wire.line
        self.open = line is not None and not line.settled
        if self.open:
            self.wire.listen_to_all()  # the answer may come from the address that is in question
        elif line is not None:
            self.wire.keep_to_peer(of_records())
        elif number is not None:
            shapes = of_session(number, endpoint.scene.wire_size, endpoint.hears)
            self.wire.keep_to_peer(shapes if endpoint.session.master else shapes + of_next(number))
