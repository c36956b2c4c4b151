"""Keys for the tests, made once, and two ends that meet over a lossy link of `channel` in virtual time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest

from channel.link import parse_link
from channel.schedule import Stream
from teleop.protocol.secure.association import Association
from teleop.protocol.secure.gate import Gate, is_for_gate
from teleop.protocol.secure.keys import Key, keygen, load_key
from teleop.protocol.secure.secure_link import SecureLink

MS = 1_000_000
AT = ("192.0.2.1", 4000)
HOME, AWAY, SLAVE = AT, ("198.51.100.7", 5000), ("192.0.2.2", 9001)
FORTH, BACK = ("203.0.113.5", 6001), ("203.0.113.5", 6002)  # where an observer's copies come from, at slave and master
SECRET = bytes(range(32))
LOSSY = "delay(0.02) | uniform(0.06) | bernoulli(0.3) | duplicate(0.2, after=0.02)"
STEP = 4  # ms between two packets of an end


class Met(NamedTuple):
    took: int  # ms
    master: Association
    slave: Association | None
    gate: Gate


class Pair(NamedTuple):
    master: Association
    slave: Association


@pytest.fixture(scope="session")
def keys(tmp_path_factory: pytest.TempPathFactory) -> list[Key]:
    """Three keys: the master's, the slave's, a stranger's."""
    folder = tmp_path_factory.mktemp("keys")
    return [load_key(keygen(folder / name)[0]) for name in ("master", "slave", "stranger")]


@pytest.fixture(scope="session")
def meet(keys: list[Key]) -> Callable[..., Met]:
    """`meet(link, seed, ...)`: master and slave, unless other keys or expectations are given."""

    def meeting(
        link: str = "delay(0.01)", seed: int = 0, *, mine: Key = keys[0], theirs: Key = keys[1],
        master_expects: str = keys[1].fingerprint, slave_expects: str = keys[0].fingerprint,
    ) -> Met:
        master, slave = Association.towards(mine, master_expects, 0), None
        gate = Gate(theirs, slave_expects, SECRET)
        forth, back = (Stream(parse_link(link), way, seed, 1200) for way in (0, 1))

        def go(stream: Stream, datagrams: list[bytes], now: int) -> None:
            for data in datagrams:
                stream.send(stream.sent, now, data)

        go(forth, master.begin(0), 0)
        took = 0
        while took < 20_000 and master.failure is None and not (master.ready and slave is not None):
            now = took * MS
            go(forth, master.due(now), now)
            go(back, slave.due(now) if slave else [], now)
            for arrived in forth.deliver(now):
                if is_for_gate(arrived.load):
                    let_in, replies = gate.receive(arrived.load, AT, now)
                    slave = let_in or slave
                    go(back, replies, now)
            for arrived in back.deliver(now):
                go(forth, master.receive(arrived.load, now)[1], now)
            took += 1
        return Met(took, master, slave, gate)

    return meeting


@pytest.fixture(scope="session")
def associated(meet: Callable[..., Met]) -> Callable[[], Pair]:

    def pair() -> Pair:
        met = meet()
        assert met.slave is not None
        return Pair(met.master, met.slave)

    return pair


class World:
    """A master and a slave that send the number of each step, and perhaps an observer on the way.

    `copies`: its copy of every datagram comes first, from an address of its own. `relays`: it passes on what is sent
    to its own addresses; else it keeps it.
    """

    def __init__(self, keys: list[Key], link: str, seed: int = 0, *, copies: bool = False) -> None:
        self.keys, self.now = keys, 0
        self.ways = [Stream(parse_link(link), way, seed, 100) for way in (0, 1)]
        self.copies, self.relays = copies, False
        self.from_, self.answers = HOME, SLAVE  # where what the master and the slave send comes from
        self.came: list[list[tuple[int, int]]] = [[], []]  # when in ms, and number, at master and slave
        self.sent: list[list[int]] = [[], []]  # numbers that were sent to master and slave
        self.to: list[Counter[Any]] = [Counter(), Counter()]  # datagrams by where they went, from master and slave
        self.passed: list[list[bytes]] = [[], []]  # by the observer, to slave and master
        self.start_master()
        self.start_slave()

    def start_master(self) -> None:
        self.master = SecureLink.calling(self.keys[0], self.keys[1].fingerprint, SLAVE)

    def start_slave(self) -> None:
        self.slave = SecureLink.listening(self.keys[1], self.keys[0].fingerprint, bytes(32))

    def restart(self, name: str, dead: int) -> int:
        """Kill an end and start it anew after so many ms; when that is, ms."""
        self.run(dead, dead=name)
        self.start_master() if name == "master" else self.start_slave()
        return self.now // MS

    def run(self, ms: int, *, dead: str = "") -> World:
        """Go on for a time; the end that is `dead` neither sends nor hears."""
        for _ in range(ms // STEP):
            for way, link, name in ((0, self.master, "master"), (1, self.slave, "slave")):
                if name != dead:
                    self.go(way, [*link.due(self.now), *self._packet(way, link)])
            for way, link, name in ((0, self.slave, "slave"), (1, self.master, "master")):
                copied, source = (BACK, self.answers) if way else (FORTH, self.from_)
                for arrived in self.ways[way].deliver(self.now):
                    for at in [copied] * self.copies + [source] if name != dead else []:
                        self._take(way, link, arrived.load, at)
                passed, self.passed[way] = self.passed[way], []
                for data in passed if name != dead else []:
                    self._take(way, link, data, copied)
            self.now += STEP * MS
        return self

    def _packet(self, way: int, link: SecureLink) -> list[Any]:
        number = self.now // MS
        data = link.send(number.to_bytes(4, "big") + bytes(96))
        self.sent[1 - way] += [] if data is None else [number]
        return [] if data is None else [(data, link.address)]

    def _take(self, way: int, link: SecureLink, data: bytes, source: Any) -> None:
        plain, back = link.receive(data, source, self.now)
        self.came[1 - way] += [(self.now // MS, int.from_bytes(one[:4], "big")) for one in plain]
        self.go(1 - way, back)

    def go(self, way: int, out: list[Any]) -> None:
        for data, at in out:
            self.to[way][at] += 1
            if at in ((self.from_,) if way else (SLAVE, self.answers)):
                self.ways[way].send(self.ways[way].sent, self.now, data)
            elif at == (FORTH if way else BACK) and self.relays:
                self.passed[way].append(data)  # faster than the link itself

    def next_at(self, end: int, since: int) -> int:
        """When something next came at an end, ms."""
        return next((when for when, _ in self.came[end] if when >= since), 10**9)

    def share(self, end: int, since: int, until: int) -> float:
        """Of what was sent to master (0) or slave (1) in this time, how much came."""
        sent = [number for number in self.sent[end] if since <= number < until]
        arrived = {number for _, number in self.came[end]}
        return sum(number in arrived for number in sent) / max(1, len(sent))


@pytest.fixture
def world(keys: list[Key]) -> Callable[..., World]:
    return lambda link="delay(0.02) | uniform(0.02)", seed=0, **other: World(keys, link, seed, **other)
