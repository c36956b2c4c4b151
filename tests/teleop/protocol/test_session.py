"""The first exchange on a virtual clock: it survives loss, finds the offset, stops what differs, keeps its peer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from heapq import heappop, heappush
from itertools import count, pairwise
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.protocol.connection import Address, Connection
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.estimates import AHEAD_NS, LEAD_NS, ROUNDS
from teleop.protocol.guard import Event
from teleop.protocol.manifest import MOST_CLOCK_NS, TICK_0, manifest_of
from teleop.protocol.packet import Echo, Kind, Packet, peek
from teleop.protocol.session import AGAIN_NS, RENEW_NS, Session, SessionBegun
from teleop.scene.loading import load_scene
from tests.begun import begin
from tests.teleop.protocol.ends import packet_in
from tests.teleop.protocol.virtual_clock import healing

MS = 1_000_000
MANIFEST = {"wire version": "1", "scene": "canonical", "law": "wave Wave(b=2.0)", "k_e": "5000.0", "dt": "0.001"}


@dataclass
class Talk:
    """A master and a slave, and the time their datagrams take. The true time is the master's clock."""

    master: Session = field(default_factory=lambda: Session(master=True, manifest=MANIFEST, number=7))
    slave: Session = field(default_factory=lambda: Session(master=False, manifest=MANIFEST))
    there: int = 25 * MS
    back: int = 25 * MS
    slave_ahead: int = 0  # the slave's clock less the master's
    lost: Callable[[Packet], bool] = lambda _packet: False
    sent: list[Packet] = field(default_factory=list)
    messages: bool = True  # do messages flow, both ways, while they have met in one session
    now: int = 0
    _under_way: list[tuple[int, int, Session, bytes]] = field(default_factory=list)
    _serial: Iterator[int] = field(default_factory=count)

    def clock(self, end: Session) -> int:
        return self.now + (self.slave_ahead if end is self.slave else 0)

    def send(self, end: Session, datagrams: list[bytes]) -> None:
        for data in datagrams:
            packet = packet_in(data)
            self.sent.append(packet)
            if not self.lost(packet):
                other, takes = (self.slave, self.there) if end is self.master else (self.master, self.back)
                heappush(self._under_way, (self.now + takes, next(self._serial), other, data))

    def flow(self) -> None:
        """The law's messages, of which a session knows that they come."""
        master, slave = self.master, self.slave
        if self.messages and not master.meeting and not slave.meeting and master.number == slave.number:
            if not self.lost(Packet(Kind.FORTH, 0, 0, 0, None, ())):
                slave.take_data(self.clock(slave))
            if not self.lost(Packet(Kind.BACK, 0, 0, 0, None, ())):
                master.take_data(self.clock(master))

    def agree(self, until: int) -> None:
        """Let time pass until both know when tick 0 is, at most until then."""
        while self.now < until and None in (self.master.start_ns, self.slave.start_ns):
            self.run(self.now + 10 * MS)

    def run(self, until: int) -> Talk:
        while self.now < until:
            while self._under_way and self._under_way[0][0] <= self.now:
                _, _, end, data = heappop(self._under_way)
                self.send(end, end.receive(packet_in(data), self.clock(end)))
            if self.now % (20 * MS) == 0:
                self.flow()
            for end in (self.master, self.slave):
                self.send(end, end.due(self.clock(end)))
            self.now += MS
        return self

    def kinds(self) -> list[str]:
        return [packet.kind.name for packet in self.sent]


def test_the_ends_agree_on_the_time_of_tick_0_which_is_still_ahead_and_then_fall_silent() -> None:
    for there, back in ((25, 25), (350, 350)):
        talk = Talk(there=there * MS, back=back * MS)
        while talk.slave.start_ns is None:
            talk.run(talk.now + MS)
        assert talk.slave.start_ns > talk.now
        talk.run(talk.now + 2000 * MS)
        assert talk.master.start_ns == talk.slave.start_ns > 5 * 50 * MS + LEAD_NS
        assert (talk.master.failure, talk.slave.failure, talk.slave.number) == (None, None, 7)
        assert talk.kinds()[-1] == "START"
        assert talk.kinds().count("START") <= 3 + (there + back) // 50  # on their way before the first answer is back
        said = len(talk.sent)
        talk.run(talk.now + 1000 * MS)
        assert len(talk.sent) == said


@settings(max_examples=25)
@given(there=st.integers(0, 200), back=st.integers(0, 200), ahead=st.integers(-(10**12), 10**12))
def test_the_clock_offset_is_within_half_the_round_trip_however_the_delays_are_shared(
    there: int, back: int, ahead: int
) -> None:
    talk = Talk(there=there * MS, back=back * MS, slave_ahead=ahead)
    talk.agree(5000 * MS)
    assert talk.master.rtt_ns is not None
    assert (there + back) * MS <= talk.master.rtt_ns <= (there + back + 2) * MS  # datagrams are seen once a ms
    assert abs(talk.master.offset_ns - ahead) <= talk.master.rtt_ns / 2
    assert talk.master.start_ns is not None
    assert talk.slave.start_ns == talk.master.start_ns + talk.master.offset_ns


def test_equal_delays_give_the_offset_itself_and_it_is_taken_from_the_fastest_round_trip() -> None:
    """The first round trips have their way back slowed down, which misleads by half of what it adds."""
    talk = Talk(there=10 * MS, back=90 * MS, slave_ahead=123_456_789).run(150 * MS)
    talk.back = 10 * MS
    talk.run(2000 * MS)
    assert talk.master.rtt_ns == 20 * MS
    assert talk.master.offset_ns == 123_456_789
    assert talk.slave.start_ns == (talk.master.start_ns or 0) + 123_456_789


@settings(max_examples=20)
@given(st.lists(st.booleans(), min_size=60, max_size=60))
def test_any_pattern_of_losses_delays_the_start_and_no_more(pattern: list[bool]) -> None:
    fate = iter(pattern)
    talk = Talk(lost=lambda _packet: next(fate, False))
    talk.agree(8000 * MS)
    assert talk.master.start_ns == talk.slave.start_ns is not None
    assert (talk.master.failure, talk.slave.failure) == (None, None)
    said = len(talk.run(talk.now + 2000 * MS).sent)
    assert len(talk.run(talk.now + 1000 * MS).sent) == said


def test_start_is_repeated_until_it_is_answered_or_messages_come() -> None:
    talk = Talk(lost=lambda packet: packet.kind is Kind.START, messages=False).run(2000 * MS)
    starts = [packet.sent_ns for packet in talk.sent if packet.kind is Kind.START]
    assert len(starts) > 10
    assert {b - a for a, b in pairwise(starts)} == {AGAIN_NS}
    talk.master.take_data(talk.now)
    talk.run(2900 * MS)
    assert len([packet for packet in talk.sent if packet.kind is Kind.START]) == len(starts)


# Ends that do not match


def test_ends_that_differ_in_any_entry_both_stop_with_a_sentence_that_names_it_from_where_each_stands() -> None:
    mine = manifest_of(load_scene("hard_wall"))
    others = {name: {**mine, name: mine[name] + "1"} for name in mine}
    gone = {"k_e": {name: mine[name] for name in mine if name != "k_e"}, "k_new": {**mine, "k_new": "1"}}
    for name, other in (*others.items(), *gone.items()):
        talk = Talk(Session(master=True, manifest=mine, number=7), Session(master=False, manifest=other))
        talk.run(200 * MS)
        assert (talk.master.start_ns, talk.slave.start_ns) == (None, None), name
        for end, here, there in ((talk.master, mine, other), (talk.slave, other, mine)):
            failure = str(end.failure)
            assert f": {name} is " in failure
            assert failure.count("\n") == 0
            assert "start both ends with the same" in failure or "install the same release" in failure
            assert name not in ("k_e", "dt") or f"{here.get(name, 'missing')} here" in failure, there
        sent = len(talk.sent)
        talk.run(300 * MS)
        assert len(talk.sent) == sent, name


# One session at a time


def hello(session: int, manifest: dict[str, str] = MANIFEST) -> Packet:
    return Packet(Kind.HELLO, session, 0, 0, None, manifest)


def start_of(session: int, welcomed: int, tick_0: int = 5) -> Packet:
    """The START of a master whose last WELCOME was sent at `welcomed`."""
    return Packet(Kind.START, session, 0, 0, Echo(welcomed, 0), tick_0)


def started(slave: Session, session: int, now: int, **told: str) -> Session:
    slave.receive(hello(session, {**MANIFEST, **told}), now)
    slave.receive(start_of(session, now), now)
    assert slave.number == session
    return slave


def test_a_running_session_is_not_taken_over_while_it_is_heard_nor_moved_by_a_second_start_or_a_refusal() -> None:
    talk = Talk().run(2000 * MS)
    slave, start = talk.slave, talk.slave.start_ns
    again = Packet(Kind.START, 7, 0, 0, None, 999)
    assert [packet_in(data).payload for data in slave.receive(again, talk.now)] == [999]
    talk.master.receive(Packet(Kind.REFUSE, 7, 0, 0, None, "no"), talk.now)
    assert talk.master.failure is None
    for i in range(10):
        now = talk.now + (i + 1) * RENEW_NS // 2
        for packet in (hello(100), hello(100, {"scene": "other"}), start_of(100, now),
                       Packet(Kind.START, 100, 0, 0, None, 5),
                       Packet(Kind.BYE, 100, 0, 0, None, "go"), Packet(Kind.REFUSE, 100, 0, 0, None, "no")):
            assert not slave.belongs(packet, now)
            assert slave.receive(packet, now) == []
        slave.take_data(now)
    assert (slave.number, slave.start_ns, slave.farewell, slave.failure, slave.met) == (7, start, None, None, 1)


def test_a_second_master_waits_until_the_first_has_been_silent() -> None:
    """Messages alone: a recorded START or WELCOME of the session proves nobody's presence."""
    slave = started(Session(master=False, manifest=MANIFEST), 1, 0)
    assert slave.receive(hello(200), RENEW_NS // 2) == []
    assert slave.receive(hello(200, {"scene": "other"}), RENEW_NS // 2) == []  # nor can it stop the slave
    slave.take_data(RENEW_NS // 2)
    assert slave.receive(hello(200), RENEW_NS) == []
    assert (slave.number, slave.failure) == (1, None)
    for now in range(RENEW_NS // 2, 2 * RENEW_NS, RENEW_NS // 4):
        for packet in (Packet(Kind.START, 1, 0, 0, None, 5), Packet(Kind.WELCOME, 1, 0, 0, None, MANIFEST)):
            slave.receive(packet, now)
    assert slave.receive(hello(200), 2 * RENEW_NS)
    assert (slave.number, slave.met) == (1, 1), "it is asked, and goes on in the session it has until START"
    assert slave.receive(Packet(Kind.START, 200, 0, 0, Echo(2 * RENEW_NS + 1, 0), 5), 2 * RENEW_NS) == []
    assert slave.receive(start_of(200, 2 * RENEW_NS), 2 * RENEW_NS)
    assert (slave.number, slave.met, slave.start_ns) == (200, 2, 5)
    assert slave.receive(start_of(1, 0), 2 * RENEW_NS) == [], "and what is old of the first one is over"
    assert (slave.number, slave.met, slave.start_ns) == (200, 2, 5)


def test_a_start_counts_only_if_it_echoes_a_welcome_and_of_two_masters_the_one_that_starts_has_the_slave() -> None:
    slave = Session(master=False, manifest=MANIFEST)
    for number, now in ((1, 10), (2, 20), (1, 30)):
        assert slave.receive(hello(number), now)
    for echo in (None, Echo(11, 0), Echo(0, 0), Echo(-10, 0)):
        assert slave.receive(Packet(Kind.START, 1, 0, 0, echo, 5), 40) == []
    assert slave.receive(start_of(2, 10), 40) == []
    assert (slave.number, slave.start_ns) == (None, None)
    assert slave.receive(start_of(2, 20), 40)
    assert slave.receive(start_of(1, 30), 50) == []
    assert (slave.number, slave.start_ns, slave.met) == (2, 5, 1)


def test_a_slave_that_has_met_nobody_believes_nobody_and_no_clock_that_nobody_has() -> None:
    slave = Session(master=False, manifest=MANIFEST)
    for number in (0, 1, 2**64 - 1):
        for kind, payload in ((Kind.START, 5), (Kind.BYE, "go"), (Kind.REFUSE, "no"), (Kind.WELCOME, MANIFEST)):
            assert slave.receive(Packet(kind, number, 0, 0, None, payload), 0) == []
    assert slave.bye("nobody to tell", 0) == []
    slave.receive(hello(1), 10)
    for tick_0 in (2**61 + 1, -(2**61) - 1, 2**63 - 1, -(2**63)):
        assert slave.receive(start_of(1, 10, tick_0), 20) == [], tick_0
    assert (slave.number, slave.start_ns, slave.farewell, slave.failure) == (None, None, None, None)


def test_a_master_takes_no_hello_no_word_of_another_session_and_no_welcome_that_answers_nothing_or_is_of_another_run(
) -> None:
    master = Session(master=True, manifest=MANIFEST, number=7)
    for packet in (hello(7), hello(8), Packet(Kind.WELCOME, 8, 0, 0, None, {"scene": "other"}),
                   Packet(Kind.REFUSE, 8, 0, 0, None, "no"), Packet(Kind.BYE, 8, 0, 0, None, "go"),
                   *[Packet(Kind.WELCOME, 7, 0, 0, None, MANIFEST)] * (3 * ROUNDS)):
        assert master.receive(packet, 0) == []
    assert (master.failure, master.farewell, master.start_ns) == (None, None, None)
    (bye,) = master.receive(Packet(Kind.WELCOME, 7, 0, 5, None, {**MANIFEST, "law": "pfra"}), 10)
    assert packet_in(bye).kind is Kind.BYE, "whatever the slave thinks: the master compares for itself"
    assert "law is wave" in str(master.failure)


def test_a_farewell_reaches_the_other_end_with_its_reason() -> None:
    talk = Talk().run(2000 * MS)
    talk.send(talk.slave, talk.slave.bye("it was asked to stop (SIGINT)", talk.now))
    talk.send(talk.master, talk.master.bye(None, talk.now))
    talk.run(2100 * MS)
    assert talk.master.farewell == "it was asked to stop (SIGINT)"
    assert talk.slave.farewell == "finished"
    assert (talk.master.left, talk.slave.left) == (True, False)


def test_a_tick_0_that_is_further_ahead_than_any_is_neither_taken_nor_joined() -> None:
    """An end that believed it would hold still until then, for years if it was told so."""
    slave = Session(master=False, manifest=MANIFEST)
    [welcome] = slave.receive(Packet(Kind.HELLO, 9, 0, 5, None, MANIFEST), 1000)
    for ahead, begun in ((AHEAD_NS + 1, 0), (MOST_CLOCK_NS, 0), (AHEAD_NS, 1)):
        slave.receive(start_of(9, packet_in(welcome, 0).sent_ns, 1000 + ahead), 1000)
        assert slave.met == begun
    for ahead, begun in ((AHEAD_NS + 100 * MS, 0), (AHEAD_NS - 100 * MS, 1)):
        master = Session(master=True, manifest=MANIFEST, number=7)
        for now in range(0, 1200 * MS, 60 * MS):
            for packet in map(packet_in, master.due(now)):
                if packet.kind is Kind.HELLO:
                    told = {**MANIFEST, TICK_0: str(now + ahead)}
                    master.receive(Packet(Kind.WELCOME, 7, 0, now, Echo(packet.sent_ns, 0), told), now)
        assert master.met == begun


def test_a_refusal_in_letters_of_several_bytes_fits_its_hello() -> None:
    """It was longer than the question then, so it was not sent, and the master waited for nothing."""
    theirs, own = ({**MANIFEST, "hand": letter * 280} for letter in "手指")
    [hello] = Session(master=True, manifest=theirs, number=7).due(0)
    asked = packet_in(hello, 0)
    [reply] = Session(master=False, manifest=own).receive(asked, 0, len(hello))
    refusal = packet_in(reply, 0)
    assert refusal.kind is Kind.REFUSE
    assert str(refusal.payload).startswith("the slave is set up for another run: hand is 手")
    assert len(reply) <= len(hello)


# Where datagrams come from and go to: the peer of a session, and hosts that are none


MASTER, SLAVE, OTHER = ("10.0.0.1", 1000), ("10.0.0.2", 2000), ("10.0.0.9", 9000)


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
    begin(sealed.endpoint.session, 0, 10)
    sealed.receive(copy[Kind.WELCOME], OTHER, 20)
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
