"""A million hostile datagrams at each end of a running session, twenty of them between two ticks.

Nothing of them is seen in what the two ends do: rows, forces and messages are the same to the bit as without them. The
exceptions are those of whoever knows the session where there are no keys, and have a test of their own. A farewell with
the right number is one of them and not fired here: it stops the run (tests/teleop/threats).

The short form is a hundredth of it: `pytest -m fuzz tests/fuzz` is the whole.
"""

from __future__ import annotations

import random
from collections import Counter
from math import isfinite
from typing import Any

import pytest

from teleop.protocol.endpoint import Endpoint
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import DATA, Kind, Packet, decode, encode
from teleop.protocol.secure.dtls_record import Dropped
from teleop.protocol.session import MOST_WELCOMED, Session
from tests.fuzz.datagrams import Hostile, View
from tests.fuzz.running import AT, CAP, MS, Memory, Running, from_outside, fuzzed

EACH = 20  # datagrams a tick
SHORT, LONG = 500, 50_000  # ticks
FORMS = [pytest.param(SHORT, id="short"),
         pytest.param(LONG, id="million", marks=[pytest.mark.fuzz, pytest.mark.timeout(3600)])]
MOST_BYTES = 1 << 20  # that the process may grow by after the first tenth
MOST_BLOCKS = 3000  # of Python's, a fraction of what one each of a short form's datagrams would be

Address = tuple[str, int]


class Fire:
    """Fires at a running end, and looks at the memory after a tenth and at the end."""

    def __init__(self, ticks: int) -> None:
        self.ticks, self.done = ticks, 0
        self.counts: Counter[str] = Counter()
        self.before: Memory | None = None
        self.grown = (0, 0)

    def look(self) -> None:
        self.done += 1
        if self.done == self.ticks // 10:
            self.before = Memory()
        elif self.done == self.ticks and self.before is not None:
            self.grown = Memory().since(self.before)

    def tell(self, what: str) -> None:
        blocks, grown = self.grown
        print(f"\n{what}: {sum(self.counts.values())} datagrams, grown by {blocks} blocks, {grown} bytes")


class AtOpen(Fire):
    """From outside, in the open."""

    def __init__(self, ticks: int, others: list[bytes], *, inside: bool = False) -> None:
        super().__init__(ticks)
        self.others, self.inside = others, inside
        self.hostile: Hostile | None = None

    def __call__(self, run: Running) -> list[tuple[bytes, Address]]:
        if self.hostile is None:
            self.hostile = Hostile(random.Random(5), run.view, self.others, [])
        self.look()
        if self.inside:
            self.counts["inside"] += EACH
            return [(self.hostile.inside(), AT["m"]) for _ in range(EACH)]
        return from_outside(self.hostile, EACH, self.counts)


def is_flat(fire: Fire, ticks: int) -> None:
    blocks, grown = fire.grown
    # What is kept has its bound after a while: the messages that wait in an inbox, the pages of a process.
    assert blocks < MOST_BLOCKS or (ticks == SHORT and "inside" in fire.counts)
    assert grown < MOST_BYTES or ticks == SHORT


def bounded(run: Running, e: str) -> None:
    """What an end keeps for its peer's words has a bound."""
    end: Any = run.ends[e]
    inbox = end.inbox
    kept = inbox._queued + inbox.waiting + len(inbox._waits) + len(inbox._coming) + len(inbox._copies)
    assert kept <= 4 * inbox._room
    assert len(end._reception.window._seen) == 4096
    assert len(end.session._welcomed) <= 1024
    assert len(end.rejected) <= 12
    assert len(end.guard.events) <= 10_000


_PLAIN: dict[int, dict[str, str]] = {}


def plain(ticks: int) -> dict[str, str]:
    """What both ends do when nobody disturbs them."""
    if ticks not in _PLAIN:
        _PLAIN[ticks] = Running(fuzzed(ticks), 7).run().digest()
    return _PLAIN[ticks]


@pytest.mark.parametrize("ticks", FORMS)
@pytest.mark.parametrize("e", "ms")
def test_in_the_open_nothing_from_outside_is_seen_in_a_run(e: str, ticks: int, others: list[bytes]) -> None:
    fire = AtOpen(ticks, others)
    run = Running(fuzzed(ticks), 7, at=e, fire=fire).run()
    fire.tell(f"open {e}")
    assert run.digest() == plain(ticks)
    end, session = run.ends[e], run.ends[e].session
    assert fire.hostile is not None
    assert (session.number, session.met, session.failure, session.farewell) == (7, 1, None, None)
    assert len(fire.counts) == len(fire.hostile.outside) == 17
    assert run.fired == EACH * fire.done >= EACH * ticks
    # Each is rejected, or a message that was told from its copies, or a word of the session, which is not counted.
    assert run.fired + run.honest == sum(end.rejected.values()) + end.received + run.words
    inbox: Any = end.inbox
    assert inbox.refused == 0
    bounded(run, e)
    is_flat(fire, ticks)


@pytest.mark.parametrize("ticks", FORMS)
@pytest.mark.parametrize("e", "ms")
def test_in_the_open_forged_messages_of_the_session_itself_pass_no_cap_and_end_no_run(
    e: str, ticks: int, others: list[bytes]
) -> None:
    """They are believed, also of what the peer has not heard or of when it is: the session then begins anew.

    Finite forces are asserted at every tick of every run here.
    """
    fire = AtOpen(ticks, others, inside=True)
    run = Running(fuzzed(ticks), 7, at=e, fire=fire).run()
    fire.tell(f"forged {e}")
    assert run.digest() != plain(ticks), "or they were not believed at all"
    assert run.most_force <= CAP
    end = run.ends[e]
    assert (end.session.failure, end.session.farewell, end.force_failed) == (None, None, None)
    assert end.session.number == 7 + end.session.met - 1 + end.session.meeting
    told = end.link.clock.drift, end.link.loss(), end.link.jitter_ns, end.link.rtt.recent, end.link.way.recent
    assert all(number is None or isfinite(number) for number in told)
    # What comes between a session's beginning and its first tick is counted by neither session.
    uncounted = run.fired + run.honest - sum(end.rejected.values()) - end.received - run.words
    assert 0 <= uncounted <= (EACH + 2) * (end.session.met - 1)
    bounded(run, e)
    is_flat(fire, ticks)


@pytest.mark.parametrize("ticks", FORMS)
@pytest.mark.parametrize("e", "ms")
def test_an_end_that_waits_for_the_other_answers_no_more_than_it_is_asked(
    e: str, ticks: int, others: list[bytes]
) -> None:
    """Where there are no keys anybody may ask a slave; a master answers only who knows the number of its session."""
    scene = fuzzed(1000)
    session = Session(master=e == "m", manifest=manifest_of(scene), number=7 if e == "m" else None)
    end = Endpoint(scene, e, session)
    hostile = Hostile(random.Random(9), View(10**6, end.format.hears, end.format.width), others, [])
    fire, words, answers = Fire(ticks), 0, 0
    for k in range(ticks):
        now = 10**12 + k * MS
        fire.look()
        for _ in range(EACH):
            name, data = hostile.shot()
            if hostile.dice.random() < 0.2:
                asks = Packet(Kind.HELLO, hostile.dice.getrandbits(64), 0, now, None, manifest_of(scene))
                name, data = "asking", encode(asks, hostile.dice.choice((None, 1200)))
            fire.counts[name] += 1
            packet = decode(data, end.format.width)
            words += isinstance(packet, Packet) and packet.kind not in DATA and session.belongs(packet, now)
            replies = end.receive(data, now)
            assert len(replies) <= 1
            assert sum(map(len, replies)) <= len(data)
            answers += len(replies)
        session.due(now)
        assert len(session._welcomed) <= MOST_WELCOMED
    fire.tell(f"waiting {e}")
    assert session.met == 0, "nobody has followed the exchange through"
    assert (answers > 0) == (e == "s")
    assert sum(fire.counts.values()) == sum(end.rejected.values()) + words
    assert end.received == 0
    is_flat(fire, ticks)


class AtSealed(Fire):
    """At an end with keys, from the very first on; from its peer's own address once there is an association."""

    def __init__(self, ticks: int, others: list[bytes], recorded: list[bytes], keys: list[Any], e: str) -> None:
        super().__init__(ticks)
        from tests.fuzz.records import HostileRecords

        self.make: Any = HostileRecords
        self.given = others, recorded, keys[2], keys[1 if e == "s" else 0].fingerprint
        self.hostile: Any = None
        self.not_handshake = 0

    def __call__(self, run: Running) -> Any:
        if self.hostile is None:
            self.hostile = self.make(random.Random(6), run.view, *self.given)
        self.look()
        e = run.at
        for _ in range(EACH):
            name, data, address = self.hostile.shot(run.now, spoofs=run.ends[e].session.met > 0)
            self.counts[name] += 1
            self.not_handshake += run.links[e].ready and not (data and data[0] in (20, 22))
            yield data, address
            self.hostile.answered(run.drawn, address, run.now)


@pytest.mark.parametrize("ticks", FORMS)
@pytest.mark.parametrize("e", "ms")
def test_with_keys_nothing_that_is_not_the_peers_own_comes_as_far_as_an_end(
    e: str, ticks: int, others: list[bytes], recorded: list[bytes], keys: list[Any]
) -> None:
    from tests.fuzz.records import links

    both = links(keys)
    reference = Running(fuzzed(ticks), 7, links=links(keys)).run()
    fire = AtSealed(ticks, others, recorded, keys, e)
    run = Running(fuzzed(ticks), 7, links=both, at=e, fire=fire, early=True).run()
    fire.tell(f"sealed {e}")
    assert run.opened == 0
    end, link = run.ends[e], both[e]
    assert dict(end.rejected) == {}
    assert end.received + run.words == run.honest
    assert (link.associations, link.address) == (1, AT["sm"[e == "s"]])
    assert run.digest() == reference.digest()
    # A handshake may be answered instead of being dropped; all else is counted.
    assert sum(link.dropped.values()) >= fire.not_handshake
    assert set(link.dropped) <= set(Dropped)
    if link._gate is not None:
        assert link._gate.refused is not None, "the strangers were refused for their certificate"
        assert len(link._gate._begun) <= 8
    bounded(run, e)
    is_flat(fire, ticks)


@pytest.mark.parametrize("ticks", FORMS)
def test_a_gate_lets_in_nobody_but_the_pinned_peer(
    ticks: int, others: list[bytes], recorded: list[bytes], keys: list[Any]
) -> None:
    """Every 100 ms an honest end comes to the gate, through all that is fired at it."""
    from teleop.protocol.secure.association import Association
    from teleop.protocol.secure.gate import Gate, is_for_gate
    from tests.fuzz.records import SECRET, HostileRecords

    gate = Gate(keys[1], keys[0].fingerprint, SECRET)
    hostile = HostileRecords(random.Random(7), View(7, Kind.FORTH, 5), others,
                             [data for data in recorded if is_for_gate(data)], keys[2], keys[1].fingerprint)
    hostile.makes = (hostile.crossed, hostile.other_head, hostile.two_in_one, hostile.hello, hostile.open.flipped,
                     hostile.open.cut, hostile.open.longer, hostile.open.noise, hostile.open.record)
    fire, met, came = Fire(ticks), 0, 0
    honest: Association | None = None
    way: list[bytes] = []
    owed: Counter[Address] = Counter()  # bytes from each address, less those sent there
    for k in range(ticks):
        now = k * MS
        fire.look()
        for _ in range(EACH):
            name, data, address = hostile.shot(now, spoofs=False)
            fire.counts[name] += 1
            let_in, replies = gate.receive(data, address, now)
            assert let_in is None
            owed[address] += len(data) - sum(map(len, replies))
            assert owed[address] >= 0
            hostile.answered(replies, address, now)
        if k % 100 == 0:
            met += honest is not None and honest.ready
            came += 1
            honest = Association.towards(keys[0], keys[1].fingerprint, now)
            way = honest.begin(now)
        assert honest is not None
        back: list[bytes] = []
        for data in [*way, *honest.due(now)]:
            back += gate.receive(data, AT["m"], now)[1]
        way = [each for data in back for each in honest.receive(data, now)[1]]
        assert len(gate._begun) <= 8
    fire.tell("gate")
    assert met >= 0.9 * (came - 1)
    assert gate.refused is not None
    assert hostile.open.view.newest == -1
    is_flat(fire, ticks)
