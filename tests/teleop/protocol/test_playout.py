"""Playout: which packet each tick plays, up front (`plan`) and as datagrams come (`Inbox`)."""

from __future__ import annotations

import subprocess
import sys
from fractions import Fraction
from math import ceil, erf, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from teleop.errors import Refused
from teleop.protocol.inbox import Inbox
from teleop.scene.playout import Fixed, Hold, Playout, Zero, repeats
from teleop.simulation.plan import Plan, plan
from teleop.stages.memory import LEFT_OUT

MS = 1_000_000
DT = 1000  # ns, in the small cases

Arrivals = list[tuple[int, int]]  # packet, time in ns

strides = st.sampled_from([1, 1, 1, 1, 2, 5])
playouts = st.sampled_from([Zero(), Hold(), *[Fixed(ticks * DT * 1e-9) for ticks in (1, 2, 3, 7, 50)]])


@st.composite
def schedules(draw: st.DrawFn) -> tuple[int, Arrivals]:
    """Some packets lost, some doubled, each delayed by 0 to 12 ticks and a bit; sorted by time."""
    count = draw(st.integers(1, 30))  # and perhaps nothing comes at all
    copies = draw(st.lists(st.tuples(st.integers(0, count - 1), st.integers(0, 12 * DT)), max_size=60))
    arrivals = [(packet, packet * DT + delay) for packet, delay in copies]
    return count, sorted(arrivals, key=lambda arrival: arrival[1])


def tick_of(packet: int, time_ns: int) -> int:
    return max(packet + 1, ceil(Fraction(time_ns, DT)))


def told_tick_by_tick(playout: Playout, arrivals: Arrivals, count: int) -> Plan:
    """The definition, word for word: what has come by each tick, and what has been played before it."""
    ticks = [(packet, tick_of(packet, time)) for packet, time in arrivals]
    first = {packet: min(t for q, t in ticks if q == packet) for packet, _ in ticks}
    come = {packet for packet, t in first.items() if t < count}
    play: list[int] = []
    for k in range(count):
        there = {packet for packet in come if first[packet] <= k}
        if isinstance(playout, Fixed):
            play.append(k - playout.ticks(DT) if k - playout.ticks(DT) in there else -1)
        else:
            play.append(max((p for p in there if all(p > q for q in play)), default=-1))
    late = waiting = overtaken = 0
    for packet in come - {*play}:
        if not isinstance(playout, Fixed):
            overtaken += 1
        elif first[packet] > packet + playout.ticks(DT):
            late += 1
        else:
            waiting += 1
    return Plan(
        played_at=np.array(play, dtype=np.int64), lag=max((k - p for k, p in enumerate(play) if p >= 0), default=0),
        sent=count, received=len(come), lost=count - len(first), in_flight=len(first) - len(come),
        duplicates=sum(t < count for _, t in ticks) - len(come), played=sum(p >= 0 for p in play),
        overtaken=overtaken, late=late, waiting=waiting,
    )


# --- plan


@settings(max_examples=75)
@given(playouts, schedules())
def test_plan_is_the_definition(playout: Playout, schedule: tuple[int, Arrivals]) -> None:
    count, arrivals = schedule
    table = np.array(arrivals, dtype=np.int64).reshape(-1, 2)
    got, definition = plan(playout, table[:, 0], table[:, 1], count, DT), told_tick_by_tick(playout, arrivals, count)
    assert (got.play, *got[1:]) == (definition.play, *definition[1:])


def newest_wins(probability: NDArray[np.float64]) -> float:
    """The share of fresh ticks if delays are independent, `probability[j]` that of j+1 ticks.

    A tick is fresh if, going back from the newest, the first packet that has come by now comes just now:
    the sum over j of P(delay = j) times the product over i < j of P(delay > i).
    """
    late = 1 - np.cumsum(probability)
    return float(probability @ np.concatenate([[1.0], np.cumprod(late[:-1])]))


def test_newest_wins_throws_most_of_a_jittery_stream_away() -> None:
    """At 1 kHz: 0-20 ms uniform leaves 26 % of the ticks fresh, normal with 20 ms 10 %."""
    count, rng, edges = 40_000, np.random.default_rng(1), np.arange(201.0)  # ms
    uniform = np.clip(edges / 20, 0, 1)
    normal = np.array([0.5 * (1.0 + erf((edge - 100) / (20 * sqrt(2.0)))) for edge in edges])
    for share, cumulative, delay in ((0.26, uniform, rng.uniform(0, 20 * MS, count)),
                                     (0.10, normal, rng.normal(100 * MS, 20 * MS, count).clip(0))):
        time = np.arange(count) * MS + delay.astype(np.int64)
        order = np.argsort(time, kind="stable")
        exact = newest_wins(np.diff(cumulative))
        assert exact == pytest.approx(share, abs=0.01)
        assert plan(Zero(), order, time[order], count, MS).played / count == pytest.approx(exact, abs=0.01)


# --- the playouts themselves


def test_a_fixed_delay_is_rounded_up_to_ticks_once_it_is_in_nanoseconds_and_gaps_are_zero_or_hold() -> None:
    for delay, ticks in ((0.05, 50), (0.1 + 0.2, 300), (0.0501, 51), (1e-3, 1), (1e-6, 1), (1e-12, 1), (3600, 3600000)):
        assert Fixed(delay).ticks(MS) == ticks, delay
    assert Fixed(0.1) == Fixed(delay=0.1, gaps=Zero())
    assert not repeats(Zero())
    assert repeats(Hold())
    assert not repeats(Fixed(1.0))
    assert repeats(Fixed(1.0, Hold()))


def test_naming_a_playout_loads_neither_numpy_nor_msgpack() -> None:
    code = "import sys, teleop.protocol.inbox as p; p.Fixed(0.1); print({'numpy', 'msgpack'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "set()\n"


# --- inbox


flags = st.lists(st.booleans(), min_size=30, max_size=30)


@settings(max_examples=75)
@given(playouts, schedules(), st.sampled_from([0, 1, 4, 15, 1000]), st.none() | flags, st.none() | flags)
def test_an_inbox_plays_and_counts_what_was_planned(
    playout: Playout, schedule: tuple[int, Arrivals], early: int, sends: list[bool] | None, skips: list[bool] | None
) -> None:
    """Put in at the tick of arrival, or any number of ticks before it; with left-out ticks at either end.

    The receiver's last tick is not left out: packets wait, or with a fixed delay are late.
    """
    count, arrivals = schedule
    sent = None if sends is None else np.array(sends[:count])
    left_out = np.array([*skips[: count - 1], False]) if skips else np.zeros(count, bool)
    arrivals = [(packet, time) for packet, time in arrivals if sent is None or sent[packet]]
    table = np.array(arrivals, dtype=np.int64).reshape(-1, 2)
    expected = plan(playout, table[:, 0], table[:, 1], count, DT, sent, left_out if skips else None)
    inbox: Inbox[str | None] = Inbox(playout, DT, room=100)
    todo = sorted(((tick_of(p, t), p) for p, t in arrivals), key=lambda item: item[0])
    play = []
    for k in range(count):
        while todo and todo[0][0] <= k + early:
            tick, packet = todo.pop(0)
            inbox.add(packet, tick, f"packet {packet}" if packet % 2 else None)
        got = None if left_out[k] else inbox.take(k)
        assert got is None or got[1] == (f"packet {got[0]}" if got[0] % 2 else None)
        play.append(LEFT_OUT if left_out[k] else -1 if got is None else got[0])
    assert play == expected.play
    for name in ("received", "duplicates", "played", "overtaken", "late", "waiting"):
        assert getattr(inbox, name) == getattr(expected, name), name
    assert inbox.refused == 0
    assert expected.sent == (count if sent is None else sent.sum()) == (
        expected.received + expected.lost + expected.in_flight)


@settings(max_examples=60)
@given(playouts, schedules(), st.lists(strides, min_size=1, max_size=30), st.integers(0, 4))
def test_skipped_ticks_and_late_puts_keep_the_rule(
    playout: Playout, schedule: tuple[int, Arrivals], steps: list[int], behind: int
) -> None:
    """A machine that stalls: it takes some ticks only, and finds datagrams whose tick it has taken."""
    _, arrivals = schedule
    inbox: Inbox[None] = Inbox(playout, DT, room=100)
    ticks = [sum(steps[: i + 1]) - 1 for i in range(len(steps))]
    seen: dict[int, int] = {}  # packet: the tick taken when it first counted
    copies = 0
    todo = sorted((tick_of(p, t) + behind, tick_of(p, t), p) for p, t in arrivals)
    before = -1
    for k in ticks:
        while todo and todo[0][0] <= k:
            _, tick, packet = todo.pop(0)
            inbox.add(packet, tick, None)
            copies += packet in seen
            seen.setdefault(packet, k)
        got = inbox.take(k)
        if isinstance(playout, Fixed):
            wanted = k - playout.ticks(DT)
            assert got == ((wanted, None) if wanted in seen else None)
        else:
            newest = max(seen, default=-1)
            assert got == ((newest, None) if newest > before else None)
            before = max(before, newest)
    assert inbox.duplicates == copies
    assert inbox.received == len(seen) == inbox.played + inbox.overtaken + inbox.late + inbox.waiting
    if isinstance(playout, Fixed):
        assert inbox.overtaken == 0
        assert inbox.waiting == sum(packet + playout.ticks(DT) > ticks[-1] for packet in seen)
    else:
        assert inbox.late == inbox.waiting == 0


@pytest.mark.parametrize("playout", [Zero(), Fixed(5e-3)])
def test_a_flood_and_the_far_future_are_refused_and_counted(playout: Playout) -> None:
    inbox: Inbox[int] = Inbox(playout, MS, room=10)
    room = 10 if isinstance(playout, Zero) else 15
    inbox.add(2**32 - 1, 1, 0)  # cannot have been sent yet
    inbox.add(0, room, 0)
    assert inbox.refused == 2
    for packet in range(1000):
        inbox.add(packet % (room - 1), room - 1, packet)
    assert inbox.refused == 2, "copies take no room"
    inbox.take(room - 1)
    assert inbox.duplicates == 1000 - (room - 1)
    inbox.add(room, room + 1, 0)
    assert inbox.refused == 2


def test_a_packet_is_not_played_at_the_tick_it_was_sent_and_time_does_not_go_backwards() -> None:
    inbox: Inbox[str] = Inbox(Zero(), MS)
    inbox.add(3, 0, "from a peer whose clock is ahead")
    assert [inbox.take(k) for k in range(5)] == [None] * 4 + [(3, "from a peer whose clock is ahead")]
    for tick in (4, 3):
        with pytest.raises(Refused, match="after 4"):
            inbox.take(tick)
    with pytest.raises(Refused, match="room"):
        Inbox(Zero(), MS, room=0)
