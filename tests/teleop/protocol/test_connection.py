"""Where datagrams come from and go to: the peer of a session, and hosts that are none."""

from __future__ import annotations

from typing import Any

from teleop.protocol.connection import Address, Connection
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.guard import Event
from teleop.protocol.packet import Kind, peek
from teleop.protocol.session import Session, SessionBegun
from tests.teleop.protocol.virtual_clock import healing

MS = 1_000_000
MASTER, SLAVE, OTHER = ("10.0.0.1", 1000), ("10.0.0.2", 2000), ("10.0.0.9", 9000)
MANIFEST = {"scene": "a"}


def connection(e: str, asked: Address | None = None, number: int = 7, *, sealed: bool = False) -> Connection:
    session = Session(master=e == "m", manifest=MANIFEST, number=number if e == "m" else None)
    return Connection(Endpoint(healing(), e, session), asked, sealed=sealed)


class Two:
    """A master and a slave, handed each other's datagrams at once by where they are sent to."""

    def __init__(self) -> None:
        self.now = 0
        self.at: dict[Address, Connection] = {MASTER: connection("m", SLAVE), SLAVE: connection("s")}
        self.sent: list[tuple[Address, bytes, Address]] = []

    def carry(self, source: Address, pairs: list[tuple[bytes, Address]]) -> None:
        for data, to in pairs:
            self.sent.append((source, data, to))
            if to in self.at:
                self.carry(to, self.at[to].receive(data, source, self.now))

    def run(self, ms: int) -> Two:
        for _ in range(ms // 5):
            self.now += 5 * MS
            for address, one in list(self.at.items()):
                self.carry(address, one.due(self.now))
        return self


def test_the_slave_takes_the_address_of_the_master_that_starts_it_and_the_session_is_told_once() -> None:
    two = Two().run(200)
    assert (two.at[SLAVE].peer, two.at[MASTER].peer) == (MASTER, SLAVE)
    assert {(source, to) for source, _, to in two.sent} == {(MASTER, SLAVE), (SLAVE, MASTER)}
    assert connection("s").bye("done", 0) == [], "without a peer there is nobody to say goodbye to"
    for one in two.at.values():
        assert one.events() == [SessionBegun(7)]
        one.endpoint.guard.tell(3, "safe", "why")
        assert one.events() == [Event(3, "safe", "why")]
        assert one.events() == []


def test_a_datagram_from_elsewhere_is_counted_and_dropped_while_a_session_lasts_unless_it_is_sealed() -> None:
    """A sealed link knows its peer by keys."""
    two = Two().run(200)
    copy: dict[Any, bytes] = {peek(data)[0]: data for _, data, _ in two.sent}
    for address, kinds in ((MASTER, (Kind.WELCOME, Kind.START)), (SLAVE, (Kind.WELCOME,))):
        one = two.at[address]
        for kind in kinds:
            assert one.receive(copy[kind], OTHER, two.now) == []
        assert one.endpoint.rejected["address"] == len(kinds)
        assert one.peer != OTHER
    start = next(data for source, data, _ in two.sent if source == MASTER and peek(data)[0] is Kind.START)
    assert [to for _, to in two.at[SLAVE].receive(start, OTHER, two.now)] == [MASTER], "a copy draws no answer there"
    assert two.at[SLAVE].peer == MASTER
    sealed = connection("s", sealed=True)
    sealed.endpoint.session.begin(0, 10)
    sealed.receive(copy[Kind.HELLO], OTHER, 20)
    assert sealed.endpoint.rejected["address"] == 0


def test_an_answer_to_a_hello_goes_to_the_host_that_asked_and_a_master_asks_anew_where_it_was_told_to() -> None:
    """The session is over, so that another master may ask; until it has started one the peer is the old one.

    A slave with two addresses may have answered from the other one, and be started again on the first alone.
    """
    two = Two().run(200)
    master, slave = two.at[MASTER], two.at[SLAVE]
    later = two.now + 3_000 * MS
    slave.endpoint.session.judge(later)
    (hello,) = connection("m", SLAVE, number=99).due(later)
    ((reply, to),) = slave.receive(hello[0], OTHER, later)
    assert (peek(reply)[0], to) == (Kind.WELCOME, OTHER)
    assert slave.peer == MASTER
    master.peer = OTHER
    master.endpoint.session.end("the session is over: as a test has it")
    ((data, to),) = master.due(two.now + 100 * MS)
    assert (peek(data)[0], to) == (Kind.HELLO, SLAVE)
