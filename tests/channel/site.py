"""A relay without its sockets, and the datagrams of ends as far as a relay looks at them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any

from channel.relay import Flow
from channel.router import Router
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Echo, Kind, Packet, encode
from teleop.protocol.secure.dtls_record import cookie_record, is_cookie_record, records
from teleop.scene.loading import load_scene
from tests.channel.no_wire import NoWire

MS = 1_000_000
MASTER, SLAVE = ("192.0.2.1", 4000), ("192.0.2.2", 9001)
UNKNOWN, OTHER_HOME = ("198.51.100.7", 5000), ("192.0.2.3", 9001)
SCENE = load_scene("canonical", link="none", duration=100)
INSIDE = count()
Where = tuple[str, int]


class Site:
    """A relay that has just been started, and what comes out of it towards each end."""

    def __init__(self, **how: Any) -> None:
        self.near, self.far, self.ports = NoWire(None), NoWire(SLAVE), list[NoWire]()
        wires: Any = self.near, self.far
        self.router = Router(how.pop("scene", SCENE), 0, *wires, port=self._port, close=self._close, secret=bytes(32),
                             **how)
        self.now = 10**12  # ns, of a clock that has been running
        self.out: tuple[list[tuple[Any, bytes]], list[tuple[Any, bytes]]] = ([], [])  # to the master, to the slave

    def _port(self, home: Where) -> Any:
        self.ports.append(NoWire(home))
        return self.ports[-1]

    def _close(self, wire: Any) -> None:
        wire.closed = True

    def takes(self, data: bytes, sender: Where, flow: Flow | None = None) -> bool:
        """Does it pass on what comes from there? What comes from 9001 comes from the slave's side.

        `flow`: through whose wire the slave answers; left out, what is sealed goes through the newest.
        """
        before, router = [len(self.out[way]) for way in (0, 1)], self.router
        if sender[1] == SLAVE[1]:
            newest = [one for one in router.flows if one.sealed] or [None]
            router.from_far(flow or (newest[-1] if data[:1] != b"B" else None), data, sender, self.now)
            way = 0
        else:
            router.from_near(data, sender, self.now)
            way = 1
        self.drain()
        return len(self.out[way]) > before[way]

    def drain(self) -> None:
        """Take what comes out by now."""
        for flow in self.router.flows:
            for way, load in flow.relay.due(0 if flow.origin is None else self.now - flow.origin):
                self.out[1 - way].append((flow.slave if way == 0 else flow.master, load))
        for way, wire in enumerate((self.near, self.far)):
            self.out[way].extend(wire.answers)
            wire.answers.clear()

    def session(self, number: int) -> Callable[..., bytes]:
        """Packets of a session, by kind."""
        def packet(kind: Kind, seq: int = 0) -> bytes:
            payload: Any = 0 if kind is Kind.START else manifest_of(SCENE)
            payload = (1.0,) if kind in (Kind.FORTH, Kind.BACK) else payload
            payload = "it is over" if kind in (Kind.BYE, Kind.REFUSE) else payload
            return encode(Packet(kind, number, seq, 0, Echo(0, 0), payload))
        return packet

    def meet(self, number: int, master: Where = MASTER, slave: Where = SLAVE) -> None:
        """The first exchange of a session."""
        packet = self.session(number)
        for kind, sender in ((Kind.HELLO, master), (Kind.WELCOME, slave), (Kind.START, master), (Kind.START, slave)):
            assert self.takes(packet(kind), sender), kind

    def run(self, number: int, ms: int = 10) -> None:
        """A session of the honest ends, from its HELLO on or further on."""
        packet = self.session(number)
        flow = self.router.flows.of(MASTER)
        if flow is None or not packet(Kind.BACK).startswith(flow.mark, 6) or not flow.mark:
            self.meet(number)
        for _ in range(ms):
            self.now += MS
            assert self.takes(packet(Kind.FORTH), MASTER)
            assert self.takes(packet(Kind.BACK), SLAVE)

    def asks(self, master: Where = MASTER, number: int = 3, random: bytes = bytes(32)) -> bytes:
        """A master shows its address to the relay; the hello with its cookie, which the relay passes on."""
        assert not self.takes(hello(number, random=random), master)
        to, reply = self.out[0][-1]
        assert to == master
        found = records(reply)
        assert found is not None
        assert is_cookie_record(found[0])
        assert found[0].number == number
        data = hello(number + 1, cookie=reply[-32:], random=random)
        assert self.takes(data, master)
        return data


def hello(number: int = 0, *, cookie: bytes = b"", random: bytes = bytes(32)) -> bytes:
    """A hello as far as a relay looks at it: head, version, random; and behind it the relay's cookie."""
    body = bytes((1,)) + bytes(11) + b"\xfe\xfd" + random + bytes(22)
    data = b"\x16\xfe\xff\0\0" + number.to_bytes(6, "big") + len(body).to_bytes(2, "big") + body
    return data + cookie_record((records(data) or [])[0], cookie) if cookie else data


def request(number: int) -> bytes:
    """What asks for a cookie, as far as a relay looks at it."""
    return b"\x16\xfe\xff\0\0" + number.to_bytes(6, "big") + b"\0\x20\x03" + bytes(31)


def sealed(number: int, kind: int = 23, size: int = 40) -> bytes:
    """A sealed record; of kind 22 and number 0, that a handshake is over. No two have the same bytes inside."""
    head = bytes((kind,)) + b"\xfe\xfd\0\1" + number.to_bytes(6, "big") + size.to_bytes(2, "big")
    return head + next(INSIDE).to_bytes(size, "big")
