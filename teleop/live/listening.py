"""Which hosts a live end listens to: its peer alone while a session lasts, any host after a silence."""

from __future__ import annotations

from teleop.live.net.filter import of_next, of_records, of_session
from teleop.live.net.wire import Wire
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.liveness import RENEW_NS

OPEN_NS = RENEW_NS  # of silence, after which a peer is listened for from anywhere
SEALED_OPEN_NS = 100_000_000  # the same with keys: the peer may have moved, and the session goes on if it is found


class Listening:
    """What the system lets through to `wire`, and so to `endpoint`. Times are ns of the monotonic clock."""

    def __init__(self, endpoint: Endpoint, wire: Wire) -> None:
        self.endpoint, self.wire = endpoint, wire
        self.to_all = False  # for the peer was silent
        self._since_ns = 0  # when it changed
        self._open_ns = OPEN_NS if wire.secure_link is None else SEALED_OPEN_NS

    def go_on(self, endpoint: Endpoint) -> None:
        """Listen for another endpoint of the same session."""
        self.endpoint = endpoint

    def update(self, now: int, begun: bool) -> None:
        """After a silence listen to all: the peer, or the channel, may come back from another port.

        `begun`: a session has begun since this was called last.
        """
        heard_ns, session = self.endpoint.heard_ns, self.endpoint.session
        if now - heard_ns <= self._open_ns and session.carries_data and not (begun or self.to_all):
            return  # nearly always
        if begun or (self.to_all and heard_ns > self._since_ns):
            self._since_ns = now
            self._keep_to_peer()
        elif not self.to_all and (now - max(heard_ns, self._since_ns) > self._open_ns or not session.carries_data):
            self._since_ns = now
            self.to_all = True
            self.wire.listen_to_all()

    def _keep_to_peer(self) -> None:
        endpoint, number, secure_link = self.endpoint, self.endpoint.session.number, self.wire.secure_link
        self.to_all = secure_link is not None and not secure_link.settled
        if self.to_all:
            self.wire.listen_to_all()  # the answer may come from the address that is in question
        elif secure_link is not None:
            self.wire.keep_to_peer(of_records())
        elif number is not None:
            shapes = of_session(number, endpoint.scene.wire_size, endpoint.hears)
            self.wire.keep_to_peer(shapes if endpoint.session.master else shapes + of_next(number))
