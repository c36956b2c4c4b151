"""The relay's core: schedules kept, session datagrams passed on, every datagram accounted for, memory bounded."""

import pytest

import channel.relay
from channel import Bernoulli, Delay, Duplicate, Effect, Link, parse_link
from channel.relay import Counts, Relay
from tests.fakes import ByNumber

MS = 1_000_000


def settled(relay: Relay) -> bool:
    both = [relay.counts(way) for way in (0, 1)]
    return all(counts.received + counts.doubled == (
        counts.lost + counts.overflowed + counts.rejected + counts.delivered + counts.under_way) for counts in both)


def test_both_directions_get_what_the_link_would_give_them() -> None:
    link = parse_link("uniform(0.02) | bernoulli(0.1) | duplicate(0.1, after=0.001) ;"
                      "gilbert_elliott(0.1, 0.3) | delay(0.01)")
    relay = Relay(link, 7, 100)
    out: list[tuple[int, bytes]] = []
    for k in range(1000):
        for direction in (0, 1):
            relay.receive(direction, k, b"%d" % k, k * MS)
        out += relay.due(k * MS)
    while (soon := relay.next_ns()) is not None:
        out += relay.due(soon)
    assert settled(relay)
    for direction in (0, 1):
        drawn = link.arrivals(direction, 1000, MS, 7, 100).packet.tolist()
        assert [int(data) for towards, data in out if towards == direction] == drawn
        counts = relay.counts(direction)
        assert (counts.received, counts.delivered, counts.under_way) == (1000, len(drawn), 0)
        assert counts.most_under_way > 0


def test_directions_come_out_in_order_of_time() -> None:
    relay = Relay(Link(Delay(0.003), Delay(0.001)), 1, 100)
    for k in range(3):
        relay.receive(0, k, b"to slave %d" % k, k * MS)
        relay.receive(1, k, b"to master %d" % k, k * MS)
    assert relay.next_ns() == 1 * MS
    assert relay.due(5 * MS) == [(1, b"to master 0"), (1, b"to master 1"), (0, b"to slave 0"), (1, b"to master 2"),
                                 (0, b"to slave 1"), (0, b"to slave 2")]
    assert relay.next_ns() is None


def test_the_sessions_own_datagrams_pass_at_once_and_whole_and_all_of_them_without_a_link() -> None:
    relay = Relay(Bernoulli(1.0) | Delay(1.0), 1, 100)
    relay.receive(0, 5, b"data", 10)
    relay.receive(0, None, b"hello", 10)
    relay.receive(1, None, b"bye", 11)
    assert relay.next_ns() == 10
    assert relay.due(11) == [(0, b"hello"), (1, b"bye")]
    assert relay.counts(0) == Counts(received=2, doubled=0, lost=1, overflowed=0, rejected=0, delivered=1, under_way=0,
                                     most_under_way=1)
    assert relay.counts(1).delivered == 1
    perfect = Relay(None, 1, 100)
    perfect.receive(1, 3, b"x", 5)
    assert perfect.due(5) == [(1, b"x")]


def test_copies_numbers_that_go_back_and_numbers_that_no_packet_has_do_not_end_it(every_effect: list[Effect]) -> None:
    for effect in every_effect:
        relay = Relay(effect, 1, 100)
        for i, k in enumerate((5, 3, 3, 4000, 0, -1, 2**62, 2**200, 5, 2, 9999, 1, 2**62 - 1)):
            relay.receive(0, k, b"x", i)
            relay.due(i)
        assert relay.counts(0).rejected == 3, effect
        assert settled(relay), effect


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """More datagrams than the bound are dropped and counted, and the next ones find room again."""
    assert channel.relay.MOST == 2**18
    monkeypatch.setattr(channel.relay, "MOST", 100)
    relay = Relay(Duplicate(1.0) | Delay(1.0), 1, 100)
    for k in range(200):
        relay.receive(k % 2, k, b"x", k)
    for _ in range(200):
        relay.receive(0, None, b"flood", 200)
    one, other = relay.counts(0), relay.counts(1)
    assert one.under_way + other.under_way == 100
    assert one.overflowed + other.overflowed == 350
    assert settled(relay)
    assert len(relay.due(2 * 10**9)) == 100
    relay.receive(0, 500, b"again", 2 * 10**9)
    assert relay.counts(0).under_way == 2


def test_eighty_megabytes_a_second_of_long_datagrams_do_not_fill_the_memory_which_is_counted_back_to_nothing() -> None:
    """For four seconds, on a link of one second: what comes beyond the bound is dropped and counted."""
    relay, most, size = Relay(Delay(1.0), 1, 100), 0, 60_000
    for k in range(5333):
        relay.receive(k % 2, k, bytes(size), k * MS * 3 // 4)
        most = max(most, sum(relay.counts(way).under_way for way in (0, 1)))
        if k % 100 == 0:
            relay.due(k * MS * 3 // 4)
    assert channel.relay.MOST_BYTES == 2**25
    assert most * size < channel.relay.MOST_BYTES < (most + 10) * size
    assert settled(relay)
    assert all(relay.counts(way).overflowed > 1000 for way in (0, 1))
    relay.due(20 * 10**9)
    assert sum(stream.bytes for stream in relay._streams) == 0
    relay.receive(0, 10**6, b"again", 20 * 10**9)
    assert relay.counts(0).under_way == 1
    for text in ("duplicate(0.5) | delay(0.1)", "bernoulli(0.5) | in_order()", "uniform(0.1)"):
        relay = Relay(parse_link(text), 1, 100)
        for k in range(300):
            relay.receive(k % 2, k, bytes(100), k * MS)
        assert sum(stream.bytes for stream in relay._streams) > 0, text
        relay.due(10**12)
        assert [stream.bytes for stream in relay._streams] == [0, 0], text


def test_what_is_read_late_is_due_by_when_it_came_and_a_clock_that_goes_back_does_no_harm() -> None:
    """A datagram may lie in the socket while `due` is asked: the link delays it from its coming, not its reading."""
    relay = Relay(Delay(0.005) | Delay(0.002), 1, 100)
    relay.receive(0, 0, b"a", 1 * MS)
    assert relay.due(6 * MS) == []
    relay.receive(1, 0, b"b", 2 * MS)
    relay.receive(0, 1, b"c", 3 * MS)
    assert relay.next_ns() == 8 * MS
    assert relay.due(8 * MS) == [(0, b"a")]
    assert relay.due(9 * MS) == [(1, b"b")]
    relay.receive(0, 2, b"d", -5 * MS)  # not before what came in its direction already
    assert relay.next_ns() == 10 * MS
    assert relay.due(10 * MS) == [(0, b"c"), (0, b"d")]


def test_what_is_read_late_finds_a_queue_that_has_moved_on() -> None:
    """Whoever has entered a queue was before it, however long it lay in the socket."""
    class Queue(ByNumber):
        order = "time"

    queue = Queue()
    relay = Relay(ByNumber(lambda k: 3 * MS * (k % 2 == 0)) | queue, 1, 100)
    relay.receive(0, 0, b"a", 1 * MS)
    assert relay.due(6 * MS) == [(0, b"a")]
    relay.receive(0, 1, b"b", 2 * MS)
    assert relay.due(7 * MS) == [(0, b"b")]
    assert queue.entered == [4 * MS, 6 * MS]
