"""Packets and sessions under whatever hypothesis thinks of: what they promise of any bytes, at any time."""

from __future__ import annotations

from math import isfinite
from typing import Any

import msgpack
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from teleop.protocol.endpoint import Endpoint
from teleop.protocol.manifest import EVERY, manifest_of
from teleop.protocol.packet import (
    DATA,
    MOST_CONTROL,
    MOST_SENTENCE,
    Echo,
    Kind,
    Packet,
    Rejection,
    decode,
    encode,
    peek,
)
from teleop.protocol.session import MOST_WELCOMED, RENEW_NS, Session
from tests.begun import begin
from tests.fuzz.datagrams import BODIES, MANIFESTS, NUMBERS, ODD, framed, packed, sealed
from tests.fuzz.running import fuzzed

MANIFEST = manifest_of(fuzzed(100))
OTHER = {**MANIFEST, "law": "another"}
times = st.one_of(st.integers(-(2**63), 2**63 - 1), st.sampled_from([n for n in NUMBERS if -(2**63) <= n < 2**63]))
texts = st.text(st.characters(categories=("L", "N", "P", "S", "Zs")).filter(str.isprintable), max_size=30)
manifests = st.dictionaries(texts, texts, max_size=5)
echoes = st.none() | st.builds(Echo, times, times.filter(lambda held: held >= 0))
finite = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def packets(draw: st.DrawFn, kinds: tuple[Kind, ...] = tuple(Kind)) -> Packet:
    """Any packet that may be sent."""
    kind = draw(st.sampled_from(kinds))
    payload: Any
    if kind in DATA:
        payload = tuple(draw(st.lists(finite, max_size=12)))
    elif kind is Kind.START:
        payload = draw(times)
    elif kind in (Kind.REFUSE, Kind.BYE, Kind.RENEW):
        payload = " ".join(draw(texts).split())[:MOST_SENTENCE]
    else:
        payload = draw(manifests)
    session, seq = draw(st.integers(0, 2**64 - 1)), draw(st.integers(0, 2**32 - 1))
    return Packet(kind, session, seq, draw(times), draw(echoes), payload, draw(st.none() | finite))


def width_of(packet: Packet) -> int:
    return len(packet.payload) if isinstance(packet.payload, tuple) else 1


@settings(max_examples=100)
@given(packets())
def test_what_is_encoded_is_decoded_to_the_same_packet(packet: Packet) -> None:
    data = encode(packet)
    assert decode(data, width_of(packet)) == packet
    assert peek(data) == (packet.kind, packet.seq)


# Anything that msgpack can carry, well-made packets and near misses among it
leaves = st.one_of(st.none(), st.booleans(), st.integers(-(2**63), 2**64 - 1), st.floats(), st.text(max_size=20),
                   st.binary(max_size=20), st.sampled_from(ODD),
                   st.builds(msgpack.ExtType, st.integers(0, 127), st.binary(max_size=9)))
values = st.recursive(
    leaves, lambda inner: st.lists(inner, max_size=6) | st.dictionaries(texts, inner, max_size=4), max_leaves=12)
nearly = st.tuples(
    st.integers(0, 2**64 - 1) | values, st.integers(0, 2**32 - 1) | values, times | values,
    st.none() | st.tuples(times, times) | values,
    st.lists(st.floats(), min_size=2, max_size=2) | manifests | texts | times | values,
    st.none() | st.floats() | values,
)
bodies = st.one_of(nearly, values).map(msgpack.packb) | st.sampled_from(BODIES) | st.binary(max_size=100)
framings = st.builds(lambda kind, body, padding: framed(kind, body, padding=bytes(padding)),
                     st.integers(0, 8), bodies, st.integers(0, 40))
headed = st.binary(max_size=100).map(lambda data: sealed(b"BT\x02" + data))
anything = st.one_of(framings, st.binary(max_size=300), headed, packets().map(encode))


@settings(max_examples=150)
@given(anything, st.integers(0, 12))
@example(b"", 1)
def test_no_bytes_raise_and_what_is_a_packet_is_the_same_packet_when_sent_on(data: bytes, width: int) -> None:
    keeps_its_word(data, width)


def keeps_its_word(data: bytes, width: int) -> None:
    """What `decode` and `peek` promise of any bytes."""
    packet, (kind, seq) = decode(data, width), peek(data)
    if isinstance(packet, Rejection):
        assert packet in set(Rejection)
        return
    assert (kind, seq) == (packet.kind, packet.seq)
    assert 0 <= packet.session < 2**64
    assert packet.E_in is None or isfinite(packet.E_in)
    if packet.kind in DATA:
        assert isinstance(packet.payload, tuple)
        assert len(packet.payload) == width
        assert all(map(isfinite, packet.payload))
        assert decode(encode(packet), width) == packet
    else:
        again = decode(encode(packet), width)
        assert isinstance(again, Packet)
        # A sentence is shortened to one line where it is sent.
        sentence = packet.kind in (Kind.REFUSE, Kind.BYE, Kind.RENEW)
        assert again == (packet._replace(payload=again.payload) if sentence else packet)
        assert decode(encode(again), width) == again


OURS = 5
TOLD = [MANIFEST, *(each for each in MANIFESTS if isinstance(
    decode(framed(Kind.HELLO, packed(1, 0, 0, None, each, None)), 1), Packet))]


class OneEnd(RuleBasedStateMachine):
    """One end that is told whatever there is to be told, by its peer and by others, at any time.

    Its peer, where there is one, is honest; others know no session but their own. Once the two have met, and as long as
    the peer is heard, nobody else moves it.
    """

    master: bool

    def __init__(self) -> None:
        super().__init__()
        self.now = 10**12
        self.end = Session(master=self.master, manifest=MANIFEST, number=OURS if self.master else None)
        self.peer = Session(master=not self.master, manifest=MANIFEST, number=None if self.master else OURS)
        self.recorded: list[tuple[Packet, int]] = []

    def tell(self, packet: Packet, room: int) -> list[bytes]:
        """One packet; what is promised of the answer."""
        before = self.state()
        heard = self.end.met > 0 and not self.end.silent(self.now)
        theirs = packet.session != self.end.number
        replies = self.end.receive(packet, self.now, room)
        assert len(replies) <= 1
        if not self.master:  # a master answers its slave alone, and asks it a few times
            assert sum(map(len, replies)) <= room
        if heard and theirs:
            assert replies == []
            assert self.state() == before
        for reply in replies:
            assert isinstance(decode(reply, 1), Packet)
        return replies

    def state(self) -> tuple[Any, ...]:
        end = self.end
        return end.number, end.start_ns, end.met, end.failure, end.farewell, end.meeting, end.offset_ns, end.peer_every

    def hand(self, datagrams: list[bytes]) -> None:
        """To the peer and, what it answers, back: until nobody has anything to say."""
        waiting = [(False, data) for data in datagrams]
        for _ in range(40):
            if not waiting:
                return
            to_end, data = waiting.pop(0)
            packet = decode(data, 1)
            assert isinstance(packet, Packet)
            if to_end:
                self.recorded = [*self.recorded[-30:], (packet, len(data))]
                answers = self.tell(packet, len(data))
            else:
                answers = self.peer.receive(packet, self.now, len(data))
            waiting += [(not to_end, answer) for answer in answers]

    @initialize(now=st.integers(0, 2**62) | st.sampled_from([0, 2**32 - 5, 2**61]))
    def clock(self, now: int) -> None:
        self.now = now

    @rule(step=st.integers(0, 10**8) | st.sampled_from([RENEW_NS, RENEW_NS + 1, 3 * RENEW_NS, 2**40]),
          lost=st.booleans())
    def wait(self, step: int, lost: bool) -> None:
        self.now += step
        out = self.end.due(self.now)
        assert len(out) <= 1
        for data in out:
            assert isinstance(decode(data, 1), Packet)
        if not lost:
            self.hand(out)

    @rule()
    def talk(self) -> None:
        self.hand(self.end.due(self.now))
        for data in self.peer.due(self.now):
            packet = decode(data, 1)
            assert isinstance(packet, Packet)
            self.recorded = [*self.recorded[-30:], (packet, len(data))]
            self.hand(self.tell(packet, len(data)))

    @precondition(lambda self: self.end.met > 0 and not self.end.meeting)
    @rule()
    def message(self) -> None:
        self.end.take_data(self.now)

    @rule(packet=packets((Kind.HELLO, Kind.WELCOME, Kind.REFUSE, Kind.START, Kind.BYE, Kind.RENEW)))
    def other(self, packet: Packet) -> None:
        if packet.session != self.end.number:
            self.tell(packet, len(encode(packet)))

    @rule(session=st.sampled_from([0, OURS - 1, OURS + 1, 2**64 - 1]),
          told=st.sampled_from([MANIFEST, OTHER, {}, {EVERY: "2"}]),
          kind=st.sampled_from([Kind.HELLO, Kind.WELCOME]), padded=st.booleans())
    def other_hello(self, session: int, told: dict[str, str], kind: Kind, padded: bool) -> None:
        if session != self.end.number:
            packet = Packet(kind, session, 0, self.now, None, told)
            self.tell(packet, len(encode(packet, MOST_CONTROL - 96 if padded else None)))

    @precondition(lambda self: self.recorded)
    @rule(which=st.integers(0, 30))
    def replay(self, which: int) -> None:
        """What the peer said once, again."""
        packet, room = self.recorded[which % len(self.recorded)]
        before, heard = self.state(), self.end.met > 0 and not self.end.silent(self.now) and not self.end.meeting
        self.tell(packet, room)
        if heard and packet.kind is not Kind.BYE:
            assert self.state() == before

    @precondition(lambda self: self.end.number is not None)
    @rule(kind=st.sampled_from([Kind.HELLO, Kind.WELCOME, Kind.REFUSE, Kind.START, Kind.RENEW]), sent=times,
          echo=echoes, when=times, told=st.sampled_from(TOLD))
    def forged(self, kind: Kind, sent: int, echo: Echo | None, when: int, told: dict[str, str]) -> None:
        """In the session's own name."""
        number = self.end.number
        assert number is not None
        payload: Any = when if kind is Kind.START else "no" if kind in (Kind.REFUSE, Kind.RENEW) else told
        packet = Packet(kind, number, 0, sent, echo, payload)
        before, heard = self.state(), self.end.met > 0 and not self.end.silent(self.now) and not self.end.meeting
        self.tell(packet, len(encode(packet)))
        if heard:
            assert self.state() == before

    @invariant()
    def is_bounded(self) -> None:
        end = self.end
        assert len(end._welcomed) <= MOST_WELCOMED
        assert end.failure is None or len(end.failure) < 2000
        assert end.start_ns is None or abs(end.start_ns) < 2**64
        assert end.liveness._first_ns <= 60_000_000_000
        said = end.bye("done", self.now)
        assert len(said) <= 1 + (end.master and end.meeting), "while it asks anew, to the session before as well"


class OneMaster(OneEnd):
    master = True


class OneSlave(OneEnd):
    master = False


TestMaster = OneMaster.TestCase
TestSlave = OneSlave.TestCase
TestMaster.settings = TestSlave.settings = settings(max_examples=25, stateful_step_count=30)


@pytest.mark.fuzz
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("machine", [OneMaster, OneSlave])
def test_thousands_of_lives_raise_nothing_and_keep_what_they_have(machine: type[OneEnd]) -> None:
    long = settings(max_examples=2000, stateful_step_count=60, derandomize=False)
    run_state_machine_as_test(machine, settings=long)


@pytest.mark.fuzz
@pytest.mark.timeout(3600)
@settings(max_examples=20_000, derandomize=False)
@given(anything, st.integers(0, 12))
def test_many_more_bytes_raise_nothing_and_come_back_as_they_are(data: bytes, width: int) -> None:
    keeps_its_word(data, width)


@settings(max_examples=50)
@given(st.sampled_from("ms"), st.booleans(), st.lists(st.tuples(anything, st.integers(0, 2**31)), max_size=30))
def test_no_datagrams_at_any_time_raise_at_an_end(e: str, running: bool, several: list[tuple[bytes, int]]) -> None:
    session = Session(master=e == "m", manifest=MANIFEST, number=OURS if running or e == "m" else None)
    if running:
        begin(session, 10**12, 10**12)
        session.take_data(10**12)
    end, now = Endpoint(fuzzed(100), e, session), 10**12
    for data, step in several:
        now += step
        replies = end.receive(data, now)
        assert len(replies) <= 1
        assert e == "m" or sum(map(len, replies)) <= len(data)
        end.session.due(now)
    assert running is False or end.session.number == OURS or now - 10**12 > RENEW_NS
