"""Datagrams by the handful: the same that a `Wire` would give one by one, with or without the system's own calls."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Iterator

import pytest

from teleop.live.net import wire as reading
from teleop.live.net.bulk import MOST, Bulk
from teleop.live.net.wire import LONGEST, STAMP, Wire, bind_udp

pytestmark = pytest.mark.live


def wait_for_stamps(wire: Wire) -> None:
    """Linux begins to stamp a moment after a socket first asks for it: until then a datagram came when it was read."""
    for _ in range(200):
        wire.sock.sendto(b"when?", wire.sock.getsockname())
        time.sleep(0.01)
        read = time.monotonic_ns()
        taken = wire.receive()
        assert taken is not None
        if read - taken[2] > 5_000_000:
            return
    assert not sys.platform.startswith("linux"), "the system does not say when a datagram came"
    pytest.skip("only Linux says when a datagram came")


@pytest.fixture(params=["many", "one by one"])
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[Bulk, Bulk, Wire, Wire]]:
    wires = [Wire(bind_udp(("127.0.0.1", 0), "--listen"), None) for _ in range(2)]
    wires[0].peer, wires[1].peer = wires[1].sock.getsockname(), wires[0].sock.getsockname()
    one, other = map(Bulk, wires)
    if request.param == "many" and not one.available:
        pytest.skip("the system has no calls for many datagrams")
    one.available = other.available = request.param == "many"
    wait_for_stamps(wires[1])
    yield one, other, wires[0], wires[1]
    for wire in wires:
        wire.sock.close()


Pair = tuple[Bulk, Bulk, Wire, Wire]


def all_of(bulk: Bulk) -> list[tuple[bytes, tuple[str, int], int]]:
    time.sleep(0.02)
    got = []
    while more := bulk.receive():
        assert len(more) <= MOST
        got += more
    return got


@pytest.mark.parametrize("count", [1, 2, MOST, MOST + 1, 3 * MOST + 5])
def test_they_come_whole_and_in_order_with_sender_and_time(pair: Pair, count: int) -> None:
    one, other, wire, _ = pair
    for _ in range(2):  # the system has written over the headers by then
        sent = [bytes([k % 251]) * (1 + 37 * k % 1200) for k in range(count)]
        before = time.monotonic_ns()
        one.send(sent)
        got = all_of(other)
        assert [data for data, _, _ in got] == sent
        assert {address for _, address, _ in got} == {wire.sock.getsockname()}
        times = [came for _, _, came in got]
        assert before - 1_000_000 <= times[0] <= times[-1] <= time.monotonic_ns() - 15_000_000  # not when it was read


def test_strangers_are_told_apart_and_empty_or_overlong_datagrams_show_as_such(pair: Pair) -> None:
    _, other, wire, far = pair
    at = far.sock.getsockname()
    strangers = [bind_udp(("127.0.0.1", 0), "--listen") for _ in range(70)]
    for stranger in strangers:
        stranger.sendto(b"x", at)
    wire.sock.sendto(b"", at)
    wire.sock.sendto(bytes(LONGEST + 500), at)
    got = all_of(other)
    senders = [stranger.getsockname() for stranger in strangers] + 2 * [wire.sock.getsockname()]
    assert [address for _, address, _ in got] == senders
    assert [len(data) for data, _, _ in got[-2:]] == [0, LONGEST]
    for stranger in strangers:
        stranger.close()


def test_a_datagram_without_a_stamp_came_when_it_was_read_and_the_next_has_its_own(pair: Pair) -> None:
    one, other, _, far = pair
    for stamped in (1, 0, 1):
        far.sock.setsockopt(socket.SOL_SOCKET, STAMP, stamped)
        if stamped:
            wait_for_stamps(far)
        one.send([b"x"])
        time.sleep(0.03)
        read = time.monotonic_ns()
        [(_, _, came)] = other.receive()
        assert (read - came > 20_000_000) == bool(stamped)


def test_it_goes_to_the_newest_peer_and_nowhere_without_one(pair: Pair) -> None:
    one, other, wire, _ = pair
    one.send([b"a", b"b"])
    wire.peer = None
    one.send([b"lost", b"lost"])
    wire.peer = wire.sock.getsockname()
    one.send([b"c", b"d"])
    assert [data for data, _, _ in all_of(other)] == [b"a", b"b"]
    assert [data for data, _, _ in all_of(one)] == [b"c", b"d"]


def test_what_cannot_be_sent_is_counted_and_the_rest_goes(pair: Pair) -> None:
    one, _, wire, _ = pair
    wire.peer = ("255.255.255.255", 9)  # broadcast was not asked for
    one.send([b"a", b"b", b"c"])
    assert wire.unsent == 3


def test_a_closed_port_raises_nothing(pair: Pair) -> None:
    one, _, wire, far = pair
    wire.keep_to_peer()
    far.sock.close()
    for _ in range(3):
        one.send([b"anybody?", b"there?"])
        time.sleep(0.005)
        assert one.receive() == []


def test_a_datagram_came_before_it_was_sent_where_the_process_stood_still_between_two_clocks(
        monkeypatch: pytest.MonkeyPatch) -> None:
    wall = 10**18
    now = iter([1_000_000, 1_000_100 + 3_000_000, 5_000_000, 5_000_100])  # 3 ms between the two of the first reading

    class Clocks:
        monotonic_ns = staticmethod(lambda: next(now))
        time_ns = staticmethod(iter([wall + 4_000_050, wall + 5_000_000]).__next__)

    monkeypatch.setattr(reading, "time", Clocks)
    assert reading.clocks() == (5_000_000, wall + 5_000_000)
