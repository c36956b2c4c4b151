"""The wire: what goes in comes out to the bit, what is not a packet is named, and nothing raises."""

from __future__ import annotations

import struct
import zlib
from math import inf, nan
from random import Random
from typing import NamedTuple

import msgpack
import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from teleop.kind import Total
from teleop.protocol.packet import (
    DATA,
    MOST_CONTROL,
    MOST_DATA,
    MOST_SENTENCE,
    VERSION,
    Echo,
    Kind,
    Layout,
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
from tests.teleop.protocol.ends import packet_in
from tests.teleop.protocol.vectors import packet_of, vectors

WIDTH = 5
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


@settings(max_examples=50)
@given(packets(), st.none() | st.integers(1000, MOST_DATA))
def test_a_packet_comes_back_to_the_bit_and_of_the_size_asked_for(packet: Packet, size: int | None) -> None:
    data = encode(packet, size)
    got = packet_in(data, WIDTH)
    assert got == packet
    assert type(got.kind) is Kind
    assert type(got.echo) is type(packet.echo)
    assert size is None or len(data) == size
    if packet.kind in DATA:  # -0.0 == 0.0, so compare the bits too
        assert np.array(got.payload).tobytes() == np.array(packet.payload).tobytes()
        assert len(encode(packet, least_size(WIDTH))) == least_size(WIDTH)


def test_the_two_ways_are_two_kinds_and_both_carry_messages_alone() -> None:
    assert {Kind.FORTH, Kind.BACK} == DATA
    for kind in DATA:
        assert decode(framed(GOOD, kind, padding=bytes(MOST_DATA)), WIDTH) is Rejection.OVERSIZE
    assert len(encode(HELLO, MOST_DATA + 1)) == MOST_DATA + 1, "a word of the session itself may be longer"
    assert [int(kind) for kind in Kind] == [*range(8)], "they are on the wire: a new order is a new version"


@given(st.integers(0, 2**40), st.integers(-(2**31), 2**31 - 1))
def test_a_number_is_found_again_from_its_last_32_bits_within_2_31_of_where_one_is(near: int, off: int) -> None:
    assert unwrapped((near + off) % 2**32, near) == near + off


def test_the_layout_is_the_documented_one_and_the_least_size_that_of_the_largest_packet() -> None:
    assert encode(LARGEST) == framed(msgpack.packb([*LARGEST[1:4], [MOST_NS, MOST_NS], [0.1] * WIDTH, -1e-300]))
    assert decode(forged(), WIDTH) == Packet(Kind.FORTH, 1, 2, 3, Echo(4, 5), (0.0,) * WIDTH, 0.5)
    for width in (0, 1, 5, 15, 16, 126):
        largest = LARGEST._replace(payload=(0.1,) * width)
        assert len(encode(largest)) == least_size(width) == check_size(least_size(width), width)
        assert len(encode(largest._replace(E_in=None))) == least_size(width, energy=False)
        assert decode(encode(largest, least_size(width)), width) == largest, width


@settings(max_examples=50)
@given(st.text(anything, max_size=100))
@example("λ" * 3000)
@example("two\n" * 3000)
def test_any_text_can_be_sent_as_a_reason(text: str) -> None:
    got = packet_in(encode(Packet(Kind.BYE, 1, 2, 3, None, text)), WIDTH)
    assert got.payload == one_line(text)
    assert one_line(text).isprintable()
    assert len(one_line(text)) <= MOST_SENTENCE


# --- what is wrong is named


def test_each_cause_is_named() -> None:
    """Cases that are not among the vectors: the bounds themselves, and numbers that are not finite at every place."""
    data = encode(LARGEST, 128)
    for bad, cause in (
            (data[:-1], Rejection.CHECKSUM), (data + b"\0", Rejection.CHECKSUM),  # only the padding was cut
            (bytes(MOST_CONTROL + 1), Rejection.OVERSIZE), (encode(LARGEST, MOST_DATA + 1), Rejection.OVERSIZE),
            (encode(HELLO, MOST_CONTROL + 1), Rejection.OVERSIZE),
            (framed(b"a different format", kind=77, version=VERSION + 1), Rejection.VERSION),
            (framed(GOOD, padding=b"\0x\0"), Rejection.MALFORMED)):
        assert decode(bad, WIDTH) is cause, bad
    for good in (encode(LARGEST, MOST_DATA), encode(HELLO, MOST_CONTROL), framed(GOOD, padding=b"\0\0\0")):
        assert isinstance(decode(good, WIDTH), Packet)
    for value in (nan, inf, -inf):
        for place in range(WIDTH):
            payload = [0.0] * WIDTH
            payload[place] = value
            assert decode(forged(payload=payload), WIDTH) is Rejection.NON_FINITE
        assert decode(forged(E_in=value), WIDTH) is Rejection.NON_FINITE
    without_a_sum = LARGEST._replace(payload=(1.7e308, 1.7e308, 1.7e308, 0.0, 1.0))
    assert decode(encode(without_a_sum), WIDTH) == without_a_sum, "finite numbers without a finite sum are a message"


FIELDS: dict[str, list[object]] = {
    "payload": [[], None, 0.0, [0.0, 0.0, 0.0, 0.0, 0], [0.0, 0.0, 0.0, 0.0, None], [[0.0] * WIDTH], "01234",
                {"x": 0.0}, b"01234", [nan] * 4],
    "session": [1.0, True, None, "1"], "seq": [-1, False, 2.0, None], "sent_ns": [True, 3.0, None],
    "echo": [[], [4, 5, 6], [2**63, 5], [4, 2**63], [4.0, 5], [4, True], 4, {"4": 5}],
    "E_in": [True, "0.5", [0.5], msgpack.Timestamp(1), msgpack.ExtType(1, b"")], "extra": [1]}
PAYLOADS: dict[int, list[object]] = {
    Kind.HELLO: [{1: "k"}, {"k": "\x1b"}, {"\n": "k"}], Kind.WELCOME: ["k", None, {"k": {}}], Kind.REFUSE: [1],
    Kind.BYE: ["two\nlines", None], Kind.START: ["now", 2**63, True], Kind.RENEW: [5], 255: [[0.0] * WIDTH],
    Kind.FORTH: ["x"], Kind.BACK: ["x", {}, [0.0] * (WIDTH + 1)]}
BODIES = [b"", b"\xc1", b"\x91" * 1000, b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xdb\xff\xff\xff\xff",
          msgpack.packb("abcdef"), msgpack.packb(6)]


def test_what_is_of_the_wrong_type_shape_or_range_is_malformed() -> None:
    """Beside the vectors: fields, payloads that do not go with their kind, and bodies that are not one array of six."""
    bad = [(forged(**{name: value}), f"{name}={value}") for name, values in FIELDS.items() for value in values]
    bad += [(forged(kind, payload=value), f"{kind}: {value}") for kind, values in PAYLOADS.items() for value in values]
    for data, name in [*bad, *[(framed(body), repr(body)) for body in BODIES]]:
        assert decode(data, WIDTH) is Rejection.MALFORMED, name


# --- nothing raises


@settings(max_examples=40)
@given(packets(), st.integers(0, 2**32))
def test_damage_is_never_taken_for_a_packet(packet: Packet, seed: int) -> None:
    """Whatever is cut, added or flipped within 32 bits, which a CRC-32 always finds; and no bytes raise."""
    good, dice = encode(packet), Random(seed)
    for _ in range(10):
        noise, at = dice.randbytes(dice.randint(4, 300)), dice.randrange(len(good) - 3)
        burst = dice.randrange(1, 2**32).to_bytes(4, "big")
        damaged = bytes(a ^ b for a, b in zip(good[at:at + 4], burst, strict=True))
        for bad in (good[:dice.randrange(len(good))], good + noise[:8], good[:at] + damaged + good[at + 4:], noise):
            assert isinstance(decode(bad, WIDTH), Rejection), bad
        assert isinstance(decode(framed(noise, dice.randrange(9)), dice.randrange(20)), (Packet, Rejection))
    bits = encode(LARGEST, 128)
    for bit in (*range(0, 8 * len(bits), 7), seed % (8 * len(bits))):
        flipped = (int.from_bytes(bits, "big") ^ 1 << bit).to_bytes(len(bits), "big")
        assert isinstance(decode(flipped, WIDTH), Rejection), bit


# --- replay


@settings(max_examples=50)
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


def test_after_a_long_silence_the_clock_vouches_for_the_numbers() -> None:
    window = Window(ahead=16, size=64)
    assert window.judge(0) == "new"
    assert window.judge(5000, tick=0) == "ahead"
    assert window.judge(5000, tick=4990) == "new"
    assert window.judge(5000, tick=4990) == "duplicate"
    assert window.judge(0, tick=4990) == "old"
    assert window.judge(-1) == "old"
    for number in (1100, 2000, 5000, 2**31, 2**32 - 1):
        window = Window(ahead=1024, size=4096)
        assert [window.judge(k, tick=k) for k in range(100)] == ["new"] * 100
        window.judge(number, tick=100)
        assert [window.judge(k, tick=k) for k in range(100, 1100)] == ["new"] * 1000, f"{number} blocks what follows"


# --- a law's messages: they come out as they went in; a total of coupled axes goes once


class Mixed(NamedTuple):
    E: Total
    x: float
    S: Total
    v: float


def test_a_laws_messages_are_all_there_and_a_total_of_coupled_axes_goes_once() -> None:
    for axes in (1, 2, 3):
        for couples in (False, True):
            layout = Layout(Mixed, axes, couples=couples)
            own = [Mixed(10.0 + i, 20.0 + i, 30.0 + i, 40.0 + i) for i in range(axes)]
            sent = tuple(one._replace(E=1.5, S=2.5) if couples else one for one in own)
            numbers = layout.flat(sent)
            assert len(numbers) == layout.width == (4 + 2 * (axes - 1) if couples else 4 * axes)
            assert layout.messages((*numbers, 7.0, 8.0)) == sent, (axes, couples)
            assert all(type(one) is Mixed for one in layout.messages(numbers))
    assert [type(number) for number in Layout(Mixed, 1, couples=False).flat((Mixed(1, 2, 3, 4),))] == [float] * 4


# --- the wire as it is written down: `teleop/protocol/vectors.json`, in both directions


def test_the_vectors_are_what_is_sent_and_taken() -> None:
    every = vectors()
    assert every["wire_version"] == VERSION
    for one in every["accepted"]:
        packet, data = packet_of(one["packet"]), bytes.fromhex(one["hex"])
        assert encode(packet, one["size"]) == data, one["name"]
        assert repr(decode(data, one["width"])) == repr(packet), one["name"]  # -0.0 is not 0.0
    for one in every["accepted_in_other_forms"]:
        packet, data = packet_of(one["packet"]), bytes.fromhex(one["hex"])
        assert decode(data, one["width"]) == packet, one["name"]
        assert encode(packet) != data, one["name"]
    for one in every["rejected"]:
        assert decode(bytes.fromhex(one["hex"]), one["width"]) is Rejection(one["rejection"]), one["name"]
    assert {one["packet"]["kind"] for one in every["accepted"]} == {one.name for one in Kind}
    assert {one["rejection"] for one in every["rejected"]} == {why.value for why in Rejection}
