"""Any bytes at all: nothing raises, and nothing is played that is no packet of this session."""

from __future__ import annotations

import random
import struct
from dataclasses import replace
from math import isfinite
from typing import Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.laws.pfra import PFRA
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.estimates import ROUNDS
from teleop.protocol.packet import VERSION, Echo, Kind, Packet, Payload, Rejection, decode, encode, unwrapped
from teleop.protocol.session import Session
from teleop.scene.playout import Fixed, Hold
from teleop.stages.force_cap import Cap
from tests.teleop.protocol.test_endpoint import MS, START, met, scene, sealed
from tests.teleop.protocol.threats.hands import LINK, MANIFEST, OTHER, OURS, STILL, WATCHED, at, control

FUZZED = [WATCHED, replace(WATCHED, playout=Fixed(0.02), cap=Cap(f_max=5.0, slew=1000.0)),
          scene(PFRA(alpha=0.2), link=LINK, playout=Hold(), observer=None)]
TIMES = [0, -1, 2**63 - 1, -(2**63), START, at(30)]
NUMBERS = [OURS, OURS, OTHER, 0, 2**64 - 1]
SEQS = [0, 1, 5, 40, 1023, 1024, 4095, 4096, 65536, 10**9, 2**32 - 1]
KINDS = list(Kind)


def extreme(dice: random.Random, width: int) -> Packet:
    """A well-made packet of any session with the most extreme fields there can be."""
    kind = dice.choice([Kind.FORTH, Kind.BACK, *KINDS])
    echo = dice.choice([None, Echo(dice.choice(TIMES), dice.choice([0, MS, 2**63 - 1]))])
    manifest = dice.choice([MANIFEST, {"scene": "x"}, {}, {"λ" * 100: "y" * 2000}])
    text = dice.choice(["", "finished", "x" * 1000])
    payloads: dict[Kind, Payload] = {
        Kind.FORTH: tuple(dice.choice([0.0, -0.0, 1e-300, dice.uniform(-100, 100)]) for _ in range(width)),
        Kind.BACK: tuple(dice.uniform(-100, 100) for _ in range(width)), Kind.START: dice.choice(TIMES),
        Kind.HELLO: manifest, Kind.WELCOME: manifest,
    }
    seq = dice.choice([dice.choice(SEQS), dice.randint(0, 60)])
    return Packet(kind, dice.choice(NUMBERS), seq, dice.choice(TIMES), echo, payloads.get(kind, text),
                  dice.choice([None, 0.0, 1e308, -1e308]))


def ill_made(dice: random.Random, packet: Packet) -> bytes:
    """The same with a field of it, or all of them, replaced by something that does not belong there."""
    fields: Any = [*packet[1:]]
    wrong: list[Any] = [None, True, -1, 2**63, 2**64 - 1, 0.5, float("nan"), float("inf"), "x", [], [2**64 - 1, 0], {}]
    fields[dice.randrange(6)] = dice.choice(wrong)
    body = msgpack.packb(dice.choice([fields, fields, fields, fields[:5], None, 6, {}]))
    return sealed(struct.pack("!2sBBH", b"BT", VERSION, dice.choice([packet.kind, 7, 255]), len(body)) + body)


def spoilt(dice: random.Random, good: bytes) -> bytes:
    """The same cut, drawn out, or with some of its bytes changed, now and then checksummed anew."""
    how = dice.randrange(4)
    if how == 0:
        return good[: dice.randrange(len(good))]
    if how == 1:
        return good + dice.randbytes(dice.randint(1, 40))
    changed = bytearray(good)
    for _ in range(dice.randint(1, 4)):
        changed[dice.randrange(len(good))] = dice.randrange(256)
    return bytes(changed) if how == 2 else sealed(bytes(changed[:-4]))


def under_fire(seed: int, noise: list[bytes], shots: int) -> tuple[int, int]:
    """Fire at one end, in one of the states it can be in; how many datagrams, and how many messages it took in."""
    dice = random.Random(seed)
    given, e = dice.choice(FUZZED), dice.choice("ms")
    end, others = met(given)[e], met(given)["sm"[e == "s"]].format.width
    running = dice.random() < 0.8
    if not running:  # nobody there yet, or in the middle of the first exchange
        end = Endpoint(given, e, Session(master=e == "m", manifest=MANIFEST, number=OURS if e == "m" else None))
    inbox: Any = end.inbox
    kept: list[bytes] = []
    heard: set[int] = set()
    now, k, taken = START, 0, 0
    for i in range(shots):
        made = extreme(dice, end.format.width)
        good = encode(made)
        shot = dice.choice([good, good, spoilt(dice, good), ill_made(dice, made), dice.choice(kept or [good]),
                            dice.choice(noise)])
        kept = [*kept[-50:], good]
        packet = decode(shot, end.format.width)
        began = end.session.start_ns
        before, most, over = end.received, end.presence.most_ahead(), end.session.ended is not None
        replies = end.receive(shot, now)
        assert all(isinstance(decode(reply, end.format.width), Packet) for reply in replies)
        valid = isinstance(packet, Packet) and packet.session == end.session.number and began is not None
        honest = valid and isinstance(packet, Packet) and packet.kind is end.format.hears
        if honest and isinstance(packet, Packet):
            near = max(end._tick, -((began - now) // MS))
            seq = unwrapped(packet.seq, near)
            if end.received > before:
                assert 0 <= seq <= near + most
                assert not over
                heard.add(seq)
            elif end._met == end.session.met and not over:
                assert not max(0, near - 2**30) <= seq <= near + most
        assert end.received - before <= honest
        taken = end.received
        assert inbox._queued + inbox.waiting <= inbox._room
        if running:
            assert (end.session.number, end.session.start_ns) == (OURS, START)
        if i % 3 == 0:
            now += MS
            k += dice.choice([1, 1, 1, 2, 30])
            tick = end.tick(k, now, STILL)
            assert tick.played == -1 or (tick.played in heard and tick.played < k)
            heard.discard(tick.played)  # it is not played twice
            if not isfinite(tick.force[0]):
                assert end.force_failed == f"f_{e}"  # a byte of a float, changed and checksummed anew
                return i + 1, taken
            told = None if tick.datagram is None else decode(tick.datagram, others)
            if told is Rejection.NON_FINITE:
                return i + 1, taken  # see test_one_number_beyond_all_bounds_does_not_silence_an_end_for_good
            assert told is None or isinstance(told, Packet)
    assert set(end.rejected) <= {*Rejection, "session", "direction", "early", "old"}
    return shots, taken


@settings(max_examples=150)
@given(st.integers(0, 2**32), st.lists(st.binary(max_size=200), min_size=1, max_size=5))
def test_no_bytes_raise_or_are_played_that_are_no_packet_of_this_session(seed: int, noise: list[bytes]) -> None:
    under_fire(seed, noise, 60)


def test_a_master_is_not_stopped_by_a_forged_clock() -> None:
    master = Endpoint(WATCHED, "m", Session(master=True, manifest=MANIFEST, number=OURS))
    for _ in range(ROUNDS):
        master.receive(control(Kind.WELCOME, MANIFEST, sent_ns=2**63 - 1, echo=Echo(-(2**63), 0)), START)


@pytest.mark.parametrize("number", ["--5", "9" * 19, "-" * 19, "²", "0x1", str(2**61), ""])
@pytest.mark.parametrize("entry", ["@every", "@tick 0"])
def test_no_number_in_a_manifest_raises(entry: str, number: str) -> None:
    master = Endpoint(WATCHED, "m", Session(master=True, manifest=MANIFEST, number=OURS))
    slave = Endpoint(WATCHED, "s", Session(master=False, manifest=MANIFEST))
    manifest = {**MANIFEST, entry: number}
    slave.receive(control(Kind.HELLO, manifest), START)
    replies = []
    for _ in range(ROUNDS):
        replies += master.receive(control(Kind.WELCOME, manifest, echo=Echo(START, 0)), START)
    assert all(isinstance(decode(reply, 1), Packet) for reply in replies)


@pytest.mark.parametrize("manifest", [{"a": "b"}, MANIFEST], ids=["another run", "the same run"])
def test_no_answer_to_a_hello_is_longer_than_the_hello(manifest: dict[str, str]) -> None:
    """Else a stranger's small datagrams under a third one's address would be large ones to that."""
    for hello in (control(Kind.HELLO, manifest), Session(master=True, manifest=manifest, number=OURS).due(0)[0]):
        slave = Endpoint(WATCHED, "s", Session(master=False, manifest=MANIFEST))
        answers = slave.receive(hello, START)
        assert [len(reply) for reply in answers if len(reply) > len(hello)] == []
        assert len(answers) == (len(hello) >= 1200), "that of a true master is answered"
