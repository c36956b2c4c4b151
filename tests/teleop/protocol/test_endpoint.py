"""Live ends on a virtual clock: they make the run of virtual time, and no datagram can disturb them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pytest

from channel import LeftOut, LeftOutTicks, Link, parse_link
from teleop import Deadband, Device, EndFit, LowPass, Refused
from teleop.law import At
from teleop.laws.direct import Direct
from teleop.laws.pfra import PFRA
from teleop.laws.pp import PositionPosition
from teleop.laws.wave import Wave
from teleop.laws.wave_position import WavePosition
from teleop.live.options import ticks_of
from teleop.physics.plant import MassDamper
from teleop.protocol.endpoint import Endpoint, Stepped
from teleop.protocol.packet import Echo, Kind, Packet, Rejection, decode, encode
from teleop.protocol.session import Session
from teleop.scene.playout import Energy, Fixed, Hold, Integral, Scaled, Zero
from teleop.scene.scene import Scene
from teleop.simulation.plan import link_plans
from teleop.simulation.virtual import run
from teleop.stages.encoder import Encoder
from teleop.stages.force_cap import Cap
from teleop.stages.watchdog import Watchdog
from tests.fakes import Motion, law_of, usually
from tests.teleop.law.test_law import Timed
from tests.teleop.protocol.ends import MS, ROUGH, SEED, START, Both, met, packet_in, reading, scene
from tests.teleop.protocol.vectors import vectors
from tests.teleop.scene.unlike import LAWS, unlike
from tests.teleop.stages.tumbling import tumbling

# One thing: virtual time and two live ends


def three_axes(law: Any, **parts: Any) -> Scene:
    base = scene(law)
    slanted = ((0.0, 0.004, 0.008), (0.001, 0.0, -0.002))
    return replace(base, axes=3, environment=(base.environment, None, base.environment), start_m=slanted[0],
                   start_s=slanted[1], **parts)


def rough(law: Any = None, **parts: Any) -> Scene:
    return scene(law, link=parse_link(ROUGH), **parts)


def skipping(law: Any, **parts: Any) -> Scene:
    """A fifth of the ticks left out in stretches at both ends."""
    return scene(law, **{"link": parse_link(f"delay(0.01) | {ROUGH}"), "energy": True, "left_out_m": LeftOut(0.2, 3.0),
                         "left_out_s": LeftOut(0.2), "playout": Zero(), **parts})


def full(name: str, make: Callable[[], Scene]) -> Any:
    return pytest.param(make, id=name, marks=pytest.mark.full)


def usual(name: str, make: Callable[[], Scene]) -> Any:
    return pytest.param(make, id=name)


DOG, CAP, QUICK = Watchdog(timeout=0.03, ramp=0.02), Cap(f_max=1.0, slew=200.0), Watchdog(timeout=0.01, ramp=0.01)
DEADBAND = {"deadband": Deadband(k=0.1), "energy": True}
DEVICES = {"device_m": Device(velocity=LowPass(cutoff=40.0)),
           "device_s": Device(encoder=Encoder(step=1e-5), velocity=EndFit(noise=1e-5), every=3, delay=2)}
SCENES = [
    full("constant", scene), usual("no link", lambda: scene(link=None)),
    usual("no delay", lambda: scene(link=parse_link("delay(0)"))), usual("zero", lambda: rough(playout=Zero())),
    usual("integral", rough), full("integral with a queue", lambda: rough(playout=Integral(0.005))),
    usual("fixed and integral", lambda: rough(playout=Fixed(0.008, Integral()))),
    usual("energy", lambda: rough(playout=Energy())), usual("scaled", lambda: rough(playout=Scaled(0.2))),
    full("no link, integral", lambda: scene(link=None, playout=Integral())),
    full("hold", lambda: rough(playout=Hold())), full("fixed", lambda: rough(playout=Fixed(0.008))),
    usual("fixed and hold", lambda: rough(playout=Fixed(0.008, Hold()))),
    usual("blackout, watchdog", lambda: scene(link=parse_link("delay(0.01) | blackout(0.1, 0.1)"), watchdog=DOG)),
    usual("other ways", lambda: scene(link=parse_link("gilbert_elliott(0.1, 0.3) ; delay(0.03) | in_order()"))),
    full("sub-tick", lambda: scene(link=parse_link("uniform(0.0007)"))),
    full("cap", lambda: scene(cap=Cap(f_max=1.0, slew=100.0))), full("direct", lambda: rough(Direct())),
    usual("direct, no hand", lambda: scene(Direct(), hand=None, start_m=0.03)),
    full("pfra", lambda: rough(PFRA(alpha=0.2))), usual("pfra, sensor", lambda: scene(PFRA(alpha=0.2), observer=None)),
    full("wave in three axes", lambda: three_axes(Wave(), link=parse_link(ROUGH))),
    usual("pfra in three axes", lambda: three_axes(PFRA(alpha=0.2), link=parse_link(ROUGH), cap=CAP, watchdog=QUICK,
                                                   duration=0.2)),
    usual("a rotation", lambda: tumbling(law=WavePosition(b=0.02, K=1.0, B=0.02, K_p=0.2, B_p=0.005),
                                         link=parse_link(ROUGH), duration=0.3)),
    *[(usual if law == "wave" else full)(f"{law} in unlike axes", lambda laws=laws: unlike(laws))
      for law, laws in LAWS.items()],
    full("sixteen axes", lambda: replace(unlike(), **{
        "axes": 16, "names": (), "units": (), "start_m": (0.01,) * 16, "start_s": 0.0, "environment": None,
        "law": PositionPosition(), "master": MassDamper(mass=0.1), "slave": MassDamper(mass=0.5), "cap": None,
        "hand": None, "device_m": None})),
    full("deadband, direct", lambda: rough(Direct(), **DEADBAND)),
    usual("deadband, wave", lambda: rough(**DEADBAND)),
    full("deadband, pfra", lambda: rough(PFRA(), watchdog=Watchdog(timeout=0.06), cap=Cap(f_max=9.0), **DEADBAND)),
    usual("skipped, zero", lambda: skipping(Wave())), full("skipped, hold", lambda: skipping(Wave(), playout=Hold())),
    full("skipped, fixed", lambda: skipping(Wave(), playout=Fixed(0.02))),
    usual("skipped, integral", lambda: skipping(Wave(), playout=Integral())),
    usual("skipped, observer, caps, devices", lambda: skipping(
        PFRA(alpha=0.2), cap=Cap(f_max=9.0, slew=2000.0, power=0.05), **DEVICES)),
    usual("skipped, span and gain", lambda: skipping(Timed())),
]


@pytest.mark.parametrize("make", SCENES)
def test_two_ends_on_exact_ticks_make_the_virtual_run_to_the_bit(make: Callable[[], Scene]) -> None:
    """The same ticks left out, and no datagram for what the deadband saves."""
    of = make()
    virtual, live = run(of, seed=SEED), Both(of).run()
    assert virtual.status == "ok"
    live.assert_records(virtual.trace)
    if of.left_out_m is None:
        trace = live.trace()
        assert list(trace) == list(virtual.trace)
        assert all(trace[n].tobytes() == virtual.trace[n].tobytes() for n in trace), "NaN and the sign of zero included"
    assert np.abs(virtual.trace["f_m"]).max() > 0.01
    for e, way in (("m", "fwd"), ("s", "bwd")):
        assert len(live.ticks[e]) < 0.9 * of.ticks or of.left_out_m is None
        assert not live.ends[e].session.ended
        if of.link is not None:
            assert len(live.sent[e]) == virtual.packets[way].sent
            assert live.ends[e].saved == virtual.packets[way].saved
            assert of.deadband is None or live.ends[e].saved > 0.3 * of.ticks


@pytest.mark.parametrize("law", [Timed(), pytest.param(PFRA(alpha=0.2), marks=pytest.mark.full)])
def test_the_watchdog_too_where_packets_are_played_by_a_schedule(law: Any) -> None:
    """In silences and in stalls; live a datagram counts from its coming, a message in virtual time from its playing."""
    stalls = LeftOutTicks((5, 6, 50, *range(230, 250), 260, *range(300, 315), *range(330, 355)))
    of = skipping(law, link=parse_link("delay(0.03) | blackout(0.1, 0.06) | bernoulli(0.1)"), left_out_m=stalls,
                  watchdog=Watchdog(timeout=0.012, ramp=0.01, settle=0.02), cap=Cap(slew=3000.0))
    virtual = run(of, seed=SEED).trace
    assert {0.0, 1.0} < set(virtual["g_m"].tolist())
    assert virtual["g_m"][249] == 1.0  # stalled, and nothing was read
    assert virtual["g_m"][250] == 0.0  # for longer than timeout and ramp
    Both(of, is_stepped=True).run().assert_records(virtual)


def test_a_stepped_end_plays_what_the_schedule_says() -> None:
    of = rough()
    plan = link_plans(of, SEED)[0]
    assert plan is not None
    box = Stepped(plan)
    for k in range(of.ticks):
        assert box.has(k - 1)
        got = box.take(k)
        assert (-1 if got is None else got[0]) == plan.play[k]
        assert got is None or got[1] == f"packet {got[0]}"
        assert not box.has(k)
        for packet in (k, k, max(0, k - 40), 0):  # copies, old and new, are no harm
            box.add(packet, 0, f"packet {packet}")
    assert len(box._held) <= plan.lag + 3


def test_ends_that_go_by_packets_take_no_deadband() -> None:
    with pytest.raises(Refused, match="each end waits for the other's packet of every tick"):
        ticks_of(rough(Direct(), **DEADBAND), None, lockstep=True, spin=False)


# A run whose ticks pass 2**32, of which a packet carries the last 32 bits

WRAP = 2**32 - 200


@usually("law, playout", [(law, playout) for law in (Wave(), PFRA(alpha=0.2)) for playout in (Zero(), Fixed(0.012))],
         (Wave(), Zero()), (PFRA(alpha=0.2), Fixed(0.012)))
def test_a_run_past_2_32_is_the_run_before_it_and_replays_and_numbers_far_off_change_nothing(
    law: Any, playout: Any
) -> None:
    of = scene(law, playout=playout, watchdog=Watchdog(timeout=0.05, ramp=0.02, settle=0.05),
               link=parse_link("delay(0.01) | uniform(0.002) | blackout(0.25, 0.07)"))

    def far_off(k: int, both: Both) -> list[tuple[str, bytes]]:
        """An old message, the first, and the newest under numbers that are far off."""
        forged = []
        for e, other in ("ms", "sm") if k > 30 else ():
            packet = packet_in(both.sent[other][-1], both.ends[e].format.width)
            seqs = [(packet.seq + off) % 2**32 for off in (5000, 2**31 - 1, 2**31, 2**31 + 1, -(2**30) - 50)]
            forged += [(e, data) for data in (both.sent[other][min(k - 20, 220)], both.sent[other][0], *[
                encode(packet._replace(seq=seq, echo=Echo(0, 0))) for seq in seqs])]
        return forged

    plain, wrapped = (Both(of, base=base).run() for base in (10_000, WRAP))
    forged = Both(of, base=WRAP, intruder=far_off).run()
    assert plain.rows == wrapped.rows == forged.rows
    assert plain.played == wrapped.played == forged.played
    for e in "ms":
        one, other = plain.ends[e], wrapped.ends[e]
        assert max(plain.played[e]) > 205
        assert (one.received, one.link.lost(), one.link.reordered) == (
            other.received, other.link.lost(), other.link.reordered)
        assert (one.link.way.least, one.link.way.most, one.link.rtt.most) == (
            other.link.way.least, other.link.way.most, other.link.rtt.most)
        assert one.guard.entries == other.guard.entries == 2  # it joined, and the link was dark for 70 ticks
        assert [event.k - 10_000 for event in one.guard.events] == [event.k - WRAP for event in other.guard.events]
        assert set(forged.ends[e].rejected) == {"early", "old"}
        assert forged.ends[e].rejected["early"] == 3 * (of.ticks - 31)
        assert forged.ends[e].link.lost() == one.link.lost()
        inbox: Any = other.inbox
        assert inbox.refused == 0
        assert inbox.received > 250
        assert inbox._window.newest > WRAP + 200, "numbered from 0 again on the wire, they grow on inside"


# Bad datagrams

ORDINARY = scene(link=parse_link(ROUGH), watchdog=Watchdog(timeout=0.05, ramp=0.02))


def bad_ones(e: str, k: int, width: int) -> list[tuple[str, str, bytes]]:
    """Each with its name and the cause for which it is rejected; `width`: the numbers of a message here."""
    found = []
    for one in vectors()["rejected"]:
        cause = decode(bytes.fromhex(one["hex"]), width)
        assert isinstance(cause, Rejection)
        found.append((one["name"], cause.value, bytes.fromhex(one["hex"])))
    message = Packet(Kind.FORTH if e == "s" else Kind.BACK, 7, k, START + k * MS, Echo(START, 5), (123.0,) * width, 1.0)
    found += [("a message that is not finite", "non-finite", encode(message._replace(payload=(inf,) * width))),
              *[("a message of another session", "session", encode(message._replace(session=number)))
                for number in (0, 6, 8, 700, 7 + 2**32, 7 + 2**63, 2**64 - 1)]]
    other = [(Kind.BYE, 8, "go"), (Kind.START, 8, 0), (Kind.HELLO, 100, {"a": "b"}), (Kind.REFUSE, 100, "no")]
    return found + [(f"{kind} of another session", "session", encode(Packet(kind, number, 0, 0, None, what)))
                    for kind, number, what in other]


def test_a_bad_datagram_is_counted_by_its_cause_and_changes_no_bit_of_the_run() -> None:
    def storm(k: int, both: Both) -> list[tuple[str, bytes]]:
        for e in "ms" if k % 9 == 0 else "":
            end = both.ends[e]
            for name, cause, data in bad_ones(e, k, end.format.width):
                before = Counter(end.rejected)
                assert end.receive(data, START + k * MS) == [], name
                assert Counter(end.rejected) - before == {cause: 1}, name
        return []

    both, undisturbed = Both(ORDINARY, intruder=storm).run(), Both(ORDINARY).run()
    assert both.rows == undisturbed.rows
    assert both.sent == undisturbed.sent  # not even in what the packets' echoes say
    for e in "ms":
        assert both.ends[e].received == undisturbed.ends[e].received


# Messages that are no numbers, or other ones


def spoilt(self: Any, s: Any, at: At, rx: Any) -> Any:
    """The master of Direct, but beyond 1 m something is added to its force and its message."""
    f, tx, s = Direct().master(s, at, rx)
    return (f + self.force, tx._replace(x=tx.x + self.message), s) if at.x > 1.0 else (f, tx, s)


Spoilt = law_of(Direct, name="Spoilt", knobs=[("force", float, 0.0), ("message", float, 0.0)], master=spoilt)


@pytest.mark.parametrize("what", [float("nan"), float("inf"), float("-inf")])
def test_a_message_that_is_not_finite_is_not_sent_and_a_force_is_named(what: float) -> None:
    """The run goes on, and no cap makes a plausible force of it."""
    end = met(scene(Spoilt(message=what)))["m"]
    assert end.tick(0, START, reading(0.0)).datagram is not None
    assert end.tick(1, START + MS, reading(2.0)).datagram is None
    assert end.force_failed is None
    assert end.message_failed
    assert end.tick(2, START + 2 * MS, reading(0.0)).datagram is not None
    for cap in (None, Cap(f_max=5.0), Cap(f_max=5.0, v_max=1.0, power=10.0)):
        end = met(scene(Spoilt(force=what), cap=cap))["m"]
        end.tick(0, START, reading(0.0))
        assert end.force_failed is None
        end.tick(1, START + MS, reading(2.0))
        assert end.force_failed == "f_m", cap


def test_messages_of_ints_and_float32_are_no_malformed_packets_to_the_peer() -> None:
    """As a formula may give them, for forces too."""
    two = np.float32(2)
    start = lambda _self, _at: ((), Motion(0, 0))  # noqa: E731
    whole = law_of(master_start=start, slave_start=start, master=lambda _self, s, _at, _rx: (0, Motion(1, 1), s),
                   slave=lambda _self, s, _at, rx: (np.float32(rx.x), Motion(two, two), s))
    both = Both(scene(whole(), link=parse_link("delay(0)"), energy=False, duration=0.1)).run()
    for e in "ms":
        assert not both.ends[e].rejected
        assert both.ends[e].received == 99
    packet = packet_in(both.sent["s"][-1], 2)
    assert packet.payload == (2.0, 2.0)
    assert packet.E_in is None, "a scene that asks for no ledger sends no stamp"
    assert both.ends["s"].stamp_margin is None


# Energy stamps, delays, round trips, ticks that were missed


def test_no_end_receives_more_energy_than_the_packet_it_plays_says_was_sent_but_by_holding_waves() -> None:
    """The hand is on its way when the link goes dark; its last wave is played for a tenth of a second."""
    for link, playout in ((ROUGH, Zero()), ("bernoulli(0.4) | duplicate(0.3)", Zero()), (ROUGH, Fixed(0.025))):
        both = Both(scene(link=parse_link(link), playout=playout)).run()
        assert min(both.ends[e].stamp_margin or 0.0 for e in "ms") >= -1e-15, (link, playout)
        assert None not in [both.ends[e].stamp_margin for e in "ms"]
    both = Both(scene(link=parse_link("blackout(0.3, 0.1)"), playout=Hold(), duration=0.6)).run()
    assert (both.ends["s"].stamp_margin or 0.0) < -0.01


def test_delays_round_trips_and_sizes_are_seen_as_they_are() -> None:
    ways = Link(fwd=parse_link("delay(0.03)"), bwd=parse_link("delay(0.0105)"))
    both = Both(scene(link=ways, packet_size=222)).run()
    forth, back, rtt = both.ends["s"].link.way, both.ends["m"].link.way, both.ends["m"].link.rtt
    assert (forth.least, forth.most) == (30 * MS, 30 * MS)
    assert (back.least, back.most, back.recent) == (11 * MS, 11 * MS, 11 * MS)
    assert (rtt.least, rtt.most) == (41 * MS, 41 * MS)  # what the other held it for is taken off
    assert forth.count == 400 - 30
    assert {len(data) for e in "ms" for data in both.sent[e]} == {222}


def test_nothing_is_sent_before_there_is_a_session_and_after_a_missed_tick_the_next_one_takes_in_what_came() -> None:
    early = Endpoint(scene(), "s", Session(master=False, manifest={}))
    assert early.tick(0, 0, reading(0.0)).datagram is None
    both = Both(scene(duration=0.02), silent=lambda _e, _k: True).run()
    slave = met(scene())["s"]
    for k in (0, 1, 2, 11, 12):
        for data in both.sent["m"][:k]:
            slave.receive(data, START + k * MS)
        assert slave.tick(k, START + k * MS, reading(0.0)).played == k - 1
