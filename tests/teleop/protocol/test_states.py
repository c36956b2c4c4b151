"""The tables of a session's states: what they allow, and that the diagrams of the README are made from them."""

from __future__ import annotations

from pathlib import Path

import pytest

from teleop.protocol import states
from teleop.protocol.estimates import ROUNDS
from teleop.protocol.packet import Echo, Kind, Packet, decode
from teleop.protocol.session import AGAIN_NS, REPEATED, Session
from teleop.protocol.states import CARRIES_DATA, MASTER, MEETING, SLAVE, SessionEvent, SessionState, Table

MANIFEST = {"scene": "canonical", "k_e": "5000.0"}


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
    assert states.diagrams() in text, "write what `python -m teleop.protocol.states` prints into the README"


@pytest.mark.parametrize(("table", "first"), [(MASTER, SessionState.ASKING), (SLAVE, SessionState.LISTENING)])
def test_every_state_of_a_table_can_be_reached_and_all_but_a_refusal_be_left(
    table: Table, first: SessionState
) -> None:
    named = {state for state, _ in table} | set(table.values())
    assert reached(table, first) == named
    for state in named - {SessionState.REFUSED}:
        assert any(then is not state for (start, _), then in table.items() if start is state)
        assert SessionState.RUNNING in reached(table, state)
    assert not [event for state, event in table if state is SessionState.REFUSED]


def test_the_two_roles_use_every_state_and_every_event() -> None:
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


@pytest.mark.parametrize(("master", "table", "first"), [
    (True, MASTER, SessionState.ASKING), (False, SLAVE, SessionState.LISTENING)])
def test_nothing_is_repeated_in_a_state_that_the_role_does_not_have(
    master: bool, table: Table, first: SessionState
) -> None:
    assert REPEATED[master].keys() <= reached(table, first)


def test_a_start_that_comes_while_the_master_still_asks_is_not_taken_for_the_answer_to_its_own() -> None:
    master = Session(master=True, manifest=MANIFEST, number=7)
    master.due(0)
    master.receive(Packet(Kind.START, 7, 0, 0, None, 5), 1)  # forged, or out of order
    for _ in range(ROUNDS):
        master.receive(Packet(Kind.WELCOME, 7, 0, 0, Echo(10, 0), MANIFEST), 10)
    assert master.state is SessionState.STARTING
    (again,) = [decode(data, 1) for data in master.due(10 + AGAIN_NS)]
    assert isinstance(again, Packet)
    assert again.kind is Kind.START, "it is repeated until the slave answers"


def test_an_end_that_has_refused_a_run_takes_up_no_other() -> None:
    slave = Session(master=False, manifest=MANIFEST)
    slave.receive(Packet(Kind.HELLO, 1, 0, 0, None, MANIFEST), 10)
    slave.receive(Packet(Kind.HELLO, 2, 0, 0, None, {"scene": "another"}), 20)
    assert slave.state is SessionState.REFUSED
    assert slave.receive(Packet(Kind.START, 1, 0, 0, Echo(10, 0), 5), 30) == []
    assert (slave.met, slave.start_ns) == (0, None)
    assert "scene" in str(slave.failure)
