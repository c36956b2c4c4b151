"""Records of data: keys from the handshake, numbers that are never used twice, and what an end does without them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import OpenSSL._util
import pytest

from teleop.protocol.secure import association as layer
from teleop.protocol.secure.association import LAST, MATERIAL, PACKET, DataRecords
from teleop.protocol.secure.context import exported
from teleop.protocol.secure.dtls_record import DATA, HEAD, OVERHEAD, Dropped

Associated = Callable[[], Any]
SECRET = bytes(range(MATERIAL))


@pytest.fixture
def pair() -> tuple[DataRecords, DataRecords]:
    """The two ends of the same secret."""
    return DataRecords(SECRET, server=False), DataRecords(SECRET, server=True)


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

        monkeypatch.setattr(layer, "AESGCM", Spy)
        for server in (False, True):
            end = DataRecords(SECRET, server=server)
            for start in (0, 2**16 - 50, LAST - 50):
                end.number = start
                for _ in range(100):
                    end.seal(b"x")
        assert len(nonces) == len(set(nonces)) == 2 * 250

    def test_when_they_have_run_out_nothing_is_sealed_any_more(self, pair: Both) -> None:
        one, other = pair
        one.number = LAST - 1
        last = one.seal(b"last")
        assert last is not None
        assert other.open(LAST, last) == b"last" + PACKET
        assert one.seal(b"more") is one.seal(b"more") is None
        assert LAST < 2**48

    def test_an_association_that_has_used_all_of_them_is_over_with_a_sentence(self, associated: Associated) -> None:
        one, _ = associated()
        one.data.number = LAST
        assert one.send(b"x") is None
        assert "has used all its numbers" in one.failure

    def test_one_that_did_not_open_does_not_move_the_window(self, pair: Both) -> None:
        one, other = pair
        record = one.seal(b"x")
        assert record is not None
        changed = record[:9] + b"\xff\xff" + record[11:]
        assert other.open(0xFFFF, changed) is Dropped.FORGED
        assert other.newest == 0
        assert other.open(1, record) == b"x" + PACKET


def test_a_record_looks_like_any_of_dtls_1_2(pair: Both) -> None:
    record = pair[0].seal(bytes(100))
    assert record is not None
    assert HEAD.unpack_from(record) == (DATA, 0xFEFD, 1, 0, 1, 100 + OVERHEAD - HEAD.size)
    assert len(record) == 100 + OVERHEAD == 130
    for at in range(13):
        changed = record[:at] + bytes((record[at] ^ 1,)) + record[at + 1 :]
        assert pair[1].open(1, changed) is Dropped.FORGED, f"byte {at} of the head can be changed"
