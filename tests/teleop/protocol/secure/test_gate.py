"""The door of the end that listens: what a stranger gets out of it, and how a peer comes in a second time."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

import pytest

from teleop.protocol.secure.association import LIMIT_NS, Association
from teleop.protocol.secure.dtls_record import HEAD, MTU, Dropped, records
from teleop.protocol.secure.gate import CHECKED_NS, MOST_BEGUN, Gate, is_for_gate
from teleop.protocol.secure.keys import Key

MS = 1_000_000
S = 1000 * MS
AT, ELSEWHERE = ("192.0.2.1", 4000), ("192.0.2.1", 4001)
SECRET = bytes(range(32))


@pytest.fixture
def gate(keys: list[Key]) -> Gate:
    return Gate(keys[1], keys[0].fingerprint, SECRET)


@pytest.fixture
def master(keys: list[Key]) -> Callable[[], tuple[Association, bytes]]:
    """`master()`: the pinned master anew, and its hello."""

    def begun() -> tuple[Association, bytes]:
        association = Association.towards(keys[0], keys[1].fingerprint, 0)
        (hello,) = association.begin(0)
        return association, hello

    return begun


Master = Callable[[], tuple[Association, bytes]]


def with_cookie(gate: Gate, begun: tuple[Association, bytes], at: tuple[str, int] = AT, now: int = 0) -> bytes:
    """The hello that comes back with its cookie."""
    association, hello = begun
    (cookie,) = gate.receive(hello, at, now)[1]
    (again,) = association.receive(cookie, 0)[1]
    return again


def let_in(gate: Gate, begun: tuple[Association, bytes], at: tuple[str, int] = AT, now: int = 0) -> Association:
    """Through the gate, at once."""
    (flight,) = gate.receive(with_cookie(gate, begun, at, now), at, now)[1]
    (proof,) = begun[0].receive(flight, 0)[1]
    association, (last,) = gate.receive(proof, at, now)
    assert association is not None
    begun[0].receive(last, 0)
    return association


class TestAStranger:
    def test_gets_a_cookie_shorter_than_its_hello_and_is_forgotten(self, gate: Gate, master: Master) -> None:
        hello = master()[1]
        for port in range(500):
            let, back = gate.receive(hello, ("198.51.100.7", port), port)
            assert let is None
            assert [len(data) for data in back] == [60]
        assert gate._begun == {}

    def test_no_answer_is_longer_than_the_question_whatever_is_asked(self, gate: Gate, master: Master) -> None:
        dice = Random(1)
        begun = master()
        known = [begun[1], begun[1].rstrip(b"\0"), with_cookie(gate, begun)]
        for i in range(1000):
            data = bytearray(dice.choice(known))
            for _ in range(dice.randrange(6)):
                data[dice.randrange(min(len(data), 180))] = dice.randrange(256)
            junk = dice.randbytes(dice.randrange(1300))
            asked = dice.choice([junk, bytes(data), bytes(data[: dice.randrange(1200)])])
            _, back = gate.receive(asked, ("198.51.100.7", dice.randrange(50)), i * MS)
            assert sum(map(len, back)) <= len(asked)

    def test_not_in_sum_either_before_it_has_shown_its_certificate(self, gate: Gate, master: Master) -> None:
        """Also of an address that is its own: the flight with our certificate comes for as many bytes."""
        hello = with_cookie(gate, master())
        short = hello.rstrip(b"\0")
        assert len(hello) == MTU
        came = went = 0
        for i in range(40):
            asked = short if i < 20 else hello
            came += len(asked)
            went += sum(map(len, gate.receive(asked, AT, i * CHECKED_NS)[1]))
            assert went <= came
        assert went > 5000

    def test_with_the_cookie_of_another_address_it_gets_another_cookie(self, gate: Gate, master: Master) -> None:
        hello = with_cookie(gate, master())
        assert [len(data) for data in gate.receive(hello, ELSEWHERE, 0)[1]] == [60]
        assert [len(data) for data in gate.receive(hello, (AT[0] + "0", AT[1]), 0)[1]] == [60]
        assert gate._begun == {}
        assert len(gate.receive(hello, AT, 0)[1][0]) > 500

    def test_a_cookie_is_good_for_one_hello_one_process_and_a_minute(
        self, gate: Gate, keys: list[Key], master: Master
    ) -> None:
        begun, other = master(), master()
        hello = with_cookie(gate, begun)
        theirs = with_cookie(gate, other)
        swapped = hello[:27] + theirs[27:59] + hello[59:]
        restarted = Gate(keys[1], keys[0].fingerprint, bytes(32))
        for where, data, now in ((gate, swapped, 0), (restarted, hello, 0), (gate, hello, 60 * S)):
            assert [len(reply) for reply in where.receive(data, AT, now)[1]] == [60]
        assert len(gate.receive(hello, AT, 30 * S)[1][0]) > 500

    def test_whose_hello_is_damaged_costs_nothing(self, gate: Gate, master: Master) -> None:
        hello = with_cookie(gate, master())
        said, proof = records(hello)  # type: ignore[misc]
        cut = said.data[:-20]
        cut = cut[:11] + (len(cut) - 13).to_bytes(2, "big") + cut[13:]
        assert gate.receive(cut + proof.data, AT, 0) == (None, [])
        assert gate.receive(said.data, AT, CHECKED_NS) == (None, [])
        assert gate._begun == {}
        assert gate.dropped == {Dropped.FORGED: 1, Dropped.UNPROVED: 1}

    def test_with_a_good_cookie_and_any_byte_of_hello_or_proof_changed_begins_nothing(
        self, gate: Gate, master: Master
    ) -> None:
        hello = with_cookie(gate, master())
        said, proof = records(hello)  # type: ignore[misc]
        inside = [*range(25, 27), 59, 60, *range(93, len(said.data))]
        inside += range(len(said.data) + HEAD.size, len(said.data + proof.data))  # its head has nothing that counts
        for i, at in enumerate(inside):
            bad = hello[:at] + bytes((hello[at] ^ 0x55,)) + hello[at + 1 :]
            back = gate.receive(bad, AT, i * CHECKED_NS)[1]
            assert [len(data) for data in back] in ([], [15], [60]), at  # nothing, an alert, a cookie
        assert gate._begun == {}
        assert len(gate.receive(hello, AT, len(inside) * CHECKED_NS)[1][0]) > 500

    def test_with_the_proof_of_another_hello_begins_nothing(self, gate: Gate, master: Master) -> None:
        (own, _), (_, theirs) = (records(with_cookie(gate, master())) for _ in range(2))  # type: ignore[misc]
        assert gate.receive((own.data + theirs.data).ljust(MTU, b"\0"), AT, 0) == (None, [])
        assert gate.dropped == {Dropped.FORGED: 1}

    def test_is_told_of_a_certificate_that_is_not_the_pinned_one(self, gate: Gate, keys: list[Key]) -> None:
        stranger = Association.towards(keys[2], keys[1].fingerprint, 0)
        begun = stranger, stranger.begin(0)[0]
        (alert,) = gate.receive(with_cookie(gate, begun), AT, 0)[1]
        assert len(alert) == 15
        stranger.receive(alert, 0)
        assert "does not take this end's certificate" in (stranger.hint or "")
        assert keys[2].fingerprint in (gate.refused or "")
        assert gate._begun == {}

    def test_that_shows_its_own_certificate_first_keeps_the_pinned_master_out_for_no_time(
        self, gate: Gate, master: Master, keys: list[Key]
    ) -> None:
        stranger = Association.towards(keys[2], keys[1].fingerprint, 0)
        gate.receive(with_cookie(gate, (stranger, stranger.begin(0)[0])), AT, 0)
        assert gate.refused is not None
        assert let_in(gate, master(), ELSEWHERE).ready

    def test_data_and_alerts_are_not_for_the_gate(self) -> None:
        assert [is_for_gate(bytes((kind,))) for kind in (20, 21, 22, 23, 66)] == [True, False, True, False, False]
        assert not is_for_gate(b"")


class TestThePeer:
    def test_that_was_restarted_comes_in_again_from_anywhere(self, gate: Gate, master: Master) -> None:
        first = master()
        old = let_in(gate, first, AT, 0)
        for at in (AT, ELSEWHERE):
            again = master()
            new = let_in(gate, again, at, S if at == AT else 2 * S)
            assert new.receive(again[0].send(b"new") or b"", 0)[0] == [b"new"]
        assert old.receive(first[0].send(b"old") or b"", 0)[0] == [b"old"]  # its owner says when it is over

    def test_a_late_copy_of_its_hello_begins_nothing(self, gate: Gate, master: Master) -> None:
        begun = master()
        hello = with_cookie(gate, begun)
        (flight,) = gate.receive(hello, AT, 0)[1]
        (proof,) = begun[0].receive(flight, 0)[1]
        assert gate.receive(proof, AT, 0)[0] is not None
        assert gate.receive(hello, AT, S) == (None, [])
        assert gate.receive(proof, AT, S) == (None, [])

    def test_that_begins_anew_in_the_middle_is_not_held_up_by_its_old_attempt(
        self, gate: Gate, master: Master
    ) -> None:
        gate.receive(with_cookie(gate, master()), AT, 0)
        assert let_in(gate, master(), AT, CHECKED_NS).ready

    def test_that_begins_many_keeps_the_newest(self, gate: Gate, master: Master) -> None:
        hellos = [with_cookie(gate, master(), ("198.51.100.7", i)) for i in range(20)]
        for i, hello in enumerate(hellos):
            gate.receive(hello, ("198.51.100.7", i), i)
        assert [port for _, port in gate._begun] == [*range(20 - MOST_BEGUN, 20)]
        assert let_in(gate, master(), AT, S).ready
        again = with_cookie(gate, master())
        gate.receive(again, AT, 2 * LIMIT_NS)
        assert [*gate._begun] == [AT]

    def test_comes_in_after_a_handshake_of_its_own_that_failed(self, gate: Gate, master: Master) -> None:
        """A record in the clear that anybody has sent from its address has broken it."""
        (flight,) = gate.receive(with_cookie(gate, first := master()), AT, 0)[1]
        (proof,) = first[0].receive(flight, 0)[1]
        gate.receive(proof[:40] + bytes((proof[40] ^ 1,)) + proof[41:], AT, 0)
        assert gate._begun == {}
        assert let_in(gate, master(), AT, CHECKED_NS).ready


def test_what_a_gate_says_depends_on_its_secret_and_nothing_hidden(keys: list[Key], master: Master) -> None:
    hello = master()[1]
    replies: list[Any] = [Gate(keys[1], keys[0].fingerprint, SECRET).receive(hello, AT, 0) for _ in range(2)]
    assert replies[0] == replies[1]
