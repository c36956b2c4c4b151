"""Playout: which packet each tick plays, up front (`plan`) and as datagrams come (`Inbox`)."""

from __future__ import annotations

import subprocess
import sys
from fractions import Fraction
from math import ceil, inf, nan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import norm

from teleop.errors import Refused
from teleop.protocol.inbox import Inbox
from teleop.scene.playout import Fixed, Hold, Playout, Zero, repeats
from teleop.simulation.plan import Plan, plan
from teleop.stages.memory import LEFT_OUT

MS = 1_000_000
DT = 1000  # ns, in the small cases
NEWEST = [Zero(), Hold()]

Arrivals = list[tuple[int, int]]  # packet, time in ns

strides = st.sampled_from([1, 1, 1, 1, 2, 5])
playouts = st.sampled_from([*NEWEST, *[Fixed(ticks * DT * 1e-9) for ticks in (1, 2, 3, 7, 50)]])


@st.composite
def schedules(draw: st.DrawFn) -> tuple[int, Arrivals]:
    """Some packets lost, some doubled, each delayed by 0 to 12 ticks and a bit; sorted by time."""
    count = draw(st.integers(1, 30))
    copies = draw(st.lists(st.tuples(st.integers(0, count - 1), st.integers(0, 12 * DT)), max_size=60))
    arrivals = [(packet, packet * DT + delay) for packet, delay in copies]
    return count, sorted(arrivals, key=lambda arrival: arrival[1])


def planned(playout: Playout, arrivals: Arrivals, count: int, dt_ns: int = DT) -> Plan:
    table = np.array(arrivals, dtype=np.int64).reshape(-1, 2)
    return plan(playout, table[:, 0], table[:, 1], count, dt_ns)


def entries(of: Plan) -> tuple[object, ...]:
    """A plan as what can be compared."""
    return of.play, *of[1:]


def tick_of(packet: int, time_ns: int, dt_ns: int = DT) -> int:
    return max(packet + 1, ceil(Fraction(time_ns, dt_ns)))


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


@settings(max_examples=400)
@given(playouts, schedules())
def test_plan_is_the_definition(playout: Playout, schedule: tuple[int, Arrivals]) -> None:
    count, arrivals = schedule
    assert entries(planned(playout, arrivals, count)) == entries(told_tick_by_tick(playout, arrivals, count))


@settings(max_examples=200)
@given(playouts, schedules())
def test_a_packet_is_played_at_most_once_and_the_numbers_grow(
    playout: Playout, schedule: tuple[int, Arrivals]
) -> None:
    count, arrivals = schedule
    got = planned(playout, arrivals, count)
    played = [packet for packet in got.play if packet >= 0]
    assert played == sorted(set(played))
    assert len(got.play) == count
    for k, packet in enumerate(got.play):
        if packet >= 0:
            assert any(q == packet and tick_of(q, time) <= k for q, time in arrivals)
            assert k - packet <= got.lag


@settings(max_examples=200)
@given(playouts, schedules())
def test_every_packet_is_counted_once(playout: Playout, schedule: tuple[int, Arrivals]) -> None:
    count, arrivals = schedule
    got = planned(playout, arrivals, count)
    assert got.sent == count == got.received + got.lost + got.in_flight
    assert got.received == got.played + got.overtaken + got.late + got.waiting
    assert got.played == sum(packet >= 0 for packet in got.play)
    assert min(each for each in got[1:] if isinstance(each, int)) >= 0
    if not isinstance(playout, Fixed):
        assert got.late == got.waiting == 0
    else:
        assert got.overtaken == 0


@given(playouts, schedules(), st.integers(0, 5 * DT))
def test_copies_change_nothing_but_their_count(
    playout: Playout, schedule: tuple[int, Arrivals], after: int
) -> None:
    count, arrivals = schedule
    copies = [(packet, time + after) for packet, time in arrivals]
    once = planned(playout, arrivals, count)
    twice = planned(playout, sorted(arrivals + copies, key=lambda arrival: arrival[1]), count)
    assert entries(twice._replace(duplicates=0)) == entries(once._replace(duplicates=0))
    assert twice.duplicates >= once.duplicates


@pytest.mark.parametrize(
    ("delay_ns", "ticks"), [(0, 1), (1, 1), (MS, 1), (MS + 1, 2), (50 * MS, 50), (50 * MS + 1, 51)]
)
def test_a_constant_delay_is_a_shift(delay_ns: int, ticks: int) -> None:
    got = planned(Zero(), [(k, k * MS + delay_ns) for k in range(200)], 200, MS)
    assert got.play == [-1] * ticks + list(range(200 - ticks))
    assert (got.lag, got.received, got.in_flight, got.overtaken) == (ticks, 200 - ticks, ticks, 0)


def test_nothing_arrives() -> None:
    for playout in (*NEWEST, Fixed(1.0)):
        got = planned(playout, [], 5)
        assert got.play == [-1] * 5
        assert (got.sent, got.lost, got.lag) == (5, 5, 0)


@pytest.mark.parametrize("packet", [-1, 5])
def test_a_packet_that_was_not_sent_is_refused(packet: int) -> None:
    with pytest.raises(Refused, match=r"packets 0 \.\. 4"):
        planned(Zero(), [(packet, 3)], 5)


def fresh_share(delay_ns: NDArray[np.int64], count: int) -> float:
    time = np.arange(count) * MS + delay_ns
    order = np.argsort(time, kind="stable")
    return plan(Zero(), order, time[order], count, MS).played / count


def newest_wins(probability: NDArray[np.float64]) -> float:
    """The share of fresh ticks if delays are independent, `probability[j]` that of j+1 ticks.

    A tick is fresh if, going back from the newest, the first packet that has come by now comes just now:
    the sum over j of P(delay = j) times the product over i < j of P(delay > i).
    """
    late = 1 - np.cumsum(probability)
    return float(probability @ np.concatenate([[1.0], np.cumprod(late[:-1])]))


@pytest.mark.parametrize(("share", "jitter"), [(0.26, "uniform"), (0.10, "normal")])
def test_newest_wins_throws_most_of_a_jittery_stream_away(share: float, jitter: str) -> None:
    """At 1 kHz: 0-20 ms uniform leaves 26 % of the ticks fresh, normal with 20 ms 10 %."""
    count, rng = 40_000, np.random.default_rng(1)
    edges = np.arange(201.0)  # ms
    if jitter == "uniform":
        probability = np.diff(np.clip(edges / 20, 0, 1))
        delay = rng.uniform(0, 20 * MS, count)
    else:
        probability = np.diff(norm.cdf(edges, loc=100, scale=20))
        delay = rng.normal(100 * MS, 20 * MS, count).clip(0)
    exact = newest_wins(probability)
    assert exact == pytest.approx(share, abs=0.01)
    assert fresh_share(delay.astype(np.int64), count) == pytest.approx(exact, abs=0.01)


# --- the playouts themselves


@pytest.mark.parametrize(
    ("delay", "ticks"),
    [(0.05, 50), (0.1 + 0.2, 300), (0.0501, 51), (1e-3, 1), (1e-6, 1), (1e-12, 1), (3600, 3_600_000)],
)
def test_a_fixed_delay_is_rounded_up_to_ticks_once_it_is_in_nanoseconds(delay: float, ticks: int) -> None:
    assert Fixed(delay).ticks(MS) == ticks


@pytest.mark.parametrize("delay", [0.0, -1.0, nan, inf, 3601.0, True, "0.1", None])
def test_a_delay_that_is_none_is_refused(delay: float) -> None:
    with pytest.raises(Refused, match="playout delay"):
        Fixed(delay)


def test_gaps_are_zero_or_hold() -> None:
    with pytest.raises(Refused, match="gaps are"):
        Fixed(0.1, gaps="hold")  # type: ignore[arg-type]
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


def counters(inbox: Inbox[str]) -> dict[str, int]:
    names = ("received", "duplicates", "played", "overtaken", "late", "waiting")
    return {name: getattr(inbox, name) for name in names}


@settings(max_examples=400)
@given(playouts, schedules(), st.integers(0, 15))
def test_an_inbox_plays_and_counts_what_was_planned(
    playout: Playout, schedule: tuple[int, Arrivals], early: int
) -> None:
    """Put in at the tick of arrival, or any number of ticks before it."""
    count, arrivals = schedule
    expected = planned(playout, arrivals, count)
    inbox: Inbox[str] = Inbox(playout, DT, room=100)
    play = []
    todo = sorted(((tick_of(p, t), p) for p, t in arrivals), key=lambda item: item[0])
    for k in range(count):
        while todo and todo[0][0] <= k + early:
            tick, packet = todo.pop(0)
            inbox.add(packet, tick, f"packet {packet}")
        got = inbox.take(k)
        assert got is None or got[1] == f"packet {got[0]}"
        play.append(-1 if got is None else got[0])
    assert play == expected.play
    assert counters(inbox) == {name: getattr(expected, name) for name in counters(inbox)}
    assert inbox.refused == 0


@settings(max_examples=400)
@given(playouts, schedules(), st.lists(st.booleans(), min_size=30, max_size=30), st.lists(
    st.booleans(), min_size=30, max_size=30))
def test_an_inbox_that_skips_ticks_plays_and_counts_what_was_planned(
    playout: Playout, schedule: tuple[int, Arrivals], sends: list[bool], skips: list[bool]
) -> None:
    """Left-out ticks at both ends, but for the receiver's last: packets wait, or with a fixed delay are late."""
    count, arrivals = schedule
    sent, left_out = np.array(sends[:count]), np.array([*skips[: count - 1], False])
    arrivals = [(packet, time) for packet, time in arrivals if sent[packet]]
    table = np.array(arrivals, dtype=np.int64).reshape(-1, 2)
    expected = plan(playout, table[:, 0], table[:, 1], count, DT, sent, left_out)
    inbox: Inbox[None] = Inbox(playout, DT, room=100)
    for packet, time in arrivals:
        inbox.add(packet, tick_of(packet, time), None)
    play = []
    for k in range(count):
        got = None if left_out[k] else inbox.take(k)
        play.append(LEFT_OUT if left_out[k] else -1 if got is None else got[0])
    assert play == expected.play
    assert counters(inbox) == {name: getattr(expected, name) for name in counters(inbox)}
    assert expected.sent == sent.sum() == expected.received + expected.lost + expected.in_flight


@settings(max_examples=400)
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


def test_a_packet_is_not_played_at_the_tick_it_was_sent() -> None:
    inbox: Inbox[str] = Inbox(Zero(), MS)
    inbox.add(3, 0, "from a peer whose clock is ahead")
    assert [inbox.take(k) for k in range(5)] == [None] * 4 + [(3, "from a peer whose clock is ahead")]


def test_a_fixed_delay_plays_at_its_tick_or_never() -> None:
    inbox: Inbox[str] = Inbox(Fixed(3e-3), MS)
    inbox.add(0, 1, "in time")
    inbox.add(1, 5, "late")
    inbox.add(2, 5, "at the last moment")
    assert [inbox.take(k) for k in range(7)] == [
        None, None, None, (0, "in time"), None, (2, "at the last moment"), None,
    ]
    assert (inbox.played, inbox.late, inbox.received) == (2, 1, 3)


def test_what_a_skipped_tick_should_have_played_is_late() -> None:
    inbox: Inbox[None] = Inbox(Fixed(3e-3), MS)
    for packet in range(4):
        inbox.add(packet, packet + 1, None)
    assert inbox.take(3) == (0, None)
    assert (inbox.late, inbox.waiting) == (0, 2)  # packet 3 comes at tick 4
    assert inbox.take(6) == (3, None)
    assert (inbox.late, inbox.waiting) == (2, 0)


def test_what_comes_after_its_tick_was_taken_arrives_at_the_next() -> None:
    inbox: Inbox[None] = Inbox(Zero(), MS)
    assert inbox.take(0) is inbox.take(1) is None
    inbox.add(0, 1, None)
    assert inbox.take(2) == (0, None)


def test_an_entry_may_be_none() -> None:
    for playout in (Zero(), Fixed(1e-3)):
        inbox: Inbox[None] = Inbox(playout, MS)
        inbox.add(0, 1, None)
        assert inbox.take(1) == (0, None)


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


def test_time_does_not_go_backwards() -> None:
    inbox: Inbox[None] = Inbox(Zero(), MS)
    inbox.take(7)
    for tick in (7, 3):
        with pytest.raises(Refused, match="after 7"):
            inbox.take(tick)
    with pytest.raises(Refused, match="room"):
        Inbox(Zero(), MS, room=0)
