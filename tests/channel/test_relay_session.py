"""Who has the relay's link: sessions that begin, run and end, and strangers who would have it, on a virtual clock."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any

import pytest

from channel.shell import QUIET_NS, TURN_NS, RelayShell
from teleop.packet import Kind, Packet, encode
from teleop.scene import load_scene
from tests.channel.no_wire import NoWire

MS = 1_000_000
MASTER, SLAVE = ("192.0.2.1", 4000), ("192.0.2.2", 9001)
STRANGER, OTHER_HOME = ("198.51.100.7", 5000), ("192.0.2.3", 9001)
SCENE = load_scene("canonical", link="none", duration=100)
INSIDE = count()


class Site:
    """A relay that has just been started, and what comes out of it towards each end."""

    def __init__(self) -> None:
        wires: Any = NoWire(None), NoWire(SLAVE)
        self.shell = RelayShell(SCENE, 0, *wires)
        self.now = 10**12  # ns, of a clock that has been running
        self.out: tuple[list[tuple[Any, bytes]], list[tuple[Any, bytes]]] = ([], [])  # to the master, to the slave

    def takes(self, data: bytes, sender: tuple[str, int]) -> bool:
        """Does it pass on what comes from there? What comes from 9001 comes from the slave's side."""
        direction = int(sender[1] == SLAVE[1])
        before = self.shell.foreign
        self.shell._take(direction, data, sender, self.now)
        origin = self.shell._origin
        for way, load in self.shell.relay.due(0 if origin is None else self.now - origin):
            self.out[1 - way if way else 1].append((self.shell.wires[1 - way].peer, load))
        return self.shell.foreign == before

    def session(self, number: int) -> Callable[..., bytes]:
        """Packets of a session, by kind."""
        def packet(kind: Kind, seq: int = 0) -> bytes:
            payload: Any = (1.0,) if kind in (Kind.FORTH, Kind.BACK) else 0 if kind is Kind.START else SCENE.manifest()
            return encode(Packet(kind, number, seq, 0, None, payload))
        return packet

    def run(self, number: int, ms: int = 10) -> None:
        """A session of the honest ends, from its HELLO on or further on."""
        packet = self.session(number)
        if self.shell._session != number:
            assert self.takes(packet(Kind.HELLO), MASTER)
            assert self.takes(packet(Kind.WELCOME), SLAVE)
        for _ in range(ms):
            self.now += MS
            assert self.takes(packet(Kind.FORTH), MASTER)
            assert self.takes(packet(Kind.BACK), SLAVE)


@pytest.mark.parametrize("pause", [1, 300])
def test_a_relay_that_was_started_anew_is_not_held_by_a_strangers_messages(pause: int) -> None:
    """They come first, and go on; the master's own do not come through until it says HELLO, which it soon does."""
    site = Site()
    strange, honest = site.session(5), site.session(7)
    for _ in range(2000 // pause):
        site.takes(strange(Kind.FORTH), STRANGER)
        site.takes(honest(Kind.FORTH, 400), MASTER)
        site.now += pause * MS
    site.run(7)
    assert not site.takes(strange(Kind.FORTH), STRANGER)
    site.run(7)


def test_a_relay_that_was_started_anew_passes_on_the_first_it_hears_of_a_session() -> None:
    site = Site()
    assert site.takes(site.session(7)(Kind.FORTH, 400), MASTER)
    assert site.out[1] != []


def test_a_stranger_that_the_slave_does_not_take_up_has_the_link_for_its_turn_alone() -> None:
    """Whatever it says, and the slave with it: that has not begun a session with it, and sends of the one before."""
    site = Site()
    site.run(7)
    site.now += QUIET_NS + MS
    strange, honest, began = site.session(5), site.session(8), site.now
    assert site.takes(strange(Kind.HELLO), STRANGER)
    while not site.takes(honest(Kind.HELLO), MASTER):
        for kind in (Kind.HELLO, Kind.FORTH):
            site.takes(strange(kind), STRANGER)
        site.takes(site.session(site.now)(Kind.HELLO), STRANGER)
        site.takes(site.session(7)(Kind.BACK), SLAVE)
        for kind in (Kind.WELCOME, Kind.REFUSE):
            site.takes(strange(kind), SLAVE)
        site.now += 10 * MS
        assert site.now - began < TURN_NS + 20 * MS
    assert site.now - began > TURN_NS - 20 * MS
    site.run(8)


@pytest.mark.parametrize(("kind", "where"), [(Kind.WELCOME, SLAVE), (Kind.BACK, OTHER_HOME), (Kind.START, OTHER_HOME)])
def test_neither_a_welcome_nor_what_comes_from_elsewhere_takes_a_stranger_up(
    kind: Kind, where: tuple[str, int]
) -> None:
    """A slave welcomes whoever has its scene; and from elsewhere a stranger could answer its own HELLO."""
    site = Site()
    strange, honest = site.session(5), site.session(7)
    assert site.takes(strange(Kind.HELLO), STRANGER)
    assert site.takes(strange(Kind.WELCOME), where)
    began = site.now
    while not site.takes(honest(Kind.HELLO), MASTER):
        assert site.takes(strange(Kind.HELLO), STRANGER)
        assert site.takes(strange(kind), where)
        site.now += 10 * MS
        assert site.now - began < TURN_NS + 20 * MS
    site.run(7)


def test_the_next_turn_is_anothers() -> None:
    """From its HELLO until the slave has taken it up the honest master is not disturbed for as long as a turn."""
    site = Site()
    assert site.takes(site.session(5)(Kind.HELLO), STRANGER)
    for _ in range(TURN_NS // (100 * MS) + 1):
        site.takes(site.session(5)(Kind.FORTH), STRANGER)
        site.now += 100 * MS
    honest = site.session(7)
    assert site.takes(honest(Kind.HELLO), MASTER)
    until = site.now + TURN_NS - 100 * MS
    while site.now < until:
        site.now += 50 * MS
        assert not site.takes(site.session(5)(Kind.HELLO), STRANGER)
        assert site.takes(honest(Kind.HELLO), MASTER)
        assert site.takes(honest(Kind.WELCOME), SLAVE)
    site.run(7)


def test_a_session_that_runs_is_not_taken_over() -> None:
    site = Site()
    site.run(7)
    strange = site.session(5)
    for _ in range(100):
        site.run(7, 100)
        for kind in (Kind.HELLO, Kind.FORTH, Kind.START):
            assert not site.takes(strange(kind), STRANGER)
        assert not site.takes(hello(), STRANGER)
        for kind in (Kind.WELCOME, Kind.BACK, Kind.START):
            assert not site.takes(strange(kind), OTHER_HOME)
    assert {to for to, _ in site.out[0]} == {MASTER}
    assert {to for to, _ in site.out[1]} == {SLAVE}


@pytest.mark.parametrize("silent", [MASTER, SLAVE])
def test_a_session_that_one_end_has_left_gives_way(silent: tuple[str, int]) -> None:
    site = Site()
    site.run(7)
    site.now += TURN_NS
    site.run(7)
    packet, other = site.session(7), site.session(8)
    for _ in range(10):
        assert not site.takes(other(Kind.HELLO), STRANGER)
        site.now += 100 * MS
        site.takes(*((packet(Kind.BACK), SLAVE) if silent == MASTER else (packet(Kind.FORTH), MASTER)))
    assert site.takes(other(Kind.HELLO), STRANGER)


def test_its_own_master_may_ask_anew_at_any_time() -> None:
    site = Site()
    site.run(7)
    site.run(8)


def test_a_slave_that_answers_from_another_address_is_heard_there_and_the_next_session_asks_the_first_again(
    capsys: pytest.CaptureFixture[str]
) -> None:
    site = Site()
    packet = site.session(7)
    assert site.takes(packet(Kind.HELLO), MASTER)
    for kind in (Kind.WELCOME, Kind.WELCOME, Kind.BACK):
        assert site.takes(packet(kind), OTHER_HOME)
    assert site.takes(packet(Kind.FORTH), MASTER)
    assert site.out[1][-1][0] == OTHER_HOME
    assert capsys.readouterr().err.count("--peer 192.0.2.3:9001") == 1
    assert site.takes(site.session(8)(Kind.HELLO), MASTER)
    assert site.out[1][-1][0] == SLAVE


def hello(number: int = 0) -> bytes:
    """A first hello as far as a relay looks at it."""
    body = bytes((1,)) + bytes(80)
    return b"\x16\xfe\xff\0\0" + number.to_bytes(6, "big") + len(body).to_bytes(2, "big") + body


def request(number: int) -> bytes:
    """What asks for a cookie, as far as a relay looks at it."""
    return b"\x16\xfe\xff\0\0" + number.to_bytes(6, "big") + b"\0\x20\x03" + bytes(31)


def sealed(number: int, kind: int = 23) -> bytes:
    """A sealed record; of kind 22 and number 0, that a handshake is over. No two have the same bytes inside."""
    return bytes((kind,)) + b"\xfe\xfd\0\1" + number.to_bytes(6, "big") + b"\0\x28" + next(INSIDE).to_bytes(40, "big")


def test_a_strangers_handshake_holds_the_link_for_its_turn_alone() -> None:
    """The slave answers everybody's hello, and sends on what is of the association before: neither takes it up."""
    site = Site()
    began, finished = site.now, sealed(0, 22)
    assert site.takes(hello(3), MASTER)
    assert site.takes(finished, SLAVE)
    site.now += QUIET_NS + MS
    assert site.takes(hello(1), STRANGER)
    began = site.now
    while not site.takes(hello(2), MASTER):
        for data in (hello(1), sealed(1), sealed(0, 22)):
            site.takes(data, STRANGER)
        for data in (request(1), sealed(900), sealed(0, 21), finished):
            site.takes(data, SLAVE)
        site.now += 10 * MS
        assert site.now - began < TURN_NS + 20 * MS
    assert site.now - began > TURN_NS - 20 * MS


def test_who_was_taken_up_by_the_slave_keeps_the_link_while_both_speak() -> None:
    site = Site()
    assert site.takes(hello(1), MASTER)
    assert site.takes(sealed(0, 22), SLAVE)
    for number in range(200):
        site.now += 100 * MS
        assert site.takes(sealed(number), MASTER)
        assert site.takes(sealed(number), SLAVE)
        assert not site.takes(hello(2), STRANGER)
        assert not site.takes(site.session(5)(Kind.HELLO), STRANGER)
    for _ in range(11):
        site.now += 100 * MS
        assert site.takes(sealed(1), MASTER)
    assert site.takes(hello(2), STRANGER), "the slave has fallen silent"


def test_a_sealed_answer_from_another_address_is_heard_if_it_has_the_number_of_the_hello(
    capsys: pytest.CaptureFixture[str]
) -> None:
    site = Site()
    asks, near = 0x3456_789A_BCDE, ("192.0.2.66", 9001)
    assert site.takes(hello(asks), MASTER)
    for data in (request(asks + 1), request(0), sealed(0, 22), sealed(1), hello(asks)):
        assert not site.takes(data, near)
    assert site.takes(request(asks), OTHER_HOME)
    assert site.takes(sealed(0, 22), OTHER_HOME)
    assert not site.takes(request(asks), near), "the slave has answered"
    assert site.takes(sealed(1), MASTER)
    assert site.out[1][-1][0] == OTHER_HOME
    assert capsys.readouterr().err.count("--peer 192.0.2.3:9001") == 1
