"""The published attacks on teleoperated surgery, and the defects of the Raven II's receiver: what they get here.

What "without keys" stands in the name of is not withstood: it is what one gets who can read the link and write to it,
and why a link beyond this machine needs keys. With them nothing that was forged, changed or replayed comes as far as an
endpoint (tests/teleop/protocol/secure, tests/live/test_ends.py); to delay and to drop is left. That an end keeps to
the address of its peer is a matter of sockets: tests/live/test_shell.py, tests/live/test_ends.py.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
import pytest

from teleop import Cap, Direct, Fixed
from teleop.protocol.endpoint import Endpoint, Stepped
from teleop.protocol.guard import UNNAMED
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Kind, Packet, decode, encode
from teleop.protocol.session import Session
from teleop.protocol.states import Cause
from teleop.scene.playout import Playout, Zero
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
    Change,
    at,
    control,
    data,
    handed_on,
    ticks,
    untouched,
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
    """A well-made message of this session: it is not played, and honest ones after it are, from the next tick on.

    Nor of ends that step together, which are never two ticks apart.
    """
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
    for seq in (2, 3, 10**9, 2**31, 2**32 - 1):
        inbox = Stepped(None)
        stepped = Endpoint(kept, "s", met(kept)["s"].session, inbox)
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


@pytest.fixture(scope="module")
def plain() -> Both:
    """The run of `WATCHED` over its link, which nobody disturbed."""
    return Both(WATCHED).run()


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


def test_without_keys_a_number_beyond_all_bounds_is_not_held_and_behind_a_cap_does_not_silence_an_end() -> None:
    """The cap keeps the force finite, the message is finite, and the ledger is not any more."""
    end = met(scene(Direct(), link=LINK))["s"]
    end.receive(data(0, payload=(1e308, 0.0)), at(0))
    end.tick(0, at(0), STILL)
    assert end.force_failed is None
    end.tick(1, at(1), STILL)
    assert end.force_failed == "f_s"
    end = met(replace(WATCHED, cap=Cap(f_max=5.0, slew=1000.0)))["s"]
    end.receive(data(0, 1e200), at(0))
    answers = [end.tick(k, at(k), STILL) for k in range(50)]
    assert end.force_failed is None
    assert all(abs(answer.force[0]) <= 5.0 for answer in answers)
    assert all(isinstance(decode(answer.datagram or b"", 1), Packet) for answer in answers)


def test_a_mirror_on_the_link_changes_nothing_of_a_run(plain: Both) -> None:
    both = Both(WATCHED, intruder=lambda k, both: [(e, both.sent[e][k - 1]) for e in "ms" if k]).run()
    assert both.rows == plain.rows
    assert both.sent == plain.sent
    assert dict(both.ends["s"].rejected) == {"direction": WATCHED.ticks - 1}


def test_packets_for_later_keep_no_honest_ones_out_but_where_a_second_has_more_ticks_than_the_inbox_room() -> None:
    """No more than one of each number, and none of them further ahead than the watchdog's timeout."""
    end = met(WATCHED)["s"]
    for i in range(1000):
        end.receive(data(10 + i % 40, 0.0), at(0))
    assert ticks(end, range(1, 60), lambda k: [data(k - 1)]) == list(range(59))
    inbox: Any = end.inbox
    assert (inbox.refused, inbox.duplicates) == (0, 1000)
    end, tick = met(scene(link=LINK, dt=1e-4, duration=0.1))["s"], 100_000
    for seq in range(100, 9000):
        end.receive(data(seq, 0.0), START)
    played = []
    for k in range(1, 400):
        end.receive(data(k - 1), START + k * tick)
        played.append(end.tick(k, START + k * tick, STILL).played)
    inbox = end.inbox
    assert inbox.refused > 3000
    assert end.rejected["early"] == 9000 - (round(UNNAMED.timeout / 1e-4) + 2), "a timeout ahead is too far"
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


# The eight communication faults of IEC 61784-3, each met by its measure


class Fault(NamedTuple):
    """What happens to packets 150 to 249 of either way, and what the end that gets them makes of it."""

    change: Change
    count: Callable[[Endpoint], int]
    counted: int
    falls: bool = False  # does the watchdog let go
    changes: bool = False  # is there any trace of it in the run
    playout: Playout = Zero()


def of_inbox(name: str) -> Callable[[Endpoint], int]:
    return lambda end: int(getattr(end.inbox, name))


def rejected(cause: str) -> Callable[[Endpoint], int]:
    return lambda end: end.rejected[cause]


def beside(datagram: Callable[[int, str], bytes]) -> Change:
    return lambda e, k, good: [(10, datagram(k, e)), (10, good)]


FAULTS = {  # by name; behind each its measure
    "corruption": Fault(  # CRC-32 over all of the packet; with keys the seal
        lambda _e, k, good: [(10, good[: k % 60] + bytes([good[k % 60] ^ 1]) + good[k % 60 + 1 :])],
        lambda end: sum(end.rejected.values()), 100, falls=True, changes=True),
    "repetition": Fault(  # a window of the numbers that came
        lambda _e, _k, good: [(10, good), (10, good), (40, good)], of_inbox("duplicates"), 200),
    "wrong sequence": Fault(  # sequence numbers; the numbers played only grow
        lambda _e, k, good: [(10 if k % 2 else 13, good)], of_inbox("overtaken"), 50, changes=True),
    "loss": Fault(  # the watchdog
        lambda _e, _k, _good: [], of_inbox("received"), WATCHED.ticks - 10 - 100, falls=True, changes=True),
    "delay": Fault(  # a fixed playout, and the watchdog
        lambda _e, _k, good: [(110, good)], of_inbox("late"), 100, falls=True, changes=True, playout=Fixed(0.015)),
    "insertion": Fault(  # the session number; with keys the seal
        beside(lambda k, e: data(k, 50.0, to=e, session=OTHER)), rejected("session"), 100),
    "masquerade": Fault(  # the session number; with keys the pinned certificate
        beside(lambda k, _e: control(*TAKEOVER[k % len(TAKEOVER)], session=OTHER)), rejected("session"), 100),
    "wrong address": Fault(  # the socket keeps to its peer; the length of the law's message, the session number
        beside(lambda k, e: data(k, payload=(1.0, 2.0), to=e, session=OTHER)), rejected("malformed"), 100),
}


@cache
def honest_run(playout: Playout) -> Both:
    return handed_on(untouched, replace(WATCHED, playout=playout))


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_of_iec_61784_3_meets_its_measure(name: str) -> None:
    fault = FAULTS[name]
    kept = replace(WATCHED, playout=fault.playout)
    both = handed_on(lambda e, k, good: (fault.change if 150 <= k < 250 else untouched)(e, k, good), kept)
    honest = honest_run(fault.playout)
    assert (both.rows != honest.rows) is fault.changes
    for e in "ms":
        if not fault.changes:
            assert both.sent[e] == honest.sent[e], "not even in what the packets' echoes say"
            one, other = both.ends[e].link, honest.ends[e].link
            assert (one.way.count, one.way.least, one.way.most) == (other.way.count, other.way.least, other.way.most)
            assert one.rtt.most == other.rtt.most
        assert fault.count(both.ends[e]) == fault.counted
        assert all(isfinite(force) for force, in both.held[e])
        numbers = [number for number in both.played[e] if number >= 0]
        assert set(numbers) <= set(honest.played[e])
        assert all(one < other for one, other in pairwise(numbers))
        assert both.played[e][-100:] == honest.played[e][-100:]  # and it is over when it is over
        gain = both.gains(e)
        assert bool(gain.min() == 0.0) is fault.falls
        assert gain[-1] == 1.0
        if fault.falls:
            assert not {*range(150, 250)} & set(numbers)
            assert all(both.held[e][k] == (0.0,) for k in np.flatnonzero(gain == 0.0))
        else:
            assert gain.min() == 1.0
