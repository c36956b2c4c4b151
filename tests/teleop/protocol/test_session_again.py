"""Sessions after the first: who asks anew and when, whose grid of ticks it is, what is told beside a manifest."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.protocol import states
from teleop.protocol.estimates import LEAD_NS, ROUNDS
from teleop.protocol.manifest import EVERY, MOST_EVERY, TICK_0
from teleop.protocol.packet import MOST_CONTROL, Code, Echo, Kind, Packet, encode
from teleop.protocol.session import AGAIN_NS, FIRST_NS, RENEW_NS, REPEATED, Session
from teleop.protocol.states import CARRIES_DATA, MASTER, MEETING, SLAVE, Cause, SessionEvent, SessionState, Table
from tests.teleop.protocol.diagrams import diagrams
from tests.teleop.protocol.ends import packet_in
from tests.teleop.protocol.test_session import MANIFEST, MS, Talk, hello, start_of, started


def welcome(to: Packet, now: int, manifest: dict[str, str] = MANIFEST, **told: str) -> Packet:
    """The answer of a slave whose clock shows `now`."""
    return Packet(Kind.WELCOME, to.session, 0, now, Echo(to.sent_ns, 0), {**manifest, **told})


def asked(data: list[bytes]) -> Packet:
    (one,) = map(packet_in, data)
    assert one.kind is Kind.HELLO
    return one


# Silence


@pytest.mark.parametrize("leaves", ["", "master", "slave"])
def test_a_master_that_hears_nothing_asks_anew_under_the_next_number_and_both_keep_their_grid_or_hear_who_leaves(
    leaves: str
) -> None:
    talk = Talk().run(2000 * MS)
    before = talk.master.start_ns
    talk.lost = lambda _packet: True
    talk.run(2000 * MS + RENEW_NS // 2)
    assert (talk.master.number, talk.master.meeting) == (7, False)
    talk.run(2000 * MS + RENEW_NS + 60 * MS)
    assert (talk.master.number, talk.master.meeting, talk.slave.number) == (8, True, 7)
    if leaves:  # the master is under the next number already, the slave still under the one before
        gone, left = (talk.master, talk.slave) if leaves == "master" else (talk.slave, talk.master)
        for data in gone.bye("the bus is gone", talk.now):
            left.receive(packet_in(data), talk.now)
        assert left.farewell == "the bus is gone"
        return
    talk.run(8000 * MS)
    assert (talk.master.number, talk.master.met, talk.slave.met) == (8, 1, 1)  # it goes on asking under that number
    talk.lost = lambda _packet: False
    talk.run(9000 * MS)
    for end in (talk.master, talk.slave):
        assert (end.number, end.met, end.start_ns, end.joined) == (8, 2, before, False)


def test_the_number_after_the_last_is_zero_and_a_farewell_of_a_session_long_gone_is_not_heard() -> None:
    talk = Talk(Session(master=True, manifest=MANIFEST, number=2**64 - 1)).run(1000 * MS)
    assert talk.slave.number == 2**64 - 1
    talk.messages = False
    talk.run(3000 * MS)
    assert talk.master.number == talk.slave.number == 0
    assert talk.slave.met == 2
    talk.messages = True
    talk.run(4000 * MS)
    assert not talk.master.meeting
    talk.master.receive(Packet(Kind.BYE, 2**64 - 1, 0, 0, None, "of before"), talk.now)
    assert talk.master.farewell is None


def test_a_session_that_goes_by_packets_is_never_renewed() -> None:
    talk = Talk(Session(master=True, manifest=MANIFEST, number=7, heals=False),
                Session(master=False, manifest=MANIFEST, heals=False), messages=False)
    talk.run(10_000 * MS)
    assert (talk.master.number, talk.master.met) == (7, 1)
    assert talk.slave.receive(hello(8), talk.now) == []


def test_a_session_without_any_message_has_twice_the_time_of_the_one_before_for_the_link_may_be_that_long() -> None:
    talk = Talk(messages=False, there=5 * MS, back=5 * MS)
    began: list[int] = []
    for _ in range(600):
        talk.run(talk.now + 100 * MS)
        if talk.master.met > len(began):
            began.append(talk.now)
    patience = [b - a for a, b in pairwise(began)]
    assert patience[0] == pytest.approx(FIRST_NS, abs=500 * MS)
    assert all(b == pytest.approx(2 * a, rel=0.2) for a, b in pairwise(patience))
    talk.master.take_data(talk.now)
    assert not talk.master.silent(talk.now + RENEW_NS)
    assert talk.master.silent(talk.now + RENEW_NS + 1)


# Whose grid


def test_a_master_that_comes_to_a_running_slave_takes_its_grid_and_a_slave_to_a_running_master_is_told_it() -> None:
    talk = Talk(slave_ahead=-123_456_789).run(2000 * MS)
    grid = talk.slave.start_ns
    talk.master = Session(master=True, manifest=MANIFEST, number=1000)
    talk.run(4000 * MS)
    assert talk.master.joined
    assert (talk.slave.number, talk.slave.start_ns, talk.slave.met) == (1000, grid, 2)
    assert talk.master.start_ns == (grid or 0) - talk.slave_ahead
    talk = Talk().run(2000 * MS)
    grid = talk.master.start_ns
    talk.slave, talk.slave_ahead = Session(master=False, manifest=MANIFEST), 5 * 10**12  # on another machine
    talk.run(4000 * MS)
    assert (talk.slave.joined, talk.master.joined) == (True, False)
    assert (talk.master.start_ns, talk.slave.start_ns) == (grid, (grid or 0) + talk.slave_ahead)


@settings(max_examples=12)
@given(step=st.integers(-3 * 10**9, 10**10), there=st.integers(0, 60), back=st.integers(0, 60))
def test_of_two_grids_that_came_apart_the_one_that_is_further_on_counts_for_no_tick_can_be_taken_back(
    step: int, there: int, back: int
) -> None:
    """A force would be held, and nothing computed, for as long as an end waited for its own ticks to come again."""
    talk = Talk(there=20 * MS, back=20 * MS).run(1000 * MS)
    before = talk.master.start_ns, talk.slave.start_ns
    talk.there, talk.back, talk.slave_ahead, talk.messages = there * MS, back * MS, step, False
    talk.run(3500 * MS - min(0, step))  # a clock that was set back is silent for longer
    assert talk.slave.met >= 2
    assert (talk.master.start_ns or 0) <= (before[0] or 0)
    assert (talk.slave.start_ns or 0) <= (before[1] or 0) + 1
    apart = (talk.slave.start_ns or 0) - (talk.master.start_ns or 0) - step
    assert abs(apart) <= (there + back + 4) * MS // 2  # the uncertainty of the clock offset


# What waited


def test_answers_to_what_waited_at_a_slave_that_stood_still_are_no_measurement() -> None:
    """They were stamped when they came, and sent seconds later: half of that would be the error of the offset."""
    master = Session(master=True, manifest=MANIFEST, number=7)
    asked_at = [asked(master.due(i * 50 * MS)) for i in range(100)]
    now = 5000 * MS
    replies: list[bytes] = []
    for one in asked_at[-40:] + asked_at[:-40]:  # and out of order
        replies += master.receive(welcome(one, one.sent_ns + 1000 * MS), now)  # its clock is a second ahead
    assert master.meeting
    while master.meeting:
        one = asked(replies[-1:])
        now += 10 * MS
        replies = master.receive(welcome(one, now - 5 * MS + 1000 * MS), now)
    assert master.rtt_ns == 10 * MS
    assert master.offset_ns == 1000 * MS
    assert now < 5000 * MS + 10 * ROUNDS * MS + 1


def test_a_link_that_jitters_does_not_keep_them_from_meeting() -> None:
    took = []
    for seed in range(20):
        dice = Random(seed)
        master = Session(master=True, manifest=MANIFEST, number=7)
        replies, now, rounds = master.due(0), 0, 0
        while master.meeting:
            now += dice.randrange(200 * MS)
            rounds += 1
            replies = master.receive(welcome(asked(replies[-1:]), now), now)
        took.append(rounds)
    assert min(took) >= ROUNDS
    assert max(took) <= 8 * ROUNDS


# What is told beside the manifest


def welcomed(**entries: str) -> tuple[Session, list[bytes]]:
    """A master after a whole exchange with a slave that says this beside its manifest, and its last replies."""
    master = Session(master=True, manifest=MANIFEST, number=7)
    for _ in range(ROUNDS):
        replies = master.receive(welcome(hello(7)._replace(sent_ns=10), 0, **entries), 10)
    return master, replies


def test_a_rate_that_is_none_is_read_as_one_and_a_grid_of_a_clock_that_nobody_has_is_not_joined() -> None:
    for text in ("--5", "-", "", "5-", "1e3", "0x1", "²", "٣", " 4", "9" * 30, "-0", "0", "1001", "-" * 19):
        slave = started(Session(master=False, manifest=MANIFEST), 1, 0, **{EVERY: text})
        master, _ = welcomed(**{EVERY: text})
        assert (slave.peer_every, master.peer_every, master.meeting) == (1, 1, False), text
    for text in ("--5", "x", "", "0x1", "²", "9" * 19, "-" * 19, "-" + "9" * 18, str(2**61 + 1)):
        master, replies = welcomed(**{TICK_0: text})
        assert master.joined is (text == "-" + "9" * 18), text
        assert [packet_in(data).kind for data in replies], "what it sends can be read"
        assert master.joined or master.start_ns == 10 + LEAD_NS


def test_the_rate_is_that_of_the_master_that_starts_and_not_of_one_that_only_asked() -> None:
    slave = started(Session(master=False, manifest=MANIFEST), 1, 0, **{EVERY: "2"})
    assert slave.peer_every == 2
    later = 2 * RENEW_NS
    assert slave.receive(hello(2, {**MANIFEST, EVERY: "5"}), later)
    assert slave.receive(hello(3, {**MANIFEST, EVERY: "7"}), later + 1)
    assert slave.peer_every == 2
    slave.receive(start_of(2, later), later)
    assert slave.peer_every == 5


@settings(max_examples=30)
@given(st.integers(0, 7900) | st.integers(8200, 9000), st.sampled_from([1, 7, MOST_EVERY]), st.booleans())
def test_no_answer_is_longer_than_its_hello_and_a_manifest_too_long_for_one_is_refused_where_it_is_written(
    length: int, every: int, running: bool
) -> None:
    manifest = {"k": "λ" * (length // 2), "": ""}
    master = Session(master=True, manifest=manifest, number=2**64 - 1, every=every)
    if length > 8000:
        with pytest.raises(ValueError, match="shorten"):
            master.due(-(2**62))
        return
    data = master.due(-(2**62))
    slave = Session(master=False, manifest=manifest, every=MOST_EVERY)
    if running:
        slave.start_ns = -(2**61)
    got = asked(data)
    assert len(data[0]) <= MOST_CONTROL
    (answer,) = slave.receive(got, 2**62, len(data[0]))
    assert len(answer) <= len(data[0])
    assert slave.receive(got, 2**62, len(encode(got))) == [], "nor to one as short as it can be"


# A session that is over for one end


@pytest.mark.parametrize("master", [True, False])
def test_an_end_that_the_other_has_not_heard_for_as_long_as_a_session_lives_is_in_none(master: bool) -> None:
    talk = Talk().run(2000 * MS)
    end = talk.master if master else talk.slave
    end.take_data(talk.now)
    end.take_echo(Echo(end.liveness.begun_ns, 0))
    end.take_echo(Echo(talk.now, RENEW_NS))
    assert end.carries_data
    end.take_echo(Echo(talk.now, RENEW_NS + 1))
    assert not end.carries_data
    assert "nothing of this end arrived" in end.ended.why
    (data,) = end.due(talk.now)
    packet = packet_in(data)
    assert (packet.kind, packet.session) == ((Kind.HELLO, 8) if master else (Kind.RENEW, 7))
    assert end.due(talk.now + 1) == [], "and again after a while"


@pytest.mark.parametrize("master", [True, False])
def test_a_session_whose_first_second_was_lost_either_way_is_over_when_something_comes(master: bool) -> None:
    """A long link is another thing: over that the first message comes late, and was sent in time."""
    for late, answers in ((0, False), (0, True), (1, False), (1, True)):
        talk = Talk(messages=False)
        talk.run(1000 * MS)
        end = talk.master if master else talk.slave
        sent, now = end.liveness.begun_ns + RENEW_NS + late, end.liveness.begun_ns + 2 * RENEW_NS
        end.take_data(now, end.liveness.begun_ns if answers else sent)
        end.take_echo(Echo(sent if answers else end.liveness.begun_ns, 0))
        assert (end.ended is not None) == bool(late)


def test_a_slave_that_asks_for_another_session_has_it_and_its_asking_for_the_one_before_changes_nothing() -> None:
    talk = Talk().run(2000 * MS)
    talk.slave.end("the session is over: its end stood still")
    (asks,) = talk.slave.due(talk.now)
    packet = packet_in(asks)
    for _ in range(3):
        assert talk.master.receive(packet, talk.now) == []
        assert talk.master.ended.why.startswith("the session is over")
        talk.master.due(talk.now)
        assert (talk.master.number, talk.master.meeting) == (8, True)
    talk.run(talk.now + 500 * MS)
    assert talk.master.number == talk.slave.number == 8
    assert talk.master.receive(packet, talk.now) == []
    assert (talk.master.ended, talk.slave.ended) == (None, None)
    assert not talk.slave.belongs(packet._replace(session=8), talk.now), "only a slave says it"


def test_neither_end_takes_another_session_before_it_has_let_go() -> None:
    talk = Talk().run(2000 * MS)
    talk.master.zero_force = talk.slave.zero_force = False
    talk.master.end("the session is over: as a test has it")
    talk.run(talk.now + 500 * MS)
    assert not talk.master.meeting
    talk.master.zero_force = True
    talk.run(talk.now + 500 * MS)
    assert talk.master.meeting
    assert talk.slave.ended.why.startswith("the session is over"), "the master's next number tells it"
    assert talk.slave.number == 7
    talk.slave.zero_force = True
    talk.run(talk.now + 500 * MS)
    assert talk.master.number == talk.slave.number == 8
    assert (talk.master.meeting, talk.slave.ended) == (False, None)


def test_a_master_that_hears_and_is_never_heard_asks_for_another_session_after_twice_the_time_of_one_way() -> None:
    talk = Talk(messages=False).run(1000 * MS)
    master = talk.master
    for now in range(master.liveness.begun_ns, master.liveness.begun_ns + 2 * FIRST_NS + 1, RENEW_NS // 4):
        master.take_data(now, now)
        master.judge(now)
        assert master.ended is None
    master.judge(master.liveness.begun_ns + 2 * FIRST_NS + 1)
    assert master.ended.why.endswith("nothing of this end arrives at the other")


# A turn, and the clutch


@pytest.mark.parametrize("first", ["master", "slave"])
def test_ends_that_are_turned_one_after_the_other_meet_again_when_both_are(first: str) -> None:
    """Nothing stops, however long the other takes: a manifest that differs is no reason to leave a run."""
    talk = Talk().run(2000 * MS)
    other = "slave" if first == "master" else "master"
    for end, until in ((first, 5000), (other, 8000)):
        session = getattr(talk, end)
        session.end(Code.TURN)
        session.manifest = {**MANIFEST, "law": "another"}
        talk.run(until * MS)
        assert (talk.master.met, talk.slave.met) == ((1, 1) if end == first else (2, 2))
    assert talk.master.failure is talk.slave.failure is None
    assert talk.master.farewell is talk.slave.farewell is None
    assert talk.master.number == talk.slave.number


def test_a_reason_is_known_by_its_code_and_by_its_sentence_where_an_older_end_sends_none() -> None:
    for code, sentence, cause in (
            (Code.CLUTCH, "words of another release", Cause.ORDERED), (Code.NONE, "the clutch is open", Cause.ORDERED),
            (Code.NONE, "a turn", Cause.ORDERED), (Code.NONE, "nothing came for 1 s", Cause.SESSION_OVER),
            (99, "a reason that is not known here", Cause.SESSION_OVER)):
        master = Talk().run(2000 * MS).master
        master.receive(Packet(Kind.RENEW, master.number or 0, code, 0, None, sentence), 2000 * MS)
        assert master.ended == (cause, f"the session is over: {sentence}")
    for code, sentence, left in (
            (Code.FINISHED, "words of another release", False), (Code.NONE, "finished", False),
            (Code.NONE, "the bus is gone", True), (99, "finished", True)):
        slave = Talk().run(2000 * MS).slave
        slave.receive(Packet(Kind.BYE, slave.number or 0, code, 0, None, sentence), 2000 * MS)
        assert (slave.farewell, slave.left) == (sentence, left)


@pytest.mark.parametrize("holds", ["master", "slave"])
def test_no_session_follows_while_either_end_may_not_renew_it_and_an_order_to_the_slave_is_told_to_the_master(
    holds: str
) -> None:
    """It was told in words alone."""
    talk = Talk().run(2000 * MS)
    getattr(talk, holds).renews = False
    talk.slave.end(Code.CLUTCH)
    talk.run(9000 * MS)
    assert (talk.master.met, talk.slave.met) == (1, 1)
    assert talk.master.ended == (Cause.ORDERED, f"the session is over: {Code.CLUTCH.sentence}")
    getattr(talk, holds).renews = True
    talk.run(11_000 * MS)
    assert (talk.master.met, talk.slave.met) == (2, 2)


# The tables of a session's states: what they allow, and that the diagrams of the README are made from them


def reached(table: Table, first: SessionState) -> set[SessionState]:
    found, waiting = {first}, [first]
    while waiting:
        state = waiting.pop()
        for (start, _), then in table.items():
            if start is state and then not in found:
                found.add(then)
                waiting.append(then)
    return found


def test_the_diagrams_of_the_readme_are_those_of_the_tables() -> None:
    text = (Path(states.__file__).parent / "README.md").read_text()
    assert diagrams() in text, "write what `python -m tests.teleop.protocol.diagrams` prints into the README"


def test_every_state_of_a_table_can_be_reached_and_all_but_a_refusal_be_left_and_the_two_use_all_there_are() -> None:
    for table, first, is_master in ((MASTER, SessionState.ASKING, True), (SLAVE, SessionState.LISTENING, False)):
        named = {state for state, _ in table} | set(table.values())
        assert reached(table, first) == named
        for state in named - {SessionState.REFUSED}:
            assert any(then is not state for (start, _), then in table.items() if start is state)
            assert SessionState.RUNNING in reached(table, state)
        assert not [event for state, event in table if state is SessionState.REFUSED]
        assert REPEATED[is_master].keys() <= named, "nothing is repeated in a state that the role does not have"
    both = {**MASTER, **SLAVE}
    assert {state for state, _ in both} | set(both.values()) == set(SessionState)
    assert {event for _, event in both} == set(SessionEvent)
    assert not CARRIES_DATA & MEETING
    assert set(SessionState) - CARRIES_DATA - MEETING == {SessionState.OVER}


@pytest.mark.parametrize(("master", "table"), [(True, MASTER), (False, SLAVE)])
def test_an_event_without_a_line_in_the_table_changes_nothing(master: bool, table: Table) -> None:
    for state in SessionState:
        for event in SessionEvent:
            session = Session(master=master, manifest=MANIFEST, number=7)
            session.state = state
            allowed = (state, event) in table
            assert session.take(event) is allowed
            assert session.state is table.get((state, event), state)
            assert session.carries_data is (session.state in CARRIES_DATA and allowed)


def test_a_start_that_comes_while_the_master_still_asks_is_not_taken_for_the_answer_to_its_own() -> None:
    master = Session(master=True, manifest=MANIFEST, number=7)
    master.due(0)
    master.receive(Packet(Kind.START, 7, 0, 0, None, 5), 1)  # forged, or out of order
    for _ in range(ROUNDS):
        master.receive(Packet(Kind.WELCOME, 7, 0, 0, Echo(10, 0), MANIFEST), 10)
    assert master.state is SessionState.STARTING
    (again,) = map(packet_in, master.due(10 + AGAIN_NS))
    assert again.kind is Kind.START, "it is repeated until the slave answers"


def test_an_end_that_has_refused_a_run_takes_up_no_other() -> None:
    slave = Session(master=False, manifest=MANIFEST)
    slave.receive(Packet(Kind.HELLO, 1, 0, 0, None, MANIFEST), 10)
    slave.receive(hello(2, {**MANIFEST, "scene": "another"}), 20)
    assert slave.state is SessionState.REFUSED
    assert slave.receive(Packet(Kind.START, 1, 0, 0, Echo(10, 0), 5), 30) == []
    assert (slave.met, slave.start_ns) == (0, None)
    assert "scene" in str(slave.failure)
