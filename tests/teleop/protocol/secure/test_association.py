"""An association of two ends: over lossy links, against strangers, and what becomes of every datagram."""

from __future__ import annotations

import os
from collections.abc import Callable
from datetime import datetime
from random import Random
from typing import Any

import OpenSSL._util
import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509 import CertificateBuilder
from OpenSSL import SSL

from channel.link import parse_link
from channel.schedule import Stream
from teleop.protocol.secure.association import (
    AGAIN_NS,
    LAST,
    LIMIT_NS,
    MATERIAL,
    MOST,
    PACKET,
    Association,
    DataRecords,
)
from teleop.protocol.secure.context import exported
from teleop.protocol.secure.dtls_record import CHANGE, DATA, HANDSHAKE, HEAD, MTU, OVERHEAD, WINDOW, Dropped, records
from teleop.protocol.secure.gate import Gate
from teleop.protocol.secure.keys import Key, fingerprint
from tests.fakes import usually
from tests.teleop.protocol.secure.conftest import AT, LOSSY, MS

Meet = Callable[..., Any]
Associated = Callable[[], Any]


def sealed(end: Association, *plain: bytes) -> list[bytes]:
    return [data for data in map(end.send, plain) if data is not None]


def opened(end: Association, datagrams: list[bytes]) -> list[bytes]:
    return [plain for data in datagrams for plain in end.receive(data, 0)[0]]


def under_the_name_of(key: Key, private: Any = None, serial: int | None = None) -> Key:
    """A key of our own whose certificate says the same as that of another."""
    own, like = private or generate_private_key(SECP256R1()), key.certificate
    builder = CertificateBuilder().subject_name(like.subject).issuer_name(like.issuer).public_key(own.public_key())
    builder = builder.not_valid_before(datetime(1970, 1, 1)).not_valid_after(datetime(1971, 1, 1))
    made = builder.serial_number(serial or like.serial_number).sign(own, SHA256())
    return Key(fingerprint=fingerprint(made.public_bytes(Encoding.DER)), private=own, certificate=made)


def until_flight(keys: list[Key]) -> tuple[Association, Gate, bytes]:
    """A master and a gate in the middle of their handshake, and the flight that is on its way to the master."""
    master = Association.towards(keys[0], keys[1].fingerprint, 0)
    gate = Gate(keys[1], keys[0].fingerprint, bytes(32))
    (cookie,) = [reply for hello in master.begin(0) for reply in gate.receive(hello, AT, 0)[1]]
    (flight,) = [reply for hello in master.receive(cookie, 0)[1] for reply in gate.receive(hello, AT, 0)[1]]
    return master, gate, flight


class TestTheHandshake:
    @usually("seeds", [range(12), range(12, 150)], range(12))
    def test_is_over_in_seconds_whatever_the_link_does(self, meet: Meet, seeds: range) -> None:
        for seed in seeds:
            met = meet(LOSSY, seed)
            assert met.master.ready, seed
            assert met.slave is not None
            assert met.took < 5000
            assert opened(met.slave, sealed(met.master, b"forth")) == [b"forth"]
            assert opened(met.master, sealed(met.slave, b"back")) == [b"back"]

    def test_takes_three_round_trips_outlasts_a_blackout_and_is_of_one_version_and_one_suite(
        self, meet: Meet, keys: list[Key], tmp_path: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """It writes no keys where the environment asks for them."""
        monkeypatch.setenv("SSLKEYLOGFILE", str(tmp_path / "secrets"))
        met = meet("delay(0.01)")
        assert met.took == 60 + 1
        for end in (met.master, met.slave):
            assert end._tls.get_protocol_version_name() == "DTLSv1.2"
            assert end._tls.get_cipher_name() == "ECDHE-ECDSA-AES128-GCM-SHA256"
            assert keys[0].fingerprint not in repr(end), "nothing of it shows a key"
            assert len(repr(end)) < 80
        assert meet("blackout(0.005, 1.0) | delay(0.01)").took < 1500
        assert meet("delay(0.3)").took < 2000
        assert not (tmp_path / "secrets").exists()

    def test_records_that_came_too_early_are_taken_when_they_come_again(self, keys: list[Key]) -> None:
        """A record in the clear that was passed over, and came again under its old number, would be a replay."""
        for first in ((3,), (4,), (4, 3), (3, 4, 2), (2, 1, 0)):
            master, gate, flight = until_flight(keys)
            (proof,) = master.receive(flight, 0)[1]
            found = records(proof)
            assert found is not None
            assert [record.type for record in found] == [HANDSHAKE] * 3 + [CHANGE, HANDSHAKE]
            for place in first:  # the others are lost
                assert gate.receive(found[place].data, AT, 0) == (None, [])
            (again,) = master.due(AGAIN_NS)
            slave, (last,) = gate.receive(again, AT, 0)
            assert slave is not None
            master.receive(last, 0)
            assert opened(slave, sealed(master, b"x")) == [b"x"], first

    def test_nobody_at_home_is_a_failure_with_a_sentence_and_a_forged_alert_is_none(self, keys: list[Key]) -> None:
        alone = Association.towards(keys[0], keys[1].fingerprint, 0)
        alone.begin(0)
        sent = [data for t in range(6000) for data in alone.due(t * MS)]
        assert alone.failure == "no association came about in 5 s"
        assert 15 < len(sent) < 25
        assert alone.receive(sent[0], 0) == ([], [])
        assert alone.send(b"x") is None
        shot = Association.towards(keys[0], keys[1].fingerprint, 0)
        shot.begin(0)
        assert shot.receive(HEAD.pack(21, 0xFEFD, 0, 0, 9, 2) + bytes((2, 42)), 0) == ([], [])
        assert shot.failure is None
        assert "does not take this end's certificate" in (shot.hint or "")


class TestWhoIsLetIn:
    def test_is_the_pinned_master_and_the_pinned_slave_only_also_over_a_lossy_link(
        self, keys: list[Key], meet: Meet
    ) -> None:
        """The same name or another certificate of the same key does not do; one that has run out does."""
        stranger, name, certificate = keys[2], under_the_name_of(keys[0]), under_the_name_of(keys[0], keys[0].private)
        met = meet(mine=stranger)
        assert stranger.fingerprint in met.gate.refused
        assert f"{keys[0].fingerprint} was asked for" in met.gate.refused
        assert "check its --peer-fingerprint" in met.master.failure
        assert stranger.fingerprint in meet(theirs=stranger).master.failure
        for seed in range(3):
            for wrong in ({"mine": stranger}, {"theirs": stranger}, {"mine": name}, {"mine": certificate},
                          {"theirs": under_the_name_of(keys[1])}):
                met = meet(LOSSY, seed, **wrong)
                assert met.slave is None, wrong
                assert not met.master.ready
                assert met.master.failure
        assert meet(mine=name, slave_expects=name.fingerprint).slave is not None

    def test_the_pinned_certificate_without_its_key_does_not_do(self, keys: list[Key]) -> None:
        thief = Key(fingerprint=keys[0].fingerprint, private=keys[2].private, certificate=keys[0].certificate)
        with pytest.raises(SSL.Error):  # it is not even possible with this library
            Association.towards(thief, keys[1].fingerprint, 0)

    def test_nobody_is_let_in_without_a_certificate(self, keys: list[Key], meet: Meet) -> None:
        class Bare(SSL.Context):
            def use_certificate(self, _: Any) -> None: ...
            def use_privatekey(self, _: Any) -> None: ...

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("teleop.protocol.secure.context.SSL.Context", Bare)
            bare = Association.towards(keys[0], keys[1].fingerprint, 0)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Association, "towards", lambda *_: bare)
            met = meet()
        assert met.slave is None
        assert "peer did not return a certificate" in met.gate.refused


class TestDatagrams:
    def test_come_out_as_they_went_in_also_several_at_once_and_those_empty_or_too_long_are_not_sent(
        self, associated: Associated
    ) -> None:
        for one, other in (associated(), reversed(associated())):
            for size in (1, 100, 1200 - OVERHEAD, 1200, MOST):
                plain = Random(size).randbytes(size)
                (data,) = sealed(one, plain)
                assert len(data) == size + OVERHEAD
                assert plain[:8] not in data or size < 8
                assert other.receive(data, 0) == ([plain], []), size
            assert opened(other, [b"".join(sealed(one, b"a", b"b", b"c"))]) == [b"a", b"b", b"c"]
            assert one.send(b"") is one.send(bytes(MOST + 1)) is None

    def test_each_comes_once_and_only_those_that_the_link_delivered(self, associated: Associated) -> None:
        one, other = associated()
        link = Stream(parse_link(LOSSY), 0, 1, 100 + OVERHEAD)
        seen, came = [], []
        for k in range(500):
            (data,) = sealed(one, k.to_bytes(2, "big") + bytes(98))
            link.send(k, k * MS, data)
            for arrived in link.deliver(k * MS):
                came.append(arrived.packet)
                seen += [int.from_bytes(plain[:2], "big") for plain in opened(other, [arrived.load])]
        newest, due = -1, []
        for number in came:  # what the window lets through
            if number not in due and number > newest - WINDOW:
                due.append(number)
            newest = max(newest, number)
        assert seen == due
        assert sum(other.dropped.values()) == len(came) - len(seen)
        assert not other.dropped[Dropped.FORGED]

    def test_that_newer_ones_overtook_are_taken_as_far_as_the_window_reaches(self, associated: Associated) -> None:
        """With the 64 places of OpenSSL's window reordering by 150 ms lost 45 % at 1 kHz."""
        assert WINDOW >= 1024
        for overtaking, taken in ((WINDOW - 1, True), (WINDOW, False)):
            one, other = associated()
            data = sealed(one, *[i.to_bytes(2, "big") for i in range(WINDOW + 1)])
            assert len(opened(other, data[1 : overtaking + 1])) == overtaking
            assert bool(opened(other, data[:1])) is taken
            assert other.dropped == ({} if taken else {Dropped.LATE: 1})

    def test_before_the_association_there_is_nothing_to_send_or_open(self, keys: list[Key]) -> None:
        early = Association.towards(keys[0], keys[1].fingerprint, 0)
        early.begin(0)
        assert early.send(b"x") is None
        assert early.receive(HEAD.pack(DATA, 0xFEFD, 1, 0, 1, 30) + bytes(30), 0) == ([], [])
        assert early.dropped == {Dropped.EARLY: 1}


class TestOtherSenders:
    def test_a_replay_never_surfaces_nor_does_a_record_of_another_association_of_the_same_ends(
        self, associated: Associated
    ) -> None:
        (before, _), (one, other) = associated(), associated()
        assert opened(other, sealed(before, b"hold", b"push")) == []
        assert other.dropped == {Dropped.FORGED: 2}, "and not for a number that is late"
        data = sealed(one, *[i.to_bytes(2, "big") for i in range(WINDOW + 100)])
        opened(other, data)
        assert opened(other, data) == []
        assert opened(one, sealed(one, b"one's own")) == []
        assert other.dropped == {Dropped.FORGED: 2, Dropped.REPLAYED: WINDOW, Dropped.LATE: 100}
        assert opened(other, sealed(one, b"next")) == [b"next"]

    def test_a_handshake_in_the_clear_does_not_touch_an_association(
        self, keys: list[Key], associated: Associated
    ) -> None:
        one, other = associated()
        hello = Association.towards(keys[2], keys[1].fingerprint, 0).begin(0)
        alert = HEAD.pack(21, 0xFEFD, 0, 0, 9, 2) + bytes((2, 40))
        for end in (one, other):
            assert [end.receive(data, 0) for data in (*hello, alert)] == [([], []), ([], [])]
            assert end.dropped == {Dropped.EPOCH: 2}
        assert opened(other, sealed(one, b"x")) == [b"x"]

    def test_no_change_of_any_byte_goes_unnoticed(self, associated: Associated) -> None:
        (one, other), dice = associated(), Random(4)
        for i in range(200):
            (good,) = sealed(one, b"good" * 5)
            at, junk = i % len(good), dice.randbytes(dice.randint(1, 60))
            flipped = good[:at] + bytes((good[at] ^ dice.randint(1, 255),)) + good[at + 1 :]
            for bad in (flipped, good[: at + 1], good + junk.replace(b"\0", b"\1"), junk + good, junk,
                        good[: HEAD.size] + junk):
                before = sum(other.dropped.values())
                assert other.receive(bad, 0) == (([], []) if bad != good else ([b"good" * 5], [])), bad
                assert sum(other.dropped.values()) > before or bad == good
                assert other.failure is None
            assert opened(other, [good]) == [b"good" * 5] * (at + 1 < len(good))

    def test_a_record_of_no_length_that_there_can_be_does_no_harm(self, associated: Associated) -> None:
        """OpenSSL 3.5.2 ends an association over a sealed record of fewer than 24 bytes."""
        for kind in (20, 21, 22, 23):
            one, other = associated()
            for length in (*range(50), MOST, MOST + 25, 2**14, 2**14 + 2048, 2**15, 2**16 - 1):
                for number in (1, 1000, 2**48 - 1):
                    head = HEAD.pack(kind, 0xFEFD, 1, number >> 32, number & 0xFFFFFFFF, length)
                    assert other.receive(head + bytes(length), 0) == ([], [])
            assert other.dropped[Dropped.NO_RECORD] >= 3 * (18 if kind == DATA else 25)  # OpenSSL has not seen them
            assert opened(other, sealed(one, b"x")) == [b"x"], kind

    def test_a_certificate_that_is_none_raises_nothing(self, keys: list[Key]) -> None:
        """It is read before its sender has proved anything."""
        ends = set()
        for at in range(105, 425, 4):
            master, _, flight = until_flight(keys)
            master.receive(flight[:at] + bytes((flight[at] ^ 0xFF >> at % 8,)) + flight[at + 1 :], 0)
            assert not master.ready
            ends.add(master.failure)
        assert any("shows the certificate" in (end or "") for end in ends)

    def test_its_memory_stays_as_it_is(self, associated: Associated) -> None:
        one, other = associated()
        (good,) = sealed(one, bytes(100))
        dice = Random(5)
        bad = [dice.randbytes(dice.randrange(200)) for _ in range(100)]
        bad += [good[:30] + dice.randbytes(107) for _ in range(100)] + [good]

        def resident() -> int:
            with open("/proc/self/statm") as file:
                return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")

        for _ in range(10):
            opened(other, bad)
        before = resident()
        for _ in range(200):
            opened(other, bad)
        assert resident() - before < 1_000_000

    @usually("seeds", [range(12), range(12, 150)], range(12))
    def test_a_handshake_under_fire_never_raises_and_never_lets_in(self, keys: list[Key], seeds: range) -> None:
        for seed in seeds:
            dice = Random(seed)
            master, slave = Association.towards(keys[0], keys[1].fingerprint, 0), None
            gate = Gate(keys[1], keys[0].fingerprint, bytes(32))
            flying = [(0, one) for one in master.begin(0)]
            for step in range(15):
                if not flying:
                    break
                way, good = flying.pop(0)
                fire = bytearray(good)
                for _ in range(dice.randrange(4)):
                    fire[dice.randrange(min(len(good), 700))] = dice.randrange(256)
                for data in (bytes(fire), dice.randbytes(dice.randrange(60)), good[: dice.randrange(len(good))], good):
                    if way:
                        back = master.receive(data, step * MS)[1]
                    else:
                        let_in, back = gate.receive(data, AT, step * 20 * MS)
                        slave = let_in or slave
                    flying += [(1 - way, one) for one in back]
            assert master.ready or master.send(b"x") is None, seed
            if slave is not None and master.ready:
                assert opened(slave, sealed(master, b"x")) == [b"x"]


class TestTheEnd:
    def test_a_farewell_ends_it_at_both_ends(self, associated: Associated) -> None:
        one, other = associated()
        (data,) = one.close()
        other.receive(data[:-1] + bytes((data[-1] ^ 1,)), 0)
        assert other.failure is None, "a forged one does not"
        assert other.receive(data, 0) == ([], [])
        assert other.failure == "the other end has ended the association"
        assert one.failure == "this end has ended the association"
        assert one.close() == other.close() == []
        assert one.send(b"x") is other.send(b"x") is None
        assert other.receive(data, 0) == ([], [])
        assert other.dropped == {Dropped.FORGED: 1, Dropped.OVER: 1}

    def test_the_last_flight_is_sent_again_until_the_other_end_has_spoken(self, associated: Associated) -> None:
        one, slave = associated()
        assert len(slave.due(200 * MS)) == 1
        assert opened(slave, sealed(one, b"x")) == [b"x"]
        assert slave.confirmed
        assert slave.due(1000 * MS) == []
        _, silent = associated()
        assert len([data for t in range(10_000) for data in silent.due(t * MS)]) < 25
        assert silent.due(LIMIT_NS * 3) == []
        assert silent.failure is None


def test_no_datagram_of_a_handshake_is_longer_than_any_network_takes(meet: Meet, monkeypatch: Any) -> None:
    sent: list[int] = []
    original = Stream.send
    monkeypatch.setattr(Stream, "send", lambda *a: (sent.append(len(a[3])), original(*a))[1])
    meet(LOSSY, 3)
    assert sent
    assert max(sent) == MTU


# Records of data: keys from the handshake, numbers that are never used twice, and what an end does without them


SHARED = bytes(range(MATERIAL))


@pytest.fixture
def pair() -> tuple[DataRecords, DataRecords]:
    return DataRecords(SHARED, server=False), DataRecords(SHARED, server=True)


Both = tuple[DataRecords, DataRecords]


class TestKeys:
    def test_both_ends_draw_the_same_from_a_handshake_and_each_handshake_gives_others(
        self, associated: Associated
    ) -> None:
        drawn, library = set(), OpenSSL._util.lib
        for _ in range(3):
            calling, called = associated()
            one, other = (exported(end._tls, MATERIAL, server=end is called) for end in (calling, called))
            assert one == other
            assert one != exported(calling._tls, MATERIAL, server=True), "they depend on which end called"
            drawn.add(one)
            # Without an extended master secret one could be made the same in two handshakes (RFC 7627).
            assert all(library.SSL_get_extms_support(end._tls._ssl) == 1 for end in (calling, called))
        assert len(drawn) == 3

    def test_the_two_directions_and_the_four_parts_differ(self, pair: Both) -> None:
        one, other = pair
        record = one.seal(b"hold")
        assert record is not None
        assert one.open(1, record) is Dropped.FORGED
        assert other.open(1, record) == b"hold" + PACKET
        mirrored = other.seal(b"hold")
        assert mirrored is not None
        assert mirrored[:13] == record[:13]
        assert mirrored[13:] != record[13:]


class TestNumbers:
    def test_every_record_has_a_nonce_of_its_own(self, pair: Both, monkeypatch: pytest.MonkeyPatch) -> None:
        nonces: list[bytes] = []

        class Spy:
            def __init__(self, key: bytes) -> None:
                self.key = key

            def encrypt(self, nonce: bytes, _plain: bytes, _head: bytes) -> bytes:
                nonces.append(self.key + nonce)
                return b""

        monkeypatch.setattr("teleop.protocol.secure.association.AESGCM", Spy)
        for server in (False, True):
            end = DataRecords(SHARED, server=server)
            for start in (0, 2**16 - 50, LAST - 50):
                end.number = start
                for _ in range(100):
                    end.seal(b"x")
        assert len(nonces) == len(set(nonces)) == 2 * 250

    def test_when_they_have_run_out_nothing_is_sealed_any_more_and_the_association_is_over(
        self, pair: Both, associated: Associated
    ) -> None:
        one, other = pair
        one.number = LAST - 1
        last = one.seal(b"last")
        assert last is not None
        assert other.open(LAST, last) == b"last" + PACKET
        assert one.seal(b"more") is one.seal(b"more") is None
        assert LAST < 2**48
        end, _ = associated()
        end.data.number = LAST
        assert end.send(b"x") is None
        assert "has used all its numbers" in end.failure


def test_a_record_looks_like_any_of_dtls_1_2_and_one_that_did_not_open_does_not_move_the_window(pair: Both) -> None:
    record = pair[0].seal(bytes(100))
    assert record is not None
    assert HEAD.unpack_from(record) == (DATA, 0xFEFD, 1, 0, 1, 100 + OVERHEAD - HEAD.size)
    assert len(record) == 100 + OVERHEAD == 130
    for at in range(13):
        changed = record[:at] + bytes((record[at] ^ 1,)) + record[at + 1 :]
        assert pair[1].open(1, changed) is Dropped.FORGED, f"byte {at} of the head can be changed"
    assert pair[1].open(0xFFFF, record[:9] + b"\xff\xff" + record[11:]) is Dropped.FORGED
    assert pair[1].newest == 0
    assert pair[1].open(1, record) == bytes(100) + PACKET
