"""The door of the end that listens: what a stranger gets out of it, and how a peer comes in a second time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from random import Random

import pytest

from teleop.protocol.secure.association import LIMIT_NS, Association
from teleop.protocol.secure.context import Verifier
from teleop.protocol.secure.dtls_record import HEAD, MTU, Dropped, DtlsRecord, records
from teleop.protocol.secure.gate import BURST, CHECK_NS, CHECKED_NS, MOST_BEGUN, Gate, is_for_gate
from teleop.protocol.secure.keys import Key
from teleop.protocol.secure.secure_link import SecureLink
from tests.fakes import usually
from tests.teleop.protocol.secure.conftest import AT, HOME, MS, SECRET, STEP, World

S = 1000 * MS
ELSEWHERE = ("192.0.2.1", 4001)


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
    association, hello = begun
    (cookie,) = gate.receive(hello, at, now)[1]
    (again,) = association.receive(cookie, 0)[1]
    return again


def let_in(gate: Gate, begun: tuple[Association, bytes], at: tuple[str, int] = AT, now: int = 0) -> Association:
    (flight,) = gate.receive(with_cookie(gate, begun, at, now), at, now)[1]
    (proof,) = begun[0].receive(flight, 0)[1]
    association, (last,) = gate.receive(proof, at, now)
    assert association is not None
    begun[0].receive(last, 0)
    return association


class TestAStranger:
    def test_gets_a_cookie_shorter_than_its_hello_by_the_gates_secret_alone_and_is_forgotten(
        self, gate: Gate, master: Master, keys: list[Key]
    ) -> None:
        hello = master()[1]
        for port in range(500):
            let, back = gate.receive(hello, ("198.51.100.7", port), port)
            assert let is None
            assert [len(data) for data in back] == [60]
        assert gate._begun == {}
        assert Gate(keys[1], keys[0].fingerprint, SECRET).receive(hello, AT, 0) == gate.receive(hello, AT, 0)

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

    def test_a_cookie_is_good_for_one_hello_one_address_one_process_and_a_minute(
        self, gate: Gate, keys: list[Key], master: Master
    ) -> None:
        begun, other = master(), master()
        hello = with_cookie(gate, begun)
        theirs = with_cookie(gate, other)
        swapped = hello[:27] + theirs[27:59] + hello[59:]
        restarted = Gate(keys[1], keys[0].fingerprint, bytes(32))
        for where, data, at, now in (
            (gate, swapped, AT, 0), (restarted, hello, AT, 0), (gate, hello, AT, 60 * S), (gate, hello, ELSEWHERE, 0),
            (gate, hello, (AT[0] + "0", AT[1]), 0),
        ):
            assert [len(reply) for reply in where.receive(data, at, now)[1]] == [60]
        assert gate._begun == {}
        assert len(gate.receive(hello, AT, 30 * S)[1][0]) > 500

    def test_whose_hello_is_damaged_or_proved_by_another_costs_nothing(self, gate: Gate, master: Master) -> None:
        hello = with_cookie(gate, master())
        said, proof = records(hello)
        cut = said.data[:-20]
        cut = cut[:11] + (len(cut) - 13).to_bytes(2, "big") + cut[13:]
        theirs = records(with_cookie(gate, master()))[1]
        for i, data in enumerate((cut + proof.data, said.data, (said.data + theirs.data).ljust(MTU, b"\0"))):
            assert gate.receive(data, AT, i * CHECKED_NS) == (None, [])
        assert gate._begun == {}
        assert gate.dropped == {Dropped.FORGED: 2, Dropped.UNPROVED: 1}

    def test_with_a_good_cookie_and_any_byte_of_hello_or_proof_changed_begins_nothing(
        self, gate: Gate, master: Master
    ) -> None:
        hello = with_cookie(gate, master())
        said, proof = records(hello)
        inside = [*range(25, 27), 59, 60, *range(93, len(said.data))]
        inside += range(len(said.data) + HEAD.size, len(said.data + proof.data))  # its head has nothing that counts
        for i, at in enumerate(inside):
            bad = hello[:at] + bytes((hello[at] ^ 0x55,)) + hello[at + 1 :]
            back = gate.receive(bad, AT, i * CHECKED_NS)[1]
            assert [len(data) for data in back] in ([], [15], [60]), at  # nothing, an alert, a cookie
        assert gate._begun == {}
        assert len(gate.receive(hello, AT, len(inside) * CHECKED_NS)[1][0]) > 500

    def test_that_shows_its_own_certificate_first_is_told_and_keeps_the_pinned_master_out_for_no_time(
        self, gate: Gate, master: Master, keys: list[Key]
    ) -> None:
        stranger = Association.towards(keys[2], keys[1].fingerprint, 0)
        (alert,) = gate.receive(with_cookie(gate, (stranger, stranger.begin(0)[0])), AT, 0)[1]
        assert len(alert) == 15
        stranger.receive(alert, 0)
        assert "does not take this end's certificate" in (stranger.hint or "")
        assert keys[2].fingerprint in (gate.refused or "")
        assert gate._begun == {}
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

    def test_that_begins_many_keeps_the_newest(self, gate: Gate, master: Master) -> None:
        hellos = [with_cookie(gate, master(), ("198.51.100.7", i)) for i in range(20)]
        for i, hello in enumerate(hellos):
            gate.receive(hello, ("198.51.100.7", i), i)
        assert [port for _, port in gate._begun] == [*range(20 - MOST_BEGUN, 20)]
        assert let_in(gate, master(), AT, S).ready
        again = with_cookie(gate, master())
        gate.receive(again, AT, 2 * LIMIT_NS)
        assert [*gate._begun] == [AT]

    def test_comes_in_after_a_handshake_of_its_own_that_failed_or_is_in_the_middle(
        self, gate: Gate, master: Master
    ) -> None:
        """A record in the clear that anybody has sent from its address has broken it."""
        (flight,) = gate.receive(with_cookie(gate, first := master()), AT, 0)[1]
        (proof,) = first[0].receive(flight, 0)[1]
        gate.receive(proof[:40] + bytes((proof[40] ^ 1,)) + proof[41:], AT, 0)
        assert gate._begun == {}
        assert gate.receive(with_cookie(gate, master(), AT, CHECKED_NS), AT, CHECKED_NS)[1], "it is in the middle"
        assert let_in(gate, master(), AT, 2 * CHECKED_NS).ready


# A pinned master that calls while others without its key keep a listening end busy, in virtual time


RATE = 1000  # hostile datagrams a second
PORTS = 64
Where = tuple[str, int]


class Hostile:
    """An attacker without the key: it asks for cookies, brings them back, and has seen what the master once sent."""

    def __init__(self, keys: list[Key], addresses: list[Where], seen: bytes, seed: int) -> None:
        self.keys, self.addresses, self.seen, self.dice = keys, addresses, seen, Random(seed)
        self.hellos: deque[tuple[Where, bytes]] = deque(maxlen=2000)  # with good cookies, each at its address
        self.calls: dict[Where, Association] = {}

    def shot(self, slave: SecureLink, now: int) -> None:
        """One datagram to the slave, and what it answers."""
        kind = self.dice.randrange(5) if self.hellos else 0
        address, hello = self.dice.choice(self.hellos) if kind else (self.dice.choice(self.addresses), b"")
        data = {1: hello, 2: self._borrowed(hello), 3: self._forged(hello), 4: self._last(hello)}.get(kind)
        if data is None:
            call = self.calls[address] = Association.towards(self.keys[2], self.keys[1].fingerprint, now)
            (data,) = call.begin(now)
        for reply, at in slave.receive(data, address, now)[1]:
            for again in self.calls[at].receive(reply, now)[1] if at in self.calls else []:
                found = records(again)
                if found is not None and found[0].is_hello:
                    self.hellos.append((at, again))

    def _borrowed(self, hello: bytes) -> bytes:
        """With everything behind the hello that the master once sent."""
        return b"".join(one.data for one in _parts(hello)[:1] + _parts(self.seen)[1:]).ljust(MTU, b"\0")

    def _forged(self, hello: bytes) -> bytes:
        """The same, its last bytes others each time."""
        return self._borrowed(hello).rstrip(b"\0")[:-8] + self.dice.randbytes(8)

    def _last(self, hello: bytes) -> bytes:
        """A record in the clear that belongs into the middle of a handshake."""
        return HEAD.pack(22, 0xFEFD, 0, 0, self.dice.randrange(1 << 16), 40) + self.dice.randbytes(40)


def _parts(datagram: bytes) -> list[DtlsRecord]:
    return records(datagram) or []


def seen_once(keys: list[Key]) -> bytes:
    """The hello with its cookie by which the pinned master came in at another time."""
    master = Association.towards(keys[0], keys[1].fingerprint, 0)
    slave = SecureLink.listening(keys[1], keys[0].fingerprint, bytes(reversed(range(32))))
    ((cookie, _),) = slave.receive(master.begin(0)[0], HOME, 0)[1]
    return master.receive(cookie, 0)[1][0]


def flooded(
    keys: list[Key], addresses: list[Where], seed: int, *, rate: int = RATE, link: str = "delay(0.05)"
) -> tuple[float, int, Gate]:
    """A slave under fire from the beginning, and a master that calls it after a second.

    How long that took until both ends were ready, s, how many handshakes were begun at most, and the slave's gate.
    """
    world, hostile, most_begun = World(keys, link, seed), Hostile(keys, addresses, seen_once(keys), seed), 0
    gate = world.slave._gate
    assert gate is not None
    while not (world.master.ready and world.slave.ready):
        for _ in range(rate * STEP // 1000):
            hostile.shot(world.slave, world.now)
        world.run(STEP, dead="master" if world.now < S else "")
        most_begun = max(most_begun, len(gate._begun))
        assert world.now < 8 * S
    return (world.now - S) / S, most_begun, gate


PORTS_OF_ONE = [("198.51.100.7", 10_000 + i) for i in range(PORTS)]
THOUSANDS = [(f"198.51.{i % 256}.{i % 199}", 1024 + i) for i in range(3000)]
THOUSANDS += [(HOME[0], HOME[1] + 1 + i) for i in range(3000)]  # and of the master's own host


@usually("kind, seed", [(kind, seed) for kind in ("one", "lossy", "thousands", "observed") for seed in range(8)],
         ("one", 0), ("lossy", 1), ("thousands", 2), ("observed", 3))
def test_a_sender_without_the_key_does_not_keep_the_pinned_master_out(keys: list[Key], kind: str, seed: int) -> None:
    """500 datagrams a second with cookies that were used before did: they filled every place for a handshake.

    Nor where the link loses datagrams besides, nor with thousands of addresses: what an end that listens remembers of
    them is bounded, and so is the time that it gives to their signatures. Nor by a copy of each of the master's own
    datagrams from the master's address: it does not use up the cookie.
    """
    link = {"lossy": "delay(0.04) | uniform(0.02) | bernoulli(0.1)", "observed": "delay(0.05) | duplicate(1.0)"}
    took, most_begun, gate = flooded(
        keys, THOUSANDS if kind == "thousands" else PORTS_OF_ONE, seed, link=link.get(kind, "delay(0.05)"),
        rate=2 * RATE if kind == "thousands" else RATE)
    assert took < 3.0
    if kind != "lossy":
        assert most_begun <= 1  # the master's own
    if kind == "thousands":
        assert len(gate._checked) <= BURST + CHECKED_NS // CHECK_NS
        assert len(gate._used) == 1


def test_signatures_that_are_looked_at_are_bounded_in_time(keys: list[Key], monkeypatch: pytest.MonkeyPatch) -> None:
    """Each costs 0.1 ms, whoever sent it: a tenth of the processor at most goes into them."""
    looked: list[int] = []
    look = Verifier.is_good
    monkeypatch.setattr(Verifier, "is_good", lambda self, *a: (looked.append(1), look(self, *a))[1])
    slave = SecureLink.listening(keys[1], keys[0].fingerprint, bytes(32))
    hostile = Hostile(keys, [(f"198.51.100.{i % 200}", 1024 + i) for i in range(300)], seen_once(keys), 1)
    while len({at for at, _ in hostile.hellos}) < 200:
        hostile.shot(slave, 0)
    looked.clear()
    for i in range(4000):
        at, hello = hostile.dice.choice(hostile.hellos)
        slave.receive(hostile._forged(hello), at, S + i * MS // 20)
    assert 0 < len(looked) <= BURST + S // 5 // CHECK_NS
