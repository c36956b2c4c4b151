"""An observer whose copy of every datagram comes first, from an address of its own: who draws the answers, in virtual
time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest

from channel.link import parse_link
from channel.schedule import Stream
from teleop.protocol.secure.keys import Key
from teleop.protocol.secure.secure_link import SecureLink

MS = 1_000_000
HOME, AWAY, SLAVE = ("192.0.2.1", 4000), ("198.51.100.7", 5000), ("192.0.2.2", 9001)
FORTH, BACK = ("203.0.113.5", 6001), ("203.0.113.5", 6002)  # where the observer's copies come from, at slave and master
STEP = 2  # ms between two packets of an end
EARLY = 1 * MS  # so long before the datagram itself its copy comes


class Observed:
    """A master and a slave that send all the time, and an observer on the way.

    `copies`: does it send its copies. `relays`: does it pass on what is sent to its own addresses; else it keeps it.
    """

    def __init__(self, keys: list[Key], link: str, seed: int = 0) -> None:
        self.keys, self.now = keys, 0
        self.ways = [Stream(parse_link(link), way, seed, 130) for way in (0, 1)]
        self.copies, self.relays = True, False
        self.from_, self.dead = HOME, ""
        self.came: list[list[int]] = [[], []]  # when what was sent came, ms, at master and slave
        self.sent: list[list[int]] = [[], []]
        self.to: list[Counter[Any]] = [Counter(), Counter()]  # datagrams by where they went, from master and slave
        self.passed: list[list[bytes]] = [[], []]  # by the observer, to slave and master
        self.start_master()
        self.start_slave()

    def start_master(self) -> None:
        self.master = SecureLink.calling(self.keys[0], self.keys[1].fingerprint, SLAVE)

    def start_slave(self) -> None:
        self.slave = SecureLink.listening(self.keys[1], self.keys[0].fingerprint, bytes(32))

    def run(self, ms: int) -> None:
        for _ in range(ms // STEP):
            for way, link, name in ((0, self.master, "master"), (1, self.slave, "slave")):
                if name != self.dead:
                    self._go(way, link.due(self.now))
                    data = link.send((self.now // MS).to_bytes(4, "big") + bytes(96))
                    if data is not None:
                        self.sent[way].append(self.now // MS)
                        self._go(way, [(data, link.address)])
            for way, link, name in ((0, self.slave, "slave"), (1, self.master, "master")):
                at, theirs = (BACK, SLAVE) if way else (FORTH, self.from_)
                for arrived in self.ways[way].deliver(self.now):
                    if name != self.dead:
                        for source in [at] * self.copies + [theirs]:
                            self._take(way, link, arrived.load, source)
                passed, self.passed[way] = self.passed[way], []
                for data in passed if name != self.dead else []:
                    self._take(way, link, data, at)
            self.now += STEP * MS

    def _take(self, way: int, link: SecureLink, data: bytes, source: Any) -> None:
        plain, back = link.receive(data, source, self.now)
        self.came[1 - way] += [int.from_bytes(one[:4], "big") for one in plain]
        self._go(1 - way, back)

    def _go(self, way: int, out: list[Any]) -> None:
        for data, at in out:
            self.to[way][at] += 1
            if at == (self.from_ if way else SLAVE):
                self.ways[way].send(self.ways[way].sent, self.now, data)
            elif at == (FORTH if way else BACK) and self.relays:
                self.passed[way].append(data)  # faster than the link itself

    def share(self, end: int, since: int, until: int) -> float:
        """Of what was sent to master (0) or slave (1) in this time, how much came."""
        sent = [when for when in self.sent[1 - end] if since <= when < until]
        came = set(self.came[end])
        return sum(when in came for when in sent) / max(1, len(sent))


@pytest.fixture
def observed(keys: list[Key]) -> Callable[..., Observed]:
    return lambda link="delay(0.02) | uniform(0.02)", seed=0: Observed(keys, link, seed)


World = Callable[..., Observed]


@pytest.mark.parametrize("seed", range(5))
def test_an_observer_whose_copies_come_first_draws_nothing_to_itself_before_the_meeting(
    observed: World, seed: int
) -> None:
    """There was no session for as long as it copied."""
    two = observed(seed=seed)
    two.run(3000)
    assert two.master.associations == two.slave.associations == 1
    assert (two.master.address, two.slave.address) == (SLAVE, HOME)
    for end in (0, 1):
        assert two.share(end, 500, 2900) == 1.0


@pytest.mark.parametrize("seed", range(5))
def test_nor_during_a_run(observed: World, seed: int) -> None:
    two = observed("delay(0.02) | uniform(0.02) | bernoulli(0.1)", seed)
    two.copies = False
    two.run(1000)
    two.copies = True
    two.run(3000)
    assert two.master.associations == two.slave.associations == 1
    assert (two.master.address, two.slave.address) == (SLAVE, HOME)
    for end in (0, 1):
        assert two.share(end, 500, 3900) > 0.85


@pytest.mark.parametrize("seed", range(5))
def test_nor_after_an_outage_of_1_4_s(observed: World, seed: int) -> None:
    """It never healed."""
    two = observed("delay(0.02) | uniform(0.02) | blackout(2.0, 1.4)", seed)
    two.run(6000)
    assert (two.master.address, two.slave.address) == (SLAVE, HOME)
    for end in (0, 1):
        assert two.share(end, 3500, 5900) > 0.99


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("who", ["master", "slave"])
def test_nor_after_an_end_was_killed_and_started_again(observed: World, who: str, seed: int) -> None:
    two = observed(seed=seed)
    two.run(1000)
    two.dead = who
    two.run(1500)
    two.dead = ""
    two.start_master() if who == "master" else two.start_slave()
    back = two.now // MS
    two.run(6000)
    assert (two.master.address, two.slave.address) == (SLAVE, HOME)
    for end in (0, 1):
        assert two.share(end, back + 3500, back + 5900) == 1.0


@pytest.mark.parametrize("copies", [False, True])
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("delay", [0.02, 0.3])
def test_a_peer_that_moves_to_another_network_is_followed(
    observed: World, delay: float, seed: int, copies: bool
) -> None:
    """Within half a second and three round trips, be there an observer or not."""
    two = observed(f"delay({delay}) | uniform(0.02) | bernoulli(0.1)", seed)
    two.copies = copies
    two.run(4000)
    assert two.slave.associations >= 1
    two.from_ = AWAY
    moved = two.now // MS
    two.run(6000)
    assert (two.master.address, two.slave.address) == (SLAVE, AWAY)
    within = round(500 + 3 * 1000 * 2 * (delay + 0.02))
    assert two.share(0, moved + within, moved + 5000) > 0.85


@pytest.mark.parametrize("seed", range(3))
def test_an_observer_that_relays_changes_no_address_as_long_as_the_old_one_answers(
    observed: World, seed: int
) -> None:
    two = observed(seed=seed)
    two.copies = False
    two.run(1000)
    two.copies = two.relays = True
    two.run(3000)
    assert (two.master.address, two.slave.address) == (SLAVE, HOME)
    for end in (0, 1):
        assert two.share(end, 500, 3900) == 1.0


@pytest.mark.parametrize("seed", range(3))
def test_what_is_drawn_by_one_that_relayed_the_meeting_comes_back_when_it_relays_no_more(
    observed: World, seed: int
) -> None:
    """As long as it relays it is on the path: it sees when something is sent, and can drop it."""
    two = observed(seed=seed)
    two.relays = True
    two.run(3000)
    for end in (0, 1):
        assert two.share(end, 1000, 2900) > 0.99
    two.relays = False
    two.run(4000)
    assert (two.master.address, two.slave.address) == (SLAVE, HOME)
    for end in (0, 1):
        assert two.share(end, 4500, 6900) == 1.0


def test_challenges_are_few_and_none_without_another_address(observed: World) -> None:
    two = observed()
    two.copies = False
    two.run(2000)
    assert set(two.to[1]) == {HOME}
    assert two.to[1][HOME] < 1020
    two.copies = True
    two.run(10_000)
    assert 10 < two.to[1][FORTH] < 200
