"""Two live ends on a virtual clock: they make the run of virtual time, and no datagram can disturb them."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import msgpack
import numpy as np
import pytest

from channel.link import Link, parse_link
from channel.relay import Relay
from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop.law import At
from teleop.laws.direct import Direct
from teleop.laws.pfra import PFRA
from teleop.laws.pp import PositionPosition
from teleop.laws.wave import Wave
from teleop.laws.wave_position import WavePosition
from teleop.physics.plant import MassDamper
from teleop.protocol.endpoint import Endpoint, Reading, Stepped
from teleop.protocol.guard import UNNAMED
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import VERSION, Echo, Kind, Packet, decode, encode
from teleop.protocol.session import Session
from teleop.scene.loading import load_scene
from teleop.scene.playout import Energy, Fixed, Hold, Integral, Scaled, Zero
from teleop.scene.scene import Scene
from teleop.simulation.plan import link_plans
from teleop.simulation.prepared import prepare
from teleop.simulation.trace import EndRecord, assemble
from teleop.simulation.virtual import run
from teleop.stages.force_cap import Cap
from teleop.stages.watchdog import Watchdog
from tests.begun import begin
from tests.teleop.scene.unlike import LAWS, unlike
from tests.teleop.stages.tumbling import tumbling

MS = 1_000_000
START = 10**12  # tick 0 on both clocks
ROUGH = "uniform(0.012) | bernoulli(0.1) | duplicate(0.2, after=0.003)"
Intruder = Callable[[int, "Both"], Sequence[tuple[str, bytes]]]


def met(scene: Scene) -> dict[str, Endpoint]:
    """Two ends that have agreed to start at START."""
    ends = {}
    for e in "ms":
        session = Session(master=e == "m", manifest=manifest_of(scene), number=7)
        begin(session, START, START)
        session.take_data(START)
        ends[e] = Endpoint(scene, e, session)
    return ends


@dataclass
class Both:
    """The two ends of a scene, driven by hand: ticks are exact, and the relay is the water between."""

    scene: Scene
    seed: int = 3
    intruder: Intruder = lambda _k, _both: ()  # what else comes in before tick k, and at which end
    silent: Callable[[str, int], bool] = lambda _e, _k: False  # what an end sends at this tick is lost
    trouble: Callable[[str, int], str | None] = lambda _e, _k: None  # why an end may hold no force
    ends: dict[str, Endpoint] = field(init=False)
    sent: dict[str, list[bytes]] = field(default_factory=lambda: {"m": [], "s": []})
    rows: dict[str, list[float]] = field(default_factory=lambda: {"m": [], "s": []})
    played: dict[str, list[int]] = field(default_factory=lambda: {"m": [], "s": []})
    held: dict[str, list[tuple[float, ...]]] = field(default_factory=lambda: {"m": [], "s": []})

    def __post_init__(self) -> None:
        self.ends = met(self.scene)

    def run(self) -> Both:
        """All ticks of the scene."""
        scene, link = self.scene, self.scene.link
        relay = Relay(link, self.seed, scene.wire_size)  # type: ignore[arg-type]
        devices: dict[str, Any] = {"m": SimulatedMaster(scene), "s": SimulatedSlave(scene)}
        for k in range(scene.ticks):
            at = k * scene.dt_ns
            for direction, data in relay.due(at):
                assert self.ends["sm"[direction]].receive(data, START + at) == []
            for e, data in self.intruder(k, self):
                self.ends[e].receive(data, START + at)
            for direction, e in enumerate("ms"):
                out = self.ends[e].tick(k, START + at, devices[e].read(k), self.trouble(e, k))
                devices[e].hold(out.force)
                self.rows[e].extend(out.row)
                self.played[e].append(out.played)
                self.held[e].append(out.force)
                if out.datagram is None:
                    assert self.ends[e].session.ended is not None
                    continue
                self.sent[e].append(out.datagram)
                if not self.silent(e, k):
                    relay.receive(direction, k, out.datagram, at)
        return self

    def trace(self) -> dict[str, Any]:
        """As the trace of a run."""
        link = self.scene.link is not None
        return assemble(prepare(self.scene), {
            e: EndRecord(range(self.scene.ticks), self.rows[e], self.played[e] if link else None) for e in "ms"
        })


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Equal to the last bit, NaN and the sign of zero included."""
    return list(one) == list(other) and all(one[n].tobytes() == other[n].tobytes() for n in one)


def scene(law: Any = None, **other: Any) -> Scene:
    knobs: dict[str, Any] = {"law": law or Wave(), "duration": 0.4, "wall": 0.005, "delay": 0.02}
    return replace(load_scene("canonical", **knobs), **other)


def three_axes(law: Any, **other: Any) -> Scene:
    base = scene(law)
    slanted = ((0.0, 0.004, 0.008), (0.001, 0.0, -0.002))
    return replace(base, axes=3, environment=(base.environment, None, base.environment), start_m=slanted[0],
                   start_s=slanted[1], **other)


# One thing: virtual time and two live ends

SCENES = {
    "wave, constant": scene(),
    "wave, no link": scene(link=None),
    "wave, no delay": scene(link=parse_link("delay(0)")),
    "wave, rough, zero": scene(link=parse_link(ROUGH), playout=Zero()),
    "wave, rough, integral": scene(link=parse_link(ROUGH)),
    "wave, rough, integral with a queue": scene(link=parse_link(ROUGH), playout=Integral(0.005)),
    "wave, rough, fixed and integral": scene(link=parse_link(ROUGH), playout=Fixed(0.008, Integral())),
    "wave, rough, energy": scene(link=parse_link(ROUGH), playout=Energy()),
    "wave, rough, scaled": scene(link=parse_link(ROUGH), playout=Scaled(0.2)),
    "wave, no link, integral": scene(link=None, playout=Integral()),
    "wave, rough, hold": scene(link=parse_link(ROUGH), playout=Hold()),
    "wave, rough, fixed": scene(link=parse_link(ROUGH), playout=Fixed(0.008)),
    "wave, rough, fixed and hold": scene(link=parse_link(ROUGH), playout=Fixed(0.008, Hold())),
    "wave, blackout, watchdog": scene(link=parse_link("delay(0.01) | blackout(0.1, 0.1)"),
                                      watchdog=Watchdog(timeout=0.03, ramp=0.02)),
    "wave, other ways": scene(link=parse_link("gilbert_elliott(0.1, 0.3) ; delay(0.03) | in_order()")),
    "wave, sub-tick": scene(link=parse_link("uniform(0.0007)")),
    "wave, cap": scene(cap=Cap(f_max=1.0, slew=100.0)),
    "direct": scene(Direct(), link=parse_link(ROUGH)),
    "direct, no hand": scene(Direct(), hand=None, start_m=0.03),
    "pfra": scene(PFRA(alpha=0.2), link=parse_link(ROUGH)),
    "pfra, sensor": scene(PFRA(alpha=0.2), observer=None),
    "wave in three axes": three_axes(Wave(), link=parse_link(ROUGH)),
    "pfra in three axes": three_axes(PFRA(alpha=0.2), link=parse_link(ROUGH), cap=Cap(f_max=1.0, slew=200.0),
                                     watchdog=Watchdog(timeout=0.01, ramp=0.01)),
    "wave_position on a rotation": tumbling(
        law=WavePosition(b=0.02, K=1.0, B=0.02, K_p=0.2, B_p=0.005), link=parse_link(ROUGH), duration=0.6),
    **{f"{law} in axes that are unlike": unlike(laws) for law, laws in LAWS.items()},
    "sixteen axes": replace(unlike(), **{
        "axes": 16, "names": (), "units": (), "start_m": (0.01,) * 16, "start_s": 0.0, "environment": None,
        "law": PositionPosition(), "master": MassDamper(mass=0.1), "slave": MassDamper(mass=0.5), "cap": None,
        "hand": None, "device_m": None}),
}


@pytest.mark.parametrize("name", SCENES)
def test_two_ends_on_exact_ticks_make_the_virtual_run_to_the_bit(name: str) -> None:
    virtual, live = run(SCENES[name], seed=3), Both(SCENES[name]).run()
    assert virtual.status == "ok"
    assert same(live.trace(), dict(virtual.trace))
    assert np.abs(virtual.trace["f_m"]).max() > 0.01


def test_the_inbox_counts_what_the_schedule_counts() -> None:
    rough = SCENES["wave, rough, fixed"]
    both = Both(rough).run()
    for e, plan in zip("sm", link_plans(rough, 3), strict=True):
        inbox: Any = both.ends[e].inbox
        assert plan is not None
        assert (inbox.played, inbox.overtaken) == (plan.played, plan.overtaken)
        # The virtual run ends with its last tick, which takes in what has come by then.
        assert (inbox.received, inbox.late, inbox.duplicates) == (plan.received, plan.late, plan.duplicates)
        assert both.ends[e].received == plan.received + plan.duplicates


# Bad datagrams

ORDINARY = scene(link=parse_link(ROUGH), watchdog=Watchdog(timeout=0.05, ramp=0.02))


@pytest.fixture(scope="module")
def undisturbed() -> Both:
    return Both(ORDINARY).run()


def forged(both: Both, e: str, k: int, **changes: Any) -> bytes:
    """A packet of this session as it might come to end `e` at tick k, with something changed."""
    width = both.ends[e].format.width
    good = Packet(Kind.FORTH, 7, k, START + k * MS, Echo(START, 5), (123.0,) * width, 1.0)
    return encode(good._replace(**changes))


def unchecked(both: Both, e: str, k: int, **changes: Any) -> bytes:
    """The same without the help of `encode`: fields that it would not write."""
    packet = decode(forged(both, e, k), both.ends[e].format.width)
    assert isinstance(packet, Packet)
    body = msgpack.packb([*packet._replace(**changes)[1:]])
    return sealed(struct.pack("!2sBBH", b"BT", VERSION, 0, len(body)) + body)


def sealed(data: bytes) -> bytes:
    return data + zlib.crc32(data).to_bytes(4, "big")


class Bad(NamedTuple):
    cause: str
    make: Callable[[Both, str, int], bytes]


def always(data: bytes) -> Callable[[Both, str, int], bytes]:
    return lambda _both, _e, _k: data


def resealed(data: bytes, place: int, byte: int) -> bytes:
    changed = bytearray(data[:-4])
    changed[place] = byte
    return sealed(bytes(changed))


BAD = {
    "nothing": Bad("truncated", always(b"")),
    "garbage": Bad("magic", always(bytes(range(50)))),
    "text": Bad("magic", always(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")),
    "cut short": Bad("truncated", lambda both, e, k: forged(both, e, k)[:40]),
    "cut to its head": Bad("truncated", lambda both, e, k: forged(both, e, k)[:6]),
    "another version": Bad("version", lambda both, e, k: resealed(forged(both, e, k), 2, VERSION + 1)),
    "a bit flipped": Bad("checksum", lambda both, e, k: forged(both, e, k)[:-20] + b"\xff" + forged(both, e, k)[-19:]),
    "a checksum of zeros": Bad("checksum", lambda both, e, k: forged(both, e, k)[:-4] + b"\0\0\0\0"),
    "another session": Bad("session", lambda both, e, k: forged(both, e, k, session=8)),
    "another session's farewell": Bad("session", always(encode(Packet(Kind.BYE, 8, 0, 0, None, "go")))),
    "another session's start": Bad("session", always(encode(Packet(Kind.START, 8, 0, 0, None, 0)))),
    "another session's hello": Bad("session", always(encode(Packet(Kind.HELLO, 100, 0, 0, None, {"a": "b"})))),
    "not a number": Bad("non-finite", lambda both, e, k: unchecked(both, e, k, payload=(1.0, 2.0, 3.0, float("nan")))),
    "infinite": Bad("non-finite", lambda both, e, k: unchecked(both, e, k, payload=(float("-inf"), 1.0, 2.0, 3.0))),
    "infinite energy": Bad("non-finite", lambda both, e, k: unchecked(both, e, k, E_in=float("inf"))),
    "a text for a number": Bad("malformed", lambda both, e, k: unchecked(both, e, k, payload=("1",))),
    "too many numbers": Bad("malformed", lambda both, e, k: unchecked(both, e, k, payload=(1.0, 2.0))),
    "too few numbers": Bad("malformed", lambda both, e, k: unchecked(both, e, k, payload=())),
    "a negative number": Bad("malformed", lambda both, e, k: unchecked(both, e, k, seq=-1)),
    "a number beyond all": Bad("malformed", lambda both, e, k: unchecked(both, e, k, seq=2**40)),
    "of no kind": Bad("malformed", lambda both, e, k: resealed(forged(both, e, k), 3, 99)),
    "enormous": Bad("oversize", always(bytes(60000))),
    "enormous and well made": Bad("oversize", lambda both, e, k: sealed(forged(both, e, k)[:-4].ljust(2000, b"\0"))),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_datagram_is_counted_by_its_cause_and_changes_no_bit_of_the_run(name: str, undisturbed: Both) -> None:
    bad = BAD[name]
    both = Both(ORDINARY, intruder=lambda k, both: [(e, bad.make(both, e, k)) for e in "ms"]).run()
    assert both.rows == undisturbed.rows
    assert both.sent == undisturbed.sent  # not even in what the packets' echoes say
    for e in "ms":
        assert dict(both.ends[e].rejected) == {bad.cause: ORDINARY.ticks}
        assert both.ends[e].received == undisturbed.ends[e].received


def test_all_of_them_together_change_nothing_either(undisturbed: Both) -> None:
    def storm(k: int, both: Both) -> list[tuple[str, bytes]]:
        return [(e, bad.make(both, e, k)) for e in "ms" for bad in BAD.values()]

    assert Both(ORDINARY, intruder=storm).run().rows == undisturbed.rows


@pytest.mark.parametrize("ago", [1, 30, 200])
@pytest.mark.parametrize("playout", [Zero(), Hold(), Fixed(0.005)])
def test_replayed_packets_change_nothing(ago: int, playout: Any) -> None:
    """Everything that was sent is sent once more, `ago` ticks later and straight to the end."""
    quiet = replace(ORDINARY, link=parse_link("delay(0.001)"), playout=playout)
    plain = Both(quiet).run()

    def replay(k: int, both: Both) -> list[tuple[str, bytes]]:
        return [(e, both.sent[other][k - ago]) for e, other in ("ms", "sm") if k >= ago]

    again = Both(quiet, intruder=replay).run()
    assert again.rows == plain.rows
    assert again.sent == plain.sent
    for e in "ms":
        one, other = plain.ends[e], again.ends[e]
        assert (other.way.count, other.way.least, other.way.most) == (one.way.count, one.way.least, one.way.most)
        assert other.link.rtt.most == one.link.rtt.most
        inbox: Any = other.inbox
        assert (inbox.received, inbox.duplicates) == (quiet.ticks - 1, quiet.ticks - ago)


def test_a_packet_from_far_ahead_does_not_make_the_honest_ones_old(undisturbed: Both) -> None:
    """Of this session and well made, so it has to be believed as far as it goes; the later ones are played still."""
    def ahead(k: int, both: Both) -> list[tuple[str, bytes]]:
        return [(e, forged(both, e, 2**32 - 1)) for e in "ms" if k == 50]

    both = Both(ORDINARY, intruder=ahead).run()
    assert both.played == undisturbed.played


def test_a_storm_of_packets_for_later_is_bounded_in_memory() -> None:
    both = Both(scene())
    end = both.ends["s"]
    for i in range(20_000):
        end.receive(forged(both, "s", i % 4000), START)
    most = round(UNNAMED.timeout / 1e-3) + 2
    assert end.rejected["early"] == 5 * (4000 - most), "a timeout ahead is too far: the two share one grid"
    assert end.session.ended is None
    inbox: Any = end.inbox
    assert inbox.take(1100) is not None
    assert inbox.received + inbox.duplicates == 5 * most


# What is not finite


@dataclass(frozen=True, kw_only=True)
class Spoilt:
    """Direct, but at one tick the master's message or its force is no number."""

    at: float  # the clock's tick is not in At: this is the position from which on it is spoilt
    force: float = 0.0
    message: float = 0.0

    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At) -> Any:
        return Direct().master_start(at)

    def slave_start(self, at: At) -> Any:
        return Direct().slave_start(at)

    def master(self, s: Any, at: At, rx: Any) -> Any:
        f, tx, s = Direct().master(s, at, rx)
        return (f + self.force, tx._replace(x=tx.x + self.message), s) if at.x > self.at else (f, tx, s)

    def slave(self, s: Any, at: At, rx: Any) -> Any:
        return Direct().slave(s, at, rx)


def reading(x: float) -> Reading:
    return Reading((x,), (0.0,), (0.0,))


@pytest.mark.parametrize("what", [float("nan"), float("inf"), float("-inf")])
def test_a_message_that_is_not_finite_is_not_sent_and_the_run_goes_on(what: float) -> None:
    end = met(scene(Spoilt(at=1.0, message=what)))["m"]
    assert end.tick(0, START, reading(0.0)).datagram is not None
    assert end.tick(1, START + MS, reading(2.0)).datagram is None
    assert end.force_failed is None
    assert end.message_failed
    assert end.tick(2, START + 2 * MS, reading(0.0)).datagram is not None


@pytest.mark.parametrize("cap", [None, Cap(f_max=5.0), Cap(f_max=5.0, v_max=1.0, power=10.0)])
@pytest.mark.parametrize("what", [float("nan"), float("inf"), float("-inf")])
def test_a_force_that_is_not_finite_is_named(what: float, cap: Cap | None) -> None:
    """No cap makes a plausible force of it."""
    end = met(scene(Spoilt(at=1.0, force=what), cap=cap))["m"]
    end.tick(0, START, reading(0.0))
    assert end.force_failed is None
    end.tick(1, START + MS, reading(2.0))
    assert end.force_failed == "f_m"


def test_nothing_is_sent_before_there_is_a_session() -> None:
    end = Endpoint(scene(), "s", Session(master=False, manifest={}))
    assert end.tick(0, 0, reading(0.0)).datagram is None


# Watchdog, cap and slew, live


def test_the_watchdog_lets_go_when_the_peer_falls_silent_and_takes_hold_when_it_is_back() -> None:
    dog = Watchdog(timeout=0.05, ramp=0.02, settle=0.03)
    pressing = scene(duration=0.8, link=parse_link("delay(0.01)"), watchdog=dog)
    both = Both(pressing, silent=lambda e, k: e == "m" and 300 <= k < 500).run()
    gain = both.trace()["g_s"]
    force = np.abs([f[0] for f in both.held["s"]])
    # The last packet before the silence, number 299, is played at tick 309.
    assert (gain[20:360] == 1.0).all()
    assert gain[360] < 1.0
    assert (np.diff(gain[359:380]) < 0.0).all()
    assert (gain[380:540] == 0.0).all()  # packets are there again from tick 510 on, and settle
    assert (force[380:540] == 0.0).all()
    assert np.diff(gain[540:560]).min() > 0.0
    assert (gain[561:] == 1.0).all()
    assert force[560:].max() > 0.1
    assert [event[:2] for event in both.ends["s"].guard.events] == [(360, "safe"), (540, "released")]
    assert "silence" in both.ends["s"].guard.events[0].why


def test_cap_and_slew_hold_at_every_tick() -> None:
    limit = Cap(f_max=0.5, slew=400.0)
    both = Both(scene(link=parse_link(ROUGH), cap=limit, playout=Zero())).run()  # whose gaps make the force jump
    for e in "ms":
        force = np.array([0.0, *[f[0] for f in both.held[e]]])
        assert np.abs(force).max() == 0.5
        assert 0.3 < np.abs(np.diff(force)).max() <= 400.0 * 1e-3 + 1e-12


def test_where_the_scene_names_no_watchdog_a_long_silence_makes_an_end_safe_live() -> None:
    both = Both(scene(duration=1.6, link=parse_link("delay(0.01)")), silent=lambda e, k: e == "m" and k >= 300).run()
    guard = both.ends["s"].guard
    force = np.array([f[0] for f in both.held["s"]])
    assert guard.events[0].k == 309 + 801
    assert (force[1200:] == 0.0).all()
    assert np.abs(force[900:1100]).min() > 0.0, "until then it acts as in virtual time"


@pytest.mark.parametrize(("playout", "played"), [(Zero(), 0.0), (Fixed(0.5), 0.5), (Fixed(2.0), 2.0)])
def test_a_session_is_renewed_only_after_the_watchdog_has_let_go(playout: Any, played: float) -> None:
    """With a fixed playout the last messages act for that long: a new session would have cut their force off."""
    dog = Watchdog(timeout=0.4, ramp=0.3)
    end = met(scene(playout=playout, watchdog=dog))["s"]
    assert end.session.liveness.renew_ns >= (played + dog.timeout + dog.ramp) * 1e9
    assert end.session.liveness.renew_ns <= max(1.0, played + dog.timeout + dog.ramp + 0.1) * 1e9


@pytest.mark.parametrize("seen", [True, False])
def test_a_device_that_is_not_where_the_scene_begins_is_taken_up_where_it_is_and_from_zero_force(seen: bool) -> None:
    """As after both ends were started anew: 15 cm apart and a stiff coupling.

    `seen`: before tick 0. If nobody could read it then, where it is at the first tick counts.
    """
    stiff = scene(Direct(K=500.0, B=5.0), duration=0.5, link=None)
    ends, force = met(stiff), []
    if seen:
        ends["m"].place((0.15,))
        ends["s"].place((0.0,))
    else:
        ends["m"].left_out(-1, "the device: its bus is not up yet")
    for k in range(400):
        now = START + k * MS
        forth = ends["m"].tick(k, now, reading(0.15)).datagram
        out = ends["s"].tick(k, now, reading(0.0 if k < 200 else -0.002))
        assert forth is not None
        assert out.datagram is not None
        ends["s"].receive(forth, now + 1)
        ends["m"].receive(out.datagram, now + 1)
        force.append(out.force[0])
        assert out.row[0] == (0.0 if k < 200 else -0.002), "the record is of the device"
    assert max(map(abs, force[:200])) < 1e-9
    assert force[-1] == pytest.approx(1.0)
    assert [event.what for event in ends["m"].guard.events][-1] == "released"
    assert {event.what for event in ends["m"].guard.events} == {"session", "safe", "released"}
    assert ends["s"].guard.events == []


# Energy stamps, delays, round trips


@pytest.mark.parametrize("link", ["delay(0.02)", ROUGH, "bernoulli(0.4) | duplicate(0.3)", "uniform(0.03)"])
@pytest.mark.parametrize("playout", [Zero(), Fixed(0.025)])
def test_no_end_receives_more_energy_than_the_packet_it_plays_says_was_sent(link: str, playout: Any) -> None:
    both = Both(scene(link=parse_link(link), playout=playout)).run()
    for e in "ms":
        margin = both.ends[e].stamp_margin
        assert margin is not None
        assert margin >= -1e-15


def test_holding_waves_shows_in_the_stamps() -> None:
    """The hand is on its way when the link goes dark; its last wave is played for a tenth of a second."""
    both = Both(scene(link=parse_link("blackout(0.3, 0.1)"), playout=Hold(), duration=0.6)).run()
    assert (both.ends["s"].stamp_margin or 0.0) < -0.01


def test_a_scene_that_asks_for_no_ledger_sends_no_stamp() -> None:
    both = Both(scene(energy=False, duration=0.05)).run()
    packet = decode(both.sent["m"][-1], 1)
    assert isinstance(packet, Packet)
    assert packet.E_in is None
    assert both.ends["s"].stamp_margin is None


def test_delays_and_round_trips_are_seen_as_they_are() -> None:
    ways = Link(fwd=parse_link("delay(0.03)"), bwd=parse_link("delay(0.0105)"))  # type: ignore[arg-type]
    both = Both(scene(link=ways)).run()
    forth, back, rtt = both.ends["s"].way, both.ends["m"].way, both.ends["m"].link.rtt
    assert (forth.least, forth.most) == (30 * MS, 30 * MS)
    assert (back.least, back.most, back.recent) == (11 * MS, 11 * MS, 11 * MS)
    assert (rtt.least, rtt.most) == (41 * MS, 41 * MS)  # what the other held it for is taken off
    assert forth.count == 400 - 30


def test_every_packet_is_as_long_as_the_scene_says() -> None:
    both = Both(scene(packet_size=222, duration=0.1)).run()
    assert {len(data) for e in "ms" for data in both.sent[e]} == {222}


# Ticks that were missed


def test_a_missed_tick_is_left_out_and_the_next_one_takes_in_what_came() -> None:
    ends = met(scene())
    master, slave = SimulatedMaster(scene()), ends["s"]
    datagrams = []
    for k in range(20):
        out = ends["m"].tick(k, START + k * MS, master.read(k))
        master.hold(out.force)
        datagrams.append(out.datagram)
    for k in (0, 1, 2, 11, 12):
        for data in datagrams[:k]:
            assert data is not None
            slave.receive(data, START + k * MS)
        assert slave.tick(k, START + k * MS, reading(0.0)).played == k - 1


# Stepped ends


def test_a_stepped_end_plays_what_the_schedule_says() -> None:
    rough = scene(link=parse_link(ROUGH))
    plan = link_plans(rough, 3)[0]
    assert plan is not None
    box = Stepped(plan)
    for k in range(rough.ticks):
        assert box.has(k - 1)
        got = box.take(k)
        assert (-1 if got is None else got[0]) == plan.play[k]
        assert got is None or got[1] == f"packet {got[0]}"  # type: ignore[comparison-overlap]
        assert not box.has(k)
        for packet in (k, k, max(0, k - 40), 0):  # copies, old and new, are no harm
            box.add(packet, 0, f"packet {packet}")  # type: ignore[arg-type]
    assert len(box._held) <= plan.lag + 3


class Whole(NamedTuple):
    x: float


@dataclass(frozen=True, kw_only=True)
class Counting:
    """A law whose messages and forces are whole numbers, or numpy's, as a formula may give them."""

    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At) -> tuple[tuple[()], Whole]:
        return (), Whole(0)

    def slave_start(self, at: At) -> tuple[tuple[()], Whole]:
        return (), Whole(0)

    def master(self, s: tuple[()], at: At, rx: Whole) -> tuple[float, Whole, tuple[()]]:
        return 0, Whole(1), s

    def slave(self, s: tuple[()], at: At, rx: Whole) -> tuple[float, Whole, tuple[()]]:
        return np.float32(rx.x), Whole(np.float32(2)), s  # type: ignore[arg-type]


def test_messages_of_ints_and_float32_are_no_malformed_packets_to_the_peer() -> None:
    both = Both(scene(Counting(), link=parse_link("delay(0)"), energy=False)).run()
    for e in "ms":
        assert not both.ends[e].rejected
        assert both.ends[e].received > 300
    packet = decode(both.sent["s"][-1], 1)
    assert isinstance(packet, Packet)
    assert packet.payload == (2.0,)
