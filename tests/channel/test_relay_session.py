"""Who has the relay's link: sessions that begin, run and end, and unknown hosts beside them, on a virtual clock."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from channel.relay import MOST_FLOWS, QUIET_NS, UNMET_MOST, UNMET_NS
from channel.router import EACH_MOST, SLOT_NS, Cookies
from teleop.protocol.packet import Echo, Kind, Packet, decode, encode
from teleop.protocol.secure.dtls_record import EXTRA, MTU, records
from teleop.protocol.session import Session
from teleop.scene.loading import load_scene
from tests.channel.site import MANIFEST, MASTER, MS, OTHER_HOME, SEED, SLAVE, UNKNOWN, Site, hello, request, sealed
from tests.live.conftest import command, summary  # noqa: F401 (a fixture)
from tests.waiting import PATIENCE

# In the open


def test_a_master_meets_the_slave_however_many_hosts_say_hello_meanwhile() -> None:
    """Each is answered, and none has a turn in which the others wait: the slave says whose session it is."""
    site = Site()
    site.takes(site.session(5)(Kind.HELLO), UNKNOWN)
    for k in range(50):
        site.now += 20 * MS
        site.takes(site.session(100 + k)(Kind.HELLO), (UNKNOWN[0], 6000 + k))
        for kind in (Kind.WELCOME, Kind.REFUSE):
            assert site.takes(site.session(100 + k)(kind), SLAVE)
            assert site.out[0][-1][0] == (UNKNOWN[0], 6000 + k)
    site.run(7)
    assert len(list(site.router.flows)) == 1


def test_hellos_reach_the_slave_at_a_bounded_rate_and_each_sender_has_a_share() -> None:
    """Of 20,000 a second from any addresses a thousand are passed on; an honest master's find room among them."""
    site, rng = Site(), random.Random(4)
    asked = passed = 0
    for k in range(10_000):
        site.now += MS // 20
        passed += site.takes(site.session(k)(Kind.HELLO), (UNKNOWN[0], rng.randrange(10_000, 60_000)))
        if k % 500 == 0:
            asked += site.takes(site.session(10**6)(Kind.HELLO), MASTER)
    assert asked > 0
    assert 500 <= passed <= 600
    once = Site()
    assert sum(once.takes(once.session(k)(Kind.HELLO), UNKNOWN) for k in range(100)) == EACH_MOST
    assert once.takes(once.session(10**6)(Kind.HELLO), MASTER)


def test_neither_a_welcome_nor_what_comes_from_elsewhere_holds_the_link() -> None:
    """A slave welcomes every master that has its scene; and from elsewhere a sender could answer its own HELLO."""
    for kind, where in ((Kind.WELCOME, SLAVE), (Kind.REFUSE, SLAVE), (Kind.BACK, OTHER_HOME), (Kind.START, OTHER_HOME)):
        site = Site()
        strange = site.session(5)
        for _ in range(20):
            site.takes(strange(Kind.HELLO), UNKNOWN)
            site.takes(strange(Kind.WELCOME), where)
            site.takes(strange(kind), where)
            site.now += 20 * MS
        for _ in range(20):
            site.run(7)
            for each in (Kind.HELLO, Kind.START, Kind.FORTH):
                assert not site.takes(strange(each), UNKNOWN)
            assert not site.takes(strange(kind), where) or where == SLAVE
        site.run(7)


def test_a_session_that_runs_is_not_taken_over_and_nothing_longer_than_its_messages_is_passed_on() -> None:
    """Before it, too, messages of an unknown host hold nothing: only what the slave has taken up is passed on.

    What is long would fill the memory where the link delays it.
    """
    site = Site()
    strange = site.session(5)
    for kind in (Kind.FORTH, Kind.BACK, Kind.START, Kind.BYE, Kind.WELCOME, Kind.REFUSE):
        assert not site.takes(strange(kind), UNKNOWN)
    site.run(7)
    site.out[0].clear()
    site.out[1].clear()
    for _ in range(40):
        site.run(7, 20)
        for kind in (Kind.HELLO, Kind.FORTH, Kind.START):
            assert not site.takes(strange(kind), UNKNOWN)
        assert not site.takes(site.session(7)(Kind.FORTH), UNKNOWN)
        assert not site.takes(hello(), UNKNOWN)
        for kind in (Kind.WELCOME, Kind.BACK, Kind.START):
            assert not site.takes(strange(kind), OTHER_HOME)
    assert {to for to, _ in site.out[0]} == {MASTER}
    assert {to for to, _ in site.out[1]} == {SLAVE}
    assert len(site.session(7)(Kind.FORTH)) <= site.router._size == 100
    assert not site.takes(encode(Packet(Kind.FORTH, 7, 1, 0, Echo(0, 0), (1.0,)), 1200), MASTER)
    assert not site.takes(bytes(8000), MASTER)


@pytest.mark.parametrize("silent", [MASTER, SLAVE])
def test_a_session_that_one_end_has_left_gives_way(silent: tuple[str, int]) -> None:
    site = Site()
    site.run(7, 200)
    packet, other = site.session(7), site.session(8)
    for _ in range(QUIET_NS // (100 * MS)):
        assert not site.takes(other(Kind.HELLO), UNKNOWN)
        site.now += 100 * MS
        site.takes(*((packet(Kind.BACK), SLAVE) if silent == MASTER else (packet(Kind.FORTH), MASTER)))
    site.meet(8, UNKNOWN)
    assert not site.takes(packet(Kind.FORTH), MASTER), "the slave has taken up another session"


def test_its_own_master_may_ask_anew_and_the_next_session_has_a_link_of_its_own_or_the_one_it_was_turned_to() -> None:
    """All stay counted; the session that both ends are about to end keeps its link."""
    site = Site()
    site.run(7)
    site.run(8)
    for way in (0, 1):
        counts = site.router.counts(way)
        assert counts.received == counts.delivered == 2 * (10 + 2)
    assert not site.takes(site.session(7)(Kind.BACK), SLAVE)
    turned = load_scene("hard_wall", link="bernoulli(0.5)")
    site.router.turn(turned)
    site.run(8)
    site.meet(9)
    for way, kind, sender in ((0, Kind.FORTH, MASTER), (1, Kind.BACK, SLAVE)):
        drawn = turned.link.arrivals(way, 40, MS, SEED, 100).packet.tolist()
        assert [k for k in range(40) if site.takes(site.session(9)(kind, k), sender)] == drawn, "by seed and number"
        counts = site.router.counts(way)
        assert (counts.lost, counts.received) == (40 - len(drawn), counts.delivered + 40 - len(drawn))


def test_a_slave_that_answers_from_another_address_is_heard_there_and_the_next_session_asks_the_first_again(
    capsys: pytest.CaptureFixture[str]
) -> None:
    site = Site()
    packet = site.session(7)
    assert site.takes(packet(Kind.HELLO), MASTER)
    for kind in (Kind.WELCOME, Kind.WELCOME, Kind.BACK):
        assert site.takes(packet(kind), OTHER_HOME)
    assert site.takes(packet(Kind.FORTH), MASTER)
    assert site.out[1][-1][0] == OTHER_HOME
    site.now += 2 * UNMET_NS
    assert site.takes(packet(Kind.FORTH), MASTER)
    assert capsys.readouterr().err.count("--peer 192.0.2.3:9001") == 1
    assert site.takes(site.session(8)(Kind.HELLO), MASTER)
    assert site.out[1][-1][0] == SLAVE


# With keys


def test_two_thousand_hellos_a_second_without_a_cookie_keep_no_master_out_and_nothing_of_them_is_kept() -> None:
    """From 64 ports; each is answered with a cookie, no longer than it was, and neither passed on nor remembered."""
    site, rng = Site(), random.Random(1)
    for k in range(2000):
        site.now += MS // 2
        data = hello(k, random=rng.randbytes(32))
        assert not site.takes(data, (UNKNOWN[0], 6000 + k % 64))
        to, reply = site.out[0].pop()
        assert to == (UNKNOWN[0], 6000 + k % 64)
        assert len(reply) <= len(data)
    assert not list(site.router.flows)
    assert site.ports == []
    began = site.now
    site.asks()
    assert site.takes(sealed(0, 22), SLAVE)
    assert site.now == began, "it waits for no turn"


def test_a_cookie_is_good_for_its_address_its_handshake_and_its_relay_alone_and_runs_out() -> None:
    site = Site()
    data = site.asks(random=b"r" * 32)
    cookie = data[-32:]
    for asked in (data, data.ljust(MTU + EXTRA, b"\0")):
        assert site.takes(asked, MASTER)
        passed = hello(4, random=b"r" * 32).ljust(min(len(asked), MTU), b"\0")
        assert site.out[1][-1][1] == passed, "the slave never sees it, and no hello is longer than any other"
    assert not site.takes(hello(9, cookie=cookie, random=b"r" * 32), UNKNOWN)
    assert not site.takes(hello(9, cookie=cookie, random=b"r" * 32), (MASTER[0], MASTER[1] + 1))
    assert not site.takes(hello(9, cookie=cookie, random=b"s" * 32), ("192.0.2.1", 4001))
    late = Site()
    late.now += 3_600_000 * MS
    assert not late.takes(data, MASTER)
    cookies, record = Cookies(b"k" * 32), (records(hello(1)) or [])[0]
    cookie = cookies.of(record, MASTER, 0)
    assert cookies.is_good(cookie, record, MASTER, SLOT_NS)
    assert not cookies.is_good(cookie, record, MASTER, 2 * SLOT_NS)
    assert not Cookies(b"l" * 32).is_good(cookie, record, MASTER, 0)


def test_masters_that_showed_their_addresses_have_a_port_each_towards_the_slave() -> None:
    """So it judges each by itself; what it says to one is not said to another."""
    site = Site()
    masters = [MASTER, UNKNOWN, (UNKNOWN[0], 5001)]
    for master in masters:
        site.asks(master)
    assert len(site.ports) == 3
    for flow, master in zip(site.router.flows, masters, strict=True):
        assert site.takes(request(4), SLAVE, flow)
        assert site.out[0][-1][0] == master


def test_the_master_that_the_slave_took_up_keeps_the_link_while_both_speak() -> None:
    """A handshake beside its own does not hold it, however long it goes on: the one that is taken up is kept."""
    site, third = Site(), ("203.0.113.9", 5000)
    site.asks(UNKNOWN)
    for _ in range(20):
        site.now += 100 * MS
        site.takes(hello(9, random=b"x" * 32), UNKNOWN)
        site.takes(sealed(3), UNKNOWN)
    site.asks(MASTER)
    strange, honest = site.router.flows
    assert site.takes(sealed(0, 22), SLAVE, honest)
    assert honest.runs(site.now)
    assert not strange.is_accepted
    for number in range(100):
        site.now += 100 * MS
        assert site.takes(sealed(number), MASTER)
        assert site.takes(sealed(number), SLAVE, honest)
        assert not site.takes(hello(2), third)
        assert not site.takes(site.session(5)(Kind.HELLO), third)
    assert not site.takes(sealed(1), UNKNOWN)
    for _ in range(11):
        site.now += 100 * MS
        assert site.takes(sealed(1), MASTER)
    site.asks(third)
    site.takes(sealed(0, 22), SLAVE)
    assert not site.takes(sealed(1), MASTER), "the slave has fallen silent, and has taken up another"


def test_no_host_keeps_out_another_however_many_ports_it_asks_from() -> None:
    """Its own handshakes take room from each other; from the one of another host they take none."""
    site = Site()
    for port in range(2 * MOST_FLOWS):
        site.now += MS
        if port < MOST_FLOWS:
            site.asks((UNKNOWN[0], 6000 + port))
    site.asks(MASTER)
    for port in range(200):
        site.now += MS
        site.takes(hello(1), (UNKNOWN[0], 9100 + port))
        reply = site.out[0][-1][1]
        site.takes(hello(2, cookie=reply[-32:]), (UNKNOWN[0], 9100 + port))
    assert len(list(site.router.flows)) == MOST_FLOWS
    flow = site.router.flows.of(MASTER)
    assert flow is not None
    assert site.takes(sealed(0, 22), SLAVE, flow)
    assert sum(port.closed for port in site.ports) == len(site.ports) - MOST_FLOWS


def test_what_a_master_sends_before_the_slave_has_taken_it_up_is_bounded() -> None:
    """In number, in length and in time; data it cannot have yet."""
    site = Site()
    site.asks()
    assert not site.takes(sealed(1), MASTER)
    assert not site.takes(hello(5) + bytes(MTU), MASTER)
    passed = sum(site.takes(hello(5), MASTER) for _ in range(2 * UNMET_MOST))
    assert passed == UNMET_MOST - 1
    site.now += UNMET_NS
    site.asks()


def test_a_sealed_answer_from_another_address_is_heard_if_it_has_the_number_of_the_hello(
    capsys: pytest.CaptureFixture[str]
) -> None:
    site = Site()
    number, elsewhere = 0x3456_789A_BCDE, ("192.0.2.66", 9001)
    site.asks(number=number - 1)
    for data in (request(number + 1), request(0), sealed(0, 22), sealed(1), hello(number)):
        assert not site.takes(data, elsewhere)
    assert site.takes(request(number), OTHER_HOME)
    assert site.takes(sealed(0, 22), OTHER_HOME)
    assert not site.takes(request(number), elsewhere), "the slave has answered"
    assert site.takes(sealed(1), MASTER)
    assert site.out[1][-1][0] == OTHER_HOME
    assert capsys.readouterr().err.count("--peer 192.0.2.3:9001") == 1


# Beyond this machine: what is not sealed stays out, unless that was asked for and is said

ANY = ("0.0.0.0", 9000)


def test_a_keyless_slave_on_loopback_is_not_opened_to_the_network_by_a_channel(
    capsys: pytest.CaptureFixture[str]
) -> None:
    """Not one datagram of either side is passed on; that is said once, with what to type. What is sealed passes."""
    site = Site(beyond=ANY)
    for _ in range(10):
        for kind in Kind:
            assert not site.takes(site.session(7)(kind), MASTER)
            assert not site.takes(site.session(7)(kind), SLAVE)
        assert not site.takes(b"GET / HTTP/1.1", MASTER)
    assert site.router.unsealed == 10 * (2 * len(Kind) + 1)
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for word in ("192.0.2.1:4000", "0.0.0.0:9000", "--key", "--insecure"):
        assert word in said
    sealing = Site(beyond=ANY)
    sealing.asks()
    assert sealing.takes(sealed(0, 22), SLAVE)
    assert sealing.takes(sealed(1), MASTER)
    assert sealing.takes(sealed(1), SLAVE)
    assert sealing.router.unsealed == 0


def test_both_ends_are_told_by_a_channel_that_was_asked_to_carry_their_link_in_the_open() -> None:
    """By an entry in each other's manifest, that tells and is not compared; the exchange goes on with it.

    Between ends of this machine nothing is marked.
    """
    site = Site(beyond=ANY, insecure=True)
    ends = {True: Session(master=True, manifest=MANIFEST, number=7), False: Session(master=False, manifest=MANIFEST)}
    assert not any(end.in_the_open for end in ends.values())
    waiting = [(True, data) for data in ends[True].due(site.now)]
    while waiting:
        master, data = waiting.pop(0)
        site.now += MS
        assert site.takes(data, MASTER if master else SLAVE)
        _, passed = site.out[1 if master else 0][-1]
        assert len(passed) <= max(1200, len(data) + 24)
        packet = decode(passed, 0)
        assert isinstance(packet, Packet)
        waiting += [(not master, reply) for reply in ends[not master].receive(packet, site.now, len(passed))]
    assert all(end.met == 1 and end.failure is None and end.in_the_open for end in ends.values())
    within = Site(insecure=True)
    for kind, sender in ((Kind.HELLO, MASTER), (Kind.WELCOME, SLAVE)):
        assert within.takes(within.session(7)(kind), sender)
        assert within.out[int(sender == MASTER)][-1][1] == within.session(7)(kind)


@pytest.mark.live
def test_a_channel_on_all_addresses_that_carries_ends_without_keys_is_said_at_all_three(
    command: Callable[..., Any], tmp_path: Path  # noqa: F811 (the fixture)
) -> None:
    scene = ["hard_wall", "--set", "duration=0.5", "--json"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", "--out", str(tmp_path / "s"))
    channel = command("channel", *scene, "--listen", "0.0.0.0:0", "--peer", f"127.0.0.1:{slave.port()}", "--insecure")
    master = command("master", *scene, "--peer", f"127.0.0.1:{channel.port()}", "--out", str(tmp_path / "m"),
                     "--wait", f"{PATIENCE}")
    ends = [one.end() for one in (master, slave)]
    assert [code for code, _, _ in ends] == [0, 0]
    assert all(err.count("INSECURE: a channel on the way") == 1 for _, _, err in ends)
    for folder in ("m", "s"):
        assert any("--insecure" in note for note in summary(tmp_path / folder)["notes"])
    channel.process.terminate()
    code, _, err = channel.end()
    assert code == 0
    assert "INSECURE: the link to 0.0.0.0:" in err
    assert err.count("\n") == 1
