"""A pinned master that calls while others without its key keep a listening end busy, in virtual time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from random import Random

import pytest

from channel.link import parse_link
from channel.schedule import Stream
from teleop.protocol.secure.association import Association
from teleop.protocol.secure.context import Verifier
from teleop.protocol.secure.dtls_record import HEAD, MTU, DtlsRecord, records
from teleop.protocol.secure.gate import BURST, CHECK_NS, CHECKED_NS, Gate
from teleop.protocol.secure.keys import Key
from teleop.protocol.secure.secure_link import SecureLink
from tests.fakes import usually

MS, S = 1_000_000, 1_000_000_000
HOME, SLAVE = ("192.0.2.1", 4000), ("192.0.2.2", 9001)
RATE = 1000  # hostile datagrams a second
PORTS = 64
Where = tuple[str, int]


class Hostile:
    """An attacker without the key: it asks for cookies, brings them back, and has seen what the master once sent."""

    def __init__(self, keys: list[Key], addresses: list[Where], seen: bytes, seed: int) -> None:
        self.keys, self.addresses, self.seen, self.dice = keys, addresses, seen, Random(seed)
        self.hellos: deque[tuple[Where, bytes]] = deque(maxlen=2000)  # with good cookies, each at its address
        self.calls: dict[Where, Association] = {}

    def shot(self, slave: SecureLink, now: int) -> None:
        """One datagram to the slave, and what it answers."""
        kind = self.dice.randrange(5) if self.hellos else 0
        address, hello = self.dice.choice(self.hellos) if kind else (self.dice.choice(self.addresses), b"")
        data = {1: hello, 2: self._borrowed(hello), 3: self._forged(hello), 4: self._last(hello)}.get(kind)
        if data is None:
            call = self.calls[address] = Association.towards(self.keys[2], self.keys[1].fingerprint, now)
            (data,) = call.begin(now)
        for reply, at in slave.receive(data, address, now)[1]:
            for again in self.calls[at].receive(reply, now)[1] if at in self.calls else []:
                found = records(again)
                if found is not None and found[0].is_hello:
                    self.hellos.append((at, again))

    def _borrowed(self, hello: bytes) -> bytes:
        """With everything behind the hello that the master once sent."""
        return b"".join(one.data for one in _parts(hello)[:1] + _parts(self.seen)[1:]).ljust(MTU, b"\0")

    def _forged(self, hello: bytes) -> bytes:
        """The same, its last bytes others each time."""
        return self._borrowed(hello).rstrip(b"\0")[:-8] + self.dice.randbytes(8)

    def _last(self, hello: bytes) -> bytes:
        """A record in the clear that belongs into the middle of a handshake."""
        return HEAD.pack(22, 0xFEFD, 0, 0, self.dice.randrange(1 << 16), 40) + self.dice.randbytes(40)


def _parts(datagram: bytes) -> list[DtlsRecord]:
    return records(datagram) or []


def seen_once(keys: list[Key]) -> bytes:
    """The hello with its cookie by which the pinned master came in at another time."""
    master = Association.towards(keys[0], keys[1].fingerprint, 0)
    slave = SecureLink.listening(keys[1], keys[0].fingerprint, bytes(reversed(range(32))))
    ((cookie, _),) = slave.receive(master.begin(0)[0], HOME, 0)[1]
    return master.receive(cookie, 0)[1][0]


class Flooded:
    """A slave under fire from the beginning, and a master that calls it after a second."""

    def __init__(
        self, keys: list[Key], addresses: list[Where], seed: int, *, rate: int = RATE, link: str = "delay(0.05)",
        is_observed: bool = False,
    ) -> None:
        self.slave = SecureLink.listening(keys[1], keys[0].fingerprint, bytes(range(32)))
        self.hostile = Hostile(keys, addresses, seen_once(keys), seed)
        self.most_begun = 0
        master = SecureLink.calling(keys[0], keys[1].fingerprint, SLAVE)
        ways = [Stream(parse_link(link), way, seed, MTU) for way in (0, 1)]
        self.took: float | None = None  # from the master's first hello until both ends were ready, s
        for ms in range(8000):
            now = ms * MS + self.hostile.dice.randrange(MS)
            shots = [ms * MS + self.hostile.dice.randrange(MS) for _ in range(rate // 1000)]
            self._fire(at for at in shots if at <= now)
            if ms >= 1000:
                self._call(master, ways, now, is_observed=is_observed)
            self._fire(at for at in shots if at > now)
            self.most_begun = max(self.most_begun, len(self.gate._begun))
            if master.ready and self.slave.ready:
                self.took = (ms - 1000) / 1000
                break

    def _fire(self, shots: Iterable[int]) -> None:
        for at in sorted(shots):
            self.hostile.shot(self.slave, at)

    def _call(self, master: SecureLink, ways: list[Stream], now: int, *, is_observed: bool) -> None:
        """What goes to and fro between the two ends; `is_observed`: each of the master's datagrams comes twice."""
        for data, _ in master.due(now):
            ways[0].send(ways[0].sent, now, data)
        for came in ways[0].deliver(now):
            for data in [came.load, came.load] if is_observed else [came.load]:
                for reply, at in self.slave.receive(data, HOME, now)[1]:
                    if at == HOME:
                        ways[1].send(ways[1].sent, now, reply)
        for came in ways[1].deliver(now):
            for data, _ in master.receive(came.load, SLAVE, now)[1]:
                ways[0].send(ways[0].sent, now, data)

    @property
    def gate(self) -> Gate:
        gate = self.slave._gate
        assert gate is not None
        return gate


PORTS_OF_ONE = [("198.51.100.7", 10_000 + i) for i in range(PORTS)]
THOUSANDS = [(f"198.51.{i % 256}.{i % 199}", 1024 + i) for i in range(3000)]
THOUSANDS += [(HOME[0], HOME[1] + 1 + i) for i in range(3000)]  # and of the master's own host


@usually("kind, seed", [(kind, seed) for kind in ("one", "lossy", "thousands", "observed") for seed in range(8)],
         ("one", 0), ("lossy", 1), ("thousands", 2), ("observed", 3))
def test_a_sender_without_the_key_does_not_keep_the_pinned_master_out(keys: list[Key], kind: str, seed: int) -> None:
    """500 datagrams a second with cookies that were used before did: they filled every place for a handshake.

    Nor where the link loses datagrams besides, nor with thousands of addresses: what an end that listens remembers of
    them is bounded, and so is the time that it gives to their signatures. Nor by a copy of each of the master's own
    datagrams from the master's address: it does not use up the cookie.
    """
    flood = Flooded(keys, THOUSANDS if kind == "thousands" else PORTS_OF_ONE, seed, is_observed=kind == "observed",
                    link="delay(0.04) | uniform(0.02) | bernoulli(0.1)" if kind == "lossy" else "delay(0.05)",
                    rate=2 * RATE if kind == "thousands" else RATE)
    assert flood.took is not None
    assert flood.took < 3.0
    if kind != "lossy":
        assert flood.most_begun <= 1  # the master's own
    if kind == "thousands":
        assert len(flood.gate._checked) <= BURST + CHECKED_NS // CHECK_NS
        assert len(flood.gate._used) == 1


def test_signatures_that_are_looked_at_are_bounded_in_time(keys: list[Key], monkeypatch: pytest.MonkeyPatch) -> None:
    """Each costs 0.1 ms, whoever sent it: a tenth of the processor at most goes into them."""
    looked: list[int] = []
    look = Verifier.is_good
    monkeypatch.setattr(Verifier, "is_good", lambda self, *a: (looked.append(1), look(self, *a))[1])
    slave = SecureLink.listening(keys[1], keys[0].fingerprint, bytes(32))
    hostile = Hostile(keys, [(f"198.51.100.{i % 200}", 1024 + i) for i in range(300)], seen_once(keys), 1)
    while len({at for at, _ in hostile.hellos}) < 200:
        hostile.shot(slave, 0)
    looked.clear()
    for i in range(4000):
        at, hello = hostile.dice.choice(hostile.hellos)
        slave.receive(hostile._forged(hello), at, S + i * MS // 20)
    assert 0 < len(looked) <= BURST + S // 5 // CHECK_NS
