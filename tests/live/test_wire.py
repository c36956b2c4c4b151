"""Sockets: by the kernel's filter only what has the shape of ours; and datagrams by the handful."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.live.driving import SEALED_OPEN_NS, Listening
from teleop.live.net import wire as wire_module
from teleop.live.net.bulk import MOST, Bulk
from teleop.live.net.filter import LONGEST, Shape, attach, detach, of_records, of_session, program
from teleop.live.net.wire import STAMP, Wire, bind_udp
from teleop.protocol.packet import DATA, VERSION, Echo, Kind, Packet, encode

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux filters for a socket")
SIZE = 136
SESSION = 0xFEDC_BA98_7654_3210
OTHER = SESSION ^ 1 << 40
PAYLOADS = {Kind.FORTH: (1.0, -2.5), Kind.BACK: (1.0, -2.5), Kind.START: 77, Kind.REFUSE: "no", Kind.BYE: "finished"}


def packet(kind: Kind, session: int = SESSION, size: int | None = SIZE, seq: int = 0) -> bytes:
    said = Packet(kind, session, seq, 10**15, Echo(5, 6), PAYLOADS.get(kind, {"k_e": "1.0"}))
    return encode(said, size if kind in DATA else None)


class Ends:
    """A socket that hears and one that speaks to it."""

    def __init__(self) -> None:
        self.here, self.there = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self.here.bind(("127.0.0.1", 0))
        self.here.setblocking(False)
        self.there.connect(self.here.getsockname())

    def come(self, *sent: bytes) -> list[bytes]:
        """What of it came in. Loopback delivers before `send` returns."""
        for data in sent:
            self.there.send(data)
        got = []
        while True:
            try:
                got.append(self.here.recv(LONGEST))
            except BlockingIOError:
                return got


@pytest.fixture(scope="module")
def ends() -> Iterator[Ends]:
    both = Ends()
    yield both
    both.here.close()
    both.there.close()


@pytest.fixture(autouse=True)
def _open_again(ends: Ends) -> Iterator[None]:
    yield
    detach(ends.here)
    assert ends.come() == []


@linux
@pytest.mark.parametrize("session", [SESSION, 7, 200, 2**16, 2**32], ids=hex)
@pytest.mark.parametrize("heard", sorted(DATA), ids=lambda kind: kind.name)
def test_what_the_other_end_of_the_session_sends_comes_through(ends: Ends, session: int, heard: Kind) -> None:
    """Whatever number it has: msgpack writes small ones shorter. An end's own messages, thrown back at it, do not."""
    assert attach(ends.here, program(*of_session(session, SIZE, heard)))
    ours = [packet(kind, session, seq=seq) for kind in Kind if kind is heard or kind not in DATA for seq in (0, 70_000)]
    (own,) = DATA - {heard}
    assert ends.come(packet(own, session), *ours) == ours


GOOD = packet(Kind.FORTH)


@linux
@pytest.mark.parametrize("bad", [
    b"", b"B", b"BT", b"BT" + bytes((VERSION, 0)), b"GET / HTTP/1.1\r\n", bytes(SIZE), bytes(1200),
    packet(Kind.FORTH, OTHER), packet(Kind.BYE, OTHER), packet(Kind.BACK),
    packet(Kind.FORTH, size=SIZE + 1), packet(Kind.FORTH, size=SIZE - 1), GOOD[:-1], GOOD[:14],
    b"BX" + GOOD[2:], b"BT" + bytes((VERSION + 1,)) + GOOD[3:],
    b"BT" + bytes((VERSION, len(Kind))) + packet(Kind.BYE)[4:],
    GOOD[:6] + b"\x95" + GOOD[7:], b"\x17\xfe\xfd\x00\x01" + bytes(SIZE - 5),
], ids=lambda bad: f"{len(bad)} {bad[:8].hex()}")
def test_what_is_none_of_it_does_not(ends: Ends, bad: bytes) -> None:
    assert ends.come(bad, GOOD) == [bad, GOOD], "without a filter it comes"
    assert attach(ends.here, program(*of_session(SESSION, SIZE, Kind.FORTH)))
    assert ends.come(bad, GOOD) == [GOOD]


@linux
def test_another_filter_takes_the_place_of_the_first_and_detaching_lets_everything_in(ends: Ends) -> None:
    one, other = packet(Kind.FORTH), packet(Kind.FORTH, OTHER)
    attach(ends.here, program(*of_session(SESSION, SIZE, Kind.FORTH)))
    assert ends.come(one, other) == [one]
    attach(ends.here, program(*of_session(OTHER, SIZE, Kind.FORTH)))
    assert ends.come(one, other) == [other]
    assert detach(ends.here)
    assert ends.come(one, other, b"anything") == [one, other, b"anything"]
    assert not detach(ends.here), "there is none any more"
    ends.there.send(b"before")
    attach(ends.here, program(*of_session(SESSION, SIZE, Kind.FORTH)))
    assert ends.come(b"after") == [b"before"], "what waited before the filter came is still there"


def sealed(kind: int, epoch: int, body: int, says: int | None = None) -> bytes:
    head = bytes((kind, 0xFE, 0xFD)) + epoch.to_bytes(2, "big") + bytes(6)
    return head + (body if says is None else says).to_bytes(2, "big") + bytes(body)


@linux
def test_sealed_data_comes_through_as_long_as_it_says_and_of_the_epoch_of_data(ends: Ends) -> None:
    good = [sealed(23, 1, size) for size in (24, 160, 8000)]
    bad = [sealed(23, 1, 160, says=161), sealed(23, 1, 160)[:-3], sealed(23, 0, 160), sealed(23, 2, 160), bytes(173),
           sealed(23, 1, 0)[:12], sealed(24, 1, 160), packet(Kind.FORTH)]
    meeting = [sealed(kind, epoch, 60) for kind in (20, 21, 22) for epoch in (0, 1)]
    meeting += [sealed(22, 0, 60) + sealed(20, 0, 1)]  # several records at once
    attach(ends.here, program(*of_records(handshakes=False)))
    assert ends.come(*bad, *good, *meeting) == good
    attach(ends.here, program(*of_records()))
    assert ends.come(*bad, *good, *meeting) == [*good, *meeting]


@linux
@settings(max_examples=75)
@given(data=st.data())
def test_the_kernel_judges_as_the_shapes_read(ends: Ends, data: st.DataObject) -> None:
    """Against the same rules written in Python, over small alphabets so that both verdicts are common."""
    few = st.binary(max_size=6).map(lambda text: bytes(byte & 1 for byte in text))
    offsets = st.integers(0, 4)
    drawn = data.draw(st.lists(st.tuples(
        st.lists(st.tuples(offsets, few), max_size=2), st.integers(0, 6), st.integers(10, 14), st.none() | offsets,
    ), min_size=1, max_size=3))
    shapes = [Shape(has=tuple(has), least=least, most=most, rest_at=at) for has, least, most, at in drawn]
    text = data.draw(st.binary(max_size=14).map(lambda text: bytes(byte & 1 for byte in text)))
    at = data.draw(st.integers(0, 4))
    if data.draw(st.booleans()) and len(text) > at + 2:  # make the number of the bytes that follow true
        text = text[:at] + (len(text) - at - 2).to_bytes(2, "big") + text[at + 2 :]

    def fits(shape: Shape) -> bool:
        rest = shape.rest_at
        return (
            shape.least <= len(text) <= shape.most
            and all(text[where : where + len(part)] == part and where + len(part) <= len(text)
                    for where, part in shape.has)
            and (rest is None or (len(text) >= rest + 2
                                  and int.from_bytes(text[rest : rest + 2], "big") == len(text) - rest - 2))
        )

    assert attach(ends.here, program(*shapes))
    assert ends.come(text) == ([text] if any(map(fits, shapes)) else [])


def test_where_there_is_no_filter_it_says_so(monkeypatch: pytest.MonkeyPatch, ends: Ends) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    assert not attach(ends.here, program(*of_session(SESSION, SIZE, Kind.FORTH)))
    assert not detach(ends.here)
    assert ends.come(b"anything") == [b"anything"]


@linux
def test_a_closed_socket_or_a_program_that_the_kernel_does_not_take_is_no_error(ends: Ends) -> None:
    gone = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    gone.close()
    assert not attach(gone, program(Shape()))
    assert not detach(gone)
    assert not attach(ends.here, b"\xff" * 8), "no such instruction"
    assert ends.come(b"anything") == [b"anything"]


def test_a_filter_is_taken_off_again_though_the_peer_could_not_be_connected_to() -> None:
    """As when the network is down at that moment: an end that kept it would be deaf to the next session."""
    kind = socket.AF_INET, socket.SOCK_DGRAM
    with socket.socket(*kind) as here, socket.socket(*kind) as other:
        here.bind(("127.0.0.1", 0))
        wire = Wire(here, ("255.255.255.255", 9))  # a broadcast, which may not be connected to
        wire.keep_to_peer(of_session(5, 100, Kind.FORTH))
        assert not wire.connected
        other.sendto(b"another session's", here.getsockname())
        assert wire.receive() is None
        wire.listen_to_all()
        other.sendto(b"another session's", here.getsockname())
        assert wire.receive() is not None


def test_an_end_with_keys_keeps_to_its_peers_records_but_in_a_silence_and_while_an_address_is_in_question() -> None:
    """Or a flood from elsewhere would cost it ticks."""
    heard: list[Any] = []
    keys = SimpleNamespace(settled=False)
    wire: Any = SimpleNamespace(secure_link=keys, keep_to_peer=heard.append, listen_to_all=lambda: heard.append("all"))
    end: Any = SimpleNamespace(heard_ns=1, session=SimpleNamespace(number=SESSION, carries_data=True))
    listening = Listening(end, wire)
    listening.update(0, True)
    keys.settled, end.heard_ns = True, 2
    for now in (2, 2 + SEALED_OPEN_NS, 3 + SEALED_OPEN_NS):
        listening.update(now, False)
    assert heard == ["all", of_records(), "all"]


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
def bulks(request: pytest.FixtureRequest) -> Iterator[tuple[Bulk, Bulk, Wire, Wire]]:
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


Bulks = tuple[Bulk, Bulk, Wire, Wire]


def all_of(bulk: Bulk) -> list[tuple[bytes, tuple[str, int], int]]:
    time.sleep(0.02)
    got = []
    while more := bulk.receive():
        assert len(more) <= MOST
        got += more
    return got


@pytest.mark.parametrize("count", [1, 2, MOST, MOST + 1, 3 * MOST + 5])
def test_they_come_whole_and_in_order_with_sender_and_time(bulks: Bulks, count: int) -> None:
    one, other, wire, _ = bulks
    for _ in range(2):  # the system has written over the headers by then
        sent = [bytes([k % 251]) * (1 + 37 * k % 1200) for k in range(count)]
        before = time.monotonic_ns()
        one.send(sent)
        got = all_of(other)
        assert [data for data, _, _ in got] == sent
        assert {address for _, address, _ in got} == {wire.sock.getsockname()}
        times = [came for _, _, came in got]
        assert before - 1_000_000 <= times[0] <= times[-1] <= time.monotonic_ns() - 15_000_000  # not when it was read


def test_strangers_are_told_apart_and_empty_or_overlong_datagrams_show_as_such(bulks: Bulks) -> None:
    _, other, wire, far = bulks
    at = far.sock.getsockname()
    strangers = [bind_udp(("127.0.0.1", 0), "--listen") for _ in range(70)]
    for stranger in strangers:
        stranger.sendto(b"x", at)
    wire.sock.sendto(b"", at)
    wire.sock.sendto(bytes(wire_module.LONGEST + 500), at)
    got = all_of(other)
    senders = [stranger.getsockname() for stranger in strangers] + 2 * [wire.sock.getsockname()]
    assert [address for _, address, _ in got] == senders
    assert [len(data) for data, _, _ in got[-2:]] == [0, wire_module.LONGEST]
    for stranger in strangers:
        stranger.close()


def test_a_datagram_without_a_stamp_came_when_it_was_read_and_the_next_has_its_own(bulks: Bulks) -> None:
    one, other, _, far = bulks
    for stamped in (1, 0, 1):
        far.sock.setsockopt(socket.SOL_SOCKET, STAMP, stamped)
        if stamped:
            wait_for_stamps(far)
        one.send([b"x"])
        time.sleep(0.03)
        read = time.monotonic_ns()
        [(_, _, came)] = other.receive()
        assert (read - came > 20_000_000) == bool(stamped)


def test_it_goes_to_the_newest_peer_what_cannot_be_sent_is_counted_and_a_closed_port_raises_nothing(
    bulks: Bulks
) -> None:
    one, other, wire, far = bulks
    one.send([b"a", b"b"])
    wire.peer = None
    one.send([b"lost", b"lost"])
    wire.peer = wire.sock.getsockname()
    one.send([b"c", b"d"])
    assert [data for data, _, _ in all_of(other)] == [b"a", b"b"]
    assert [data for data, _, _ in all_of(one)] == [b"c", b"d"]
    wire.peer = far.sock.getsockname()
    known, wire.peer = wire.peer, ("255.255.255.255", 9)  # broadcast was not asked for
    one.send([b"a", b"b", b"c"])
    assert wire.unsent == 3
    wire.peer = known
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

    monkeypatch.setattr(wire_module, "time", Clocks)
    assert wire_module.clocks() == (5_000_000, wall + 5_000_000)
