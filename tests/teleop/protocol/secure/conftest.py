"""Keys for the tests, made once, and two ends that meet over the water of `channel` in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import pytest

from channel.link import parse_link
from channel.schedule import Stream
from teleop.protocol.secure.association import Association
from teleop.protocol.secure.gate import Gate, is_for_gate
from teleop.protocol.secure.keys import Key, keygen, load_key

MS = 1_000_000
AT = ("192.0.2.1", 4000)
SECRET = bytes(range(32))
BAD_WATER = "delay(0.02) | uniform(0.06) | bernoulli(0.3) | duplicate(0.2, after=0.02)"


class Met(NamedTuple):
    """What a meeting came to."""

    took: int  # ms
    master: Association
    slave: Association | None
    gate: Gate


class Meeting(NamedTuple):
    """How to let two ends meet: `Meeting(...)()`."""

    mine: Key
    theirs: Key
    master_expects: str
    slave_expects: str
    link: str
    seed: int

    def __call__(self) -> Met:
        master, slave = Association.towards(self.mine, self.master_expects, 0), None
        gate = Gate(self.theirs, self.slave_expects, SECRET)
        forth, back = (Stream(parse_link(self.link), way, self.seed, 1200) for way in (0, 1))

        def go(stream: Stream, datagrams: list[bytes], now: int) -> None:
            for data in datagrams:
                stream.send(stream.sent, now, data)

        go(forth, master.begin(0), 0)
        took = 0
        while took < 20_000 and master.failure is None and not (master.ready and slave is not None):
            now = took * MS
            go(forth, master.due(now), now)
            go(back, slave.due(now) if slave else [], now)
            for came in forth.deliver(now):
                if is_for_gate(came.load):
                    let_in, replies = gate.receive(came.load, AT, now)
                    slave = let_in or slave
                    go(back, replies, now)
            for came in back.deliver(now):
                go(forth, master.receive(came.load, now)[1], now)
            took += 1
        return Met(took, master, slave, gate)


class Pair(NamedTuple):
    """Two ends that have met."""

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
        return Meeting(mine, theirs, master_expects, slave_expects, link, seed)()

    return meeting


@pytest.fixture(scope="session")
def associated(meet: Callable[..., Met]) -> Callable[[], Pair]:
    """`associated()`: two ends that have met, anew at every call."""

    def pair() -> Pair:
        met = meet()
        assert met.slave is not None
        return Pair(met.master, met.slave)

    return pair
