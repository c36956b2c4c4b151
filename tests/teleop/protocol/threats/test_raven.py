"""The defects of the receiver of the Raven II, on a virtual clock, without keys; and none of them is here.

What an attacker, or a faulty network, gets from two live ends is in this folder. What "without keys" stands in the name
of is not withstood: it is what one gets who can read the link and write to it, and why a link beyond this machine needs
keys. With them nothing that was forged, changed or replayed comes as far as an endpoint (tests/teleop/protocol/secure,
tests/live/test_sealed.py); to delay and to drop is left, of all that follows.

That an end keeps to the address of its peer is a matter of sockets: tests/live/test_shell.py
(test_a_stranger_who_copies_what_was_sent_does_not_draw_the_run_to_himself) and tests/live/test_flood.py.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from teleop.protocol.endpoint import Endpoint, Stepped
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Kind, Packet, decode
from teleop.protocol.states import Cause
from teleop.scene.playout import Fixed, Playout
from tests.teleop.protocol.test_endpoint import START, Both, met
from tests.teleop.protocol.threats.hands import (
    MS,
    OTHER,
    OURS,
    PLAYOUTS,
    STILL,
    WATCHED,
    at,
    control,
    data,
    handed_on,
    ticks,
    untouched,
)


def test_hands_that_change_nothing_are_as_good_as_a_wire(plain: Both) -> None:
    assert handed_on(untouched).rows == plain.rows


def test_raven_the_checksum_is_tested_a_flipped_bit_anywhere_is_refused(plain: Both) -> None:
    good, end = plain.sent["m"][100], met(WATCHED)["s"]
    for bit in range(8 * len(good)):
        flipped = bytearray(good)
        flipped[bit // 8] ^= 1 << bit % 8
        assert end.receive(bytes(flipped), at(0)) == []
    assert sum(end.rejected.values()) == 8 * len(good)
    assert end.received == 0
    assert ticks(end, range(105), lambda _k: []) == [-1] * 105


@pytest.mark.parametrize("session", [0, OURS - 1, OTHER, OURS + 2**32, OURS + 2**63, 2**64 - 1])
def test_raven_not_any_sender_is_accepted_but_the_session_number_alone(session: int) -> None:
    end = met(WATCHED)["s"]
    assert ticks(end, range(50), lambda k: [data(k - 1, session=session)] if k else []) == [-1] * 50
    assert dict(end.rejected) == {"session": 49}


@pytest.mark.parametrize("gap", [1, 14, 300, 900])
@pytest.mark.parametrize("playout", PLAYOUTS, ids=str)
def test_raven_the_good_packet_after_a_gap_is_played(playout: Playout, gap: int) -> None:
    end = met(replace(WATCHED, playout=playout))["s"]
    later = playout.ticks(MS) if isinstance(playout, Fixed) else 1
    ticks(end, range(11), lambda k: [data(k - 1)] if k else [])
    played = ticks(end, range(11, gap + 60), lambda k: [data(k - 1)] if k > 10 + gap else [])
    assert played[10 + gap + later - 11] == 10 + gap
    assert played[10 + gap + later - 11 :] == list(range(10 + gap, gap + 60 - later))


@pytest.mark.parametrize("playout", PLAYOUTS, ids=str)
def test_after_a_gap_that_is_longer_than_a_session_lives_nothing_of_it_is_played(playout: Playout) -> None:
    end = met(replace(WATCHED, playout=playout))["s"]
    ticks(end, range(11), lambda k: [data(k - 1)] if k else [])
    played = ticks(end, range(11, 1200), lambda k: [data(k - 1)] if k > 1100 else [])
    assert max(played[30:]) == -1
    assert end.session.ended.cause is Cause.SESSION_OVER


@pytest.mark.parametrize("seq", [2**32 - 1, 10**9])
@pytest.mark.parametrize("playout", PLAYOUTS, ids=str)
def test_raven_one_huge_sequence_number_does_not_block_what_follows(playout: Playout, seq: int) -> None:
    """Of this session and well made: it is not played, and whatever honest comes after it is, from the next tick on."""
    kept = replace(WATCHED, playout=playout)
    both = Both(kept, intruder=lambda k, _both: [(e, data(seq, to=e)) for e in "ms" if k in (0, 50)]).run()
    honest = Both(kept).run()
    assert both.played == honest.played
    assert both.rows == honest.rows
    for e in "ms":
        assert dict(both.ends[e].rejected) == {"old" if seq == 2**32 - 1 else "early": 2}
        assert both.ends[e].way.count == honest.ends[e].way.count


@pytest.mark.parametrize("seq", [2, 3, 10**9, 2**31, 2**32 - 1])
def test_raven_one_huge_sequence_number_does_not_block_a_stepped_end(seq: int) -> None:
    """Ends that step together are never two ticks apart."""
    end = met(WATCHED)["s"]
    inbox = Stepped(None)
    stepped = Endpoint(WATCHED, "s", end.session, inbox)
    stepped.tick(0, at(0), STILL)
    stepped.receive(data(seq), at(0))
    stepped.receive(data(0), at(0))
    assert inbox.has(0)
    assert not inbox.has(seq)
    assert sum(stepped.rejected.values()) == 1
    assert stepped.tick(1, at(1), STILL).played == 0


@pytest.mark.parametrize("session", [OURS, OTHER])
@pytest.mark.parametrize("playout", PLAYOUTS, ids=str)
def test_raven_no_reset_of_the_sequence_makes_old_numbers_fresh_again(playout: Playout, session: int) -> None:
    """A second HELLO and START, of this session number or another, and all old packets behind them."""
    kept = replace(WATCHED, playout=playout)
    end = met(kept)["s"]
    before = ticks(end, range(1, 101), lambda k: [data(k - 1)])
    replies = [
        reply for kind, payload in ((Kind.HELLO, manifest_of(kept)), (Kind.START, at(101)), (Kind.START, 0))
        for reply in end.receive(control(kind, payload, session), at(101))
    ]
    kinds = [packet.kind for reply in replies if isinstance(packet := decode(reply, 1), Packet)]
    assert kinds == ([Kind.START, Kind.START] if session == OURS else [])  # it is said once more that it has come
    assert (end.session.number, end.session.start_ns, end.session.met) == (OURS, START, 1)
    after = ticks(end, range(101, 161), lambda k: [*(data(old, 5.0) for old in range(100)), data(k - 1)])
    numbers = [number for number in before + after if number >= 0]
    assert all(one < other for one, other in pairwise(numbers))
    assert max(after[:-1]) < after[-1] == 160 - (playout.ticks(MS) if isinstance(playout, Fixed) else 1)
