"""One link, two forms: `arrivals` draws a whole direction, `Stream` the same live; and ticks that an end leaves out."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.random import Generator, Philox

from channel import (
    Bernoulli,
    Chain,
    Delay,
    Duplicate,
    Effect,
    InOrder,
    LeftOut,
    LeftOutTicks,
    Link,
    Mahimahi,
    UniformJitter,
)
from channel.rng import BLOCK, KEY, Rng, inside, unit
from channel.schedule import Stream, TwoWay, Verdicts, arrivals, by_number, by_time, verdicts
from teleop.errors import Refused

MS = 1_000_000


def streamed(link: TwoWay, count: int, dt_ns: int, polls: set[int]) -> list[tuple[int, int]]:
    """The same packets live; after the sends named in `polls`, what is due is taken out."""
    stream, out = Stream(link, 0, 1, 100), []
    for k in range(count):
        stream.send(k, k * dt_ns)
        if k in polls:
            out += stream.due(k * dt_ns)
        assert stream.sent + stream.doubled == stream.lost + stream.delivered + stream.under_way
    while (soon := stream.next_ns()) is not None:
        out += stream.due(soon)
    return out


@settings(max_examples=50)
@given(data=st.data(), dt_ns=st.sampled_from([1, 3, 1000, 333_333, MS]), count=st.integers(0, 120))
def test_the_stream_gives_the_arrivals(every_effect: list[Effect], data: st.DataObject, dt_ns: int, count: int) -> None:
    """For any chain: reordering before queues, copies, ties of many packets in one nanosecond, any polling."""
    effects = tuple(data.draw(st.lists(st.sampled_from(every_effect), min_size=1, max_size=5)))
    try:
        link = Chain(effects)
    except Refused:  # in_order behind a queue that sees disorder
        return
    polls = data.draw(st.sets(st.integers(0, max(count - 1, 0))))
    drawn = arrivals(link, 0, count, dt_ns, 1, 100)
    assert streamed(link, count, dt_ns, polls) == list(zip(drawn.packet.tolist(), drawn.time_ns.tolist(), strict=True))


def test_constant_delays_alone_are_no_other_than_in_company() -> None:
    """Whether the stream adds them up, or its log wants to know what each of them did."""
    sends = [(0, 0), (2, 5), (1, 5), (3, 7), (3, 7), (9, 8)]  # ties go by number, copies stay
    for link in (Delay(0.05), Delay(0.0), Delay(0.001) | Delay(2e-9) | Delay(0.02)):
        log: list[Verdicts] = []
        quiet, told = Stream(link, 0, 1, 100), Stream(link, 0, 1, 100, log=log.append)
        for packet, time_ns in sends:
            quiet.send(packet, time_ns, b"%d" % packet)
            told.send(packet, time_ns, b"%d" % packet)
        assert quiet.next_ns() == told.next_ns()
        assert quiet.under_way == told.under_way == len(sends)
        came = quiet.deliver(10**9)
        assert came == told.deliver(10**9)
        assert [one.packet for one in came] == [0, 1, 2, 3, 3, 9]
        assert len(log) == len(sends) * len(link.in_direction(0))


def test_jitter_before_a_narrow_queue_in_which_packets_that_are_never_sent_take_no_place(recordings: Path) -> None:
    """The case that needs events: packets overtake each other, then compete for room in the order they come.

    Of an end that leaves out ticks the stream is sent the others alone.
    """
    link = UniformJitter(0.02) | Mahimahi(str(recordings / "trace"), queue=5) | Bernoulli(0.1)
    every, some = np.ones(2000, bool), LeftOut(0.5).left_out(0, 2000, 4)
    all_sent = arrivals(link, 0, 2000, MS // 8, 1, 1500)
    for sent in (every, some):
        drawn = arrivals(link, 0, 2000, MS // 8, 1, 1500, sent)
        stream, out = Stream(link, 0, 1, 1500), []
        for k in np.flatnonzero(sent).tolist():
            stream.send(k, k * MS // 8)
            if sent is every:
                out += stream.due(k * MS // 8)
        out += stream.due(10**15)
        assert out == list(zip(drawn.packet.tolist(), drawn.time_ns.tolist(), strict=True))
        assert sent[drawn.packet].all()
    assert np.array_equal(all_sent.packet, arrivals(link, 0, 2000, MS // 8, 1, 1500, every).packet)
    assert 0 < len(all_sent.packet) < 1000  # the queue was full
    assert (np.diff(all_sent.packet) < 0).any()
    assert len(drawn.packet) > some[all_sent.packet].sum()  # there was more room for those that were sent


def test_rows_that_are_sorted_already_are_returned_as_they_came() -> None:
    run = np.arange(5), np.arange(5)
    for rows in (by_time, by_number):
        assert all(got is given for got, given in zip(rows(*run), run, strict=True))
    assert [x.tolist() for x in by_number(np.array([1, 0, 1]), np.array([5, 5, 2]))] == [[0, 1, 1], [5, 2, 5]]
    assert by_time(np.array([1, 0]), np.array([5, 5]))[0].tolist() == [0, 1], "ties go by number"


def test_a_draw_depends_on_seed_direction_and_place_and_on_nothing_else() -> None:
    """On no effect behind it, no other packets, no tick and no size."""
    loss = Bernoulli(0.5)
    base = loss.arrivals(0, 1000, MS, 1, 100).packet
    assert np.array_equal(base, Bernoulli(0.5).arrivals(0, 1000, 2 * MS, 1, 200).packet)
    assert np.array_equal(base, Link(loss, Delay(1.0)).arrivals(0, 1000, MS, 1, 100).packet)
    assert np.array_equal(base, verdicts(loss | Bernoulli(0.2), 0, 1000, MS, 1, 100)[0].packet_out)
    many = loss.arrivals(0, 5000, MS, 1, 100).packet
    assert np.array_equal(base, many[many < 1000])
    for other in (loss.arrivals(0, 1000, MS, 2, 100), loss.arrivals(1, 1000, MS, 1, 100),
                  (Delay(0.0) | loss).arrivals(0, 1000, MS, 1, 100)):
        agree = np.isin(np.arange(1000), base) == np.isin(np.arange(1000), other.packet)
        assert agree.mean() == pytest.approx(0.5, abs=0.07)


def test_in_order_waits_for_those_in_front_but_not_for_the_lost() -> None:
    """Packet k leaves at the latest entry of all packets up to k: a running maximum over those that came."""
    link = Bernoulli(0.3) | UniformJitter(0.02) | Bernoulli(0.3) | InOrder()
    before, done = verdicts(link, 0, 3000, MS, 1, 100)[-2:]
    came = dict(zip(before.packet_out.tolist(), before.time_out.tolist(), strict=True))
    latest, expected = 0, {}
    for packet in sorted(came):
        latest = expected[packet] = max(latest, came[packet])
    assert dict(zip(done.packet_out.tolist(), done.time_out.tolist(), strict=True)) == expected
    assert np.all(np.diff(done.packet_out) > 0)
    assert np.all(np.diff(done.time_out) >= 0)


def test_verdicts_tell_who_was_lost_late_and_doubled_and_the_stream_tells_the_same() -> None:
    link = Duplicate(0.2, after=0.001) | Bernoulli(0.2) | UniformJitter(0.003)
    log = verdicts(link, 0, 500, MS, 1, 100)
    assert [one.effect for one in log] == [
        "Duplicate(p=0.2, after=0.001)", "Bernoulli(p=0.2)", "UniformJitter(width=0.003)"]
    assert len(log[0].packet_out) > 500 > len(log[1].packet_out) == len(log[2].packet_out)
    for one, behind in pairwise(log):
        assert np.array_equal(one.packet_out, behind.packet_in)
    live: list[Verdicts] = []
    stream = Stream(link, 0, 1, 100, log=live.append)
    for k in range(500):
        stream.send(k, k * MS)
    for one in log:
        mine = [row for row in live if row.effect == one.effect]
        for drawn, rows in (((one.packet_in, one.time_in), [(r.packet_in, r.time_in) for r in mine]),
                            ((one.packet_out, one.time_out), [(r.packet_out, r.time_out) for r in mine])):
            together = sorted((t, p) for packets, times in rows
                              for p, t in zip(packets.tolist(), times.tolist(), strict=True))
            assert together == list(zip(drawn[1].tolist(), drawn[0].tolist(), strict=True))


def test_the_stream_carries_loads_and_counts_and_refuses_a_size_that_cannot_be_carried(recordings: Path) -> None:
    stream = Stream(Duplicate(1.0, after=0.002) | Delay(0.01), 0, 1, 100)
    stream.send(0, 0, b"zero")
    assert (stream.sent, stream.doubled, stream.under_way, stream.next_ns()) == (1, 1, 2, 10 * MS)
    assert stream.deliver(10 * MS - 1) == []
    assert stream.deliver(11 * MS) == [(0, 10 * MS, b"zero")]
    assert stream.due(12 * MS) == [(0, 12 * MS)]
    assert (stream.delivered, stream.lost, stream.under_way, stream.next_ns()) == (2, 0, 0, None)
    with pytest.raises(Refused, match="1500 bytes, not 1501"):
        Mahimahi(str(recordings / "trace")).stream(0, 1, 1501)


# Ticks that an end leaves out


COUNT = 40_000


@pytest.mark.parametrize(("share", "stretch"), [(0.01, None), (0.2, None), (0.05, 1.0), (0.2, 8.0), (0.44, 20.0)])
def test_share_and_mean_stretch_are_those_that_were_asked_for(share: float, stretch: float | None) -> None:
    out = LeftOut(share, stretch).left_out(0, COUNT, seed=5)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], out, [False]]).astype(int)))
    stretches = edges[1::2] - edges[::2]
    mean = 1.0 / (1.0 - share) if stretch is None else stretch
    cycles = share * COUNT / mean
    assert out.mean() == pytest.approx(share, rel=5.0 / np.sqrt(cycles))
    assert stretches.mean() == pytest.approx(mean, rel=5.0 / np.sqrt(cycles))
    assert stretch != 1.0 or stretches.max() == 1


def test_a_tick_left_out_depends_on_seed_end_and_tick_alone_and_is_never_tick_0() -> None:
    for stretch in (None, 4.0):
        ticks = LeftOut(0.3, stretch)
        one = ticks.left_out(0, COUNT, seed=1)
        assert np.array_equal(ticks.left_out(0, 1000, seed=1), one[:1000])
        assert not np.array_equal(ticks.left_out(1, COUNT, seed=1), one)
        assert not np.array_equal(ticks.left_out(0, COUNT, seed=2), one)
        assert not any(ticks.left_out(0, 5, seed=seed)[0] for seed in range(50))
    assert LeftOut(0.0).left_out(0, 100, seed=0).sum() == 0
    assert LeftOut(1.0).left_out(0, 100, seed=0).sum() == 99
    assert np.flatnonzero(LeftOutTicks((0, 3, 4, 1000)).left_out(1, 10, seed=9)).tolist() == [0, 3, 4]


# Random numbers: Philox as published, keyed as stated, uniform and normal


MASK = 2**64 - 1


def philox_4x64_10(counter: list[int], key: list[int]) -> list[int]:
    """The generator as published (Salmon et al. 2011), in plain integers."""
    c, k = list(counter), list(key)
    for _ in range(10):
        one, two = 0xD2E7470EE14C6C93 * c[0], 0xCA5A826395121157 * c[2]
        c = [two >> 64 ^ c[1] ^ k[0], two & MASK, one >> 64 ^ c[3] ^ k[1], one & MASK]
        k = [(k[0] + 0x9E3779B97F4A7C15) & MASK, (k[1] + 0xBB67AE8584CAA73B) & MASK]
    return c


def test_reference_gives_the_published_vectors() -> None:
    """Known answers distributed with Random123."""
    assert philox_4x64_10([0] * 4, [0] * 2) == [
        0x16554D9ECA36314C, 0xDB20FE9D672D0FDC, 0xD7E772CEE186176B, 0x7E68B68AEC7BA23B]
    assert philox_4x64_10([MASK] * 4, [MASK] * 2) == [
        0x87B092C3013FE90B, 0x438C3C67BE8D0224, 0x9CC7D7C69CD777B6, 0xA09CAEBF594F0BA0]


@settings(max_examples=50)
@given(seed=st.integers(0, MASK), packet=st.integers(0, 2**62), draw=st.integers(0, 2**40),
       place=st.integers(0, 50), direction=st.integers(0, 1))
def test_words_are_philox_of_seed_direction_place_packet_draw(
        seed: int, packet: int, draw: int, place: int, direction: int) -> None:
    words = Rng(seed, direction, place).words(np.array([packet]), draw)[0].tolist()
    lane = 2 * place + direction
    assert words == philox_4x64_10([packet + 1, draw, lane, 0], [seed, KEY])
    numpys = Philox(key=np.array([seed, KEY], np.uint64), counter=np.array([packet, draw, lane, 0], np.uint64))
    assert words == numpys.random_raw(4).tolist()


@settings(max_examples=50)
@given(packets=st.lists(st.one_of(st.integers(0, 5000), st.integers(0, 2**61)), max_size=40))
@example([*range(BLOCK - 100, 2 * BLOCK + 100)])
def test_a_draw_does_not_depend_on_what_it_is_drawn_with(packets: list[int]) -> None:
    together = Rng(3, 0, 1).words(np.array(packets, np.int64))
    assert together.shape == (len(packets), 4)
    kept = Rng(3, 0, 1)
    for packet, row in zip(packets, together, strict=True):
        assert np.array_equal(kept.words(np.array([packet]))[0], row)
    assert np.array_equal(Rng(3, 0, 1).words(np.array(packets[::-1], np.int64)), together[::-1])


def test_uniform_numbers_are_numpys_of_the_same_53_bits_and_stay_within_their_ends() -> None:
    ours = Rng(4, 0, 0).words(np.arange(50))
    theirs = Generator(Philox(key=[4, KEY], counter=[0, 0, 0, 0])).random(200)
    assert unit(ours).ravel().tolist() == theirs.tolist()
    drawn = Rng(4, 0, 0).uniform(np.arange(50), draw=5, word=2)
    assert drawn.tolist() == unit(Rng(4, 0, 0).words(np.arange(50), 5)[:, 2]).tolist()
    extremes = np.array([0, MASK], np.uint64)
    assert unit(extremes).tolist() == [0.0, 1.0 - 2.0**-53]
    assert inside(extremes).tolist() == [2.0**-53, 1.0 - 2.0**-53]
