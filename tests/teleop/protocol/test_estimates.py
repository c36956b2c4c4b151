"""What packets tell of the link and of the peer's clock: against direct computation, and clocks that are known."""

from __future__ import annotations

from itertools import pairwise
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop import Direct, Fixed, Zero
from teleop.protocol.estimates import FEWEST, MOST_RTT_NS, LinkEstimates, PeerClock
from tests.fakes import usually
from tests.teleop.protocol.virtual_clock import MS, Clock, S, World, healing

BAND = MS // 2
EPS = 20_000  # ns


def exchange(clock: PeerClock, t1: int, there: int, held: int, back: int, peer: Clock) -> int | None:
    """A packet that leaves at t1 by our clock, which is the true one, and its echo."""
    t3 = t1 + there + held
    return clock.add(t1, peer.at(t3) - peer.at(t1 + there), peer.at(t3), t3 + back)


def watched(peer: Clock, seconds: float, way: Any, hz: int = 200, start: int = 0) -> PeerClock:
    """A peer's clock after so many seconds; `way(i)` are the two delays of the i-th exchange."""
    clock = PeerClock(BAND)
    for i in range(int(seconds * hz)):
        there, back = way(i)
        exchange(clock, start + i * S // hz, there, 3 * MS, back, peer)
    return clock


# Figures


@settings(max_examples=50)
@given(st.integers(0, 2**32), st.sampled_from([1, 2, 5]), st.integers(0, 10**6))
def test_loss_order_times_and_jitter_are_those_of_the_link(seed: int, every: int, first: int) -> None:
    dice, link = Random(seed), LinkEstimates(BAND)
    sent = [(first + i * every, i * every * MS) for i in range(300)]
    came = sorted((at + dice.randrange(40 * MS), seq, at) for seq, at in sent if dice.random() > 0.2)
    for now, seq, at in came:
        link.add(seq, at + 10**12, None, now - at, now)
    seqs, ways = [seq for _, seq, _ in came], [now - at for now, _, at in came]
    newest = [max(seqs[: i + 1]) for i in range(len(seqs))]
    assert link.lost(every) == (max(seqs) - min(seqs)) // every + 1 - len(seqs)
    assert link.loss(every) == pytest.approx(link.lost(every) / (link.lost(every) + len(seqs)))
    assert link.reordered == sum(b < top for top, b in zip(newest, seqs[1:], strict=False))
    assert (link.way.count, link.way.total, link.way.least, link.way.most) == (
        len(ways), sum(ways), min(ways), max(ways))
    recent = sum(ways[:200]) / 200
    for each in ways[200:]:
        recent += (each - recent) / 200
    assert link.way.recent == pytest.approx(recent)
    jitter = 0.0  # RFC 3550, 6.4.1: D(i,j) = (R_j - R_i) - (S_j - S_i), J += (|D| - J)/16
    for (r0, _, s0), (r1, _, s1) in pairwise(came):
        jitter += (abs((r1 - r0) - (s1 - s0)) - jitter) / 16
    assert link.jitter_ns == pytest.approx(jitter)


def test_a_new_session_goes_on_with_the_figures_and_begins_its_numbers_and_its_clock_anew() -> None:
    link = LinkEstimates(BAND)
    for seq in (0, 1, 5):
        link.add(seq, seq * MS, (seq * MS, 0), MS, (seq + 1) * MS)
    assert link.lost() == 3
    jitter = link.jitter_ns
    link.begin()
    for seq in (1000, 1002):
        link.add(seq, 7 * S + seq * MS, None, MS, (seq + 1) * MS)
    assert link.lost() == 4, "what was not sent between the sessions was not lost"
    assert link.jitter_ns == pytest.approx(jitter * 15 / 16), "another clock is no jitter"
    assert link.way.count == 5
    assert link.clock.offset_ns is None


# The peer's clock


@pytest.mark.parametrize(("offset", "ppm"), [(0, 0.0), (3 * S, 200.0), (-(10**15), -450.0)])
def test_the_drift_is_found_and_the_shift_follows_it(ppm: float, offset: int) -> None:
    clock = watched(Clock(offset, ppm), 60.0, lambda _i: (10 * MS, 10 * MS))
    assert clock.drift == pytest.approx(ppm * 1e-6, abs=1e-7)
    assert clock.offset_ns == pytest.approx(offset + 60.0 * ppm * 1e3, abs=abs(ppm) * 2e3 + 10)
    assert clock.shift_ns == pytest.approx(59.0 * ppm * 1e3, abs=BAND + abs(ppm) * 2e3)
    back = watched(Clock(offset, ppm), 60.0, lambda _i: (0, 25 * MS))
    assert back.drift == pytest.approx(ppm * 1e-6, abs=1e-7), "whatever the ways, as long as they stay"
    for seed in range(2):
        dice = Random(seed)
        rough = watched(Clock(5, ppm), 100.0, lambda _i, dice=dice: (
            dice.randrange(10, 30) * MS, dice.randrange(10 * MS, 30 * MS)))
        assert rough.drift == pytest.approx(ppm * 1e-6, abs=10e-6), "and through jitter"
        assert abs(rough.shift_ns - 99 * ppm * 1e3) < 3 * MS


@usually("step, ppm, there", [(step, ppm, there)
         for step in (40, -15) for ppm in (0.0, 100.0) for there in (True, False)],
         (40, 100.0, True), (-15, 0.0, False))
def test_a_way_that_changes_for_good_is_not_taken_for_a_clock(step: int, ppm: float, there: bool) -> None:
    dice = Random(1)
    for until in (5.0, 25.0, 62.0):  # soon after, and when the new way is the usual one
        def way(i: int) -> tuple[int, int]:
            more, one, other = step * MS if i > 20 * 200 else 0, dice.randrange(4 * MS), dice.randrange(4 * MS)
            return (20 * MS + one + more * there, 20 * MS + other + more * (not there))

        clock = watched(Clock(0, ppm), 20.0 + until, way)
        assert abs(clock.shift_ns - (20.0 + until) * ppm * 1e3) < 2 * MS + abs(ppm) * 11e3
        if until > 5.0 or step > 0:  # of a faster way the few windows there are count most
            assert clock.drift == pytest.approx(ppm * 1e-6, abs=20e-6)


@pytest.mark.parametrize("step", [0.003, -0.003, 0.3, -5.0])
def test_a_clock_that_is_set_is_followed_for_the_ways_cannot_explain_it(step: float) -> None:
    peer, clock = Clock(), PeerClock(BAND)
    for i in range(4000):
        if i == 2000:
            peer.offset += round(step * S)
        exchange(clock, i * 5 * MS, 10 * MS, 0, 10 * MS, peer)
    assert clock.shift_ns == pytest.approx(step * S, abs=EPS)


@settings(max_examples=60)
@given(st.lists(st.tuples(*[st.integers(-(2**63), 2**63 - 1)] * 4), max_size=60))
def test_what_nobody_can_have_sent_is_no_round_trip_and_no_times_raise(times: list[tuple[int, int, int, int]]) -> None:
    clock = PeerClock(BAND)
    for t1, held, t4 in ((10, 0, 9), (0, 11, 10), (0, 0, MOST_RTT_NS + 1), (-(2**63), 0, 10), (2**63 - 1, 0, 0)):
        assert clock.add(t1, held, 0, t4) is None
    assert clock.offset_ns is clock.drift is None
    assert clock.add(0, 5, 7, 15) == 10
    for t1, held, t3, t4 in times:
        clock.add(t1, abs(held), t3, t4)
    assert clock.drift is None or isinstance(clock.drift, float)
    narrow = PeerClock(0)
    for i in range(FEWEST + 6):
        narrow.add(i * S, 0, i * S, i * S)
    assert narrow.drift == 0.0


# Two ends whose clocks go apart


@pytest.mark.parametrize(("ppm", "playout", "jitter", "noise"), [
    ({"m": -200.0, "s": 200.0}, Zero(), 0, MS // 10), ({"m": 400.0}, Fixed(0.08), 20 * MS, 0), ({}, Zero(), 0, 2 * MS),
])
def test_two_minutes_of_hundreds_of_ppm_are_a_tick_or_two_and_the_noise_of_the_stamps_is_no_drift(
    ppm: dict[str, float], playout: Any, jitter: int, noise: int
) -> None:
    clocks = {e: Clock(10**12 * (e == "s"), ppm.get(e, 0.0)) for e in "ms"}
    scene = healing(Direct(K=200.0, B=5.0), dt=0.02, duration=700.0, playout=playout)
    world = World(scene, clocks=clocks, still=True, jitter=jitter, noise=noise).run(120.0)
    apart = clocks["s"].ppm - clocks["m"].ppm
    for e in "ms":
        end = world.end(e)
        assert end.guard.events == []
        assert end.session.met == 1
        assert end.link.clock.drift == pytest.approx((apart if e == "m" else -apart) * 1e-6, abs=20e-6)
        assert ppm or end.link.clock.shift_ns == 0
        assert end.link.way.least > 20 * MS - 20 * MS
        assert end.link.way.most < 20 * MS + jitter + 2 * 20 * MS
        assert dict(end.rejected) == {}
        assert len(world.done[e]) == pytest.approx(6000, abs=30)
        if isinstance(playout, Fixed):
            inbox: Any = end.inbox
            assert inbox.late == 0
    assert abs(world.done["m"][-1].k - world.done["s"][-1].k) <= 1, "without it they would be 2.4 ticks apart"


@usually("step, who", [(step, who) for step in (0.3, -0.3, 0.9, 1.3, 5.0, -5.0) for who in "ms"],
         (0.3, "m"), (-0.3, "s"), (1.3, "s"), (-5.0, "m"))
def test_a_clock_that_is_set_makes_no_force_jump_and_they_go_on(step: float, who: str) -> None:
    """Monotonic clocks are not set, but a machine that slept may show as much. Back, an end has to wait for itself."""
    scene = healing(Direct(K=200.0, B=5.0))
    world = World(scene)
    assert world.until_both_play(5.0) < 5.0
    world.run(3.0)
    last = {e: world.done[e][-1].k for e in "ms"}
    world.step(who, round(step * S))
    world.run(0.3)
    bound = 4.0 + max(0.0, -step)
    assert world.until_both_play(bound) < bound
    world.run(1.0)
    assert world.both_play()
    for e in "ms":
        assert world.done[e][-1].k > last[e] + 100
        steps = [(b.force - a.force) / (b.k - a.k) for a, b in pairwise(world.done[e])]
        assert max(map(abs, steps)) <= 40.0 * scene.dt + 1e-9
        assert all(a.k < b.k for a, b in pairwise(world.done[e])), "no tick is taken twice"
    other = [done.true for done in world.done["s" if who == "m" else "m"]]
    assert max(b - a for a, b in pairwise(other)) < 0.05 * S, "and whose clock was left alone goes on ticking"
    assert world.end("m").session.met == world.end("s").session.met == 2, "one of them stood still"
