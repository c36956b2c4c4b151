"""Two ends that talk all the time, killed, restarted, moved, shot at and observed, in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from teleop.protocol.secure.dtls_record import (
    EXTRA,
    MTU,
    OVERHEAD,
    VERIFY_REQUEST,
    Dropped,
    RelayCookie,
    cookie_of,
    cookie_record,
    records,
)
from teleop.protocol.secure.keys import Key
from teleop.protocol.secure.secure_link import ELSEWHERE_NS, SILENT_NS, SecureLink
from tests.fakes import usually
from tests.teleop.protocol.secure.conftest import AWAY, FORTH, HOME, MS, SLAVE, STEP, World

OTHER_SLAVE = ("192.0.2.3", 9001)


@pytest.mark.parametrize("seed", range(2))
def test_two_ends_meet_and_talk_and_new_keys_cost_not_a_packet(world: Callable[..., World], seed: int) -> None:
    two = world(seed=seed).run(600)
    assert two.slave.address == HOME
    assert two.master.associations == two.slave.associations == 1
    assert two.master.trouble is two.slave.trouble is None
    for end in (0, 1):
        assert two.next_at(end, 0) < 300
        assert len(two.came[end]) == len({number for _, number in two.came[end]})
    two.go(0, two.master.renew(two.now))
    two.run(1000)
    assert two.master.associations == two.slave.associations == 2
    for end in (0, 1):
        sent = [number for number in two.sent[end] if 300 <= number < 1500]
        assert set(sent) <= {number for _, number in two.came[end]}
    for link in (two.master, two.slave):  # flights that came again, and at first data that overtook the last one
        assert set(link.dropped) <= {Dropped.EPOCH, Dropped.EARLY}


@pytest.mark.parametrize(("who", "seed"), [("master", 0), ("slave", 1)])
def test_an_end_that_was_killed_is_met_again_by_itself(world: Callable[..., World], who: str, seed: int) -> None:
    two = world("delay(0.02) | uniform(0.04) | bernoulli(0.3) | duplicate(0.1, after=0.01)", seed).run(3000)
    back = two.restart(who, 1500)
    two.run(6000)
    for end in (0, 1):
        assert two.next_at(end, back + 100) < back + 5500
    late = [when for when, _ in two.came[0]][-1]
    assert late > back + 5800


@pytest.mark.parametrize("after", range(20, 120, 20))
def test_an_end_that_was_killed_in_the_middle_of_a_handshake_is_met_again_soon(
    world: Callable[..., World], after: int
) -> None:
    """Its answers are in the other's half of a handshake that the one which was started anew knows nothing of."""
    two = world("delay(0.02)")
    two.run(after)
    two.start_slave()
    back = two.now // MS
    two.run(4000)
    assert two.next_at(1, back + 1) < back + 3500


def test_a_handshake_is_heard_from_the_peers_address_only(world: Callable[..., World]) -> None:
    two = world()
    ((hello, _),) = two.master.due(two.now)
    assert two.master.receive(hello, AWAY, two.now) == ([], [])
    assert two.master.trouble is None
    assert two.master.dropped == {Dropped.EPOCH: 1}
    two.master.receive(hello, SLAVE, two.now)
    assert "unexpected message" in (two.master.trouble or "")


def test_a_slave_that_answers_from_another_address_than_was_called_is_met(world: Callable[..., World]) -> None:
    """As a host with several does, whose slave listens on all of them. It is called there from then on."""
    two = world()
    two.answers = OTHER_SLAVE
    two.run(1500)
    assert two.master.ready
    assert two.slave.ready
    assert two.master.address == OTHER_SLAVE
    assert two.master.associations == two.slave.associations == 1
    assert two.next_at(0, 0) < 400 + ELSEWHERE_NS // MS
    two.run(600, dead="slave")
    two.start_slave()
    two.run(4000)
    assert two.came[0][-1][0] > 5500
    assert two.master.address == OTHER_SLAVE


def answers(slave: SecureLink, said: list[Any]) -> list[bytes]:
    """What the slave has to say to what came from home."""
    return [data for asked, _ in said for data, _ in slave.receive(asked, HOME, 0)[1]]


def test_a_handshake_that_the_called_address_does_not_answer_is_heard_from_where_its_hellos_are_answered(
    keys: list[Key]
) -> None:
    """And goes on to where it was called: the way that the hello took is the one that its cookie is for."""
    master = SecureLink.calling(keys[0], keys[1].fingerprint, SLAVE)
    slave = SecureLink.listening(keys[1], keys[0].fingerprint, bytes(32))
    (early,) = answers(slave, master.due(0))
    assert master.receive(early, OTHER_SLAVE, MS) == ([], [])
    now = MS + ELSEWHERE_NS
    (later,) = answers(slave, master.due(now))
    assert master.receive(later, ("198.51.100.9", 9001), now) == ([], [])  # it has answered nothing so far
    _, flying = master.receive(later, OTHER_SLAVE, now + MS)
    while not master.ready:
        assert {at for _, at in flying} == {SLAVE}
        back = answers(slave, flying)
        flying = []
        for data in back:
            assert master.receive(data, AWAY, now + MS) == ([], [])
            flying += master.receive(data, OTHER_SLAVE, now + MS)[1]
    assert master.address == SLAVE
    assert master.associations == 1


@pytest.mark.parametrize(("delay", "seed"), [(0.02, 0), (0.02, 1), (0.04, 0), (0.3, 0)])
def test_an_observer_who_answers_first_and_wrongly_does_not_come_into_a_handshake(
    world: Callable[..., World], delay: float, seed: int
) -> None:
    """It sees every hello, and answers each at once from an address of its own with a cookie that is none.

    So it does where the peer's round trip is longer than the wait before a hello is sent again, up to a satellite's.
    """
    two, quiet = (world(f"delay({delay}) | uniform(0.001)", seed) for _ in range(2))
    for _ in range(150 if delay < 0.1 else 900):
        for data, _ in two.master.due(two.now):
            two.go(0, [(data, SLAVE)])
            found = records(data) or []
            for hello in [one for one in found if one.is_hello]:
                body = b"\xfe\xff\x14" + bytes(20)
                size = len(body).to_bytes(3, "big")
                message = bytes((VERIFY_REQUEST,)) + size + bytes(5) + size + body
                number = hello.number.to_bytes(6, "big")
                wrong = b"\x16\xfe\xff\0\0" + number + len(message).to_bytes(2, "big") + message
                for shot in (wrong, wrong, hello.data):
                    assert two.master.receive(shot, AWAY, two.now) == ([], [])
        two.run(STEP)
        quiet.run(STEP)
    assert two.master.ready
    assert two.master.address == SLAVE
    assert two.next_at(0, 0) <= quiet.next_at(0, 0) + 50


@pytest.mark.parametrize(("there", "seed"), [(SLAVE, 0), (OTHER_SLAVE, 1)])
def test_a_stranger_who_does_not_see_the_hello_changes_nothing(
    world: Callable[..., World], keys: list[Key], there: tuple[str, int], seed: int
) -> None:
    """It answers as the slave would, all the time and from all over, with good cookies that it was given itself."""
    two, quiet = world("delay(0.05) | uniform(0.02)", seed), world("delay(0.05) | uniform(0.02)", seed)
    two.answers = quiet.answers = there
    theirs = SecureLink.listening(keys[2], keys[0].fingerprint, bytes(32))
    own = SecureLink.calling(keys[0], keys[2].fingerprint, SLAVE)
    ((asked, _),) = own.due(0)
    _, ((request, _),) = theirs.receive(asked, HOME, 0)
    _, ((again, _),) = own.receive(request, SLAVE, 0)
    _, flight = theirs.receive(again, HOME, MS)
    shots = [request, *(request[:5] + number.to_bytes(6, "big") + request[11:] for number in (0, 1, 2**46, 2**48 - 1)),
             *(data for data, _ in flight), request + flight[0][0]]
    for _ in range(500):
        two.run(STEP)
        quiet.run(STEP)
        for shot in shots:
            for at in (AWAY, ("198.51.100.7", 9001)):
                assert two.master.receive(shot, at, two.now) == ([], [])
    assert len(flight) > 0
    assert two.master.ready
    assert two.master.address == there
    assert two.master.associations == 1
    assert two.came == quiet.came


def test_who_waits_long_for_the_other_end_meets_it_and_takes_no_request_of_an_earlier_handshake(
    world: Callable[..., World]
) -> None:
    """Its cookie is of another hello, and whoever heeded it would not heed the right one any more."""
    for wait, more in ((2500, 500), (12_000, 6000)):
        two = world()
        ((hello, _),) = two.master.due(0)
        _, ((late, _),) = two.slave.receive(hello, HOME, 0)
        two.run(wait, dead="slave")
        assert str(two.master.trouble).startswith("nothing answers; ")
        assert two.master.receive(late, SLAVE, two.now) == ([], [])
        two.run(more)
        assert two.master.ready
        assert two.slave.ready


def test_each_datagram_that_is_not_taken_counts_once_and_what_is_no_record_of_the_peers_raises_no_question(
    world: Callable[..., World]
) -> None:
    """Wherever it comes from."""
    two = world().run(600)
    two.go(0, two.master.renew(two.now))
    two.run(400)
    before = two.slave.dropped.total()
    data = two.master.send(b"x" * 100) or b""
    changed = data[:-1] + bytes((data[-1] ^ 1,)), data[:10] + b"\xff" + data[11:]
    for _ in range(5):
        two.slave.receive(data, HOME, two.now)
    two.slave.receive(changed[0], HOME, two.now)
    assert two.slave.dropped.total() == before + 5
    assert two.slave.dropped[Dropped.REPLAYED] >= 4
    for bad in (*changed, *(data[:length] for length in range(1, len(data))), data + b"x"):
        assert two.slave.receive(bad, AWAY, two.now) == ([], [])
    assert two.slave.settled


def test_a_long_silence_is_no_end_and_a_farewell_is_from_which_the_caller_begins_anew(
    world: Callable[..., World]
) -> None:
    two = world("delay(0.02) | blackout(2.0, 3.0)").run(7000)
    for end in (0, 1):
        assert two.next_at(end, 5000) < 5200
    assert SILENT_NS < 3_000 * MS
    two = world().run(600)
    two.go(1, two.slave.close())
    two.start_slave()
    two.run(3000)
    assert two.master.trouble == "the other end has ended the association"
    assert two.master.associations == 2
    assert two.came[0][-1][0] > 3500


def test_before_anybody_came_there_is_nobody_to_send_to_and_any_address_of_this_machine_is_its_first(
    keys: list[Key]
) -> None:
    """Who sends to 0.0.0.0 is answered from there."""
    link = SecureLink.listening(keys[1], keys[0].fingerprint, bytes(32))
    assert link.address is None
    assert link.send(b"x") is None
    assert link.due(0) == link.close() == link.renew(0) == []
    assert link.receive(b"\x17" + bytes(OVERHEAD), HOME, 0) == ([], [])
    calling = SecureLink.calling(keys[0], keys[1].fingerprint, ("0.0.0.0", 9001))
    assert [at for _, at in calling.due(0)] == [("127.0.0.1", 9001)]


# An observer whose copy of every datagram comes first, from an address of its own: who draws the answers


Make = Callable[..., World]


def assert_at_home(two: World, since: int, until: int, least: float = 1.0) -> None:
    """Nothing was drawn elsewhere, and as much of what was sent in this time came as the link lets through."""
    assert (two.master.address, two.slave.address) == (SLAVE, HOME)
    for end in (0, 1):
        assert two.share(end, since, until) >= least


@usually("seed", range(5), 0, 1)
def test_an_observer_whose_copies_come_first_draws_nothing_to_itself_before_the_meeting_or_during_a_run(
    world: Make, seed: int
) -> None:
    """There was no session for as long as it copied."""
    two = world(seed=seed, copies=True).run(3000)
    assert two.master.associations == two.slave.associations == 1
    assert_at_home(two, 500, 2900)
    two = world("delay(0.02) | uniform(0.02) | bernoulli(0.1)", seed).run(1000)
    two.copies = True
    two.run(3000)
    assert two.master.associations == two.slave.associations == 1
    assert_at_home(two, 500, 3900, 0.85)


@usually("who, seed", [(who, seed) for who in ("master", "slave") for seed in range(3)], ("master", 0), ("slave", 1))
def test_nor_after_an_outage_of_1_4_s_or_after_an_end_was_killed_and_started_again(
    world: Make, who: str, seed: int
) -> None:
    """It never healed."""
    two = world("delay(0.02) | uniform(0.02) | blackout(2.0, 1.4)", seed, copies=True).run(6000)
    assert_at_home(two, 3500, 5900, 0.99)
    two = world(seed=seed, copies=True).run(1000)
    back = two.restart(who, 1500)
    two.run(6000)
    assert_at_home(two, back + 3500, back + 5900)


@usually("delay, seed, copies", [(delay, seed, copies)
         for delay in (0.02, 0.3) for seed in range(5) for copies in (False, True)],
         (0.02, 0, True), (0.02, 1, False), (0.3, 2, True))
def test_a_peer_that_moves_to_another_network_is_followed(world: Make, delay: float, seed: int, copies: bool) -> None:
    """Within half a second and three round trips, be there an observer or not."""
    two = world(f"delay({delay}) | uniform(0.02) | bernoulli(0.1)", seed, copies=copies).run(4000)
    assert two.slave.associations >= 1
    two.from_ = AWAY
    moved = two.now // MS
    two.run(6000)
    assert (two.master.address, two.slave.address) == (SLAVE, AWAY)
    within = round(500 + 3 * 1000 * 2 * (delay + 0.02))
    assert two.share(0, moved + within, moved + 5000) > 0.85


@usually("seed", range(3), 0)
def test_an_observer_that_relays_changes_no_address_of_a_run_and_what_it_drew_of_the_meeting_comes_back(
    world: Make, seed: int
) -> None:
    """As long as the old address answers, and when it relays no more.

    While it relays it is on the path: it sees when something is sent, and can drop it.
    """
    two = world(seed=seed).run(1000)
    two.copies = two.relays = True
    two.run(3000)
    assert_at_home(two, 500, 3900)
    two = world(seed=seed, copies=True)
    two.relays = True
    two.run(3000)
    for end in (0, 1):
        assert two.share(end, 1000, 2900) > 0.99
    two.relays = False
    two.run(4000)
    assert_at_home(two, 4500, 6900)


def test_challenges_are_few_and_none_without_another_address(world: Make) -> None:
    two = world().run(2000)
    assert set(two.to[1]) == {HOME}
    assert two.to[1][HOME] < 520
    two.copies = True
    two.run(5000)
    assert 5 < two.to[1][FORTH] < 100


def hello(number: int) -> bytes:
    body = bytes((1,)) + bytes(100)
    return (b"\x16\xfe\xff\0\0" + number.to_bytes(6, "big") + len(body).to_bytes(2, "big") + body).ljust(MTU, b"\0")


def test_a_relays_cookie_for_a_hello_that_was_not_sent_is_none() -> None:
    caller = RelayCookie()
    sent = caller.stamp(hello(77))
    assert sent == hello(77)
    for number in (76, 78, 0):
        record = (records(hello(number)) or [])[0]
        assert caller.take(cookie_record(record, b"f" * 32)) == b""
    assert caller.stamp(hello(78)) == hello(78)
    record = (records(hello(77)) or [])[0]
    assert caller.take(cookie_record(record, b"c" * 32)) == caller.stamp(hello(77))
    assert cookie_of(records(caller.stamp(hello(79))) or []) == b"c" * 32
    assert caller.take(cookie_record(record, b"c" * 32)) == b"", "a copy draws nothing"
    for other in (b"", b"\x16", bytes(EXTRA), hello(77), hello(77)[:EXTRA]):
        assert caller.take(other) is None
