"""A relay without its sockets, and the datagrams of ends as far as a relay looks at them."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import count
from typing import Any

from channel.relay import Flow
from channel.router import Router
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Echo, Kind, Packet, encode
from teleop.protocol.secure.dtls_record import cookie_record, is_cookie_record, records
from teleop.scene.loading import load_scene

MS = 1_000_000
MASTER, SLAVE = ("192.0.2.1", 4000), ("192.0.2.2", 9001)
UNKNOWN, OTHER_HOME = ("198.51.100.7", 5000), ("192.0.2.3", 9001)
SCENE = load_scene("canonical", link="none", duration=100)
MANIFEST = manifest_of(SCENE)
INSIDE = count()
SEED = 9
Where = tuple[str, int]


class NoWire:
    """A wire, its own socket too, that goes nowhere. `answers`: what was sent, and where to."""

    def __init__(self, peer: Where | None) -> None:
        self.peer, self.sock, self.closed = peer, self, False
        self.answers: list[tuple[Where, bytes]] = []

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        self.closed = True

    def answer(self, data: bytes, address: Where) -> None:
        self.answers.append((address, data))


@lru_cache(maxsize=256)
def packet_of(number: int, kind: Kind, seq: int) -> bytes:
    payload: Any = {Kind.START: 0, Kind.FORTH: (1.0,), Kind.BACK: (1.0,), Kind.BYE: "it is over",
                    Kind.REFUSE: "it is over"}.get(kind, MANIFEST)
    return encode(Packet(kind, number, seq, 0, Echo(0, 0), payload))


class Site:
    """A relay that has just been started, and what comes out of it towards each end."""

    def __init__(self, **how: Any) -> None:
        self.near, self.far, self.ports = NoWire(None), NoWire(SLAVE), list[NoWire]()
        wires: Any = self.near, self.far
        self.router = Router(SCENE, SEED, *wires, port=self._port, close=NoWire.close,  # no wires
                             secret=bytes(32),
                             **how)
        self.now = 10**12  # ns, of a clock that has been running
        self.out: tuple[list[tuple[Any, bytes]], list[tuple[Any, bytes]]] = ([], [])  # to the master, to the slave

    def _port(self, home: Where) -> Any:
        self.ports.append(NoWire(home))
        return self.ports[-1]

    def takes(self, data: bytes, sender: Where, flow: Flow | None = None) -> bool:
        """True if it passes on what comes from there. What comes from port 9001 comes from the slave's side.

        `flow`: through whose wire the slave answers; left out, what is sealed goes through the newest.
        """
        way, router = int(sender[1] != SLAVE[1]), self.router
        before = len(self.out[way])
        if way == 0:
            newest = [one for one in router.flows if one.sealed] or [None]
            router.from_far(flow or (newest[-1] if data[:1] != b"B" else None), data, sender, self.now)
        else:
            router.from_near(data, sender, self.now)
        for each in router.flows:
            for direction, load in each.relay.due(0 if each.origin is None else self.now - each.origin):
                self.out[1 - direction].append((each.slave if direction == 0 else each.master, load))
        for side, wire in enumerate((self.near, self.far)):
            self.out[side].extend(wire.answers)
            wire.answers.clear()
        return len(self.out[way]) > before

    def session(self, number: int) -> Callable[..., bytes]:
        """Packets of a session, by kind and number."""
        return lambda kind, seq=0: packet_of(number, kind, seq)

    def meet(self, number: int, master: Where = MASTER, slave: Where = SLAVE) -> None:
        for kind, sender in ((Kind.HELLO, master), (Kind.WELCOME, slave), (Kind.START, master), (Kind.START, slave)):
            assert self.takes(packet_of(number, kind, 0), sender), kind

    def run(self, number: int, ms: int = 10) -> None:
        """A session of the honest ends, from its HELLO on or further on."""
        forth, back = (packet_of(number, kind, 0) for kind in (Kind.FORTH, Kind.BACK))
        flow = self.router.flows.of(MASTER)
        if flow is None or not back.startswith(flow.mark, 6) or not flow.mark:
            self.meet(number)
        for _ in range(ms):
            self.now += MS
            assert self.takes(forth, MASTER)
            assert self.takes(back, SLAVE)

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
