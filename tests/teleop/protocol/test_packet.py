"""The wire: what goes in comes out to the bit, what is not a packet is named, and nothing raises."""

from __future__ import annotations

import struct
import zlib
from math import inf, nan

import msgpack
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from teleop.errors import Refused
from teleop.protocol.packet import (
    DATA,
    MOST_CONTROL,
    MOST_DATA,
    MOST_SENTENCE,
    VERSION,
    Echo,
    Kind,
    Packet,
    Rejection,
    Window,
    check_size,
    decode,
    encode,
    least_size,
    one_line,
    unwrapped,
)

WIDTH = 5
HUGE = 1.7e308  # of which two have no finite sum
MOST_NS = 2**63 - 1
LARGEST = Packet(Kind.FORTH, 2**64 - 1, 2**32 - 1, MOST_NS, Echo(MOST_NS, MOST_NS), (0.1,) * WIDTH, -1e-300)
GOOD = msgpack.packb([1, 2, 3, None, [0.0] * WIDTH, None])
HELLO = Packet(Kind.HELLO, 7, 0, 5, None, {"scene": "canonical", "k_e": "50000.0"})

finite = st.floats(allow_nan=False, allow_infinity=False)
times = st.integers(-(2**63), MOST_NS)
letters = st.sampled_from("aZ09 =.-_'\"\\äλ字🤖")
anything = st.sampled_from("aZ 0λ🤖\0\n\t\r\x1b\x7f\x9b\u202e\u2028\udcff")
sentences = st.text(letters, max_size=200).map(one_line)
printable = st.text(letters, max_size=20)
payloads = {
    Kind.FORTH: st.tuples(*[finite] * WIDTH),
    Kind.BACK: st.tuples(*[finite] * WIDTH),
    Kind.HELLO: st.dictionaries(printable, printable, max_size=5),
    Kind.WELCOME: st.dictionaries(printable, printable, max_size=5),
    Kind.REFUSE: sentences,
    Kind.START: times,
    Kind.BYE: sentences,
    Kind.RENEW: sentences,
}


def packets(*kinds: Kind) -> st.SearchStrategy[Packet]:
    echo = st.none() | st.builds(Echo, times, st.integers(0, MOST_NS))
    return st.sampled_from(kinds or tuple(Kind)).flatmap(
        lambda kind: st.builds(
            Packet, st.just(kind), st.integers(0, 2**64 - 1), st.integers(0, 2**32 - 1), times, echo,
            payloads[kind], st.none() | finite,
        )
    )


def framed(body: bytes, kind: int = 0, version: int = VERSION, padding: bytes = b"") -> bytes:
    """A datagram built from the layout in the documentation, with a correct checksum."""
    data = struct.pack("!2sBBH", b"BT", version, kind, len(body)) + body + padding
    return data + struct.pack("!I", zlib.crc32(data))


def forged(kind: int = 0, **changes: object) -> bytes:
    """A well-framed datagram with one or more fields replaced by anything."""
    fields: dict[str, object] = {
        "session": 1, "seq": 2, "sent_ns": 3, "echo": [4, 5], "payload": [0.0] * WIDTH, "E_in": 0.5,
    }
    return framed(msgpack.packb([*(fields | changes).values()]), kind)


# --- round trip


@given(packets(), st.none() | st.integers(1000, MOST_DATA))
def test_a_packet_comes_back_to_the_bit_and_of_the_size_asked_for(packet: Packet, size: int | None) -> None:
    data = encode(packet, size)
    got = decode(data, WIDTH)
    assert isinstance(got, Packet)
    assert got == packet
    assert type(got.kind) is Kind
    assert type(got.echo) is type(packet.echo)
    assert size is None or len(data) == size
    if packet.kind in DATA:  # -0.0 == 0.0, so compare the bits too
        assert np.array(got.payload).tobytes() == np.array(packet.payload).tobytes()


def test_the_layout_is_the_documented_one() -> None:
    fields = [*LARGEST[1:4], [MOST_NS, MOST_NS], [0.1] * WIDTH, -1e-300]
    assert encode(LARGEST) == framed(msgpack.packb(fields))
    assert encode(LARGEST, 128) == framed(msgpack.packb(fields), padding=bytes(128 - least_size(WIDTH)))
    assert decode(forged(), WIDTH) == Packet(Kind.FORTH, 1, 2, 3, Echo(4, 5), (0.0,) * WIDTH, 0.5)


def test_the_two_ways_are_two_kinds_and_both_carry_messages_alone() -> None:
    assert {Kind.FORTH, Kind.BACK} == DATA
    for kind in DATA:
        got = decode(encode(LARGEST._replace(kind=kind)), WIDTH)
        assert isinstance(got, Packet)
        assert got.kind is kind
        assert decode(framed(GOOD, kind, padding=bytes(MOST_DATA)), WIDTH) is Rejection.OVERSIZE
    assert len(encode(HELLO, MOST_DATA + 1)) == MOST_DATA + 1, "a word of the session itself may be longer"
    assert [int(kind) for kind in Kind] == [*range(8)], "they are on the wire: a new order is a new version"


@given(st.integers(0, 2**40), st.integers(-(2**31), 2**31 - 1))
def test_a_number_is_found_again_from_its_last_32_bits_within_2_31_of_where_one_is(near: int, off: int) -> None:
    assert unwrapped((near + off) % 2**32, near) == near + off


def test_finite_numbers_without_a_finite_sum_are_a_message() -> None:
    packet = LARGEST._replace(payload=(HUGE, HUGE, HUGE, 0.0, 1.0))
    assert decode(encode(packet), WIDTH) == packet
    assert decode(encode(packet._replace(payload=(HUGE, HUGE, HUGE, inf, -inf))), WIDTH) is Rejection.NON_FINITE
    assert decode(encode(packet._replace(payload=(inf, -inf, 0.0, 0.0, 0.0))), WIDTH) is Rejection.NON_FINITE


@pytest.mark.parametrize("width", [0, 1, 5, 15, 16, 126])
def test_least_size_is_the_size_of_the_largest_packet(width: int) -> None:
    largest = LARGEST._replace(payload=(0.1,) * width)
    assert len(encode(largest)) == least_size(width)
    assert len(encode(largest._replace(E_in=None))) == least_size(width, energy=False)
    assert decode(encode(largest, least_size(width)), width) == largest


@given(packets(Kind.FORTH, Kind.BACK))
def test_every_data_packet_fits_into_the_least_size(packet: Packet) -> None:
    assert len(encode(packet, least_size(WIDTH))) == least_size(WIDTH)


def test_sizes_that_cannot_work_are_refused() -> None:
    assert check_size(128, WIDTH) == 128
    assert check_size(least_size(WIDTH), WIDTH) == least_size(WIDTH)
    with pytest.raises(Refused, match=f"packet_size={least_size(WIDTH)}$"):
        check_size(least_size(WIDTH) - 1, WIDTH)
    with pytest.raises(Refused, match="at most 1200"):
        check_size(MOST_DATA + 1, WIDTH)
    with pytest.raises(Refused, match="127 numbers"):
        least_size(127)
    for wrong in (nan, 128.5, True, "128"):
        with pytest.raises(Refused, match="packet_size"):
            check_size(wrong, WIDTH)  # type: ignore[arg-type]
    with pytest.raises(Refused, match="shorten"):
        encode(HELLO._replace(payload={"k": "x" * MOST_CONTROL}))
    with pytest.raises(Refused, match="fewer"):
        encode(LARGEST._replace(payload=(0.0,) * 200))
    with pytest.raises(Refused, match=f"{least_size(WIDTH)} bytes is above {least_size(WIDTH) - 1}"):
        encode(LARGEST, least_size(WIDTH) - 1)


@given(st.text(anything, max_size=100))
@example("λ" * 3000)
@example("two\n" * 3000)
def test_any_text_can_be_sent_as_a_reason(text: str) -> None:
    got = decode(encode(Packet(Kind.BYE, 1, 2, 3, None, text)), WIDTH)
    assert isinstance(got, Packet)
    assert got.payload == one_line(text)
    assert one_line(text).isprintable()
    assert len(one_line(text)) <= MOST_SENTENCE


def test_a_manifest_with_control_characters_is_refused_by_the_sender() -> None:
    with pytest.raises(Refused, match="printable"):
        encode(HELLO._replace(payload={"k": "\x1b[2J"}))


# --- what is wrong is named


def test_each_cause_is_named() -> None:
    data = encode(LARGEST, 128)
    assert decode(b"", WIDTH) is Rejection.TRUNCATED
    assert decode(data[:9], WIDTH) is Rejection.TRUNCATED
    assert decode(data[:80], WIDTH) is Rejection.TRUNCATED  # shorter than its own length field
    assert decode(data[:-1], WIDTH) is Rejection.CHECKSUM  # only the padding was cut
    assert decode(data + b"\0", WIDTH) is Rejection.CHECKSUM
    assert decode(b"GET / HTTP/1.1\r\n", WIDTH) is Rejection.MAGIC
    assert decode(bytes(MOST_CONTROL + 1), WIDTH) is Rejection.OVERSIZE
    assert decode(encode(LARGEST, MOST_DATA + 1), WIDTH) is Rejection.OVERSIZE
    assert isinstance(decode(encode(LARGEST, MOST_DATA), WIDTH), Packet)
    assert isinstance(decode(encode(HELLO, MOST_CONTROL), WIDTH), Packet)
    assert decode(encode(HELLO, MOST_CONTROL + 1), WIDTH) is Rejection.OVERSIZE


def test_another_version_is_named_whatever_follows_it() -> None:
    whatever = bytearray(encode(LARGEST))
    whatever[2] = VERSION + 1
    assert decode(bytes(whatever), WIDTH) is Rejection.VERSION
    assert decode(framed(b"a different format", kind=77, version=VERSION + 1), WIDTH) is Rejection.VERSION


@pytest.mark.parametrize("packet", [LARGEST, HELLO, Packet(Kind.START, 1, 2, 3, None, 4)])
def test_every_single_bit_flip_is_rejected(packet: Packet) -> None:
    data = encode(packet, 128)
    for bit in range(8 * len(data)):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        assert isinstance(decode(bytes(flipped), WIDTH), Rejection), bit


@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_not_finite(value: float) -> None:
    for place in range(WIDTH):
        payload = [0.0] * WIDTH
        payload[place] = value
        assert decode(forged(payload=payload), WIDTH) is Rejection.NON_FINITE
    assert decode(forged(E_in=value), WIDTH) is Rejection.NON_FINITE
    assert decode(encode(LARGEST._replace(E_in=value)), WIDTH) is Rejection.NON_FINITE


@pytest.mark.parametrize(
    "changes",
    [
        {"payload": [0.0] * 4}, {"payload": [0.0] * 6}, {"payload": []}, {"payload": None}, {"payload": 0.0},
        {"payload": [0.0, 0.0, 0.0, 0.0, 0]}, {"payload": [True, 0.0, 0.0, 0.0, 0.0]},
        {"payload": [0.0, 0.0, 0.0, 0.0, None]}, {"payload": [[0.0] * WIDTH]}, {"payload": "01234"},
        {"payload": {"x": 0.0}}, {"payload": b"01234"}, {"payload": [nan] * 4},
        {"session": -1}, {"session": 1.0}, {"session": True}, {"session": None}, {"session": "1"},
        {"seq": -1}, {"seq": 2**32}, {"seq": False}, {"seq": 2.0}, {"seq": None},
        {"sent_ns": 2**63}, {"sent_ns": True}, {"sent_ns": 3.0}, {"sent_ns": None},
        {"echo": []}, {"echo": [4]}, {"echo": [4, 5, 6]}, {"echo": [4, -1]}, {"echo": [2**63, 5]},
        {"echo": [4, 2**63]}, {"echo": [4.0, 5]}, {"echo": [4, True]}, {"echo": 4}, {"echo": {"4": 5}},
        {"E_in": 1}, {"E_in": True}, {"E_in": "0.5"}, {"E_in": [0.5]}, {"extra": 1},
        {"E_in": msgpack.Timestamp(1)}, {"E_in": msgpack.ExtType(1, b"")},
    ],
    ids=str,
)
def test_fields_of_the_wrong_type_shape_or_range_are_malformed(changes: dict[str, object]) -> None:
    assert decode(forged(**changes), WIDTH) is Rejection.MALFORMED


@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        (Kind.HELLO, {"k": 1}), (Kind.HELLO, {1: "k"}), (Kind.HELLO, {"k": "\x1b"}),
        (Kind.HELLO, {"\n": "k"}),
        (Kind.WELCOME, "k"), (Kind.WELCOME, ["k"]), (Kind.WELCOME, None), (Kind.WELCOME, {"k": {}}),
        (Kind.REFUSE, 1), (Kind.REFUSE, b"no"), (Kind.REFUSE, "\x1b[2J"), (Kind.BYE, "two\nlines"),
        (Kind.BYE, "x" * (MOST_SENTENCE + 1)), (Kind.BYE, None), (Kind.START, "now"), (Kind.START, 1.0),
        (Kind.START, 2**63), (Kind.START, True), (Kind.RENEW, 5), (8, "x"), (255, [0.0] * WIDTH), (Kind.FORTH, "x"),
        (Kind.BACK, "x"), (Kind.BACK, {}), (Kind.BACK, [0.0] * (WIDTH + 1)),
    ],
)
def test_payloads_that_do_not_go_with_the_kind_are_malformed(kind: int, payload: object) -> None:
    assert decode(forged(kind, payload=payload), WIDTH) is Rejection.MALFORMED


@pytest.mark.parametrize(
    "body",
    [
        b"", b"\xc1", b"\x91" * 1000, b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff",
        b"\xdb\xff\xff\xff\xff",
        b"\x96\x01\x02\x03\xc0\xa1\xff\xc0", GOOD + b"\xc0", GOOD[:-1], msgpack.packb({"seq": 1}),
        msgpack.packb("abcdef"), msgpack.packb(6),
    ],
)
def test_bodies_that_are_not_one_array_of_six_are_malformed(body: bytes) -> None:
    assert decode(framed(body), WIDTH) is Rejection.MALFORMED


def test_padding_hides_nothing() -> None:
    assert isinstance(decode(framed(GOOD, padding=b"\0\0\0"), WIDTH), Packet)
    assert decode(framed(GOOD, padding=b"\0x\0"), WIDTH) is Rejection.MALFORMED


# --- nothing raises


@settings(max_examples=500)
@given(st.binary(max_size=300), st.integers(0, 8), st.integers(0, 20))
def test_no_bytes_raise(noise: bytes, kind: int, width: int) -> None:
    assert isinstance(decode(noise, width), Rejection)
    assert isinstance(decode(framed(noise, kind), width), (Packet, Rejection))


texts = st.text(letters, max_size=3)
integers = st.integers(-(2**63), 2**64 - 1)
values = st.recursive(
    st.none() | st.booleans() | integers | st.floats() | texts | st.binary(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=8,
)
almost = st.tuples(
    st.integers(-1, 2**64 - 1) | values, st.integers(-1, 2**32) | values, integers | values,
    st.none() | st.tuples(integers, integers) | values,
    st.tuples(st.floats(), st.floats()) | st.dictionaries(texts, texts) | texts | values,
    st.none() | st.floats() | values,
)


@settings(max_examples=250)
@given(st.integers(0, 6), almost | st.lists(values, min_size=5, max_size=7) | values)
def test_whatever_well_framed_values_pass_are_a_true_packet(kind: int, fields: object) -> None:
    got = decode(framed(msgpack.packb(fields), kind), 2)
    if isinstance(got, Packet):
        sent = got._replace(payload=one_line(got.payload)) if isinstance(got.payload, str) else got
        assert decode(encode(got), 2) == sent
    else:
        assert got in (Rejection.MALFORMED, Rejection.NON_FINITE)


@settings(max_examples=500)
@given(packets(), st.data())
def test_damage_is_never_taken_for_a_packet(packet: Packet, data: st.DataObject) -> None:
    good = encode(packet)
    cut = data.draw(st.integers(0, len(good) - 1))
    assert isinstance(decode(good[:cut], WIDTH), Rejection)
    assert isinstance(decode(good + data.draw(st.binary(min_size=1, max_size=8)), WIDTH), Rejection)
    # A burst of up to 32 bits is what a CRC-32 always finds.
    start = data.draw(st.integers(0, len(good) - 4))
    burst = data.draw(st.binary(min_size=4, max_size=4).filter(any))
    damaged = bytes(a ^ b for a, b in zip(good[start : start + 4], burst, strict=True))
    assert isinstance(decode(good[:start] + damaged + good[start + 4 :], WIDTH), Rejection)


# --- replay


@settings(max_examples=300)
@given(st.lists(st.integers(-8, 6), max_size=80), st.integers(1, 6), st.integers(0, 4))
def test_the_window_agrees_with_a_set_of_all_numbers(steps: list[int], ahead: int, more: int) -> None:
    size = ahead + more
    window, seen, newest = Window(ahead=ahead, size=size), set[int](), -1
    for step in steps:
        seq = max(0, newest + step)
        if seq > max(newest, 0) + ahead:
            expected = "ahead"
        elif seq <= newest - size:
            expected = "old"
        else:
            expected = "duplicate" if seq in seen else "new"
        assert window.judge(seq) == expected
        if expected == "new":
            seen.add(seq)
            newest = max(newest, seq)
        assert window.newest == newest


@given(st.lists(st.integers(0, 30) | st.integers(0, 2**33), max_size=50))
def test_no_number_is_new_twice(numbers: list[int]) -> None:
    window = Window(ahead=4, size=16)
    new = [seq for seq in numbers if window.judge(seq, tick=2**33) == "new"]
    assert len(new) == len(set(new))


def test_what_was_overtaken_is_new_once() -> None:
    window = Window()
    assert [window.judge(seq) for seq in (0, 3, 1, 1, 2, 3, 0)] == [
        "new", "new", "new", "duplicate", "new", "duplicate", "duplicate",
    ]


@pytest.mark.parametrize("forged_seq", [1100, 2000, 5000, 2**31, 2**32 - 1])
def test_one_forged_number_does_not_block_what_comes_after(forged_seq: int) -> None:
    window = Window(ahead=1024, size=4096)
    assert [window.judge(k, tick=k) for k in range(100)] == ["new"] * 100
    window.judge(forged_seq, tick=100)
    assert [window.judge(k, tick=k) for k in range(100, 1100)] == ["new"] * 1000


def test_after_a_long_silence_the_clock_vouches_for_the_numbers() -> None:
    window = Window(ahead=16, size=64)
    assert window.judge(0) == "new"
    assert window.judge(5000, tick=0) == "ahead"
    assert window.judge(5000, tick=4990) == "new"
    assert window.judge(5000, tick=4990) == "duplicate"
    assert window.judge(0, tick=4990) == "old"
    assert window.judge(-1) == "old"


@pytest.mark.parametrize(("ahead", "size"), [(0, 10), (11, 10), (-1, 10)])
def test_a_window_that_cannot_work_is_refused(ahead: int, size: int) -> None:
    with pytest.raises(Refused, match="ahead must be"):
        Window(ahead=ahead, size=size)
