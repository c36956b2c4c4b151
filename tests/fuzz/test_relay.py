"""A million hostile datagrams at the relay between two ends of a running session.

It passes on what bears an end's address and a good checksum, or looks sealed: whose it is the ends look at. All else is
foreign. Asserted is that every honest datagram comes out as without the flood, to the byte and to the nanosecond.

Fired from an end's own address is all but a HELLO and a WELCOME, by which a master may begin anew at any time.
"""

from __future__ import annotations

import random
from dataclasses import replace
from hashlib import sha256
from struct import pack
from typing import Any, NamedTuple

import pytest

from channel.link import parse_link
from channel.router import Router
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Kind, Packet, encode, peek
from tests.channel.site import NoWire
from tests.fuzz.datagrams import Hostile, View
from tests.fuzz.running import AT, MS, fuzzed
from tests.fuzz.test_million import EACH, FORMS, Fire, is_flat

STRANGER = ("198.51.100.7", 5000)
NUMBER = 77
MARK = 0.777  # J, the stamp of what is honest
LINK = "delay(0.01) | uniform(0.01) | bernoulli(0.1) | duplicate(0.1, after=0.003)"


class Relayed(NamedTuple):
    """What came out: how much that was honest, a digest of when it came, which way and what; and how much else."""

    came: int
    sha: str
    strange: int
    router: Router


def relayed(ticks: int, fire: Fire | None, others: list[bytes]) -> Relayed:
    """A session through a relay, under fire or not."""
    scene = replace(fuzzed(ticks), link=parse_link(LINK))
    wires: Any = NoWire(None), NoWire(AT["s"])
    router = Router(scene, 3, *wires, port=lambda _home: wires[1], close=lambda _wire: None, secret=bytes(32))
    view = View(NUMBER, Kind.FORTH, 1)
    hostile = Hostile(random.Random(8), view, others, [])
    sha, came, strange = sha256(), 0, 0

    def passed() -> int:
        return sum(router.counts(way).received for way in (0, 1))

    def take(direction: int, data: bytes, sender: tuple[str, int], now: int) -> None:
        if direction == 0:
            router.from_near(data, sender, now)
        else:
            router.from_far(None, data, sender, now)

    for kind in (Kind.HELLO, Kind.WELCOME, Kind.START, Kind.START):
        payload: Any = 0 if kind is Kind.START else manifest_of(scene)
        direction = int(kind is Kind.WELCOME or router.counts(0).received == 2)
        take(direction, encode(Packet(kind, NUMBER, 0, 0, None, payload)), AT["ms"[direction]], 0)
    for k in range(ticks + 100):
        now = 10**9 + k * MS
        if fire is not None and 0 < k <= ticks:
            fire.look()
            view.k = view.newest = k - 1
            for _ in range(EACH):
                name, data = ("inside", hostile.inside()) if hostile.dice.random() < 0.1 else hostile.shot()
                fire.counts[name] += 1
                own = hostile.dice.random() < 0.5 and peek(data)[0] not in (Kind.HELLO, Kind.WELCOME)
                direction = int(hostile.dice.random() * 2)
                foreign, before = router.foreign, passed()
                take(direction, data, AT["ms"[direction]] if own else STRANGER, now)
                assert router.foreign + passed() == foreign + before + 1, "each is foreign or passed on"
                assert own or passed() == before, "a stranger's is foreign"
        if k < ticks:
            for direction, kind in enumerate((Kind.FORTH, Kind.BACK)):
                data = encode(Packet(kind, NUMBER, k, now, None, (1.0,), MARK))
                take(direction, data, AT["ms"[direction]], now)
        flow = router.flows.of(AT["m"])
        assert flow is not None
        for way, data in flow.relay.due(now - (flow.origin or 0)):
            if pack(">d", MARK) in data:
                came += 1
                sha.update(pack("<QB", now, way) + data)
            else:
                strange += peek(data)[0] not in (Kind.HELLO, Kind.WELCOME, Kind.START)
    return Relayed(came, sha.hexdigest(), strange, router)


@pytest.mark.parametrize("ticks", FORMS)
def test_the_honest_session_comes_out_of_the_relay_as_without_the_flood(ticks: int, others: list[bytes]) -> None:
    fire = Fire(ticks)
    plain, under_fire = relayed(ticks, None, others), relayed(ticks, fire, others)
    router = under_fire.router
    fire.tell("relay")
    assert plain.strange == 0
    assert (under_fire.came, under_fire.sha) == (plain.came, plain.sha)
    assert plain.came > 1.5 * ticks
    flow = router.flows.of(AT["m"])
    assert flow is not None
    assert flow.slave == AT["s"]
    assert list(router.flows) == [flow]
    counts = [router.counts(way) for way in (0, 1)]
    assert sum(count.under_way for count in counts) == 0
    for count in counts:
        assert count.received + count.doubled == count.lost + count.overflowed + count.rejected + count.delivered
    fired, received = sum(fire.counts.values()), sum(count.received for count in counts)
    assert router.foreign + received == fired + 2 * ticks + 4
    assert 0 < under_fire.strange < fired
    is_flat(fire, ticks)
