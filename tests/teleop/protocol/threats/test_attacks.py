"""The published attacks on teleoperated surgery over ITP: what they get of two ends without keys."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from math import isfinite
from typing import Any

import numpy as np
import pytest

from teleop.laws.direct import Direct
from teleop.laws.pfra import PFRA
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.packet import Echo, Kind, Packet, Payload, decode, encode
from teleop.protocol.session import RENEW_NS, Session
from teleop.scene.playout import Fixed
from teleop.stages.force_cap import Cap
from tests.teleop.protocol.test_endpoint import MS, START, Both, met, scene
from tests.teleop.protocol.threats.hands import (
    LINK,
    MANIFEST,
    OTHER,
    OURS,
    STILL,
    TAKEOVER,
    WATCHED,
    at,
    control,
    data,
    gains,
    handed_on,
    ticks,
)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("attack", ["delay", "drop", "reorder", "repeat", "all"])
def test_whoever_delays_drops_reorders_and_repeats_draws_no_energy_from_the_link(attack: str, seed: int) -> None:
    """Keys do not keep anybody from that. The law claims to be passive over whatever link, this one among them."""
    dice = random.Random(seed)

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


def test_what_is_held_up_for_good_is_played_late_and_shows_in_the_delays() -> None:
    """Newest wins sets no bound to a message's age: a delay that lasts is a longer link, not a silence."""
    both = handed_on(lambda _e, k, datagram: [(10 if k < 100 else 110, datagram)])
    way = both.ends["s"].way
    assert (way.least, way.most) == (10 * MS, 110 * MS)
    assert both.played["s"][-1] == WATCHED.ticks - 1 - 110


def test_what_is_held_up_longer_than_a_fixed_playout_is_never_played() -> None:
    both = handed_on(lambda _e, k, datagram: [(10 if k < 100 else 110, datagram)],
                     replace(WATCHED, playout=Fixed(0.02)))
    assert max(both.played["s"]) == 99
    gain = gains(both)
    assert gain[100 + 20 - 1 + 51] < 1.0
    assert gain[-1] == 0.0
    assert both.held["s"][-1] == (0.0,)


def test_content_that_was_changed_and_not_checksummed_anew_is_refused() -> None:
    both = handed_on(lambda _e, _k, datagram: [(10, datagram[:24] + bytes(8) + datagram[32:])])
    assert max(both.played["s"]) == max(both.played["m"]) == -1
    assert set(both.ends["s"].rejected) == {"checksum"}


def test_without_keys_content_that_was_checksummed_anew_is_believed_within_cap_and_slew() -> None:
    limit = Cap(f_max=2.0, slew=200.0)

    def change(_e: str, k: int, datagram: bytes) -> list[tuple[int, bytes]]:
        packet = decode(datagram, 1)
        assert isinstance(packet, Packet)
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


@pytest.mark.parametrize(("kind", "payload"), TAKEOVER, ids=lambda value: str(value)[:20])
def test_a_second_master_of_another_session_takes_nothing_over(kind: Kind, payload: Payload, plain: Both) -> None:
    word = control(kind, payload, OTHER)
    both = Both(WATCHED, intruder=lambda _k, _both: [("m", word), ("s", word)]).run()
    assert both.rows == plain.rows
    for e in "ms":
        session = both.ends[e].session
        assert dict(both.ends[e].rejected) == {"session": WATCHED.ticks}
        assert (session.number, session.start_ns, session.farewell, session.failure) == (OURS, START, None, None)


@pytest.mark.parametrize(("kind", "payload"), TAKEOVER[:-1], ids=lambda value: str(value)[:20])
def test_a_second_master_of_the_same_session_number_moves_nothing_of_a_run(
    kind: Kind, payload: Payload, plain: Both
) -> None:
    word = control(kind, payload)
    both = Both(WATCHED, intruder=lambda _k, _both: [("m", word), ("s", word)]).run()
    assert both.rows == plain.rows
    assert both.sent == plain.sent
    for e in "ms":
        session = both.ends[e].session
        assert (session.number, session.start_ns, session.farewell) == (OURS, START, None)


def test_an_emergency_stop_of_another_session_stops_nothing() -> None:
    end = met(WATCHED)["s"]
    dice = random.Random(1)
    for _ in range(2000):  # off the path the 64 bits have to be guessed
        end.receive(control(Kind.BYE, "emergency stop", dice.getrandbits(64)), at(0))
    assert end.session.farewell is None
    assert end.rejected["session"] == 2000


def test_without_keys_a_forged_farewell_with_the_right_session_number_stops_the_run() -> None:
    """It fails towards zero force: what an end does when the other leaves is to let go."""
    end = met(WATCHED)["s"]
    assert end.receive(control(Kind.BYE, "emergency stop"), at(0)) == []
    assert end.session.farewell == "emergency stop"


@pytest.mark.parametrize("law", [None, Direct(), PFRA(alpha=0.2)], ids=str)
def test_a_packet_that_is_thrown_back_at_its_sender_is_not_taken_for_the_others(law: Any) -> None:
    """It says which way it was sent, whatever the law's two messages have in common."""
    for e in "ms":
        end = met(scene(law, link=LINK))[e]
        own = end.tick(0, at(0), STILL).datagram
        assert own is not None
        end.receive(own, at(1))
        assert end.tick(1, at(1), STILL).played == -1
        assert sum(end.rejected.values()) == 1
        assert end.received == 0
        if law is None:
            assert dict(end.rejected) == {"direction": 1}


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
    for i in range(5000):
        end.receive(data(10 + i % 40, 0.0), at(0))
    assert ticks(end, range(1, 260), lambda k: [data(k - 1)]) == list(range(259))
    inbox: Any = end.inbox
    assert (inbox.refused, inbox.duplicates) == (0, 5000)


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
        packet = decode(datagram, 1)
        assert isinstance(packet, Packet)
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
    assert both.ends["s"].way.count == plain.ends["s"].way.count


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
            packet = decode(word, 1)
            assert isinstance(packet, Packet)
            for reply in first.receive(packet, now):
                answer = decode(reply, 1)
                assert isinstance(answer, Packet)
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
