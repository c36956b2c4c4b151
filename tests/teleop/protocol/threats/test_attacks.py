"""The published attacks on teleoperated surgery, and the defects of the Raven II's receiver: what they get here.

What "without keys" stands in the name of is not withstood: it is what one gets who can read the link and write to it,
and why a link beyond this machine needs keys. With them nothing that was forged, changed or replayed comes as far as an
endpoint (tests/teleop/protocol/secure, tests/live/test_sealed.py); to delay and to drop is left. That an end keeps to
the address of its peer is a matter of sockets: tests/live/test_shell.py, tests/live/test_ends.py.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from math import isfinite
from typing import Any

import numpy as np
import pytest

from teleop import Cap, Direct, Fixed
from teleop.protocol.endpoint import Endpoint, Stepped
from teleop.protocol.estimates import ROUNDS
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Echo, Kind, Packet, decode, encode
from teleop.protocol.session import RENEW_NS, Session
from teleop.protocol.states import Cause
from tests.teleop.protocol.ends import MS, START, Both, met, packet_in, scene
from tests.teleop.protocol.threats.hands import (
    LINK,
    MANIFEST,
    OTHER,
    OURS,
    PLAYOUTS,
    STILL,
    TAKEOVER,
    WATCHED,
    at,
    control,
    data,
    handed_on,
    ticks,
)


@pytest.mark.parametrize("attack", ["delay", "drop", "reorder", "repeat", "all"])
def test_whoever_delays_drops_reorders_and_repeats_draws_no_energy_from_the_link(attack: str) -> None:
    """Keys do not keep anybody from that. The law claims to be passive over whatever link, this one among them."""
    dice = random.Random(1)

    def change(_e: str, _k: int, datagram: bytes) -> list[tuple[int, bytes]]:
        after = {"delay": [10 + 40 * (_k > 100)], "drop": [10] * (dice.random() > 0.5),
                 "reorder": [dice.randint(1, 60)], "repeat": [10, dice.randint(10, 200)],
                 "all": [dice.randint(1, 60) for _ in range(dice.randint(0, 2))]}[attack]
        return [(ticks, datagram) for ticks in after]

    both = handed_on(change)
    assert both.trace()["E_link"].min() > -1e-9
    for e in "ms":
        numbers = [number for number in both.played[e] if number >= 0]
        assert len(numbers) > 40
        assert all(one < other for one, other in pairwise(numbers))  # each once, and none out of order
        assert all(isfinite(force) for force, in both.held[e])


@pytest.mark.parametrize("playout", PLAYOUTS, ids=str)
def test_raven_the_good_packet_after_a_gap_is_played_as_long_as_the_session_lives(playout: Any) -> None:
    kept = replace(WATCHED, playout=playout)
    for gap in (1, 14, 300, 900, 1090):
        end = met(kept)["s"]
        later = playout.ticks(MS) if isinstance(playout, Fixed) else 1
        ticks(end, range(11), lambda k: [data(k - 1)] if k else [])
        played = ticks(end, range(11, gap + 60), lambda k, gap=gap: [data(k - 1)] if k > 10 + gap else [])
        if gap < 1000:
            assert played[10 + gap + later - 11 :] == list(range(10 + gap, gap + 60 - later)), gap
        else:
            assert max(played[30:]) == -1
            assert end.session.ended.cause is Cause.SESSION_OVER


@pytest.mark.parametrize("playout", PLAYOUTS, ids=str)
def test_raven_one_huge_sequence_number_does_not_block_what_follows(playout: Any) -> None:
    """Of this session and well made: it is not played, and whatever honest comes after it is, from the next tick on."""
    kept = replace(WATCHED, playout=playout)
    honest = Both(kept).run()
    for seq, cause in ((2**32 - 1, "old"), (10**9, "early")):
        shot = {e: data(seq, to=e) for e in "ms"}
        both = Both(kept, intruder=lambda k, _both, shot=shot: [*shot.items()] if k in (0, 50) else []).run()
        assert both.played == honest.played
        assert both.rows == honest.rows
        for e in "ms":
            assert dict(both.ends[e].rejected) == {cause: 2}
            assert both.ends[e].link.way.count == honest.ends[e].link.way.count


def test_raven_one_huge_sequence_number_does_not_block_a_stepped_end() -> None:
    """Ends that step together are never two ticks apart."""
    for seq in (2, 3, 10**9, 2**31, 2**32 - 1):
        inbox = Stepped(None)
        stepped = Endpoint(WATCHED, "s", met(WATCHED)["s"].session, inbox)
        stepped.tick(0, at(0), STILL)
        for one in (seq, 0):
            stepped.receive(data(one), at(0))
        assert (inbox.has(0), inbox.has(seq), sum(stepped.rejected.values())) == (True, False, 1), seq
        assert stepped.tick(1, at(1), STILL).played == 0


@pytest.mark.parametrize("playout", PLAYOUTS, ids=str)
def test_raven_no_reset_of_the_sequence_makes_old_numbers_fresh_again(playout: Any) -> None:
    """A second HELLO and START, of this session number or another, and all old packets behind them."""
    kept = replace(WATCHED, playout=playout)
    for session in (OURS, OTHER):
        end = met(kept)["s"]
        before = ticks(end, range(1, 101), lambda k: [data(k - 1)])
        replies = [reply for kind, payload in ((Kind.HELLO, manifest_of(kept)), (Kind.START, at(101)), (Kind.START, 0))
                   for reply in end.receive(control(kind, payload, session), at(101))]
        kinds = [packet.kind for reply in replies if isinstance(packet := decode(reply, 1), Packet)]
        assert kinds == ([Kind.START, Kind.START] if session == OURS else [])  # it is said once more that it has come
        assert (end.session.number, end.session.start_ns, end.session.met) == (OURS, START, 1)
        after = ticks(end, range(101, 161), lambda k: [*(data(old, 5.0) for old in range(100)), data(k - 1)])
        numbers = [number for number in before + after if number >= 0]
        assert all(one < other for one, other in pairwise(numbers))
        assert max(after[:-1]) < after[-1] == 160 - (playout.ticks(MS) if isinstance(playout, Fixed) else 1)


@pytest.mark.parametrize("session", [OURS, OTHER])
def test_a_second_master_takes_nothing_over_and_moves_nothing_of_a_run(session: int, plain: Both) -> None:
    words = [(e, control(kind, payload, session)) for kind, payload in TAKEOVER for e in "ms"
             if session == OTHER or kind is not Kind.BYE]
    both = Both(WATCHED, intruder=lambda k, _both: words if k % 4 == 0 else []).run()
    assert both.rows == plain.rows
    assert both.sent == plain.sent
    for e in "ms":
        end = both.ends[e].session
        assert (end.number, end.start_ns, end.farewell, end.failure) == (OURS, START, None, None)
        assert session == OURS or dict(both.ends[e].rejected) == {"session": len(TAKEOVER) * WATCHED.ticks // 4}


def test_what_is_held_up_for_good_is_played_late_and_shows_in_the_delays() -> None:
    """Newest wins sets no bound to a message's age: a delay that lasts is a longer link, not a silence."""
    both = handed_on(lambda _e, k, datagram: [(10 if k < 100 else 110, datagram)])
    way = both.ends["s"].link.way
    assert (way.least, way.most) == (10 * MS, 110 * MS)
    assert both.played["s"][-1] == WATCHED.ticks - 1 - 110


def test_without_keys_content_that_was_checksummed_anew_is_believed_within_cap_and_slew() -> None:
    limit = Cap(f_max=2.0, slew=200.0)

    def change(_e: str, k: int, datagram: bytes) -> list[tuple[int, bytes]]:
        packet = packet_in(datagram)
        return [(10, encode(packet._replace(payload=((-1) ** (k // 50) * 1e6,))))]

    both = handed_on(change, replace(WATCHED, cap=limit))
    for e in "ms":
        force = np.array([0.0, *(f for f, in both.held[e])])
        assert both.played[e][-1] == WATCHED.ticks - 11
        assert np.abs(force).max() == limit.f_max
        assert np.abs(np.diff(force)).max() <= 200.0 * 1e-3 + 1e-12


def test_without_keys_numbers_beyond_all_bounds_end_the_run_and_are_not_held() -> None:
    end = met(scene(Direct(), link=LINK))["s"]
    end.receive(data(0, payload=(1e308, 0.0)), at(0))
    end.tick(0, at(0), STILL)
    assert end.force_failed is None
    end.tick(1, at(1), STILL)
    assert end.force_failed == "f_s"


def test_one_number_beyond_all_bounds_does_not_silence_an_end_for_good() -> None:
    """The cap keeps the force finite, the message is finite, and the ledger is not any more."""
    end = met(replace(WATCHED, cap=Cap(f_max=5.0, slew=1000.0)))["s"]
    end.receive(data(0, 1e200), at(0))
    answers = [end.tick(k, at(k), STILL) for k in range(50)]
    assert end.force_failed is None
    assert all(abs(answer.force[0]) <= 5.0 for answer in answers)
    assert all(answer.datagram is not None for answer in answers)
    assert isinstance(decode(answers[-1].datagram or b"", 1), Packet)


def test_without_keys_a_forged_farewell_with_the_right_session_number_stops_the_run() -> None:
    """It fails towards zero force: what an end does when the other leaves is to let go."""
    end = met(WATCHED)["s"]
    assert end.receive(control(Kind.BYE, "emergency stop"), at(0)) == []
    assert end.session.farewell == "emergency stop"


def test_a_mirror_on_the_link_changes_nothing_of_a_run(plain: Both) -> None:
    both = Both(WATCHED, intruder=lambda k, both: [(e, both.sent[e][k - 1]) for e in "ms" if k]).run()
    assert both.rows == plain.rows
    assert both.sent == plain.sent
    assert dict(both.ends["s"].rejected) == {"direction": WATCHED.ticks - 1}


def test_with_keys_a_record_that_is_thrown_back_at_its_sender_is_dropped_by_the_tunnel(
    associated: Callable[[], Any]
) -> None:
    """The two ways of an association have keys of their own."""
    master, slave = associated()
    for end, other in ((master, slave), (slave, master)):
        record = end.send(b"forth")
        assert record is not None
        assert end.receive(record, 0)[0] == []
        assert sum(end.dropped.values()) == 1
        assert other.receive(record, 0)[0] == [b"forth"], "and it was a good one"


def test_packets_for_later_do_not_keep_honest_ones_out() -> None:
    """No more than one of each number, and none of them further ahead than the watchdog's timeout."""
    end = met(WATCHED)["s"]
    for i in range(1000):
        end.receive(data(10 + i % 40, 0.0), at(0))
    assert ticks(end, range(1, 60), lambda k: [data(k - 1)]) == list(range(59))
    inbox: Any = end.inbox
    assert (inbox.refused, inbox.duplicates) == (0, 1000)


def test_without_keys_packets_for_later_fill_the_inbox_where_a_second_has_more_ticks_than_it_has_room() -> None:
    fast = scene(link=LINK, dt=1e-4, duration=0.1)
    end, tick = met(fast)["s"], 100_000
    for seq in range(100, 9000):
        end.receive(data(seq, 0.0), START)
    played = []
    for k in range(1, 400):
        end.receive(data(k - 1), START + k * tick)
        played.append(end.tick(k, START + k * tick, STILL).played)
    inbox: Any = end.inbox
    assert inbox.refused > 3000
    assert end.rejected["early"] > 900
    assert played[100:] == list(range(100, 399)), "what was forged, each at its tick"


def test_a_forged_time_of_sending_is_no_round_trip_and_changes_nothing_of_the_run(plain: Both) -> None:
    def change(e: str, k: int, datagram: bytes) -> list[tuple[int, bytes]]:
        packet = packet_in(datagram)
        return [(10, encode(packet._replace(sent_ns=(-1) ** k * (2**63 - 1)), len(datagram)) if e == "s" else datagram)]

    both = handed_on(change)
    assert both.rows == plain.rows
    assert both.ends["m"].link.rtt.count == 0
    assert plain.ends["m"].link.rtt.count > 300
    assert both.ends["s"].session.start_ns == START


def test_without_keys_numbers_that_climb_are_believed_no_further_than_a_timeout_ahead(plain: Both) -> None:
    """Not from the newest one that came, so none of them is a step for the next."""
    climb = [("s", data(seq)) for seq in range(1000, 6000, 1000)]
    both = Both(WATCHED, intruder=lambda k, _both: climb if k == 50 else []).run()
    assert both.rows == plain.rows
    assert dict(both.ends["s"].rejected) == {"early": 5}
    assert both.ends["s"].link.way.count == plain.ends["s"].link.way.count


def test_without_keys_a_stranger_who_starts_a_session_has_the_slave_as_long_as_he_sends_messages() -> None:
    slave = Endpoint(WATCHED, "s", Session(master=False, manifest=MANIFEST))
    ours = Session(master=True, manifest=MANIFEST, number=OURS).due(0)[0]
    slave.receive(Session(master=True, manifest=MANIFEST, number=OTHER).due(0)[0], START)
    slave.receive(control(Kind.START, START, OTHER, echo=Echo(START, 0)), START)
    assert slave.session.number == OTHER
    for i in range(10):
        now = START + i * RENEW_NS // 2
        slave.receive(data(i * 500, session=OTHER), now)
        slave.tick(i * 500, now, STILL)
        assert slave.receive(ours, now) == []
        assert slave.receive(ours, now + RENEW_NS // 4) == []
    assert slave.receive(ours, now + RENEW_NS + 1)


def test_without_keys_a_stranger_who_asks_for_another_run_sends_a_waiting_slave_home() -> None:
    slave = Endpoint(WATCHED, "s", Session(master=False, manifest=MANIFEST))
    slave.receive(control(Kind.HELLO, {"scene": "mine"}, OTHER), 0)
    assert slave.session.failure is not None


@pytest.mark.parametrize("again", [True, False], ids=["started anew", "running"])
def test_a_recorded_session_cannot_be_played_to_a_slave_be_it_started_anew_or_running(plain: Both, again: bool) -> None:
    """Nothing in it is stale to a slave that remembers nothing; but its START echoes another one's WELCOME."""
    master, first = Session(master=True, manifest=MANIFEST, number=OURS), Session(master=False, manifest=MANIFEST)
    said, now = master.due(START - MS), START - MS
    while first.start_ns is None:
        for word in said[-1:]:
            packet = packet_in(word)
            for reply in first.receive(packet, now):
                answer = packet_in(reply)
                said += master.receive(answer, now)
        now += 1
    slave = Endpoint(WATCHED, "s", Session(master=False, manifest=MANIFEST))
    if not again:
        slave = met(WATCHED)["s"]
        slave.session.number = OTHER
    for word in said:
        slave.receive(word, START - MS // 2)
    assert slave.session.number == (None if again else OTHER)
    assert ticks(slave, range(1, 101), lambda k: [plain.sent["m"][k - 1]]) == [-1] * 100



def test_a_master_is_not_stopped_by_a_forged_clock() -> None:
    master = Endpoint(WATCHED, "m", Session(master=True, manifest=MANIFEST, number=OURS))
    for _ in range(ROUNDS):
        master.receive(control(Kind.WELCOME, MANIFEST, sent_ns=2**63 - 1, echo=Echo(-(2**63), 0)), START)
