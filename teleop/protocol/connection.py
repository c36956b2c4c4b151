"""Connection of an end to its peer's address: `(datagram, address)` pairs and `now` in; pairs and events out. Sans-IO.

The form is that of aioquic's `QuicConnection`. In the open the peer is known by its address: while a session lasts, a
datagram from elsewhere is counted as `address` and dropped, unless it may begin another session. A peer that has moved
notices that nothing of it arrives, for the echoes that it gets stand still. A sealed link knows its peer by keys, and
the address follows from that.
"""

from __future__ import annotations

from teleop.protocol.endpoint import Endpoint
from teleop.protocol.guard import Event
from teleop.protocol.packet import Kind, peek
from teleop.protocol.session import SessionBegun

Address = tuple[str, int]


class Connection:
    """An `endpoint` and the address of its `peer`, None before there is one.

    `configured`: the address typed for the peer; None: whichever master comes. `sealed`: datagrams come opened.
    """

    def __init__(self, endpoint: Endpoint, configured: Address | None, *, sealed: bool = False) -> None:
        self.endpoint = endpoint
        self.configured = configured
        self.peer = configured
        self._sealed = sealed

    def receive(self, data: bytes, address: Address, now: int) -> list[tuple[bytes, Address]]:
        """Take a datagram that came at `now`; what is to be sent back at once, and where to."""
        endpoint, session = self.endpoint, self.endpoint.session
        if address != self.peer and self._from_unknown_address(data):
            endpoint.rejected["address"] += 1
            return []
        met = session.met
        replies = endpoint.receive(data, now)
        if session.met != met or (replies and not met):
            self.peer = address  # a copy of a packet that another host sent must not draw ours to it
        if not replies:
            return []
        to = address if self.peer is None or peek(data)[0] is Kind.HELLO else self.peer
        return [(reply, to) for reply in replies]

    def due(self, now: int) -> list[tuple[bytes, Address]]:
        """Datagrams to send again, since nothing answered them. A HELLO goes to the configured address."""
        session = self.endpoint.session
        datagrams = session.due(now)
        if session.meeting and self.configured is not None:
            self.peer = self.configured
        return self._to_peer(datagrams) if datagrams else []

    def bye(self, reason: str | None, now: int) -> list[tuple[bytes, Address]]:
        """The farewell to send when this end leaves, None: at its end."""
        return self._to_peer(self.endpoint.session.bye(reason, now))

    def events(self) -> list[Event | SessionBegun]:
        """Events since the last call: the guard's, and the sessions that have begun."""
        guard, session = self.endpoint.guard, self.endpoint.session
        if not guard.new_events and not session.new_events:  # nearly always
            return []
        return [*guard.take_events(), *session.take_events()]

    def _to_peer(self, datagrams: list[bytes]) -> list[tuple[bytes, Address]]:
        return [] if self.peer is None else [(data, self.peer) for data in datagrams]

    def _from_unknown_address(self, data: bytes) -> bool:
        """True if the datagram is neither from the peer nor able to start a session."""
        session = self.endpoint.session
        if self._sealed or not session.met or session.meeting:
            return False
        return session.master or peek(data)[0] not in (Kind.HELLO, Kind.START)
